"""The options of a search with their defaults, without JAX."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields

from elitelanes_jax._util.checks import check_named, flag, nonblank, none_or, one_of, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Option, option
from elitelanes_jax._util.types import OptionValue, Plain, UserValue
from elitelanes_jax.formats.road_map import as_maps
from elitelanes_jax.network.codes import check_alphabet
from elitelanes_jax.network.records import Weights
from elitelanes_jax.problem.descriptor import Axis, parse_axes
from elitelanes_jax.problem.features import TOWN_FEATURES, check_features
from elitelanes_jax.problem.fixed_cells import FixedCells, parse_fixed_cells
from elitelanes_jax.problem.inventory import parse_inventory, parse_numbers
from elitelanes_jax.problem.ranges import Range, parse_ranges
from elitelanes_jax.problem.rules import RULES
from elitelanes_jax.problem.targets import ExampleValues, parse_targets
from elitelanes_jax.search.style import read_style

METHODS = {
    "map-elites": ("tuned", "paper", "standard", "irregular"),
    "ea": ("tuned", "paper"),
    "pso": ("tuned", "paper"),
    "gwo": ("tuned", "paper"),
}
"""The methods, and the presets of each, the default first."""

CUSTOM = "custom"
"""The preset, in results, of a configuration that equals no preset.

It is also the method of a user's own optimiser.
"""

Grids = tuple[tuple[tuple[int, ...], ...], ...]
"""Maps as hashable values: for each map its rows of tile codes."""


def check_method(method: UserValue) -> str:
    """Checks the name of a method: one of `METHODS`, or `CUSTOM`, which only results have."""
    if isinstance(method, str) and method == CUSTOM:
        return method
    return one_of(*METHODS)(method)


def parse_weights(
    weights: UserValue, user_features: Collection[str] = ()
) -> tuple[tuple[str, int], ...]:
    """Reads `Weights`, or what `parse_numbers` reads.

    Names of the user's features are also accepted.
    """
    known = (*Weights._fields, *TOWN_FEATURES, *user_features)
    if isinstance(weights, Weights):
        weights = weights._asdict()
    # The fitness has 32 bits. How large a weight may be depends on the shape, see `resolve`.
    return parse_numbers("weights", known, weights, least=-(2**31))


def parse_initial(initial: UserValue) -> Grids:
    """Reads one map or several, as `as_maps` takes them; only the default, (), has none."""
    maps = as_maps(initial)
    if not maps and not isinstance(initial, tuple):
        raise InputError("", "at least one map", "none")
    grids = []
    for road_map in maps:
        rows = road_map.codes.tolist()
        grids.append(tuple(tuple(row) for row in rows))
    return tuple(grids)


@dataclass(frozen=True)
class Settings:
    """A value for each option of a search.

    `SearchSpec` has the options that a user gave. `elitelanes_jax.search.resolve.resolve` adds
    those of the style and of the example maps, and the defaults.

    Each field has its default, its check and, if it is an option of the command line, the name of
    its value there; `Option` describes the other arguments. A check with ``after="features"`` also
    takes the names of the user's own features.

    Attributes:
      style: named options: town, paper, or a .toml file; your options override them
      like: example maps, map.json or Duckietown's .yaml; maps have features in the same ranges, and
        none is a copy
      method: the method: map-elites, ea, pso or gwo
      preset: configuration of the method: tuned, paper, or for map-elites standard or irregular
      evaluations: grids that each run evaluates, rounded up to whole generations
      generations: generations of each run, instead of evaluations
      features: names of the user's own features, whose kernels `evolve` takes
      axes: axes of the niches, such as straight_share:10; by default the preset's
      where: ranges that every map meets, such as crossings=6..10, bridges=0 or straight_share=0.3..
      weights: weights of the fitness that differ from the usual ones, such as dead_ends=480
      targets: features of example maps, by name; the chosen maps' features have the same
        distribution
      fix: JSON rows of tile codes that every map keeps, null for free cells
      rules: rules that every map keeps: duckietown
      inventory: tiles that maps may need at most, such as straight=20 turn=10 crossing3=4, or a
        file .toml
      fill: whether repair also gives every tile two connections; by default yes, unless rules or an
        inventory leave cells empty
      initial: maps that every run begins with, map.json or Duckietown's .yaml
      alphabet: tile codes to draw from; by default all with two or more connections
    """

    # A specification has the style itself, and settings have its name.
    style: str | None = option(None, none_or(read_style), "NAME", many="once")  # type: ignore[assignment]
    like: Grids = option((), parse_initial, "MAP", many=True)
    method: str = option("map-elites", check_method, "NAME")
    preset: str = option("tuned", nonblank, "NAME")
    evaluations: int = option(200_000, whole(0), "N")
    generations: int | None = option(None, none_or(whole(0)), "N")
    features: tuple[str, ...] = option((), check_features)
    axes: tuple[Axis, ...] | None = option(
        None, none_or(parse_axes), "NAME:BINS", many=True, after="features"
    )
    where: tuple[Range, ...] = option(
        (), parse_ranges, "NAME=LOW..HIGH", many=True, after="features"
    )
    weights: tuple[tuple[str, int], ...] = option(
        (), parse_weights, "NAME=N", many=True, after="features"
    )
    targets: tuple[ExampleValues, ...] = option((), parse_targets, after="features")
    fix: FixedCells | None = option(None, none_or(parse_fixed_cells), "FILE", many="once")
    rules: str | None = option(None, none_or(one_of(*RULES)), "NAME")
    inventory: tuple[tuple[str, int], ...] | None = option(
        None, none_or(parse_inventory), "KIND=N", many=True
    )
    fill: bool | None = option(None, none_or(flag))
    initial: Grids = option((), parse_initial, "MAP", flag="from", many=True)
    alphabet: tuple[int, ...] | None = option(None, none_or(check_alphabet))

    def values(self) -> dict[str, OptionValue]:
        """Returns the values of the options, by name."""
        return {name: getattr(self, name) for name in OPTIONS}

    def to_plain(self) -> dict[str, Plain]:
        """Returns plain values for JSON, from which `settings_from_plain` makes equal settings."""
        plain = self.values()
        plain["where"] = [str(item) for item in self.where]
        plain["weights"] = dict(self.weights)
        plain["targets"] = {target.name: list(target.values) for target in self.targets}
        if self.axes is not None:
            plain["axes"] = [axis._asdict() for axis in self.axes]
        if self.inventory is not None:
            plain["inventory"] = dict(self.inventory)
        if self.fix is not None:
            plain["fix"] = self.fix.rows
        return plain


OPTIONS: dict[str, Option] = {item.name: item.metadata["option"] for item in fields(Settings)}
"""The `Option` of each setting, by name."""


def check_option(name: str, value: UserValue, user_features: Collection[str]) -> OptionValue:
    """Checks the value of an option alone.

    The message of an `InputError` starts with the option's name.
    """
    check, after = OPTIONS[name].check, OPTIONS[name].after
    if after is None:
        return check_named(name, check, value)
    return check_named(name, check, value, user_features)


def settings_from_plain(plain: Plain) -> Settings:
    """Returns the settings that `Settings.to_plain` described. The style is not read again.

    Raises:
      InputError: for a missing or unknown option, or a wrong value.
    """
    if not isinstance(plain, Mapping) or set(plain) != set(OPTIONS):
        raise InputError("search", "all options of a search", quote(plain))
    # The features are checked first, because other options name them. The check of the style would
    # read its file, which may not exist any more.
    user_features = check_named("features", check_features, plain["features"])
    values: dict[str, OptionValue] = {
        "style": check_named("style", none_or(nonblank), plain["style"])
    }
    for name, value in plain.items():
        if name == "style":
            continue
        # JSON has lists in place of tuples. Only the default, (), may be empty.
        if value == []:
            value = ()
        values[name] = check_option(name, value, user_features)
    return Settings(**values)
