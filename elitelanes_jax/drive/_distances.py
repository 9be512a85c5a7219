"""Distances and shortest routes between nodes, in tiles, by relaxation on the whole grid at once."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Int, Int32, UInt8

from elitelanes_jax._util.checks import check_named, none_or, whole
from elitelanes_jax.drive.lanes import LaneNode, Movement, linked, single
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.movements import EXIT

UNREACHABLE = 2**30
"""The distance if no way leads to the goal."""

NO_WAY = 3
"""The value instead of a turn if no way leads to the goal."""

_SWEEPS = 4  # between two checks for changes


def lane_nodes(grid: Int[ArrayLike, "H W"]) -> Bool[Array, "H W 4"]:
    """Returns which nodes a grid has: a tile has the node of a heading if it is linked to the tile behind it.

    Raises:
      InputError: for a bad grid (see `check_grid`).
    """
    links = linked(grid)
    return jnp.stack([links & side.opposite > 0 for side in SIDES], axis=-1)


def distances(grid: Int[ArrayLike, "H W"], goal: LaneNode) -> Int32[Array, "H W 4"]:
    """Computes the number of tiles of a shortest way to the goal, from every node of a grid.

    Each movement counts one tile. The distance is `UNREACHABLE` if no way leads to the goal, or the grid does not have
    the node.

    Args:
      grid: integer codes ``[H, W]``.
      goal: a node. If the grid does not have it, all distances are `UNREACHABLE`.

    Raises:
      InputError: for a bad grid (see `check_grid`), or a goal that is no `LaneNode`.
    """
    return _distances(check_grid(grid), check_named("goal", single(LaneNode), goal))


@jax.jit
def _distances(grid: Array, goal: LaneNode) -> Array:
    links = linked(grid)
    reached, _ = _relax(links, goal)
    return jnp.where(lane_nodes(links), jnp.moveaxis(reached, 0, -1), UNREACHABLE)


def shortest_ways(grid: Int[ArrayLike, "H W"], goal: LaneNode) -> UInt8[Array, "H W"]:
    """Computes the turn at every node of a grid for a shortest way to the goal, two bits per heading.

    A turn is 0 right, 1 straight, 2 left, or `NO_WAY`. Among several shortest ways the right turn comes first, then
    straight on. Raises `InputError` for a bad grid.
    """
    return _shortest_ways(check_grid(grid), goal)


@jax.jit
def _shortest_ways(grid: Array, goal: LaneNode) -> Array:
    _, onward = _relax(linked(grid), goal)
    ways = jnp.zeros(onward.shape[1:], jnp.uint8)
    for heading in range(4):
        three = onward[EXIT[heading]]
        turn = jnp.where(three.min(axis=0) < UNREACHABLE, three.argmin(axis=0), NO_WAY)
        ways |= turn.astype(jnp.uint8) << (2 * heading)
    return ways


def _relax(links: Array, goal: LaneNode) -> tuple[Array, Array]:
    """Returns the distances by the heading with which a tile is entered, and by the heading with which it is left.

    Both are int32 ``[4, H, W]``.
    """
    height, width = links.shape
    # The longest way visits each node once. Small numbers are faster if they suffice.
    dtype = jnp.int16 if 4 * height * width < 2**14 else jnp.int32
    far = dtype(2**14) if dtype == jnp.int16 else dtype(UNREACHABLE)
    rows, columns = jnp.arange(height)[:, None], jnp.arange(width)
    at_goal = (rows == goal.row) & (columns == goal.column) & (jnp.arange(4)[:, None, None] == goal.heading)
    at_goal &= jnp.stack([links & side.opposite > 0 for side in SIDES])
    walls = [jnp.where(links & side.bit > 0, dtype(0), far) for side in SIDES]

    def onward(reached: Array) -> list[Array]:
        padded = jnp.pad(reached, ((0, 0), (1, 1), (1, 1)), constant_values=far)
        return [
            jnp.maximum(
                padded[index, 1 + side.down : 1 + side.down + height, 1 + side.right : 1 + side.right + width] + 1,
                walls[index],
            )
            for index, side in enumerate(SIDES)
        ]

    def sweep(reached: Array) -> Array:
        onto = onward(reached)
        best = [jnp.minimum(jnp.minimum(onto[right], onto[ahead]), onto[left]) for right, ahead, left in EXIT]
        return jnp.minimum(reached, jnp.stack(best))

    def sweep_on(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        before, _ = carry
        after = before
        for _ in range(_SWEEPS):
            after = sweep(after)
        return after, (after != before).any()

    first = jnp.where(at_goal, dtype(0), far)
    reached, _ = jax.lax.while_loop(lambda carry: carry[1], sweep_on, (first, links.any() | True))

    def plain(numbers: Array) -> Array:
        return jnp.where(numbers >= far, UNREACHABLE, numbers.astype(jnp.int32))

    return plain(reached), plain(jnp.stack(onward(reached)))


class Route(NamedTuple):
    """A way from node to node.

    Attributes:
      nodes: `LaneNode` with int32 ``[N]``, from the start to the goal, which is then repeated.
      turns: int32 ``[N]``, the turn taken at each node; `NO_WAY` from the goal on.
      length: int32, tiles. If no way leads to the goal it is `UNREACHABLE`, and all nodes are the start.
    """

    nodes: LaneNode
    turns: Int32[Array, " N"]
    length: Int32[Array, ""]

    @property
    def movements(self) -> Movement:
        """The movements of the route, with int32 ``[N]``; from the goal on with the turn `NO_WAY`."""
        return Movement(*self.nodes, self.turns)


def route(grid: Int[ArrayLike, "H W"], start: LaneNode, goal: LaneNode, *, most: int | None = None) -> Route:
    """Finds a shortest way; among several the one that turns right first, then the one that goes straight on first.

    Args:
      grid: integer codes ``[H, W]``.
      start: a node. If the grid does not have it, the length is `UNREACHABLE`, and so for the goal.
      goal: a node.
      most: N, the largest number of nodes; by default 4·H·W, the nodes of a grid. A longer route is cut after N nodes.

    Raises:
      InputError: for a bad grid (see `check_grid`), nodes that are no `LaneNode`, or `most` below 1.
    """
    check_named("start", single(LaneNode), start)
    check_named("goal", single(LaneNode), goal)
    return _route(check_grid(grid), start, goal, check_named("most", none_or(whole(1)), most))


@partial(jax.jit, static_argnames="most")
def _route(grid: Array, start: LaneNode, goal: LaneNode, most: int | None) -> Route:
    links = linked(grid)
    size = 4 * links.size if most is None else most
    # JAX clamps an index beyond the grid, and would return the length of another node.
    within = jnp.stack([(part >= 0) & (part < size) for part, size in zip(start, (*links.shape, 4), strict=True)])
    length = jnp.where(within.all(), distances(links, goal)[start.row, start.column, start.heading], UNREACHABLE)
    count = jnp.where(length < UNREACHABLE, length, 0)
    ways = shortest_ways(links, goal).astype(jnp.int32)

    def go(index: Array, carry: tuple[Array, Array, LaneNode]) -> tuple[Array, Array, LaneNode]:
        nodes, turns, node = carry
        turn = jnp.where(index < count, ways[node.row, node.column] >> 2 * node.heading & 3, NO_WAY)
        onward = Movement(*node, jnp.minimum(turn, 2)).next_node
        there = jax.tree.map(lambda new, old: jnp.where(turn < NO_WAY, new, old), onward, node)
        return nodes.at[:, index].set(jnp.stack(node)), turns.at[index].set(turn), there

    first = LaneNode(*(jnp.asarray(part, jnp.int32) for part in start))
    empty = jnp.zeros((3, size), jnp.int32), jnp.full(size, NO_WAY, jnp.int32), first
    nodes, turns, _ = jax.lax.fori_loop(0, size, go, empty)
    return Route(LaneNode(*nodes), turns, length)
