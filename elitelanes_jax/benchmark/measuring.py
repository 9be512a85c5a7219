"""The measures by which the benchmark judges grids."""

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int8

from elitelanes_jax._util.types import AnyArray

if TYPE_CHECKING:
    from elitelanes_jax.benchmark.tasks import Task
    from elitelanes_jax.network.records import Metrics

_BATCH = 4096


class Measured(NamedTuple):
    """What is measured of grids ``[B, H, W]``; a search receives it for those that it yields.

    Attributes:
      fitness: int32 ``[B]``, lower is better.
      cyclomatic: int32 ``[B]``, the cyclomatic number.
      flaws: int32 ``[B]``, the number of dead ends, boundary violations, mismatches, adjacent
        crossings, adjacent turns and components beside the first; of empty cells, if the task fills
        every cell; and of bridges, if the task has two descriptors.
      niche: int32 ``[B, D]``, the descriptors: the cyclomatic number, and the number of the task's
        `tiles` if it has two descriptors.
    """

    fitness: Int[np.ndarray, " B"]
    cyclomatic: Int[np.ndarray, " B"]
    flaws: Int[np.ndarray, " B"]
    niche: Int[np.ndarray, "B D"]

    @property
    def counts(self) -> Bool[np.ndarray, " B"]:
        """Whether the grid is flawless, bool ``[B]``. Other grids have no part in `Scores`."""
        return self.flaws == 0


def measure_grids(task: "Task", grids: Int8[np.ndarray, "P H W"]) -> Measured:
    """Measures grids for a task, in batches of one size.

    Batches of one size need only one compiled program.
    """
    batches = []
    for start in range(0, len(grids), _BATCH):
        batch = grids[start : start + _BATCH].astype(np.int8)
        # The last batch is filled up to a power of two, so that few programs are compiled.
        filler = np.zeros(
            (min(_BATCH, 1 << (len(batch) - 1).bit_length()) - len(batch), *batch.shape[1:]),
            np.int8,
        )
        part = _measurer(task.tiles)(np.concatenate([batch, filler]), task.fill)
        batches.append([np.asarray(values)[: len(batch)] for values in part])
    return Measured(*map(np.concatenate, zip(*batches, strict=True)))


def count_flaws(metrics: "Metrics", fill: AnyArray | bool) -> AnyArray:
    """Counts flaws: see `Measured.flaws`. `fill` says whether every cell has to be filled."""
    at_cells = (
        metrics.dead_ends
        + metrics.boundary_violations
        + metrics.mismatches
        # `fill` is a factor, because JAX traces it: one program serves both variants.
        + fill * metrics.empty_cells
    )
    between_cells = metrics.adjacent_crossings + metrics.adjacent_turns
    # A grid without roads has no component, which is one flaw.
    return at_cells + between_cells + abs(metrics.components - 1)


@cache
def _measurer(tiles: str | None) -> Callable[[AnyArray, bool], tuple[AnyArray, ...]]:
    """Returns the program that computes the fields of `Measured`, in their order.

    `tiles` is the second descriptor of the task, or None.
    """
    import jax
    import jax.numpy as jnp

    from elitelanes_jax.network.metrics import measure
    from elitelanes_jax.network.weighted_sum import fitness

    @jax.jit
    def measure_batch(batch: AnyArray, fill: AnyArray) -> tuple[AnyArray, ...]:
        metrics = jax.vmap(measure)(batch)
        flaws = count_flaws(metrics, fill)
        niche = [metrics.cyclomatic]
        if tiles is not None:
            # The optima of these tasks are proven for networks without bridges.
            flaws += metrics.bridges
            niche.append(getattr(metrics, tiles))
        return fitness(metrics), metrics.cyclomatic, flaws, jnp.stack(niche, axis=-1)

    return measure_batch
