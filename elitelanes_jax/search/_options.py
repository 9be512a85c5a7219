"""The types of a search's options for type checkers and editors. `SearchSpec` checks them and says what they mean."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from elitelanes_jax.formats.road_map import RoadMap
    from elitelanes_jax.network.records import Weights
    from elitelanes_jax.problem.descriptor import Axis
    from elitelanes_jax.problem.fixed_cells import FixedCells
    from elitelanes_jax.problem.ranges import Range
    from elitelanes_jax.problem.targets import ExampleValues
    from elitelanes_jax.search.spec import SearchSpec

Maps: TypeAlias = "str | Path | ArrayLike | RoadMap | Iterable[str | Path | ArrayLike | RoadMap]"
"""One map or several: files, grids or records."""

Limits: TypeAlias = "str | float | tuple[float | None, float | None]"
"""The limits of a range: ``"6..10"``, ``6``, or ``(6, None)``."""


class SearchOptions(TypedDict, total=False):
    """The options of `evolve`, which takes the user's features as kernels."""

    style: "str | Path | None"
    like: Maps
    method: str
    preset: str
    evaluations: "int | str"
    generations: "int | str | None"
    axes: "str | Axis | Iterable[str | Axis | Mapping[str, Any]] | Mapping[str, int | tuple[int, int]] | None"
    where: "str | Range | Iterable[str | Range] | Mapping[str, Limits]"
    weights: "str | Weights | Mapping[str, int] | Iterable[str | tuple[str, int]]"
    targets: "Mapping[str, Sequence[float]] | Iterable[ExampleValues]"
    fix: "str | Path | FixedCells | ArrayLike | Sequence[Sequence[int | None]] | None"
    rules: "str | None"
    inventory: "str | Path | Mapping[str, int] | Iterable[str | tuple[str, int]] | None"
    fill: "bool | None"
    initial: Maps
    alphabet: "Iterable[int] | None"
    large: "Mapping[str, Any] | SearchSpec | None"


class SpecOptions(SearchOptions, total=False):
    """The options of `SearchSpec`."""

    features: "Iterable[str]"
