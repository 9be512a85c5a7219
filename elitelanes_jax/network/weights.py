"""The weights of the fitness: a record, without JAX."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.network.checks import LONGEST_SIDE
from elitelanes_jax.network.metric_names import largest_metrics

if TYPE_CHECKING:
    from jaxtyping import ArrayLike, Int


class Weights(NamedTuple):
    """The amount that one unit of each metric adds to the fitness: integers; negative ones reward.

    The default is the paper's equation (section "Fitness Function"), with a(x) read as adjacent crossings and b(x) as
    bridges. `jax.vmap` may map over arrays of weights.

    Attributes:
      components: for each component beyond the first.
      constant: added once.
      others: each for one unit of the metric with its name.
    """

    components: "Int[ArrayLike, '...']" = 300
    cyclomatic: "Int[ArrayLike, '...']" = -2
    dead_ends: "Int[ArrayLike, '...']" = 480
    boundary_violations: "Int[ArrayLike, '...']" = 150
    bridges: "Int[ArrayLike, '...']" = 100
    crossings: "Int[ArrayLike, '...']" = 0
    adjacent_crossings: "Int[ArrayLike, '...']" = 100
    adjacent_crossing_score: "Int[ArrayLike, '...']" = 0
    adjacent_turns: "Int[ArrayLike, '...']" = 80
    straight_score: "Int[ArrayLike, '...']" = -2
    straights: "Int[ArrayLike, '...']" = 0
    turns: "Int[ArrayLike, '...']" = 0
    crowded_crossings: "Int[ArrayLike, '...']" = 0
    unlinked_neighbours: "Int[ArrayLike, '...']" = 0
    tiles: "Int[ArrayLike, '...']" = 0
    empty_cells: "Int[ArrayLike, '...']" = 0
    edges: "Int[ArrayLike, '...']" = 0
    mismatches: "Int[ArrayLike, '...']" = 0
    off_alphabet: "Int[ArrayLike, '...']" = 480
    constant: "Int[ArrayLike, '...']" = 0


def check_weights(weights: UserValue, shape: tuple[int, int], more: int = 0) -> Weights:
    """Checks weights; returns them as ints.

    Raises `InputError` if one is not a whole number, or the fitness of a grid of the shape might not fit int32 together
    with other features, which add at most `more` in size.
    """
    if not isinstance(weights, Weights):
        raise InputError(f"weights: expected Weights, got {type(weights).__name__}")
    for name, weight in weights._asdict().items():
        if np.ndim(weight) or not np.issubdtype(np.asarray(weight).dtype, np.integer):
            raise InputError(f"weights: expected whole numbers, got {name}={weight!r}")
    exact = Weights(*(int(np.asarray(weight)) for weight in weights))
    largest = _largest_fitness(exact, shape) + more
    if largest >= 2**31:
        raise InputError(
            f"weights: expected a fitness within int32 for every grid of {shape[0]} x {shape[1]}, "
            f"got weights with which it might reach {largest:,}"
        )
    return exact


def largest_side(weights: Weights) -> int:
    """Returns the longest side of a square grid whose fitness always fits int32; 0 if the weights are too large."""
    fits = [side for side in range(2, LONGEST_SIDE + 1) if _largest_fitness(weights, (side, side)) < 2**31]
    return max(fits, default=0)


def _largest_fitness(weights: Weights, shape: tuple[int, int]) -> int:
    units = largest_metrics(shape) | {"constant": 1}
    return sum(abs(int(getattr(weights, name))) * most for name, most in units.items())
