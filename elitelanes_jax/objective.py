"""Fitness: a weighted sum of metrics, to be minimised (paper, section "Fitness Function")."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array, Numeric

from elitelanes_jax.errors import InputError
from elitelanes_jax.metrics import Metrics

__all__ = ["Weights", "check_weights", "fitness", "penalties"]


class Weights(NamedTuple):
    """What one unit of each metric adds to the fitness: integers, negative ones reward.

    The default is the paper's equation, a(x) read as adjacent crossings and b(x) as bridges. Other readings are other
    records, and an array in place of a number sweeps it under `jax.vmap`.

    Attributes:
      components: for each component beyond the first.
      constant: added once.
      others: each for a unit of the metric of its name.
    """

    components: Numeric = 300
    cyclomatic: Numeric = -2
    dead_ends: Numeric = 480
    boundary_violations: Numeric = 150
    bridges: Numeric = 100
    crossings: Numeric = 0
    adjacent_crossings: Numeric = 100
    adjacent_crossing_score: Numeric = 0
    adjacent_turns: Numeric = 80
    straight_score: Numeric = -2
    straights: Numeric = 0
    turns: Numeric = 0
    crowded_crossings: Numeric = 0
    unlinked_neighbours: Numeric = 0
    tiles: Numeric = 0
    empty_cells: Numeric = 0
    edges: Numeric = 0
    mismatches: Numeric = 0
    off_alphabet: Numeric = 480
    constant: Numeric = 0


def fitness(metrics: Metrics, weights: Weights = Weights()) -> Array:  # noqa: B008
    """The weighted sum of a grid's metrics, lower is better.

    Args:
      metrics: of one grid, or of many with the same leading axes.
      weights: integers, or integer arrays that broadcast against the metrics; see `check_weights` for how large.

    Returns:
      int32, of the metrics' shape.

    Raises:
      InputError: for weights that are not integers.
    """
    total = _integer("constant", weights.constant)
    for name in Weights._fields[:-1]:
        value = getattr(metrics, name)
        if name == "components":
            value = jnp.maximum(value - 1, 0)
        total = total + _integer(name, getattr(weights, name)) * value
    return total


def penalties(weights: Weights) -> Weights:
    """The weights of flaws alone: what rewards, and the constant, is 0."""
    return Weights(*(jnp.maximum(weight, 0) for weight in weights))._replace(constant=0)


def _integer(name: str, weight: Numeric) -> Array:
    array = weight if isinstance(weight, jax.Array) else np.asarray(weight)
    if not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError(f"weights: expected integers, got {name} of type {array.dtype}")
    if isinstance(array, np.ndarray) and (array != array.astype(np.int32)).any():
        raise InputError(f"weights: expected integers of 32 bits, got {name}={weight!r}")
    return jnp.asarray(array, jnp.int32)


def check_weights(weights: Weights, shape: tuple[int, int]) -> Weights:
    """The weights as ints.

    Args:
      weights: concrete numbers.
      shape: (height, width) of the grids they are meant for.

    Raises:
      InputError: if one is not a whole number, or the fitness of a grid of that shape could leave int32.
    """
    if not isinstance(weights, Weights):
        raise InputError(f"weights: expected Weights, got {type(weights).__name__}")
    for name, weight in weights._asdict().items():
        if np.ndim(weight) or not np.issubdtype(np.asarray(weight).dtype, np.integer):
            raise InputError(f"weights: expected whole numbers, got {name}={weight!r}")
    exact = Weights(*(int(weight) for weight in weights))
    largest = sum(abs(getattr(exact, name)) * most for name, most in _most(shape).items())
    if largest >= 2**31:
        raise InputError(
            f"weights: expected a fitness within int32 for every grid of {shape[0]} x {shape[1]}, "
            f"got weights with which it might reach {largest:,}"
        )
    return exact


def _most(shape: tuple[int, int]) -> dict[str, int]:
    """No grid of the shape has more than so many units of what each weight is for."""
    area = shape[0] * shape[1]
    # Two links and two pairs a tile, four connections a tile; a pair of crossings counts twice, and eight at most for
    # its score; one run of L² in each row or column.
    others = {
        "bridges": 2 * area,
        "edges": 2 * area,
        "adjacent_turns": 2 * area,
        "crowded_crossings": 2 * area,
        "unlinked_neighbours": 2 * area,
        "adjacent_crossings": 4 * area,
        "mismatches": 4 * area,
        "adjacent_crossing_score": 16 * area,
        "straight_score": max(shape) * area,
        "constant": 1,
    }
    return {name: others.get(name, area) for name in Weights._fields}
