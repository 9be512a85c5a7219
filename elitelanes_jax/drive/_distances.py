"""Distances and shortest ways to a node, in tiles, by relaxation on the whole grid at once."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int32, UInt8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.drive.lanes import single
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import EXIT, LaneNode
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import vary_together

UNREACHABLE = 2**30
"""The distance if no way leads to the goal."""

NO_WAY = 3
"""The value instead of a turn if no way leads to the goal."""

# The sweeps between two checks for changes.
_SWEEPS = 4

# A distance in int16 that no way has. A sweep may add 1 to it without an overflow.
_FAR_INT16 = 2**14


@name_wrong_arguments
@runs_jax
@divide_batches
def lane_nodes(grid: Int[ArrayLike, "H W"]) -> Bool[Array, "H W 4"]:
    """Returns which nodes a grid has.

    A tile has the node of a heading if it is linked to the tile behind it. For traced codes see
    `measure`.

    Raises:
      InputError: for a bad grid.
    """
    links = linked_codes(grid)
    return jnp.stack([links & side.opposite > 0 for side in SIDES], axis=-1)


@name_wrong_arguments
@runs_jax
def distances(grid: Int[ArrayLike, "H W"], goal: LaneNode) -> Int32[Array, "H W 4"]:
    """Computes the number of tiles of a shortest way to the goal, from every node of a grid.

    Each movement counts one tile. The distance is `UNREACHABLE` if no way leads to the goal, or the
    grid does not have the node.

    Args:
      grid: integer codes ``[H, W]``; for traced ones see `measure`.
      goal: a node. If the grid does not have it, all distances are `UNREACHABLE`.

    Raises:
      InputError: for a bad grid, or a goal that is no `LaneNode` of whole numbers.
    """
    goal = check_named("goal", single(LaneNode), goal)
    return _distances(check_grid(grid), goal)


@jax.jit
@divide_batches
def _distances(grid: Array, goal: LaneNode) -> Array:
    links = linked_codes(grid)
    reached, _ = _relax(links, goal)
    return jnp.where(lane_nodes(links), jnp.moveaxis(reached, 0, -1), UNREACHABLE)


@jax.jit
@divide_batches
def shortest_ways(grid: Int[ArrayLike, "H W"], goal: LaneNode) -> UInt8[Array, "H W"]:
    """Computes the turn at every node of a grid for a shortest way to the goal.

    The result has two bits per heading. A turn is 0 right, 1 straight, 2 left, or `NO_WAY`. Among
    several shortest ways the right turn comes first, then straight on.
    """
    _, onward = _relax(linked_codes(grid), goal)
    ways = jnp.zeros(onward.shape[1:], jnp.uint8)
    for heading in range(4):
        # The first of equal turns is taken, which `shortest_ways` promises.
        by_turn = onward[EXIT[heading]]
        turn = jnp.where(by_turn.min(axis=0) < UNREACHABLE, by_turn.argmin(axis=0), NO_WAY)
        ways |= turn.astype(jnp.uint8) << (2 * heading)
    return ways


def _relax(links: Array, goal: LaneNode) -> tuple[Array, Array]:
    """Returns the distances of all nodes to the goal.

    The first result is by the heading with which a tile is entered, and the second one by the
    heading with which it is left. Both are int32 ``[4, H, W]``.
    """
    height, width = links.shape
    # The longest way visits each node once. Small numbers are faster if they suffice.
    if 4 * height * width < _FAR_INT16:
        dtype, far = jnp.int16, jnp.int16(_FAR_INT16)
    else:
        dtype, far = jnp.int32, jnp.int32(UNREACHABLE)
    headings, rows, columns = np.ogrid[:4, :height, :width]
    at_goal = (rows == goal.row) & (columns == goal.column) & (headings == goal.heading)
    # A goal that the grid does not have stays unreachable.
    at_goal &= jnp.stack([links & side.opposite > 0 for side in SIDES])
    # Open sides have 0, and closed sides a distance that is too far. A maximum with it closes a
    # side.
    walls = [jnp.where(links & side.bit > 0, dtype(0), far) for side in SIDES]

    def onward(reached: Array) -> list[Array]:
        # Whoever leaves a tile by a side enters the neighbour there with the heading of this side.
        # Cells beyond the grid are far.
        padded = jnp.pad(reached, ((0, 0), (1, 1), (1, 1)), constant_values=far)
        return [
            jnp.maximum(
                padded[
                    index,
                    1 + side.down : 1 + side.down + height,
                    1 + side.right : 1 + side.right + width,
                ]
                + 1,
                walls[index],
            )
            for index, side in enumerate(SIDES)
        ]

    def sweep(reached: Array) -> Array:
        # A way from a node is the shortest of the ways by its three exits.
        onto = onward(reached)
        best = [
            jnp.minimum(jnp.minimum(onto[right], onto[ahead]), onto[left])
            for right, ahead, left in EXIT
        ]
        return jnp.minimum(reached, jnp.stack(best))

    def sweep_on(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        # Each sweep finds the ways that are one tile longer. Sweeps after the last change do no
        # harm.
        before, _ = carry
        after = before
        for _ in range(_SWEEPS):
            after = sweep(after)
        return after, (after != before).any()

    # Distances begin at the goal, and sweep by sweep spread against the direction of driving.
    first = jnp.where(at_goal, dtype(0), far)
    carry = vary_together((first, jnp.array(True)), links)
    reached, _ = jax.lax.while_loop(lambda carry: carry[1], sweep_on, carry)

    def to_int32(lengths: Array) -> Array:
        return jnp.where(lengths >= far, UNREACHABLE, lengths.astype(jnp.int32))

    return to_int32(reached), to_int32(jnp.stack(onward(reached)))
