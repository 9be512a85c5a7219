"""The published sets of operators, which searches of the fixed-operator tracks vary grids with."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Key

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, one_of, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import ArrayOrRows
from elitelanes_jax.benchmark.checks import SpentError, check_batch
from elitelanes_jax.benchmark.submissions import TRACKS
from elitelanes_jax.benchmark.tasks import Task
from elitelanes_jax.network.bits import fold_in, randint, random_bits, seed_key
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.optimizers.interop import qdax_moves
from elitelanes_jax.problem.problem import Problem
from elitelanes_jax.problem.road import road_problem

OPERATOR_SETS = TRACKS[1:]
"""The names of the sets of operators."""


class OperatorSet(NamedTuple):
    """Two functions for `jax.jit`, which consume their keys.

    Attributes:
      random: (key, count) -> int8 ``[count, H, W]``, grids to start from.
      mutate: (grids int8 ``[B, H, W]``, key) -> int8 ``[B, H, W]``, each grid with one change.

    `random` raises `InputError` for a count below 1, and `mutate` for grids of another shape or
    dtype.
    """

    random: Callable[[Key[Array, ""], int], Array]
    mutate: Callable[[Array, Key[Array, ""]], Array]


@name_wrong_arguments
def find_operators(name: str, shape: tuple[int, int], *, fill: bool) -> OperatorSet:
    """Returns a set of operators for grids of one shape.

    - ``tiles``: starts from `Problem.random`; a mutation draws a cell, and its code uniformly from
      those with no or at least two connections. Then repair links the tile as the code says.
    - ``links``: starts from grids in which each pair of neighbours is linked with probability 1/2;
      a mutation draws a pair of neighbours uniformly, and makes or cuts its link.
    - ``moves``: starts from `Problem.random`; a mutation is that of `qdax_moves`, which repairs.

    Args:
      name: ``tiles``, ``links`` or ``moves``.
      shape: (height, width).
      fill: whether repair fills every cell.

    Raises:
      InputError: for another name or a bad shape.
    """
    check_named("operators", one_of(*OPERATOR_SETS), name)
    shape = check_shape(shape, new=True)
    if name == "links":
        return _checked(_links(shape), shape)
    problem = road_problem(shape, fill=fill)
    mutate = qdax_moves(problem)[0] if name == "moves" else _tile_flip(problem)
    return _checked(OperatorSet(problem.random, mutate), shape)


def _checked(operators: OperatorSet, shape: tuple[int, int]) -> OperatorSet:
    """Returns the operators with a check of the count, and of the grids' shape and dtype."""

    def random(key: Key[Array, ""], count: int) -> Array:
        return operators.random(key, check_named("count", whole(1), count))

    def mutate(grids: Array, key: Key[Array, ""]) -> Array:
        return operators.mutate(check_array("grids", grids, ("B", *shape), jnp.int8), key)

    return OperatorSet(random, mutate)


def _tile_flip(problem: Problem) -> Callable[[Array, Key[Array, ""]], Array]:
    height, width = problem.shape
    codes = jnp.array([code for code in range(16) if code.bit_count() != 1], jnp.int8)

    def flip(bits: Array, grid: Array) -> Array:
        cell, code = randint(bits[0], height * width), codes[randint(bits[1], len(codes))]
        place = (cell // width, cell % width)
        # Repair lets the new tile decide over its neighbours.
        return problem.repair(
            grid.at[place].set(code), jnp.zeros(grid.shape, bool).at[place].set(True)
        )

    return lambda grids, key: jax.vmap(flip)(random_bits(key, (len(grids), 2)), grids)


def _links(shape: tuple[int, int]) -> OperatorSet:
    height, width = shape
    cells = np.arange(height * width).reshape(shape)
    ends = [
        (cells[:, :-1].ravel(), cells[:, 1:].ravel(), EAST, WEST),
        (cells[:-1].ravel(), cells[1:].ravel(), SOUTH, NORTH),
    ]
    # [L, H·W]: the bits of both tiles that the link of a pair of neighbours sets.
    masks = np.zeros((sum(len(one) for one, *_ in ends), height * width), np.int8)
    start = 0
    for one, other, side, opposite in ends:
        rows = np.arange(start, start + len(one))
        masks[rows, one], masks[rows, other] = side, opposite
        start += len(one)

    def random(key: Key[Array, ""], count: int) -> Array:
        linked = (random_bits(key, (count, len(masks))) & 1).astype(jnp.int8)
        # Every bit is set by one link, so the sum is the union.
        return (linked @ jnp.asarray(masks)).reshape(count, height, width)

    def mutate(grids: Array, key: Key[Array, ""]) -> Array:
        drawn = randint(random_bits(key, (len(grids),)), len(masks))
        return grids ^ jnp.asarray(masks)[drawn].reshape(grids.shape)

    return OperatorSet(random, mutate)


class Operators:
    """The operators of one run, which `run_task` gives to the search.

    A search may yield only grids that its operators have made. The run ends at the next call after
    they have made as many grids as the task has evaluations. A call beyond that number repeats its
    last grid. Operators cannot be copied, because a copy would make grids that nobody counts.
    """

    def __init__(self, name: str, task: Task, seed: int) -> None:
        self._task = check_named("task", instance(Task), task)
        check_named("operators", one_of(*OPERATOR_SETS), name)
        self._random, self._mutate = _compiled(name, task.shape, task.fill)
        number = check_named("seed", whole(0, 2**63 - 1), seed)
        self._key = seed_key(int(np.random.SeedSequence(number).generate_state(1)[0]))
        self._calls = self._count = 0
        self._known: set[bytes] = set()

    def random(self, count: int) -> Int8[np.ndarray, "count H W"]:
        """Returns grids to start from."""
        size = check_named("count", whole(1), count)
        return self._note(lambda key: self._random(key, _round_up(size)), size)

    def mutate(self, grids: ArrayOrRows) -> Int8[np.ndarray, "B H W"]:
        """Returns each of the grids ``[B, H, W]`` with one change.

        Raises:
          InputError: for a grid that these operators have not made.
        """
        parents = check_batch("grids", self._task, grids)
        self.check("grids", parents)
        # Batches of few sizes need few compiled programs.
        padded = np.resize(parents, (_round_up(len(parents)), *self._task.shape))
        return self._note(lambda key: self._mutate(jnp.asarray(padded), key), len(parents))

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise InputError("operators", "one object in a run", "a copy")

    def check(self, subject: str, grids: Int8[np.ndarray, "B H W"]) -> None:
        """Raises `InputError` for a grid that these operators have not made."""
        for index, grid in enumerate(grids):
            if grid.tobytes() not in self._known:
                raise InputError(
                    subject, "grids that the operators of this run have made", f"another at {index}"
                )

    def _note(
        self, make: Callable[[Key[Array, ""]], Array], count: int
    ) -> Int8[np.ndarray, "B H W"]:
        if self._count >= self._task.evaluations:
            raise SpentError
        grids = np.array(make(fold_in(self._key, self._calls)))[:count]
        # A search could otherwise choose among more grids than it may evaluate.
        rest = self._task.evaluations - self._count
        grids[rest:] = grids[min(count, rest) - 1]
        self._calls += 1
        self._count += count
        self._known.update(grid.tobytes() for grid in grids)
        return grids


def _round_up(count: int) -> int:
    """Returns the next power of two."""
    return 1 << (count - 1).bit_length()


@cache
def _compiled(name: str, shape: tuple[int, int], fill: bool) -> OperatorSet:
    random, mutate = find_operators(name, shape, fill=fill)
    return OperatorSet(jax.jit(random, static_argnums=1), jax.jit(mutate))
