"""The gridlock number of a road network: how many robots can never block each other for ever.

The model: robots keep right. The lane of a tile in one heading has a number of slots, and each slot
holds one robot. A robot chooses its turn before it crosses a tile, and never turns back. It moves
to the next slot of its way only if this slot is free before the move. So robots keep crossings
clear, and do not follow into a slot that another robot is leaving. Robots are in gridlock, a
deadlock, if each of them waits for the next one in a circle.

The theorem: the fewest robots in a gridlock are slots x girth. The girth is the number of tiles of
the shortest loop of the network. Proof: a robot waits for at most one other, the robot in its next
slot. So the slots of a circle of waiting robots are a closed way along lanes, and all its slots are
taken. A way that never turns back and closes contains a loop, with at least as many tiles as the
girth. Conversely, robots that fill a lane of the shortest loop and stay on it are in gridlock. A
loop with a crossing can get full while all its robots move: the last robot comes in there. Without
a circle, the first robot of each queue can move, and nobody waits for ever.

The theorem is this project's. ``docs/gridlock.md`` has the proof with its steps, a search of all
states of small networks, and what does not hold in other models.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int8, Int32, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import ArrayOrRows
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.links import links_between
from elitelanes_jax.network.records import LONGEST_TOWN
from elitelanes_jax.network.sharding import divide_batches


@name_wrong_arguments
@runs_jax
def gridlock_number(codes: ArrayOrRows, *, slots: int = 1) -> Int32[Array, ""]:
    """Returns the largest number of robots that are never in gridlock; `jax.vmap` it for many maps.

    It is slots x girth - 1. The girth is the number of tiles of the network's shortest loop. The
    theorem and its model are in this module's text: robots keep crossings clear, and gridlock is a
    circle of robots that wait for each other.

    The number holds for every start of the robots. So a ring without a crossing counts like any loop,
    although no robot can enter it. The shortest loop of all parts of a map counts. A map without a
    loop has the number 0: no robot can drive on for ever. Roads to dead ends have no effect. A
    robot that enters one cannot leave it, which is no gridlock.

    The time grows with the length of the shortest loop. One core measures over 100,000 maps of 8 x
    8 a second, and needs 10 s for a single loop that fills 128 x 128.

    Args:
      codes: integer codes ``[H, W]``, repaired or not. A connection that the neighbour does not
        return is no link.
      slots: the robots that find room one behind another in the lane of a tile, 1 to 1000.

    Raises:
      InputError: for a bad grid, one with a side over 128, or bad slots.
    """
    grid = check_grid(codes, "codes")
    if max(grid.shape) > LONGEST_TOWN:
        expected = f"sides of at most {LONGEST_TOWN} for the gridlock number"
        raise InputError("codes", expected, grid.shape)
    return _gridlock_number(grid, slots=check_named("slots", whole(1, 1000), slots))


@partial(jax.jit, static_argnames="slots")
@divide_batches
def _gridlock_number(grid: Int8[Array, "H W"], *, slots: int) -> Int32[Array, ""]:
    return jnp.maximum(slots * girth(*links_between(grid)) - 1, 0)


def girth(east: Bool[Array, "H w"], south: Bool[Array, "h W"]) -> Int32[Array, ""]:
    """Returns the number of tiles of the shortest loop of a grid with these links.

    It is 0 without a loop.

    Breadth-first searches from many tiles advance together, a bit for each. A loop has an even
    number of tiles. A search from a tile of the shortest loop reaches the tile opposite in half of
    this number of rounds, from two neighbours at once. Before, no search reaches any tile from two
    neighbours, because both ways together would be a shorter loop.
    """
    allowed, start = _searches(east.shape[0], south.shape[1])
    every_bit = np.uint32(2**32 - 1)
    east_bits, south_bits = (jnp.where(link, every_bit, 0)[None] for link in (east, south))

    def advance(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        front, before, rounds, _ = carry
        from_west = jnp.pad(front[:, :, :-1] & east_bits, ((0, 0), (0, 0), (1, 0)))
        from_east = jnp.pad(front[:, :, 1:] & east_bits, ((0, 0), (0, 0), (0, 1)))
        from_north = jnp.pad(front[:, :-1] & south_bits, ((0, 0), (1, 0), (0, 0)))
        from_south = jnp.pad(front[:, 1:] & south_bits, ((0, 0), (0, 1), (0, 0)))
        along, upright = from_west | from_east, from_north | from_south
        # Neighbours of the front are in the front before or in the next one, because tiles have two
        # colours as on a chessboard.
        reached = (along | upright) & ~before & allowed
        twice = (from_west & from_east) | (from_north & from_south) | (along & upright)
        return reached, front, rounds + 1, jnp.max(twice & reached) > 0

    def unfinished(carry: tuple[Array, Array, Array, Array]) -> Array:
        front, _, _, is_closed = carry
        return ~is_closed & (jnp.max(front) > 0)

    # The carry is made from the links, so that inside `jax.shard_map` it is on the same devices.
    zero = jnp.max(east_bits, initial=0) & 0
    carry = (
        jnp.asarray(start) | zero,
        jnp.zeros_like(start) | zero,
        zero.astype(jnp.int32),
        zero > 0,
    )
    _, _, rounds, is_closed = lax.while_loop(unfinished, advance, carry)
    return jnp.where(is_closed, 2 * rounds, 0)


@cache
def _searches(
    height: int, width: int
) -> tuple[UInt32[np.ndarray, "N H W"], UInt32[np.ndarray, "N H W"]]:
    """Returns the searches that each tile is part of, and those that start there, as bits.

    A line of tiles divides the grid in two. Each loop passes this line, or is in one of the parts,
    which are divided in the same way. So it is enough to search from the tiles of each line, within
    its part. Separate parts share bits. 8 x 8 tiles need 20 bits, and 128 x 128 tiles need 382.
    """
    allowed, start = np.zeros((2, max(height, width) // 8 + 1, height, width), np.uint32)

    def divide(allowed: np.ndarray, start: np.ndarray, first: int) -> None:
        """Adds the searches of a part of the grid, from a bit on."""
        rows, columns = allowed.shape[1:]
        # No loop fits in one row.
        if min(rows, columns) < 2:
            return
        # The line is as short as possible.
        if rows < columns:
            divide(allowed.swapaxes(1, 2), start.swapaxes(1, 2), first)
            return
        middle = rows // 2
        for column in range(columns):
            word, place = divmod(first + column, 32)
            allowed[word] |= np.uint32(1 << place)
            start[word, middle, column] |= np.uint32(1 << place)
        for half in (np.s_[:, :middle], np.s_[:, middle + 1 :]):
            divide(allowed[half], start[half], first + columns)

    divide(allowed, start, 0)
    words = max(1, np.count_nonzero(allowed.any(axis=(1, 2))))
    return allowed[:words], start[:words]
