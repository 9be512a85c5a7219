"""Localisation by elimination: the number of tiles until a driver with a map knows its position.

The driver does not know its node, a tile and a heading. At each tile it sees which turns are open. It keeps every
possible start, given all that it has seen, and knows its node when all these starts lead to the same node. This is the
exact Bayes filter of a world without noise (Thrun, Burgard and Fox, "Probabilistic robotics", 2005, section 8.2, grid
localization).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Int32

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.drive._distances import lane_nodes
from elitelanes_jax.drive.lanes import TAKEN, Movement, linked, movements
from elitelanes_jax.network.checks import check_grid

_Carry = tuple[Array, Array, Array, Array, Array]

NEVER = 2**30
"""The number of tiles if the driver's turns do not reveal its node, or the grid does not have the node."""


def localization_steps(grid: Int[ArrayLike, "H W"], asked: Int[ArrayLike, " K"]) -> Int32[Array, "H W 4"]:
    """Counts the tiles to drive from each node until the driver knows its node.

    Args:
      grid: integer codes ``[H, W]``.
      asked: the turn that the driver wants on each tile that it leaves: 0 right, 1 straight, 2 left. If it is not open,
        the next open one is taken, in the order right, straight, left, right, as in `RoadNav`. On a dead end the driver
        stays.

    Returns:
      int32 ``[H, W, 4]``, by the heading with which the tile was entered: 0 to K; 0 if the first look suffices. `NEVER`
      if K tiles do not suffice, or the grid does not have the node.

    Raises:
      InputError: for a bad grid (see `check_grid`), or no turn.
    """
    if not np.size(asked):
        raise InputError("asked: expected at least one turn, got none")
    return _localization_steps(check_grid(grid), jnp.asarray(asked))


@jax.jit
def _localization_steps(grid: Array, asked: Array) -> Array:
    links = linked(grid)
    height, width = links.shape
    size = 4 * height * width
    is_node = lane_nodes(links).reshape(-1)
    starts = jnp.arange(size, dtype=jnp.int32)
    row, column, heading = starts // (4 * width), starts // 4 % width, starts % 4
    is_open = movements(links).reshape(size, 3)
    view = (is_open * jnp.array([1, 2, 4])).sum(axis=-1).astype(jnp.int32)
    there = Movement(row, column, heading, jnp.asarray(TAKEN)[links].reshape(size, 3).astype(jnp.int32).T).next_node
    # By the wanted turn and the node; on a dead end the driver stays.
    moves = jnp.where(is_open.any(axis=1), (there.row * width + there.column) * 4 + there.heading, starts)

    def eliminate(group: Array, node: Array) -> tuple[Array, Array]:
        """Splits groups of starts by what is seen now; returns them, and which starts are still ambiguous.

        A group is named by its first start.
        """
        key = jnp.where(is_node, group * 8 + view[node], 8 * size)
        group = jnp.full(8 * size + 1, size, jnp.int32).at[key].min(starts)[key]
        apart = node != node[group]
        return group, jnp.zeros(size, bool).at[group].max(apart)[group] & is_node

    def go(carry: _Carry) -> _Carry:
        step, group, node, unsure, steps = carry
        node = moves[asked[step], node]
        group, unsure = eliminate(group, node)
        return step + 1, group, node, unsure, steps + unsure

    group, unsure = eliminate(jnp.zeros_like(starts), starts)
    start = jnp.int32(0), group, starts, unsure, unsure.astype(jnp.int32)
    _, _, _, unsure, steps = jax.lax.while_loop(lambda c: (c[0] < asked.size) & c[3].any(), go, start)
    return jnp.where(is_node & ~unsure, steps, NEVER).reshape(height, width, 4)


def ambiguity(grid: Int[ArrayLike, "H W"]) -> Int32[Array, ""]:
    """Returns how ambiguous the nodes of a map are: a feature for `elitelanes_jax.evolve`.

    It is the mean over all nodes of `localization_steps` for a driver that wants right, straight on, left, repeatedly.
    The driver gives up after 2 (H + W) tiles. Nodes where it gives up count as many tiles.

    Args:
      grid: integer codes ``[H, W]``.

    Returns:
      int32, hundredths of a tile, rounded down; 0 for a map without nodes.

    Raises:
      InputError: for a bad grid (see `check_grid`).
    """
    return _ambiguity(check_grid(grid))


@jax.jit
def _ambiguity(grid: Array) -> Array:
    last = 2 * sum(grid.shape)
    counted = lane_nodes(grid)
    steps = jnp.where(counted, jnp.minimum(localization_steps(grid, jnp.arange(last) % 3), last), 0)
    return (100 * steps.sum() // jnp.maximum(counted.sum(), 1)).astype(jnp.int32)
