"""The problem in the interfaces of QDax, evosax and pyribs; none of them is imported here.

Each function takes a `Problem` (see `road_problem`) and returns the functions that the other library's own loop calls.
QDax and pyribs maximise: they get the fitness with its sign changed. A fitness is a whole number; float32, in which
QDax and evosax keep it, holds it exactly up to 2**24 either way.
"""

from collections.abc import Callable
from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32, Key
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import AnyArray, Untyped
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.optimizers._moves import Mix, random_move
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, niche_bins
from elitelanes_jax.problem.problem import Problem


def qdax_scoring_fn(problem: Problem) -> Callable[[Array, Key[Array, ""]], tuple[Array, Array, dict[str, Array]]]:
    """Makes the scoring function of QDax's `MAPElites` (QDax 0.5), on genotypes that are grids.

    Args:
      problem: with a fitness and axes.

    Returns:
      (genotypes int8 ``[B, H, W]``, key) -> (fitness float32 ``[B]`` to be maximised, descriptor float32 ``[B, D]``,
      extra scores). The descriptor is the bin on each axis, a whole number from 0, whose nearest centroid of
      `qdax_centroids` is our niche. Extra scores are ``{"counts": int32 [B, M]}``, as `stack_counts` orders them. The
      key is not used, for there is no noise. Genotypes are taken as they are; those of `Problem.random` and
      `qdax_moves` are repaired.

    Raises:
      InputError: from the function, for genotypes of another shape or type.
    """

    def score(genotypes: Array, key: Key[Array, ""]) -> tuple[Array, Array, dict[str, Array]]:
        _check_genotypes(problem, genotypes)
        fitness, counts = problem.evaluate(genotypes)
        bins = niche_bins(compute_descriptor(counts, problem.axes), problem.axes)
        return (-fitness).astype(jnp.float32), bins.astype(jnp.float32), {"counts": counts}

    return score


def _check_genotypes(problem: Problem, genotypes: Array) -> None:
    if genotypes.shape[1:] != problem.shape or genotypes.dtype != jnp.int8:
        height, width = problem.shape
        raise InputError(
            f"genotypes: expected int8 grids [B, {height}, {width}], got {genotypes.dtype} {genotypes.shape}"
        )


def qdax_centroids(axes: tuple[Axis, ...]) -> Array:
    """Returns the centroids, float32 ``[N, D]``, that give QDax the same niches, in the order of `niche_index`.

    They are whole numbers, so that no distance is rounded and the niche's own centroid alone is nearest.
    """
    bins = np.indices([axis.bins for axis in axes], np.float32)
    return jnp.asarray(bins.reshape(len(axes), -1).T)


def qdax_moves(
    problem: Problem,
    mix: Mix = Mix(),
) -> tuple[Callable[[Array, Key[Array, ""]], Array], Callable[[Array, Array, Key[Array, ""]], Array]]:
    """Makes the mutation and the variation of QDax's `MixingEmitter` (QDax 0.5): one move of the mix each, repaired.

    Args:
      problem: that repairs.
      mix: how often each move is made.

    Returns:
      (genotypes, key) -> genotypes, and (genotypes, mates, key) -> genotypes, all int8 ``[B, H, W]``. The second
      transplants blocks of the mates, the first blocks of the same grid. Keys are consumed.

    Raises:
      InputError: for a bad mix; from the functions, for genotypes of another shape or type.
    """
    move = random_move(mix, fill=problem.fill, fixed=problem.fixed)

    def varied(bits: Array, grid: Array, mate: Array) -> Array:
        return problem.repair(*move.apply(bits, grid, mate))

    def vary(genotypes: Array, mates: Array, key: Key[Array, ""]) -> Array:
        _check_genotypes(problem, genotypes)
        _check_genotypes(problem, mates)
        return jax.vmap(varied)(random_bits(key, (len(genotypes), move.bits)), genotypes, mates)

    def mutate(genotypes: Array, key: Key[Array, ""]) -> Array:
        return vary(genotypes, genotypes, key)

    return mutate, vary


class EvosaxState(NamedTuple):
    """The state that an `EvosaxTask` carries.

    Attributes:
      counter: int32, batches evaluated so far.
    """

    counter: Int32[Array, ""]


class EvosaxTask(NamedTuple):
    """The interface of evosax's `Problem` (evosax 0.3): logits in, a fitness to be minimised out.

    A solution has K logits for each cell, ``[H·W·K]``, row by row, for the K codes of the problem's alphabet.

    Attributes:
      num_dims: H·W·K.
      init: key -> `EvosaxState`.
      eval: (key, solutions float ``[B, num_dims]``, state) -> (fitness float32 ``[B]``, state, metrics), where metrics
        are ``{"counts": int32 [B, M]}``, as `stack_counts` orders them. The key is not used: there is no noise.
      sample: key -> a solution float32 ``[num_dims]``, standard normal; every code is as likely as any other.
      decode: a solution float ``[num_dims]`` -> its grid int8 ``[H, W]``: in each cell the code of the largest logit,
        the first among equals, then repaired by `Problem.repair_raster`. NaN counts as larger than all.
    """

    num_dims: int
    init: Callable[[Key[Array, ""]], EvosaxState]
    eval: Callable[[Key[Array, ""], Array, EvosaxState], tuple[Array, EvosaxState, dict[str, Array]]]
    sample: Callable[[Key[Array, ""]], Array]
    decode: Callable[[Array], Array]


def evosax_task(problem: Problem) -> EvosaxTask:
    """Makes the problem for evosax's strategies.

    Raises:
      InputError: from `eval` and `decode`, for solutions of another length.
    """
    codes = jnp.array(problem.alphabet, jnp.int8)
    shape = (*problem.shape, len(problem.alphabet))

    def init(key: Key[Array, ""]) -> EvosaxState:
        return EvosaxState(jnp.int32(0))

    def sample(key: Key[Array, ""]) -> Array:
        return jax.random.normal(key, (prod(shape),))

    def decode(solution: Array) -> Array:
        if solution.shape != (prod(shape),):
            raise InputError(f"solution: expected logits [{prod(shape)}], got shape {solution.shape}")
        return problem.repair_raster(codes[solution.reshape(shape).argmax(axis=-1)])

    def evaluate(
        key: Key[Array, ""], solutions: Array, state: EvosaxState
    ) -> tuple[Array, EvosaxState, dict[str, Array]]:
        fitness, counts = problem.evaluate(jax.vmap(decode)(solutions))
        return fitness.astype(jnp.float32), EvosaxState(state.counter + 1), {"counts": counts}

    return EvosaxTask(prod(shape), init, jax.jit(evaluate), sample, jax.jit(decode))


def ribs_archive_space(problem: Problem) -> dict[str, Untyped]:
    """Returns the arguments with which pyribs's `GridArchive` (pyribs 0.12) has our niches as cells, in their order.

    Returns:
      ``solution_dim`` H·W, and of the problem's axes ``dims``, the bins, and ``ranges``, from where the first bin
      starts to where the last one would end.
    """
    return {
        "solution_dim": prod(problem.shape),
        "dims": [axis.bins for axis in problem.axes],
        "ranges": [(axis.start, axis.start + axis.bins * axis.width) for axis in problem.axes],
    }


def ribs_grids(problem: Problem) -> Callable[[Untyped], NDArray[np.int8]]:
    """Makes the function from solutions of pyribs to grids.

    Returns:
      Solutions ``[B, H·W]``, row by row -> repaired grids int8 ``[B, H, W]``. Integers are tile codes. Real numbers are
      places in the problem's alphabet of K codes: 0 to under 1 is the first, K - 1 to under K the last; others are
      clipped to these.

    Raises:
      InputError: from the function, for solutions of another shape, numbers that are not finite, or codes outside
        0..15.
    """
    size, last = prod(problem.shape), len(problem.alphabet) - 1
    codes = np.array(problem.alphabet, np.int8)
    settle = jax.jit(jax.vmap(problem.repair_raster))

    def grids(solutions: AnyArray) -> NDArray[np.int8]:
        try:
            array = np.asarray(solutions)
        except ValueError as error:
            raise InputError(f"solutions: expected numbers [B, {size}], got: {error}") from None
        if array.ndim != 2 or array.shape[1] != size or array.dtype.kind not in "iuf":
            raise InputError(f"solutions: expected numbers [B, {size}], got {array.dtype} {array.shape}")
        if array.dtype.kind == "f":
            if not np.isfinite(array).all():
                raise InputError("solutions: expected finite numbers, got NaN or infinity")
            array = codes[np.floor(array).clip(0, last).astype(int)]
        elif array.size and (array.min() < 0 or array.max() > 15):
            raise InputError(f"solutions: expected tile codes 0 to 15, got {array.min()} to {array.max()}")
        return np.asarray(settle(array.astype(np.int8).reshape(-1, *problem.shape)))

    return grids


def ribs_evaluate(problem: Problem) -> Callable[[Untyped], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Makes the evaluation for pyribs's loop (pyribs 0.12), between `ask` and `tell`.

    Returns:
      Solutions ``[B, H·W]`` (see `ribs_grids`) -> (objective float64 ``[B]`` to be maximised, measures float64
      ``[B, D]``, the plain values of the axes' features).

    Raises:
      InputError: from the function, see `ribs_grids`.
    """
    grids = ribs_grids(problem)

    @jax.jit
    def scored(batch: Array) -> tuple[Array, Array]:
        fitness, counts = problem.evaluate(batch)
        return -fitness, compute_descriptor(counts, problem.axes)

    def evaluate(solutions: AnyArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        objective, descriptor = scored(grids(solutions))
        return np.asarray(objective, np.float64), np.asarray(descriptor, np.float64)

    return evaluate
