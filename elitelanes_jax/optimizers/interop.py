"""A problem in the interfaces of QDax, evosax and pyribs. None of these libraries is imported here.

Each function takes a `Problem` (see `road_problem`) and returns the functions that the loop of the
other library calls. QDax and pyribs maximise, so they receive the negative fitness. QDax and evosax
store it as float32, which represents whole numbers exactly up to 2**24 in size.
"""

from collections.abc import Callable
from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32, Key
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import ArrayOrRows, Untyped, UserValue
from elitelanes_jax.network.bits import normal, random_bits
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.optimizers._moves import MoveWeights, random_move
from elitelanes_jax.optimizers._population import evaluate as evaluate_all
from elitelanes_jax.problem.descriptor import Axis, niche_bins
from elitelanes_jax.problem.problem import Problem


def qdax_scoring_fn(
    problem: Problem,
) -> Callable[[Array, Key[Array, ""]], tuple[Array, Array, dict[str, Array]]]:
    """Makes the scoring function of QDax's `MAPElites` (QDax 0.5), on genotypes that are grids.

    Args:
      problem: a problem with at least one axis.

    Returns:
      (genotypes int8 ``[B, H, W]``, key) -> (fitness float32 ``[B]`` to be maximised, descriptor
      float32 ``[B, D]``, extra scores). The descriptor is the bin on each axis, a whole number from
      0; its nearest centroid in `qdax_centroids` is the niche. The extra scores are
      ``{"features": int32 [B, F]}``, in the order of `Problem.feature_names`. The key is not used,
      because the evaluation has no noise. A refused grid has the fitness -inf and becomes no elite.
      Genotypes are not repaired; `Problem.random` and `qdax_moves` return repaired ones.

    Raises:
      InputError: from the function, for genotypes of another shape or type.
    """
    _check_niches(problem)

    def score(genotypes: Array, key: Key[Array, ""]) -> tuple[Array, Array, dict[str, Array]]:
        genotypes = _check_grids("genotypes", problem, genotypes)
        population = evaluate_all(problem, genotypes)
        bins = niche_bins(problem.descriptor(population.features), problem.axes)
        # The fitness of a refused grid may be the largest int32, which is finite. So -inf replaces
        # it.
        negative_fitness = (-population.fitness).astype(jnp.float32)
        fitness = jnp.where(population.valid, negative_fitness, -jnp.inf)
        return fitness, bins.astype(jnp.float32), {"features": population.features}

    return score


def _check_niches(problem: UserValue) -> None:
    checked = check_named("problem", instance(Problem), problem)
    check_named("problem", _count_niches, checked)


def _count_niches(problem: Problem) -> int:
    """Returns the number of niches; raises for a problem without axes."""
    return problem.niches


def _check_grids(name: str, problem: Problem, grids: Array) -> Array:
    return check_array(name, grids, ("B", *problem.shape), jnp.int8)


@name_wrong_arguments
@runs_jax
def qdax_centroids(axes: tuple[Axis, ...]) -> Array:
    """Returns centroids, float32 ``[N, D]``, that give QDax the same niches.

    They are in the order of `Problem.niche`. They are whole numbers, so that distances are exact and
    only the niche's own centroid is nearest.
    """
    if not axes:
        raise InputError("axes", "at least one", "none")
    bins = np.indices([axis.bins for axis in axes], np.float32)
    return jnp.asarray(bins.reshape(len(axes), -1).T)


@name_wrong_arguments
def qdax_moves(
    problem: Problem,
    weights: MoveWeights = MoveWeights(),
) -> tuple[
    Callable[[Array, Key[Array, ""]], Array], Callable[[Array, Array, Key[Array, ""]], Array]
]:
    """Makes the mutation and the variation of QDax's `MixingEmitter` (QDax 0.5).

    Each makes a random move and repairs the grid.

    Args:
      problem: whose repair follows each move.
      weights: the weights of the moves.

    Returns:
      Two functions of genotypes, int8 ``[B, H, W]``: the mutation, (genotypes, key) -> genotypes,
      whose moves copy blocks within a grid; and the variation, (genotypes, mates, key) ->
      genotypes, whose moves copy blocks of the mates. Keys are consumed.

    Raises:
      InputError: from the functions, for genotypes of another shape or type.
    """
    check_named("problem", instance(Problem), problem)
    move = random_move(weights, fill=problem.fill, fixed=problem.fixed)

    @divide_batches
    def move_and_repair(bits: Array, grid: Array, mate: Array) -> Array:
        moved_grid, dirty = move.apply(bits, grid, mate)
        return problem.repair(moved_grid, dirty)

    def vary(genotypes: Array, mates: Array, key: Key[Array, ""]) -> Array:
        genotypes = _check_grids("genotypes", problem, genotypes)
        mates = _check_grids("mates", problem, mates)
        if len(mates) != len(genotypes):
            raise InputError("mates", pluralize(len(genotypes), "grid"), len(mates))
        bits = random_bits(key, (len(genotypes), move.bits))
        return jax.vmap(move_and_repair)(bits, genotypes, mates)

    def mutate(genotypes: Array, key: Key[Array, ""]) -> Array:
        # A mutation has no mates, so blocks are copied within each genotype.
        return vary(genotypes, genotypes, key)

    return mutate, vary


class EvosaxState(NamedTuple):
    """The state of an `EvosaxTask`.

    Attributes:
      counter: int32, the number of batches evaluated so far.
    """

    counter: Int32[Array, ""]


class EvosaxTask(NamedTuple):
    """The interface of evosax's `Problem` (evosax 0.3): from logits to a fitness to be minimised.

    A solution has K logits for each cell, ``[H·W·K]``, row by row, for the K codes of the problem's
    alphabet.

    Attributes:
      num_dims: H·W·K.
      init: key -> `EvosaxState`.
      eval: (key, solutions float ``[B, num_dims]``, state) -> (fitness float32 ``[B]``, state,
        metrics). Metrics are ``{"features": int32 [B, F]}``, in the order of
        `Problem.feature_names`. The key is not used, because the evaluation has no noise. evosax
        cannot refuse a grid: a refused one has the highest fitness, 2147483648 or the largest
        float32.
      sample: key -> a solution float32 ``[num_dims]``, standard normal; all codes are equally
        likely.
      decode: a solution float ``[num_dims]`` -> its grid int8 ``[H, W]``: each cell has the code of
        its largest logit, the first among equal ones; then `Problem.repair_raster` repairs the
        grid. NaN counts as the largest.
    """

    num_dims: int
    init: Callable[[Key[Array, ""]], EvosaxState]
    eval: Callable[
        [Key[Array, ""], Array, EvosaxState], tuple[Array, EvosaxState, dict[str, Array]]
    ]
    sample: Callable[[Key[Array, ""]], Array]
    decode: Callable[[Array], Array]


@runs_jax
def evosax_task(problem: Problem) -> EvosaxTask:
    """Makes the task that evosax's strategies solve.

    Its `eval` and `decode` refuse solutions of another length.
    """
    check_named("problem", instance(Problem), problem)
    codes = jnp.array(problem.alphabet, jnp.int8)
    height, width = problem.shape
    shape = (height, width, len(problem.alphabet))
    length = prod(shape)

    @runs_jax
    def init(key: Key[Array, ""]) -> EvosaxState:
        return EvosaxState(jnp.int32(0))

    @runs_jax
    def sample(key: Key[Array, ""]) -> Array:
        return normal(key, (length,))

    @divide_batches
    def decode(solution: Array) -> Array:
        if solution.shape != (length,):
            raise InputError("solution", f"logits [{length}]", f"shape {solution.shape}")
        indices = solution.reshape(shape).argmax(axis=-1)
        return problem.repair_raster(codes[indices])

    def evaluate(
        key: Key[Array, ""], solutions: Array, state: EvosaxState
    ) -> tuple[Array, EvosaxState, dict[str, Array]]:
        grids = jax.vmap(decode)(solutions)
        population = evaluate_all(problem, grids)
        # Means of a strategy need finite numbers, so infinity becomes the largest one.
        fitness = population.fitness.astype(jnp.float32).clip(None, np.finfo(np.float32).max)
        metrics = {"features": population.features}
        return fitness, EvosaxState(state.counter + 1), metrics

    return EvosaxTask(
        num_dims=length,
        init=init,
        eval=runs_jax(jax.jit(evaluate)),
        sample=sample,
        decode=runs_jax(jax.jit(decode)),
    )


def ribs_archive_space(problem: Problem) -> dict[str, Untyped]:
    """Returns arguments for pyribs's `GridArchive` (pyribs 0.12).

    With them, the cells of the archive are our niches, in the same order.

    Returns:
      ``solution_dim``, H·W; ``dims``, the bins of each axis; and ``ranges``, from the start of the
      first bin to the end of the last one.
    """
    _check_niches(problem)
    dims = []
    ranges = []
    for axis in problem.axes:
        dims.append(axis.bins)
        ranges.append((axis.start, axis.start + axis.bins * axis.width))
    return {"solution_dim": prod(problem.shape), "dims": dims, "ranges": ranges}


def ribs_grids(problem: Problem) -> Callable[[Untyped], NDArray[np.int8]]:
    """Makes the function from solutions of pyribs to grids.

    Returns:
      Solutions ``[B, H·W]``, row by row -> repaired grids int8 ``[B, H, W]``. Integers are tile
      codes. A real number x is the code at index floor(x) of the problem's alphabet, limited to the
      first and the last index. The function raises `InputError` for solutions of another shape,
      numbers that are not finite, or codes outside 0..15.
    """
    check_named("problem", instance(Problem), problem)
    height, width = problem.shape
    size = height * width
    codes = np.array(problem.alphabet, np.int8)
    repair_all = runs_jax(jax.jit(jax.vmap(problem.repair_raster)))

    def to_grids(solutions: ArrayOrRows) -> NDArray[np.int8]:
        try:
            array = np.asarray(solutions)
        except ValueError as error:
            # NumPy makes no array of rows with several lengths.
            raise InputError("solutions", f"numbers [B, {size}]", error) from None
        if array.ndim != 2 or array.shape[1] != size or array.dtype.kind not in "iuf":
            raise InputError("solutions", f"numbers [B, {size}]", f"{array.dtype} {array.shape}")
        if array.dtype.kind == "f":
            if not np.isfinite(array).all():
                # The floor of these is no index.
                raise InputError("solutions", "finite numbers", "NaN or infinity")
            # Emitters propose real numbers of any size, so indices outside the alphabet are
            # limited.
            indices = np.floor(array).clip(0, len(codes) - 1).astype(int)
            array = codes[indices]
        elif array.size and (array.min() < 0 or array.max() > 15):
            got = f"{array.min()} to {array.max()}"
            raise InputError("solutions", "tile codes 0 to 15", got)
        grids = array.astype(np.int8).reshape(-1, height, width)
        return np.asarray(repair_all(grids))

    return to_grids


def ribs_evaluate(
    problem: Problem,
) -> Callable[[Untyped], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Makes the evaluation in pyribs's loop (pyribs 0.12), between `ask` and `tell`.

    Returns:
      Solutions ``[B, H·W]`` (see `ribs_grids`) -> (objective float64 ``[B]`` to be maximised,
      measures float64 ``[B, D]``, the values of the axes' features). pyribs cannot refuse a grid: a
      refused one has the lowest objective, -2147483647 or that of float32.
    """
    to_grids = ribs_grids(problem)

    @runs_jax
    @jax.jit
    def score(grids: Array) -> tuple[Array, Array]:
        population = evaluate_all(problem, grids)
        is_float = jnp.issubdtype(population.fitness.dtype, jnp.floating)
        lowest = np.finfo(np.float32).min if is_float else -(2**31 - 1)
        objective = jnp.where(population.valid, -population.fitness, lowest)
        return objective, problem.descriptor(population.features)

    def evaluate(solutions: ArrayOrRows) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        objective, descriptor = score(to_grids(solutions))
        return np.asarray(objective, np.float64), np.asarray(descriptor, np.float64)

    return evaluate
