"""The specification of a search: all options with their defaults, without JAX."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, Unpack

from elitelanes_jax._util.checks import check_named, flag, name, none_or, one_of, whole
from elitelanes_jax._util.errors import InputError, pluralize, shorten
from elitelanes_jax._util.records import Record, check_names, option
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.road_map import RoadMap, as_maps
from elitelanes_jax.network.codes import check_alphabet
from elitelanes_jax.network.records import (
    LONGEST_DETOUR,
    LONGEST_TOWN,
    METRIC_NAMES,
    Weights,
    check_weights,
    largest_side,
)
from elitelanes_jax.problem.bounds import check_feasible
from elitelanes_jax.problem.descriptor import Axis, paper_axes, parse_axes, resolve_axes, tuned_axes
from elitelanes_jax.problem.features import TOWN_FEATURES, check_features, columns_for, largest_addend
from elitelanes_jax.problem.fixed_cells import FixedCells, check_fits, parse_fixed_cells
from elitelanes_jax.problem.inventory import parse_inventory, parse_numbers, within_inventory
from elitelanes_jax.problem.ranges import Range, largest_penalty, parse_ranges
from elitelanes_jax.problem.rules import RULES
from elitelanes_jax.problem.targets import ExampleValues, parse_targets
from elitelanes_jax.search.like import settings_like
from elitelanes_jax.search.style import Style, merge_options, read_style

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

METHODS = {
    "map-elites": ("tuned", "paper", "standard", "irregular"),
    "ea": ("tuned", "paper"),
    "pso": ("tuned", "paper"),
    "gwo": ("tuned", "paper"),
}
"""The methods, and the presets of each, the default first."""

CUSTOM = "custom"
"""In results: the preset if a configuration equals no preset, and the method of a user's own optimiser."""

LARGE = 12
"""Maps whose shorter side is at least this long are large."""

SEEDS = 8
"""The default number of independent runs of a search."""

check_seeds = whole(1, 10**6)
"""Checks a number of independent runs."""

_Maps: TypeAlias = "str | Path | ArrayLike | RoadMap | Iterable[str | Path | ArrayLike | RoadMap]"
_Limits: TypeAlias = str | float | tuple[float | None, float | None]


class SearchOptions(TypedDict, total=False):
    """The options of `evolve`, for type checkers and editors. `SearchSpec` says what they mean."""

    style: str | Path | None
    like: _Maps
    method: str
    preset: str
    evaluations: int | str
    generations: int | str | None
    axes: str | Iterable[str | Axis | Mapping[str, Any]] | Mapping[str, int | tuple[int, int]] | None
    where: str | Iterable[str | Range] | Mapping[str, _Limits]
    weights: str | Weights | Mapping[str, int] | Iterable[str | tuple[str, int]]
    targets: Mapping[str, Sequence[float]] | Iterable[ExampleValues]
    fix: "str | Path | FixedCells | ArrayLike | Sequence[Sequence[int | None]] | None"
    rules: str | None
    inventory: str | Path | Mapping[str, int] | Iterable[str | tuple[str, int]] | None
    fill: bool | None
    initial: _Maps
    alphabet: Iterable[int] | None
    large: Mapping[str, Any] | None


class SpecOptions(SearchOptions, total=False):
    """The options of `SearchSpec`."""

    features: Iterable[str]


_BUDGET = ("generations", "evaluations")
_NOT_OF_STYLES = ("style", "like", "features", *_BUDGET)
_NOT_OF_LARGE = (*_NOT_OF_STYLES, "large")


def check_method(method: UserValue) -> str:
    """Checks the name of a method: one of `METHODS`, or `CUSTOM`, which `SearchSpec.check_on` refuses for a search."""
    return method if isinstance(method, str) and method == CUSTOM else one_of(*METHODS)(method)


def parse_weights(weights: UserValue, own: Collection[str] = ()) -> tuple[tuple[str, int], ...]:
    """Reads `Weights`, or what `parse_numbers` reads; `own` are the names of the user's own features."""
    known = (*Weights._fields, *TOWN_FEATURES, *own)
    given = weights._asdict() if isinstance(weights, Weights) else weights
    return parse_numbers("weights", known, given, least=-(2**31))


def parse_initial(initial: UserValue) -> tuple[tuple[tuple[int, ...], ...], ...]:
    """Reads one map or several, as `as_maps` takes them, each as a tuple of rows; only the default, (), has none."""
    maps = tuple(tuple(map(tuple, road_map.codes.tolist())) for road_map in as_maps(initial))
    if not maps and not isinstance(initial, tuple):
        raise InputError("expected at least one map, got none")
    return maps


def _parse_large(large: UserValue, own: Collection[str]) -> dict[str, UserValue]:
    """Checks options for large maps, by name or as the specification that was made of them."""
    if isinstance(large, SearchSpec):
        large = {name: value for name, value in large._given.items() if name not in _NOT_OF_LARGE}
    if not isinstance(large, Mapping):
        raise InputError(f"expected options by their names, got {shorten(repr(large))}")
    return _check_options(large, own, without=_NOT_OF_LARGE)


def _check_options(
    options: Mapping[str, UserValue], own: Collection[str], without: Collection[str] = ()
) -> dict[str, UserValue]:
    """Checks each option alone, and that none is in `without`; `own` are the names of the user's features."""
    known = {name: one for name, one in SearchSpec.options().items() if name not in without}
    check_names(options, known)
    return {
        name: check_named(name, known[name].check, value, *([own] if known[name].after else []))
        for name, value in options.items()
    }


@dataclass(frozen=True, init=False)
class SearchSpec(Record):
    """A search: the method, its budget, and the constraints and niches of its maps.

    Attributes:
      style: named options: town, paper, or a .toml file; your options override them
      like: example maps, map.json or Duckietown's .yaml; maps have features in the same ranges, and none is a copy
      method: the method: map-elites, ea, pso or gwo
      preset: configuration of the method: tuned, paper, or for map-elites standard or irregular
      evaluations: grids that each run evaluates, rounded up to whole generations
      generations: generations of each run, instead of evaluations
      features: names of the user's own features, whose kernels `evolve` takes
      axes: axes of the niches, such as straight_share:10; by default the preset's
      where: ranges that every map meets, such as crossings=6..10, bridges=0 or straight_share=0.3..
      weights: weights of the fitness that differ from the usual ones, such as dead_ends=480
      targets: features of example maps, by name; the chosen maps' features have the same distribution
      fix: JSON rows of tile codes that every map keeps, null for free cells
      rules: rules that every map keeps: duckietown
      inventory: tiles that maps may need at most, such as straight=20 turn=10 crossing3=4, or a file .toml
      fill: whether repair also gives every tile two connections; by default yes, unless rules or an inventory leave
        cells empty
      initial: maps that every run begins with, map.json or Duckietown's .yaml
      alphabet: tile codes to draw from; by default all with two or more connections
      large: options for maps whose shorter side is 12 or more; they override the others
    """

    style: str | None = option(None, none_or(read_style), "NAME", many="once")
    like: tuple[tuple[tuple[int, ...], ...], ...] = option((), parse_initial, "MAP", many=True)
    method: str = option("map-elites", check_method, "NAME")
    preset: str = option("tuned", name, "NAME")
    evaluations: int = option(200_000, whole(0), "N")
    generations: int | None = option(None, none_or(whole(0)), "N")
    features: tuple[str, ...] = option((), check_features)
    axes: tuple[Axis, ...] | None = option(None, none_or(parse_axes), "NAME:BINS", many=True, after="features")
    where: tuple[Range, ...] = option((), parse_ranges, "NAME=LOW..HIGH", many=True, after="features")
    weights: tuple[tuple[str, int], ...] = option((), parse_weights, "NAME=N", many=True, after="features")
    targets: tuple[ExampleValues, ...] = option((), parse_targets, after="features")
    fix: FixedCells | None = option(None, none_or(parse_fixed_cells), "FILE")
    rules: str | None = option(None, none_or(one_of(*RULES)), "NAME")
    inventory: tuple[tuple[str, int], ...] | None = option(None, none_or(parse_inventory), "KIND=N", many=True)
    fill: bool | None = option(None, none_or(flag))
    initial: tuple[tuple[tuple[int, ...], ...], ...] = option((), parse_initial, "MAP", flag="from", many=True)
    alphabet: tuple[int, ...] | None = option(None, none_or(check_alphabet))
    large: "SearchSpec | None" = option(None, none_or(_parse_large), after="features")
    _given: Mapping[str, UserValue] = field(init=False, repr=False, compare=False)
    _where: tuple[Range, ...] = field(init=False, repr=False, compare=False)  # without the limits of the inventory
    _origins: Mapping[str, str] = field(init=False, repr=False, compare=False)  # of the style or `like`

    def __init__(self, **given: Unpack[SpecOptions]) -> None:
        """Makes a specification from options by name; all have defaults.

        Your options override those from the example maps, and these override the style's. Ranges and weights are merged
        feature by feature.

        Raises:
          InputError: for an unknown option, a wrong value, or options that exclude each other.
        """
        _check_budget(given)
        self._resolve(given)._keep_inputs(given)

    def replace(self, **given: Unpack[SpecOptions]) -> "SearchSpec":  # type: ignore[override]
        """Returns a specification with new options, as if they had been given to the constructor with the earlier ones.

        Raises:
          InputError: as the constructor does.
        """
        new_budget = _check_budget(given)
        kept = {name: value for name, value in self._given.items() if not (new_budget and name in _BUDGET)}
        return _empty()._resolve({**kept, **given})._keep_inputs(given, *self.inputs)

    @classmethod
    def from_plain(cls, plain: Plain) -> "SearchSpec":
        """Returns the specification that `to_plain` described. The style is not read again.

        Raises:
          InputError: for a missing or unknown option, or a wrong value.
        """
        if not isinstance(plain, Mapping) or set(plain) != set(cls.options()):
            raise InputError(f"search: expected all options of a search, got {shorten(repr(plain))}")
        rest = {"style": none_or(name)(plain["style"]), "large": None}
        values = {name: () if value == [] else value for name, value in plain.items() if name not in rest}
        values = _check_options(values, check_features(values["features"])) | rest
        if (large := plain["large"]) is not None:
            if not isinstance(large, Mapping):
                raise InputError(f"large: expected options by their names, got {shorten(repr(large))}")
            values["large"] = cls.from_plain({**plain, **large, "large": None})
        return _empty()._fill(values)

    def _resolve(self, given: Mapping[str, UserValue]) -> "SearchSpec":
        """Fills the record from layers of options: the style's, the example maps', and the given ones."""
        own = check_named("features", check_features, given.get("features", ()))
        given = _check_options(given, own)
        layers, style, origins = [given], given.get("style"), dict[str, str]()
        if given.get("like"):
            layers.insert(0, _check_options(settings_like(given["like"]), own))
            origins = dict.fromkeys(_names_in(layers[0]), "like")
        if style is not None:
            check = partial(_check_options, own=own, without=_NOT_OF_STYLES)
            layers.insert(0, check_named(f"style {style.name!r}", check, style.options))
            origins = dict.fromkeys(_names_in(layers[0]), f"style {style.name!r}") | origins
        origins = {name: origin for name, origin in origins.items() if name not in _names_in(given)}
        small = [{name: value for name, value in layer.items() if name != "large"} for layer in layers]
        rest = {"style": style and style.name, "large": None}
        values = merge_options(small) | rest
        last = max((index for index, layer in enumerate(layers) if "large" in layer), default=0)
        if (large := layers[last].get("large")) is not None:
            values["large"] = _empty()._fill(merge_options([*small[: last + 1], large, *small[last + 1 :]]) | rest)
        return self._fill(values, given, origins)

    def _fill(
        self,
        values: Mapping[str, UserValue],
        given: Mapping[str, UserValue] | None = None,
        origins: Mapping[str, str] | None = None,
    ) -> "SearchSpec":
        """Sets the fields to checked values, or to their defaults; by default, all of them count as given."""
        every = {name: values.get(name, default) for name, default in _DEFAULTS.items()}
        label = every["style"] and Style(every["style"], {})
        given = every | {"style": label} if given is None else given
        own = every["where"]
        if every["inventory"] is not None:
            where = within_inventory(every["where"], every["inventory"])
            added = {f"where {item.name}": "inventory" for item in where if item not in every["where"]}
            every, origins = every | {"where": where}, {**(origins or {}), **added}
        vars(self).update(every, _given=given, _where=own, _origins=origins or {})
        with self.naming_origins():
            self.check_together()
        return self

    def given(self) -> Mapping[str, UserValue]:
        """Returns the options that were given, by name, without those of the style and the example maps."""
        return self._given

    def on(self, shape: tuple[int, int]) -> "SearchSpec":
        """Returns the search for grids ``(height, width)``. For large grids the options for large maps are merged in.

        All its options count as given.
        """
        chosen = self.large if self.large is not None and min(shape) >= LARGE else self
        values = {name: getattr(chosen, name) for name in _DEFAULTS} | {"large": None, "where": chosen._where}
        return _empty()._fill(values, origins=self._origins)._keep_inputs({}, *self.inputs)

    @contextmanager
    def naming_origins(self) -> Iterator[None]:
        """Makes errors in its block that name an option from the style or `like` start with that origin."""
        try:
            yield
        except InputError as error:
            option = re.match(r"(\w+)(?: '(\w+)=)?", str(error))
            origin = option and self._origins.get(" ".join(filter(None, option.groups())))
            if not origin:
                raise
            raise InputError(f"{origin}: {error}") from None

    def check_together(self) -> None:
        """Checks the preset against the method, and filling against the rules."""
        presets = METHODS.get(self.method, (self.preset,))
        if self.preset not in (*presets, CUSTOM):
            raise InputError(f"preset: expected one of {', '.join(presets)} for {self.method}, got {self.preset!r}")
        if self.rules is not None and self.fill:
            raise InputError(f"fill: expected none with the rules of {self.rules}, which leave cells empty, got True")
        if self.initial and (self.method, self.preset) == ("pso", "paper"):
            expected = "none with the paper's PSO, whose particles are no grids; tuned would do"
            raise InputError(f"initial: expected {expected}, got {pluralize(len(self.initial), 'grid')}")

    def check_on(self, shape: tuple[int, int], name: str = "size") -> None:
        """Checks the options for grids ``(height, width)`` before a search starts. Messages call the shape `name`.

        Raises:
          InputError: for a custom method or preset, which only results have, cells or initial maps of another shape, or
            weights with which the fitness of a grid could exceed 32 bits.
        """
        search = self if self.large is None else self.on(shape)
        with search.naming_origins():
            search._check_on(shape, name)

    def _check_on(self, shape: tuple[int, int], name: str) -> None:
        if self.method == CUSTOM:
            expected = f"one of {', '.join(METHODS)}, or evolve's argument optimizer"
            raise InputError(f"method: expected {expected}, got {CUSTOM!r}")
        if self.preset == CUSTOM:
            expected = f"one of {', '.join(METHODS[self.method])}, or evolve's argument config"
            raise InputError(f"preset: expected {expected}, got {CUSTOM!r}")
        size = f"{shape[0]} x {shape[1]}"
        if self.fix is not None:
            check_fits(self.fix, shape)
        most = LONGEST_DETOUR if "mean_detour" in self.measured else LONGEST_TOWN
        if set(self.measured) & set(TOWN_FEATURES) and max(shape) > most:
            what = "the mean detour" if most == LONGEST_DETOUR else "the features of a town"
            raise InputError(f"{name}: expected sides of at most {most} for {what}, got {size}")
        for grid in self.initial:
            if (len(grid), len(grid[0])) != shape:
                raise InputError(f"initial: expected maps of {size}, got one of {len(grid)} x {len(grid[0])}")
        penalty = largest_penalty(len(self.where), (*METRIC_NAMES, *self.measured))
        try:
            check_weights(self.all_weights, shape, penalty + largest_addend(self.weights, shape))
        except InputError:
            if self.weights:
                raise
            side = largest_side(self.all_weights, penalty)
            expected = f"grids whose fitness has 32 bits, such as all up to {side} x {side}"
            raise InputError(f"{name}: expected {expected}, got {size}") from None

    def check_maps(self, shape: tuple[int, int]) -> None:
        """Checks that maps ``(height, width)`` can satisfy all constraints; raises as `check_feasible`."""
        search = self.on(shape)
        with search.naming_origins():
            check_feasible(
                shape,
                search.where,
                fix=search.fix,
                rules=search.rules,
                filled=search.repair_fills,
                alphabet=search.alphabet,
            )

    @property
    def optimizer(self) -> str:
        """The name of the method, or in results the module and name of your own optimiser."""
        return self.preset if self.method == CUSTOM else self.method

    @property
    def repair_fills(self) -> bool:
        return self.rules is None and self.inventory is None if self.fill is None else self.fill

    @property
    def all_weights(self) -> Weights:
        """The usual weights, or those of the rules, with the given weights instead of theirs."""
        usual = Weights() if self.rules is None else RULES[self.rules].weights
        return usual._replace(**{name: weight for name, weight in self.weights if name in Weights._fields})

    @property
    def measured(self) -> tuple[str, ...]:
        """The features that are measured beside metrics: of axes, ranges, weights and targets, and the user's."""
        axes, ranges = [axis.metric for axis in self.axes or ()], [item.name for item in self.where]
        weights = [name for name, _ in self.weights if name not in Weights._fields]
        targets = [target.name for target in self.targets]
        return columns_for(axes, ranges, weights, self.features, targets)[len(METRIC_NAMES) :]

    @property
    def feature_weights(self) -> tuple[int, ...] | None:
        """The weights of the `measured` features; None if all are 0."""
        weights = tuple(dict(self.weights).get(name, 0) for name in self.measured)
        return weights if any(weights) else None

    def steps(self, evaluations_per_step: int) -> int:
        """Returns the number of steps of an optimiser within the budget, rounded up."""
        return -(-self.evaluations // evaluations_per_step) if self.generations is None else self.generations

    def axes_on(self, shape: tuple[int, int]) -> tuple[Axis, ...]:
        """Returns the axes of the niches of grids ``(height, width)``: the given ones, or the preset's."""
        if self.axes:
            return resolve_axes(self.axes, shape, self.features)
        return tuned_axes(shape) if self.preset in ("tuned", "irregular") else paper_axes(shape)

    def to_plain(self) -> dict[str, Plain]:
        """Returns plain values for JSON, from which `from_plain` makes the same specification."""
        plain = {name: getattr(self, name) for name in _DEFAULTS} | {
            "axes": None if self.axes is None else [axis._asdict() for axis in self.axes],
            "where": [str(item) for item in self._where],
            "weights": dict(self.weights),
            "inventory": None if self.inventory is None else dict(self.inventory),
            "targets": {target.name: list(target.values) for target in self.targets},
            "fix": None if self.fix is None else self.fix.rows,
        }
        if self.large is not None:  # only the options that differ
            large = self.large.to_plain()
            plain["large"] = {name: large[name] for name in plain if name != "large" and large[name] != plain[name]}
        return plain


def _names_in(layer: Mapping[str, UserValue]) -> set[str]:
    """Returns the names of the options in a layer, also those for large maps, and of each range."""
    large = layer.get("large") or {}
    ranges = {f"where {item.name}" for options in (layer, large) for item in options.get("where", ())}
    return {*layer, *large, *ranges}


_DEFAULTS = {name: getattr(SearchSpec, name) for name in SearchSpec.options()}


def _empty() -> SearchSpec:
    return object.__new__(SearchSpec)


def _check_budget(given: Mapping[str, UserValue]) -> bool:
    """Returns whether a budget is given; raises `InputError` for two."""
    budgets = [given[name] for name in _BUDGET if given.get(name) is not None]
    if len(budgets) == 2:
        raise InputError("generations: expected it or evaluations, got both, {} and {}".format(*budgets))
    return bool(budgets)
