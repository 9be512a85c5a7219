"""Resolves what a user asks of a search, once, without JAX.

All later steps read the resulting record.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

from elitelanes_jax._util.cells import describe_size
from elitelanes_jax._util.errors import InputError, pluralize, quote
from elitelanes_jax._util.types import OptionValue, Plain
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.network.records import (
    LONGEST_DETOUR,
    LONGEST_TOWN,
    METRIC_NAMES,
    Weights,
    check_weights,
    largest_side,
)
from elitelanes_jax.problem.bounds import check_feasible, check_ranges_of_grids
from elitelanes_jax.problem.descriptor import Axis, complete_axes
from elitelanes_jax.problem.features import TOWN_FEATURES, columns_for, largest_addend
from elitelanes_jax.problem.fixed_cells import check_fits
from elitelanes_jax.problem.inventory import within_inventory
from elitelanes_jax.problem.ranges import Range, largest_penalty
from elitelanes_jax.problem.rules import RULES
from elitelanes_jax.search._layers import NOT_OF_LARGE, naming_origins
from elitelanes_jax.search.settings import CUSTOM, METHODS, Settings, settings_from_plain
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.search.style import CROSSING, Style

LARGE = 12
"""Maps whose shorter side is at least this long are large."""

Room: TypeAlias = Literal["maps", "grids", "anything"]
"""What the constraints must leave room for.

``maps`` are maps to write, and ``grids`` are repaired grids. ``anything`` is what a user's
optimiser makes; for it nothing is checked.
"""


@dataclass(frozen=True)
class Search:
    """A search for grids of one shape: all its settings, and what follows from them.

    A search is never changed.

    Attributes:
      shape: (height, width) of the grids.
      settings: a value for each option.
      alphabet: the codes that new tiles are drawn from.
      fills: whether repair also gives every tile two connections.
      axes: the axes of the niches.
      ranges: the ranges that every map meets: those asked for, and the limits of the inventory.
      measured: the features that are measured besides the metrics.
      weights: the weights of the metrics and the constant in the fitness.
      feature_weights: the weights of the `measured` features in the fitness; None if all are 0.
      inputs: the files and folders that the options named.
    """

    shape: tuple[int, int]
    settings: Settings
    alphabet: tuple[int, ...]
    fills: bool
    axes: tuple[Axis, ...]
    ranges: tuple[Range, ...]
    measured: tuple[str, ...]
    weights: Weights
    feature_weights: tuple[int, ...] | None
    inputs: tuple[str, ...] = field(default=(), compare=False, repr=False)

    @property
    def feature_names(self) -> tuple[str, ...]:
        """The names of the features that are measured: the metrics, then the others."""
        return (*METRIC_NAMES, *self.measured)

    @property
    def optimizer(self) -> str:
        """The name of the method, or in results the module and name of the user's own optimiser."""
        if self.settings.method == CUSTOM:
            return self.settings.preset
        return self.settings.method

    @property
    def fills_all_cells(self) -> bool:
        """Whether every cell of a map has a road, unless rules leave cells empty."""
        return self.fills and self.settings.fix is None

    def steps(self, evaluations_per_step: int) -> int:
        """Returns the number of steps of an optimiser within the budget, rounded up."""
        if self.settings.generations is not None:
            return self.settings.generations
        # The division rounds up.
        return -(-self.settings.evaluations // evaluations_per_step)

    def to_plain(self) -> dict[str, Plain]:
        """Returns plain values for JSON, as results and run.json keep a search."""
        # A search is on one shape, so it has no other options for large maps.
        return self.settings.to_plain() | {"large": None}

    def to_spec(self) -> SearchSpec:
        """Returns a specification that asks for exactly this search, with all options given."""
        return _spec_of_settings(self.settings)


def resolve(
    spec: SearchSpec,
    shape: tuple[int, int],
    alphabet: tuple[int, ...] | None = None,
    *,
    room_for: Room = "grids",
    shape_name: str = "size",
) -> Search:
    """Resolves a specification on a shape and an alphabet, and checks all options together.

    Args:
      spec: what the user asks for.
      shape: (height, width) of the grids, checked.
      alphabet: the codes of the tile set, which the search draws from unless the user names an
        alphabet.
      room_for: what the constraints must leave room for.
      shape_name: how messages call the shape.

    Raises:
      InputError: for options that exclude each other, cells or initial maps of another shape,
        weights with which the fitness of a grid could exceed 32 bits, or constraints that leave no
        room.
    """
    merged = spec.merged
    settings = merged.small
    if merged.large is not None and min(shape) >= LARGE:
        settings = merged.large
    if settings.alphabet is None:
        settings = replace(settings, alphabet=alphabet)
    search = replace(_with_crossings(_complete(settings, shape)), inputs=spec.inputs)
    # A message about a range that the user did not write says where the range comes from.
    origins = dict(merged.origins)
    for item in search.ranges:
        if item not in search.settings.where:
            origins[f"where {item.name}"] = "inventory"
    with naming_origins(origins):
        _check_choices(settings)
        _check_shape(search, shape_name)
        _check_constraints(search, room_for)
    return search


def _with_crossings(search: Search) -> Search:
    """Asks for a crossing on small maps of the style `town`, if some map of the search may have one.

    A user's range of `crossings` holds instead. Large towns have crossings without this.
    """
    is_asked = any(item.name == CROSSING.name for item in search.settings.where)
    if search.settings.style != "town" or min(search.shape) >= LARGE or is_asked:
        return search
    settings = replace(search.settings, where=(*search.settings.where, CROSSING))
    asking = _complete(settings, search.shape)
    try:
        _check_constraints(asking, "maps")
    except InputError:
        # The map is too small, or the tiles or the user's other options allow no crossing. An error
        # of the user's options alone is raised later.
        return search
    return asking


def plain_spec(spec: SearchSpec) -> dict[str, Plain]:
    """Returns what a specification asks for on any shape, plain values for JSON.

    ``large`` has the options that differ for large maps, or None.
    """
    merged = spec.merged
    plain = merged.small.to_plain()
    large = None
    if merged.large is not None:
        options = merged.large.to_plain()
        large = {name: value for name, value in options.items() if value != plain[name]}
    return plain | {"large": large}


def spec_from_plain(plain: Plain) -> SearchSpec:
    """Returns the specification that `plain_spec` described, with all options given.

    The style is not read again.

    Raises:
      InputError: for a missing or unknown option, or a wrong value.
    """
    options, large = _split_large(plain)
    spec = _spec_of_settings(settings_from_plain(options))
    if large is None:
        return spec
    if not isinstance(large, Mapping):
        raise InputError("large", "options by their names", quote(large))
    values = settings_from_plain(options | dict(large)).values()
    options_of_large = {name: value for name, value in values.items() if name not in NOT_OF_LARGE}
    return spec.replace(large=options_of_large)


def search_from_plain(plain: Plain, shape: tuple[int, int]) -> Search:
    """Returns the search on a shape that `Search.to_plain` described.

    Raises:
      InputError: for a missing or unknown option, or a wrong value.
    """
    options, large = _split_large(plain)
    if large is not None:
        raise InputError("large", "none in a search on one shape", quote(large))
    return _complete(settings_from_plain(options), shape)


def has_other_alphabet(search: Search, other: Search) -> bool:
    """Returns whether two searches differ, and in the alphabet alone."""
    if search == other:
        return False
    settings = replace(search.settings, alphabet=other.settings.alphabet)
    return replace(search, settings=settings, alphabet=other.alphabet) == other


def _split_large(plain: Plain) -> tuple[dict[str, Plain], Plain]:
    """Splits plain options into those for all maps and those for large maps, or None."""
    if not isinstance(plain, Mapping) or "large" not in plain:
        raise InputError("search", "all options of a search", quote(plain))
    options = dict(plain)
    large = options.pop("large")
    return options, large


def _spec_of_settings(settings: Settings) -> SearchSpec:
    """Returns a specification with all options of settings."""
    options = settings.values()
    if settings.style is not None:
        # The settings have the options of the style already, so it keeps its name alone.
        options["style"] = Style(settings.style, {})
    # Settings always have evaluations, but a specification refuses two budgets.
    if settings.generations is not None:
        del options["evaluations"]
    return SearchSpec(**options)


def resolve_again(
    search: Search, options: Mapping[str, OptionValue], alphabet: tuple[int, ...]
) -> Search:
    """Resolves a search with other options for maps that are chosen among its elites.

    Args:
      search: the search that found the elites.
      options: checked values by name.
      alphabet: all codes that the elites may have.

    Raises:
      InputError: for constraints that no map meets.
    """
    settings = replace(search.settings, **options)
    # Elites may have codes outside the search's alphabet, so the check allows all of them.
    widened = replace(settings, alphabet=alphabet)
    _check_constraints(_complete(widened, search.shape), "maps")
    return _complete(settings, search.shape)


def with_ranges(search: Search, ranges: Sequence[Range]) -> Search:
    """Returns a search with more ranges, which override those of the same feature."""
    range_by_name = {item.name: item for item in search.ranges}
    range_by_name |= {item.name: item for item in ranges}
    settings = replace(search.settings, where=tuple(range_by_name.values()))
    # The niches of the elites stay those of the search that found them.
    return replace(_complete(settings, search.shape), axes=search.axes)


def with_method(search: Search, method: str, preset: str) -> Search:
    """Returns a search whose settings say what makes its result.

    This is a custom configuration, or the user's optimiser.
    """
    settings = replace(search.settings, method=method, preset=preset, axes=search.axes)
    return replace(search, settings=settings)


def _complete(settings: Settings, shape: tuple[int, int]) -> Search:
    """Computes what follows from settings on a shape."""
    ranges = settings.where
    if settings.inventory is not None:
        ranges = within_inventory(settings.where, settings.inventory)
    # Rules and an inventory leave cells empty, which a repair that fills would not allow.
    fills = settings.fill
    if fills is None:
        fills = settings.rules is None and settings.inventory is None
    asked = dict(settings.weights)
    columns = columns_for(
        [axis.metric for axis in settings.axes or ()],
        [item.name for item in ranges],
        [name for name in asked if name not in Weights._fields],
        settings.features,
        [target.name for target in settings.targets],
    )
    measured = columns[len(METRIC_NAMES) :]
    weights = Weights() if settings.rules is None else RULES[settings.rules].weights
    metric_weights = {name: asked[name] for name in asked if name in Weights._fields}
    feature_weights = tuple(asked.get(name, 0) for name in measured)
    return Search(
        shape=shape,
        settings=settings,
        alphabet=settings.alphabet or ROAD_ALPHABET,
        fills=fills,
        axes=complete_axes(settings.axes, settings.preset, shape),
        ranges=ranges,
        measured=measured,
        weights=weights._replace(**metric_weights),
        feature_weights=feature_weights if any(feature_weights) else None,
    )


def _check_choices(settings: Settings) -> None:
    """Checks the method and the preset, and options against each other."""
    if settings.method == CUSTOM:
        expected = f"one of {', '.join(METHODS)}, or evolve's argument optimizer"
        raise InputError("method", expected, repr(CUSTOM))
    presets = METHODS[settings.method]
    if settings.preset == CUSTOM:
        expected = f"one of {', '.join(presets)}, or evolve's argument config"
        raise InputError("preset", expected, repr(CUSTOM))
    if settings.preset not in presets:
        expected = f"one of {', '.join(presets)} for {settings.method}"
        raise InputError("preset", expected, quote(settings.preset))
    if settings.rules is not None and settings.fill:
        expected = f"none with the rules of {settings.rules}, which leave cells empty"
        raise InputError("fill", expected, "True")
    if settings.initial and (settings.method, settings.preset) == ("pso", "paper"):
        expected = "none with the paper's PSO, whose particles are no grids; tuned would do"
        raise InputError("initial", expected, pluralize(len(settings.initial), "grid"))


def _check_shape(search: Search, shape_name: str) -> None:
    """Checks that fixed cells, initial maps, measured features and the fitness fit the shape."""
    if search.settings.fix is not None:
        check_fits(search.settings.fix, search.shape)
    _check_town_features(search, shape_name)
    _check_initial_maps(search)
    _check_fitness(search, shape_name)


def _check_town_features(search: Search, shape_name: str) -> None:
    """Checks that the features of towns, if any is measured, can be measured on the shape."""
    if set(search.measured).isdisjoint(TOWN_FEATURES):
        return
    longest, features = LONGEST_TOWN, "the features of a town"
    if "mean_detour" in search.measured:
        longest, features = LONGEST_DETOUR, "the mean detour"
    if max(search.shape) > longest:
        expected = f"sides of at most {longest} for {features}"
        raise InputError(shape_name, expected, describe_size(search.shape))


def _check_initial_maps(search: Search) -> None:
    """Checks that the initial maps have the shape."""
    for grid in search.settings.initial:
        shape = (len(grid), len(grid[0]))
        if shape != search.shape:
            expected = f"maps of {describe_size(search.shape)}"
            raise InputError("initial", expected, f"one of {describe_size(shape)}")


def _check_fitness(search: Search, shape_name: str) -> None:
    """Checks that the fitness of each grid of the shape has 32 bits."""
    weights = search.settings.weights
    penalty = largest_penalty(len(search.ranges), search.feature_names)
    addend = largest_addend(weights, search.shape)
    # If the user gave weights, the message names them. Otherwise the grid is too large for the
    # default weights, and the message says which size fits.
    try:
        check_weights(search.weights, search.shape, penalty + addend)
    except InputError:
        if weights:
            raise
        side = largest_side(search.weights, penalty)
        expected = f"grids whose fitness has 32 bits, such as all up to {side} x {side}"
        size = describe_size(search.shape)
        raise InputError(shape_name, expected, size) from None


def _check_constraints(search: Search, room_for: Room) -> None:
    """Checks that the constraints leave room for maps, or for repaired grids."""
    if room_for == "maps":
        check_feasible(
            search.shape,
            search.ranges,
            fix=search.settings.fix,
            rules=search.settings.rules,
            filled=search.fills,
            alphabet=search.settings.alphabet,
        )
    elif room_for == "grids":
        check_ranges_of_grids(search.ranges, search.shape, filled=search.fills_all_cells)
