"""The specifications of a search and of a generated folder: all settings with their defaults, without JAX."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from elitelanes_jax._util.checks import (
    check_named,
    check_unique,
    flag,
    name,
    none_or,
    one_of,
    split_settings,
    whole,
)
from elitelanes_jax._util.errors import InputError, pluralize, shorten, suggest
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.road_map import read_map
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import check_alphabet
from elitelanes_jax.network.town_features import LONGEST_DETOUR, LONGEST_TOWN
from elitelanes_jax.network.weights import Weights, check_weights, largest_side
from elitelanes_jax.problem.constraints import Range, parse_ranges
from elitelanes_jax.problem.descriptor import Axis, paper_axes, parse_axes, resolve_axes, tuned_axes
from elitelanes_jax.problem.feasible import Requirements, check_feasible, check_number
from elitelanes_jax.problem.features import FEATURES, TOWN_FEATURES, extra_names, largest_feature
from elitelanes_jax.problem.rules import RULES, check_rules
from elitelanes_jax.problem.targets import Target, parse_targets
from elitelanes_jax.problem.template import Template, parse_template
from elitelanes_jax.search.like import ranges_like, settings_like
from elitelanes_jax.search.style import read_style

METHODS = {
    "map-elites": ("tuned", "paper", "standard", "irregular"),
    "ea": ("tuned", "paper"),
    "pso": ("tuned", "paper"),
    "gwo": ("tuned", "paper"),
}
"""The methods, and the presets of each, the default first."""

LARGE = 12
"""The shorter side from which on maps are large."""

SEEDS = 8
"""The number of independent runs of a search, by default."""

check_seeds = whole(1, 10**6)
"""Checks a number of independent runs."""

_NOT_A_STYLES = ("style", "like", "features")


def check_names(features: UserValue) -> tuple[str, ...]:
    """Checks the names of features of one's own.

    Raises:
      InputError: for anything but names, one given twice, or one of another feature.
    """
    if isinstance(features, str) or not isinstance(features, Iterable):
        raise InputError(f"features: expected names, got {shorten(repr(features))}")
    names = check_unique("features", "name", map(name, features))
    for one in names:
        if not one.isidentifier() or one in (*FEATURES, *TOWN_FEATURES, *Weights._fields):
            raise InputError(f"features: expected names that no other feature has, got {shorten(repr(one), 40)}")
    return tuple(names)


def parse_weights(weights: UserValue, own: Collection[str] = ()) -> tuple[tuple[str, int], ...]:
    """Reads weights from texts such as ``bridges=300``, a mapping of names to whole numbers, pairs, or `Weights`.

    Args:
      weights: to read.
      own: names of features of one's own, which may have a weight too.

    Raises:
      InputError: for anything else, an unknown metric, or one given twice.
    """
    if isinstance(weights, str):
        weights = split_settings(weights)
    if isinstance(weights, Weights):
        weights = weights._asdict()
    if isinstance(weights, Mapping):
        weights = weights.items()
    if not isinstance(weights, Iterable):
        raise InputError(f"weights: expected weights such as ['bridges=300'], got {weights!r}")
    pairs = tuple(_parse_weight(weight, own) for weight in weights)
    check_unique("weights", "metric", [metric for metric, _ in pairs])
    return pairs


def _parse_weight(weight: UserValue, own: Collection[str]) -> tuple[str, int]:
    try:
        metric, number = weight.partition("=")[::2] if isinstance(weight, str) else weight
    except (TypeError, ValueError):
        raise InputError(f"weights: expected weights such as 'bridges=300', got {shorten(repr(weight))}") from None
    metric = metric.strip() if isinstance(metric, str) else metric
    known = (*Weights._fields, *TOWN_FEATURES, *own)
    if metric not in known:
        raise InputError(
            f"weights: expected a metric such as dead_ends, or constant, got {shorten(repr(metric), 40)}"
            f"{suggest(metric, known)} (there are {', '.join(known)})"
        )
    try:
        return metric, whole(-(2**31), 2**31 - 1)(number)
    except InputError:
        text = weight if isinstance(weight, str) else f"{metric}={number}"
        raise InputError(f"weights: expected NAME=N with a whole number, got {shorten(repr(text), 40)}") from None


def parse_initial(initial: UserValue) -> tuple[tuple[tuple[int, ...], ...], ...]:
    """Reads the grids that a search begins with, each as a tuple of rows.

    Args:
      initial: grids ``[H, W]``, or paths of map files (see `read_map`): one array or path, or several; an array
        ``[N, H, W]`` is several.

    Raises:
      InputError: for a bad grid or file.
    """
    if isinstance(initial, str | Path) or getattr(initial, "ndim", 0) == 2:
        initial = [initial]
    if not isinstance(initial, Iterable):
        raise InputError(f"expected grids or files of maps, got {initial!r}")
    grids = [read_map(one).codes if isinstance(one, str | Path) else check_grid(one) for one in initial]
    return tuple(tuple(map(tuple, np.asarray(grid).tolist())) for grid in grids)


def parse_large(large: UserValue, own: Collection[str] = ()) -> "SearchSpec":
    """Reads the settings for large maps, from a mapping of them by name, or from a specification.

    Args:
      large: to read.
      own: names of features of one's own.

    Raises:
      InputError: for anything else, an unknown setting, or a value that its check refuses.
    """
    if isinstance(large, SearchSpec):
        return large
    if not isinstance(large, Mapping):
        raise InputError(f"expected settings by their names, got {shorten(repr(large))}")
    known = [field for field in SearchSpec.options() if field not in (*_NOT_A_STYLES, "large")]
    for field in large:
        if field not in known:
            words = f"settings of a search, {', '.join(known)}"
            raise InputError(f"expected {words}, got {shorten(repr(field), 40)}{suggest(field, known)}")
    return SearchSpec().replace(**{**large, "features": tuple(own)})


_BY_FEATURE = (("where", parse_ranges), ("weights", parse_weights))


def _join(taken: Mapping[str, UserValue], more: Mapping[str, UserValue], own: Collection[str]) -> dict[str, UserValue]:
    """Returns settings with more of them in their places.

    Ranges and weights are joined feature by feature. Targets do not stay where there are axes, over which maps are
    spread then, and a preset not where there is another method.
    """
    joined = {**taken, **more}
    for field, parse in _BY_FEATURE:
        if field in taken and field in more:
            items = {item[0]: item for one in (taken, more) for item in parse(one[field], own)}
            joined[field] = tuple(items.values())
    if "method" in more and "preset" not in more:
        joined.pop("preset", None)
    if "axes" in more and "targets" not in more:
        joined["targets"] = ()
    if "large" in taken and "large" not in more:
        joined["large"] = _left(taken["large"], more)
    return joined


def _left(large: "SearchSpec", given: Mapping[str, UserValue]) -> "SearchSpec":
    """Returns those settings of large maps that are not given: given ones hold for all sizes."""
    left = {field: value for field, value in large.given.items() if field not in given}
    for field, parse in _BY_FEATURE:
        if field in given:
            names = {item[0] for item in parse(given[field], large.features)}
            left[field] = tuple(item for item in getattr(large, field) if item[0] not in names)
    if "axes" in given:
        left.pop("targets", None)
    if "method" in given:
        left.pop("preset", None)
    return SearchSpec(**left)


@dataclass(frozen=True)
class SearchSpec(Record):
    """A search: the method, its budget, and what is searched for.

    Attributes:
      style: a set of settings, town or paper, or a file .toml; other settings take the place of its own
      like: maps whose features others are to have, map.json or Duckietown's .yaml; none is written again
      method: the method: map-elites, ea, pso or gwo
      preset: settings of the method: tuned, paper, or for map-elites standard or irregular
      evaluations: grids that each run evaluates, rounded up to whole generations
      generations: generations of each run, in place of evaluations
      features: names of features of one's own, whose kernels `evolve` takes
      axes: axes of the niches, such as straight_share:10; by default the preset's
      where: ranges that every map meets, such as crossings=6..10, bridges=0 or straight_share=0.3..
      weights: weights of the fitness that differ from the usual ones, such as dead_ends=480
      targets: features of example maps, by name, among whose values those of the chosen maps are spread
      fix: JSON rows of tile codes that every map keeps, null for free cells
      rules: rules that every map keeps: duckietown
      fill: whether repair also gives every tile two connections; by default yes, unless rules leave cells empty
      initial: maps that every run begins with, map.json or Duckietown's .yaml
      alphabet: tile codes to draw from; by default all with two or more connections
      large: settings for maps whose shorter side is 12 or more, in place of the others
    """

    style: str | Path | None = option(None, lambda value: value, "NAME")
    like: tuple[tuple[tuple[int, ...], ...], ...] = option((), parse_initial, "MAP", many=True)
    method: str = option("map-elites", one_of(*METHODS), "NAME")
    preset: str = option("tuned", name, "NAME")
    evaluations: int = option(200_000, whole(0), "N")
    generations: int | None = option(None, none_or(whole(0)), "N", replaces="evaluations")
    features: tuple[str, ...] = option((), check_names)
    axes: tuple[Axis, ...] | None = option(None, none_or(parse_axes), "NAME:BINS", many=True, after="features")
    where: tuple[Range, ...] = option((), parse_ranges, "NAME=LOW..HIGH", many=True, after="features")
    weights: tuple[tuple[str, int], ...] = option((), parse_weights, "NAME=N", many=True, after="features")
    targets: tuple[Target, ...] = option((), parse_targets, after="features")
    fix: Template | None = option(None, none_or(parse_template), "FILE")
    rules: str | None = option(None, none_or(check_rules), "NAME")
    fill: bool | None = option(None, none_or(flag))
    initial: tuple[tuple[tuple[int, ...], ...], ...] = option((), parse_initial, "MAP", flag="from", many=True)
    alphabet: tuple[int, ...] | None = option(None, none_or(check_alphabet))
    large: "SearchSpec | None" = option(None, none_or(parse_large), after="features")

    def __post_init__(self) -> None:
        """Takes the settings of a style and those of maps like given ones in place of defaults, then checks all.

        What was taken stays, and the style goes: the record is the same again when it is made of its own fields.
        """
        object.__setattr__(self, "like", check_named("like", parse_initial, self.like))
        given = self.given
        if self.like and ranges_like() <= {item.name for item in parse_ranges(self.where, None)}:
            del given["like"]  # a record made of another's fields: they are taken already, and may have been changed
        for field, value in self._with_taken(given, self.features).items():
            object.__setattr__(self, field, value)
        object.__setattr__(self, "style", None)
        super().__post_init__()

    def replace(self, **given: UserValue) -> "SearchSpec":
        """Returns the record with other values in some fields; those given stand before those of a style.

        Raises:
          InputError: as that of `Record`, and for a style that is none (see `read_style`).
        """
        taken = self._with_taken(given, given.get("features", self.features))
        if "large" not in taken and self.large is not None:
            taken["large"] = _left(self.large, taken)
        return super().replace(**{field: value for field, value in taken.items() if field != "style"})

    @property
    def given(self) -> dict[str, UserValue]:
        """The fields that differ from their defaults."""
        defaults = {one.name: one.default for one in fields(self)}
        return {
            field: value
            for field, value in vars(self).items()  # arrays have no truth: they are compared with none of them
            if not isinstance(value, type(defaults[field])) or value != defaults[field]
        }

    def on(self, shape: tuple[int, int]) -> "SearchSpec":
        """Returns the search for grids ``(height, width)``: its settings for large maps are taken, or dropped."""
        if self.large is None:
            return self
        more = self.large.given if min(shape) >= LARGE else {}
        return replace(self, **_join(self.given, more, self.features) | {"large": None})

    @classmethod
    def _with_taken(cls, given: Mapping[str, UserValue], own: Collection[str]) -> dict[str, UserValue]:
        """Returns given settings, and those of the style and of the maps in `like` that are not given (see `_join`)."""
        style, like = given.get("style"), check_named("like", parse_initial, given.get("like", ()))
        known = [field for field in cls.options() if field not in _NOT_A_STYLES]
        taken = {} if style is None else read_style(style, known)
        if "large" in taken:
            taken["large"] = check_named("large", none_or(parse_large), taken["large"], own)
        for more in (settings_like(like) if like else {}, given):
            taken = _join(taken, more, own)
        return taken

    def check_together(self) -> None:
        """Checks the preset against the method, and filling against the rules."""
        presets = METHODS[self.method]
        if self.preset not in presets:
            raise InputError(f"preset: expected one of {', '.join(presets)} for {self.method}, got {self.preset!r}")
        if self.rules is not None and self.fill:
            raise InputError(f"fill: expected none with the rules of {self.rules}, which leave cells empty, got True")
        if self.initial and (self.method, self.preset) == ("pso", "paper"):
            expected = "none with the paper's PSO, whose particles are no grids; tuned would do"
            raise InputError(f"initial: expected {expected}, got {pluralize(len(self.initial), 'grid')}")

    def check_on(self, shape: tuple[int, int], name: str = "size") -> None:
        """Checks the settings for grids ``(height, width)``; a search does so before it starts.

        Args:
          shape: of the grids.
          name: of the shape, for the message.

        Raises:
          InputError: for given cells or first maps of another shape, or weights with which the fitness of such grids
            might leave 32 bits.
        """
        if self.large is not None:
            return self.on(shape).check_on(shape, name)
        size = f"{shape[0]} x {shape[1]}"
        if self.fix is not None and self.fix.shape != shape:
            rows, columns = self.fix.shape
            raise InputError(f"fix: expected cells of a map of {size}, got {rows} x {columns}")
        most = LONGEST_DETOUR if "mean_detour" in self.extras else LONGEST_TOWN
        if set(self.extras) & set(TOWN_FEATURES) and max(shape) > most:
            what = "the mean detour" if most == LONGEST_DETOUR else "the features of a town"
            raise InputError(f"{name}: expected sides of at most {most} for {what}, got {size}")
        for grid in self.initial:
            if (len(grid), len(grid[0])) != shape:
                raise InputError(f"initial: expected maps of {size}, got one of {len(grid)} x {len(grid[0])}")
        try:
            weighed = zip(self.extras, self.extra_weights or (), strict=False)
            most = sum(abs(weight) * largest_feature(name, shape) for name, weight in weighed)
            check_weights(self.all_weights, shape, most)
        except InputError:
            if self.weights:
                raise
            side = largest_side(self.all_weights)
            expected = f"grids whose fitness has 32 bits, such as all up to {side} x {side}"
            raise InputError(f"{name}: expected {expected}, got {size}") from None

    def check_maps(self, shape: tuple[int, int], maps: int = 1) -> None:
        """Checks that so many maps ``(height, width)`` can be as they are searched for, as far as limits tell.

        Raises:
          InputError: for constraints that cannot be met; the message says the limit.
        """
        check_feasible(self.on(shape)._requirements(shape, maps))

    def count_maps(self, shape: tuple[int, int], maps: int) -> None:
        """Checks as `check_maps` does, and where there are few such maps, goes through all of them.

        Raises:
          InputError: for constraints that cannot be met; the message says the limit.
        """
        self.check_maps(shape, maps)
        check_number(self.on(shape)._requirements(shape, maps))

    def _requirements(self, shape: tuple[int, int], maps: int) -> Requirements:
        return Requirements(shape, self.where, self.fix, self.rules, self.fills, self.alphabet, maps)

    @property
    def fills(self) -> bool:
        """Whether repair fills."""
        return self.rules is None if self.fill is None else self.fill

    @property
    def all_weights(self) -> Weights:
        """The usual weights, or those of the rules, with the given ones in their places."""
        usual = Weights() if self.rules is None else RULES[self.rules].weights
        return usual._replace(**{name: weight for name, weight in self.weights if name in Weights._fields})

    @property
    def extras(self) -> tuple[str, ...]:
        """The names of the extra features that are measured: those of axes, ranges, weights, targets, one's own."""
        axes, ranges = [axis.metric for axis in self.axes or ()], [item.name for item in self.where]
        weights = [name for name, _ in self.weights if name not in Weights._fields]
        targets = [target.name for target in self.targets]
        return extra_names(axes, ranges, weights, self.features, targets)

    @property
    def extra_weights(self) -> tuple[int, ...] | None:
        """The weight of each extra feature; None where there is none but 0."""
        weights = tuple(dict(self.weights).get(name, 0) for name in self.extras)
        return weights if any(weights) else None

    def steps(self, evaluations_per_step: int) -> int:
        """Returns how many steps of an optimiser the budget allows, the last of them begun within it."""
        return -(-self.evaluations // evaluations_per_step) if self.generations is None else self.generations

    def axes_on(self, shape: tuple[int, int]) -> tuple[Axis, ...]:
        """Returns the axes of the niches of grids ``(height, width)``: the given ones, or the preset's."""
        if self.axes:
            return resolve_axes(self.axes, shape, self.features)
        return tuned_axes(shape) if self.preset in ("tuned", "irregular") else paper_axes(shape)

    def to_plain(self) -> dict[str, Plain]:
        """Returns plain values for JSON, of which `SearchSpec` makes the same record again."""
        return vars(self) | {
            "axes": None if self.axes is None else [axis._asdict() for axis in self.axes],
            "where": [str(item) for item in self.where],
            "weights": dict(self.weights),
            "targets": {target.name: list(target.values) for target in self.targets},
            "fix": None if self.fix is None else self.fix.rows,
            "large": self.large and self.large._plain_given(),
        }

    def _plain_given(self) -> dict[str, Plain]:
        return {field: value for field, value in self.to_plain().items() if field in self.given and field != "features"}
