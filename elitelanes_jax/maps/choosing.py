"""Chooses maps of a result for a folder, and describes where they come from."""

from collections.abc import Sequence

from jaxtyping import Int8
from numpy import ndarray

from elitelanes_jax._util.errors import NotEnoughMapsError
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.types import Plain
from elitelanes_jax.optimizers.presets import config_to_plain
from elitelanes_jax.problem.archive import coverage, qd_score
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.selection import Choice
from elitelanes_jax.tiles.tileset import TileSet


def choose_enough(
    result: Result,
    count: int,
    *,
    at_most: bool,
    seed: int = 0,
    exclude: Sequence[Int8[ndarray, "_ _"]] = (),
    hint: str | None = None,
) -> Choice:
    """Chooses maps as `Result.choose` does, and fails if there are too few.

    Args:
      result: the result of a search.
      count: the number of maps.
      at_most: whether fewer maps are enough.
      seed: the seed of the run; it is noted in the maps.
      exclude: grids that no chosen map may equal.
      hint: what finds more; by default it depends on the search.

    Raises:
      NotEnoughMapsError: for fewer maps than `count`; with `at_most`, for none.
    """
    with Progress("choosing maps"):
        choice = result.choose(count, seed, exclude=exclude)
    enough = 1 if at_most else count
    if len(choice.maps) < enough:
        if hint is None:
            hint = choice.hint(result.search)
        raise NotEnoughMapsError(choice.describe_shortage(count, hint))
    return choice


def describe_archive(result: Result) -> dict[str, list[float]]:
    """Returns two metrics of an archive, by seed. An elite worse than 0 does not count."""
    valid = result.elites.valid
    score = qd_score(result.elites.fitness, valid, worst=0)
    return {"coverage": coverage(valid).tolist(), "qd_score": score.tolist()}


def describe_source(tiles: TileSet, result: Result, choice: Choice | None) -> dict[str, Plain]:
    """Returns the entries that the records of all folders of maps share, plain values for JSON."""
    record: dict[str, Plain] = {
        "config": result.config and config_to_plain(result.config),
        "tile_set": {
            name: getattr(tiles, name) for name in ("name", "licence", "alphabet", "blend")
        },
        "axes": [axis._asdict() for axis in result.search.axes],
    }
    if choice is not None:
        record["elites"] = {
            "found": choice.found,
            "rejected": choice.rejected,
            "alike": choice.alike,
        }
    return record
