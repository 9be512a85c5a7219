"""What a user asks of a search: options by name, without JAX."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypedDict, Unpack

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import inputs_among
from elitelanes_jax._util.types import OptionValue, Untyped, UserValue
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.records import Weights
from elitelanes_jax.problem.descriptor import Axis
from elitelanes_jax.problem.features import check_features
from elitelanes_jax.problem.fixed_cells import FixedCells
from elitelanes_jax.problem.ranges import Range
from elitelanes_jax.problem.targets import ExampleValues
from elitelanes_jax.search._layers import BUDGET, Merged, check_options, merge_layers
from elitelanes_jax.search.settings import OPTIONS
from elitelanes_jax.search.style import STYLES, Style

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

SEEDS = 8
"""The default number of independent runs of a search."""

check_seeds = whole(1, 10**6)
"""Checks a number of independent runs."""

_Maps: TypeAlias = "str | Path | ArrayLike | RoadMap | Iterable[str | Path | ArrayLike | RoadMap]"
_Limits: TypeAlias = str | float | tuple[float | None, float | None]


class SearchOptions(TypedDict, total=False):
    """The options of `evolve`, for type checkers and editors. `Settings` says what they mean."""

    style: str | Path | None
    like: _Maps
    method: str
    preset: str
    evaluations: int | str
    generations: int | str | None
    axes: (
        str | Iterable[str | Axis | Mapping[str, Any]] | Mapping[str, int | tuple[int, int]] | None
    )
    where: str | Iterable[str | Range] | Mapping[str, _Limits]
    weights: str | Weights | Mapping[str, int] | Iterable[str | tuple[str, int]]
    targets: Mapping[str, Sequence[float]] | Iterable[ExampleValues]
    fix: "str | Path | FixedCells | ArrayLike | Sequence[Sequence[int | None]] | None"
    rules: str | None
    inventory: str | Path | Mapping[str, int] | Iterable[str | tuple[str, int]] | None
    fill: bool | None
    initial: _Maps
    alphabet: Iterable[int] | None
    large: "Mapping[str, Any] | SearchSpec | None"


class SpecOptions(SearchOptions, total=False):
    """The options of `SearchSpec`."""

    features: Iterable[str]


@dataclass(frozen=True, init=False)
class SearchSpec:
    """What a user asks of a search: the options that were given, each checked alone.

    `large` has options for maps whose shorter side is 12 or more. They override the others, and
    those that the style has for such maps. With None, such maps have no options of their own.

    Attributes:
      options: the checked values of the given options, by name.
      inputs: the files and folders that the options named, also those for large maps and those of
        a style's file.
    """

    options: Mapping[str, OptionValue]
    inputs: tuple[str, ...]

    def __init__(self, **options: Unpack[SpecOptions]) -> None:
        """Makes a specification from options by name; all have defaults.

        Your options override those that follow from the example maps, and these override the
        style's. Ranges and weights are merged feature by feature.

        Raises:
          InputError: for an unknown option, a wrong value, or two budgets.
        """
        _check_budget(options)
        inputs = [*_inputs_of(options)]
        # The options for large maps may also be a specification that was made of them.
        large = options.get("large")
        if isinstance(large, SearchSpec):
            options["large"] = large.options
        user_features = check_named("features", check_features, options.get("features", ()))
        checked = check_options(options, user_features)
        inputs += _inputs_of_style(checked.get("style"))
        object.__setattr__(self, "options", checked)
        object.__setattr__(self, "inputs", tuple(dict.fromkeys(inputs)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SearchSpec) and self.options == other.options

    def __repr__(self) -> str:
        """Returns the call that makes the specification."""
        options = ", ".join(f"{name}={value!r}" for name, value in self.options.items())
        return f"SearchSpec({options})"

    @cached_property
    def merged(self) -> Merged:
        """The options, merged once with those of the example maps and of the style.

        Raises:
          InputError: for a wrong option of the style, or example maps without roads.
        """
        return merge_layers(self.options)

    def replace(self, **options: Unpack[SpecOptions]) -> Self:
        """Returns a specification with new options.

        They apply as if they had been given together with the earlier ones.

        Raises:
          InputError: as the constructor does.
        """
        earlier: dict[str, OptionValue] = dict(self.options)
        if _check_budget(options):
            for name in BUDGET:
                earlier.pop(name, None)
        both: Untyped = {**earlier, **options}
        spec = type(self)(**both)
        object.__setattr__(spec, "inputs", tuple(dict.fromkeys((*spec.inputs, *self.inputs))))
        return spec


def _inputs_of(options: Mapping[str, UserValue]) -> Iterator[str]:
    """Yields the files and folders that options name, before they are checked."""
    yield from inputs_among(options, OPTIONS)
    large = options.get("large")
    if isinstance(large, SearchSpec):
        yield from large.inputs
    elif isinstance(large, Mapping):
        yield from inputs_among(large, OPTIONS)


def _inputs_of_style(style: Style | None) -> Iterator[str]:
    """Yields the files and folders that the options in a style's file name."""
    # The words of the package's own styles, such as duckietown, name no files.
    if style is not None and style.name not in STYLES:
        yield from _inputs_of(style.options)


def _check_budget(options: Mapping[str, UserValue]) -> bool:
    """Returns whether options have a budget; raises `InputError` for two."""
    generations, evaluations = map(options.get, BUDGET)
    if generations is not None and evaluations is not None:
        raise InputError("generations", f"none with evaluations={evaluations}", generations)
    return generations is not None or evaluations is not None
