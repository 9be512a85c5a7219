"""Grows towns that keep Duckietown's rules.

A town begins as a ring of road. Then streets are added across its blocks, and bends in its streets.
A street leads straight across a block, from one straight road to another. A bend moves a stretch of
a straight road aside. Both leave empty cells between roads, and tiles between crossings and other
crossings or turns. A grown town is therefore in one piece, has no dead ends, and keeps the rules,
however large it is.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int8, Int32, Key, UInt32

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.bits import randint, random_bits
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import (
    CROSSINGS,
    EAST,
    NORTH,
    SOUTH,
    WEST,
    exchange_sides,
    transpose_codes,
)
from elitelanes_jax.network.xla import materialize, vary_together

SMALLEST_GROWN = 3
"""The shortest side of a grid on which a town grows."""

# The cells per block and the cells per bend, the most and the fewest. Each town draws both
# densities.
_CELLS_A_BLOCK, _CELLS_A_BEND = (29, 16), (12, 4)
# A bend moves a stretch of 2 to 4 links by 1 to 3 cells.
_WIDEST, _FARTHEST = 4, 3
# The cells per step, and the largest number of steps. A step adds one street or bend, if it can.
_CELLS_A_STEP, _MOST_STEPS = 4, 256

_ALONG, _UPRIGHT = EAST | WEST, NORTH | SOUTH


class _Town(NamedTuple):
    """A town while it grows.

    Attributes:
      codes: the codes. Cells outside the grid are crossings, on which nothing is built.
      streets: the number of streets to add.
      bends: the number of bends to add.
    """

    codes: Int8[Array, "N N"]
    streets: Int32[Array, ""]
    bends: Int32[Array, ""]


def grow_town(key: Key[Array, ""], shape: tuple[int, int]) -> Int8[Array, "H W"]:
    """Grows a town that covers its grid.

    Both sides are at least `SMALLEST_GROWN`; the key is consumed.
    """
    height, width = check_shape(shape, new=True)
    if min(shape) < SMALLEST_GROWN:
        raise InputError("shape", f"sides of at least {SMALLEST_GROWN} for a town to grow", shape)
    cells = (height - 1) * (width - 1)
    steps = min(-(-cells // _CELLS_A_STEP), _MOST_STEPS)
    # Each step has its own row of bits. The last row draws the numbers of streets and bends.
    bits = random_bits(key, (steps + 1, 5))
    streets, bends = (
        cells // few + randint(bits[steps, index], cells // many - cells // few + 1)
        for index, (few, many) in enumerate((_CELLS_A_BLOCK, _CELLS_A_BEND))
    )
    # The grid becomes a square, because a step may transpose it.
    ring = jnp.pad(
        _ring(height, width), [(0, max(shape) - side) for side in shape], constant_values=15
    )
    town = vary_together(_Town(ring, streets, bends))
    town = jax.lax.fori_loop(0, steps, lambda step, town: _grow(town, bits[step]), town)
    return town.codes[:height, :width]


def _ring(height: int, width: int) -> Int8[np.ndarray, "H W"]:
    codes = np.zeros((height, width), np.int8)
    codes[:, [0, -1]], codes[[0, -1]] = _UPRIGHT, _ALONG
    codes[0, 0], codes[0, -1], codes[-1, 0], codes[-1, -1] = (
        EAST | SOUTH,
        SOUTH | WEST,
        NORTH | EAST,
        NORTH | WEST,
    )
    return codes


def _grow(town: _Town, bits: UInt32[Array, " 5"]) -> _Town:
    # One of the eight symmetries of a square is drawn, so that streets and bends need only be built
    # southwards.
    codes = _mirror(_transpose(town.codes, bits[0]), bits[0])
    is_street = bits[0] & 8 == 0
    # Both kinds are computed. A branch would save nothing, because under `jax.vmap` JAX computes
    # every branch.
    fits, changed = (
        jnp.where(is_street, street, bend)
        for street, bend in zip(_street(codes, bits), _bend(codes, bits), strict=True)
    )
    # A step does nothing if nothing fits, or if the town has enough of the drawn kind.
    happens = fits & jnp.where(is_street, town.streets > 0, town.bends > 0)
    return _Town(
        jnp.where(happens, _transpose(_mirror(changed, bits[0]), bits[0]), town.codes),
        town.streets - (happens & is_street).astype(jnp.int32),
        town.bends - (happens & ~is_street).astype(jnp.int32),
    )


def _transpose(codes: Int8[Array, "N N"], bits: UInt32[Array, ""]) -> Int8[Array, "N N"]:
    return jnp.where(bits & 1 == 0, codes, transpose_codes(codes).T)


def _mirror(codes: Int8[Array, "N N"], bits: UInt32[Array, ""]) -> Int8[Array, "N N"]:
    # These grids are stored, because otherwise XLA turns the grid again for each use of a cell.
    codes = materialize(codes)
    codes = materialize(jnp.where(bits & 2 == 0, codes, exchange_sides(codes, NORTH, SOUTH)[::-1]))
    return materialize(jnp.where(bits & 4 == 0, codes, exchange_sides(codes, EAST, WEST)[:, ::-1]))


def _street(
    codes: Int8[Array, "N N"], bits: UInt32[Array, " 5"]
) -> tuple[Bool[Array, ""], Int8[Array, "N N"]]:
    """Adds a street that runs south at a random position.

    Returns whether there is such a position, and the codes.
    """
    # Straight tiles on both sides keep the new crossing away from turns and crossings. Empty cells
    # on both sides keep the street away from other roads.
    along, free = (_with_sides(codes == code) for code in (_ALONG, 0))
    rows, columns = _indices(codes)
    # For each cell this is the first row from it on that is not free, times two, plus one if no
    # street can end there. So one cumulative minimum finds both.
    end = _next(jnp.where(free, 2**20, 2 * rows + (~along).astype(jnp.int32)), axis=0)
    after = jnp.pad(end[1:], ((0, 1), (0, 0)), constant_values=1)
    # A street starts at a straight road, passes at least one free cell, and ends at a straight
    # road.
    some, north, column = _draw(
        bits[1], along & (after & 1 == 0) & (after > 2 * rows + 2) & (after < 2**20)
    )
    south = after[north, column] // 2
    here = columns == column
    added = jnp.where(here & (rows >= north) & (rows < south), SOUTH, 0)
    added = added | jnp.where(here & (rows > north) & (rows <= south), NORTH, 0)
    return some, codes | added.astype(jnp.int8)


def _bend(
    codes: Int8[Array, "N N"], bits: UInt32[Array, " 5"]
) -> tuple[Bool[Array, ""], Int8[Array, "N N"]]:
    """Moves a stretch of a road south at a random position.

    Returns whether there is such a position, and the codes.
    """
    side = len(codes)
    wide, far = 2 + randint(bits[2], _WIDEST - 1), 1 + randint(bits[3], _FARTHEST)
    rows, columns = _indices(codes)
    # For each cell this is the first row from it on with a road.
    road = _next(jnp.where(codes > 0, rows, side), axis=0)
    below = jnp.pad(road[1:], ((0, 1), (0, 0)), constant_values=side)
    # The cells to the south are free if another road is more than one cell beyond the bend, or if
    # there is no road and the bend is inside the grid.
    free = (below > rows + far + 1) | (below == side) & (rows + far < side)
    # A stretch is a run of straight tiles with free cells to its south, and no crossing is beside
    # its ends. `end` is the first column from a cell on that cannot be in a stretch.
    end = _next(jnp.where((codes == _ALONG) & free, side, columns), axis=1)
    beside = jnp.pad(~jnp.isin(codes, np.array(CROSSINGS, np.int8)) & free, ((0, 0), (1, side + 1)))
    after = jax.lax.dynamic_slice_in_dim(beside, wide + 2, side, axis=1)
    some, row, west = _draw(bits[1], beside[:, :side] & (end - columns > wide) & after)
    east = west + wide
    across, at_ends = (columns > west) & (columns < east), (columns == west) | (columns == east)
    within = (rows > row) & (rows < row + far)
    turns = (
        (row, west, SOUTH | WEST),
        (row, east, EAST | SOUTH),
        (row + far, west, NORTH | EAST),
        (row + far, east, NORTH | WEST),
    )
    # The old stretch becomes empty, the new one is laid, and both are joined by sides and turns.
    codes = jnp.where(across & (rows == row), 0, codes)
    codes = jnp.where(across & (rows == row + far), _ALONG, codes)
    codes = jnp.where(at_ends & within, _UPRIGHT, codes)
    for turn_row, column, code in turns:
        codes = jnp.where((rows == turn_row) & (columns == column), code, codes)
    return some, codes.astype(jnp.int8)


def _indices(codes: Int8[Array, "N N"]) -> tuple[np.ndarray, np.ndarray]:
    indices = np.arange(len(codes), dtype=np.int32)
    return indices[:, None], indices[None]


def _with_sides(cells: Bool[Array, "N N"]) -> Bool[Array, "N N"]:
    return (
        cells & jnp.pad(cells, ((0, 0), (1, 0)))[:, :-1] & jnp.pad(cells, ((0, 0), (0, 1)))[:, 1:]
    )


def _next(numbers: Int32[Array, "N N"], axis: int) -> Int32[Array, "N N"]:
    return jax.lax.cummin(numbers, axis=axis, reverse=True)


def _draw(
    bits: UInt32[Array, ""], where: Bool[Array, "N N"]
) -> tuple[Bool[Array, ""], Array, Array]:
    """Draws a cell that is True; returns whether there is one, and its row and column."""
    # The index of the cell is drawn first. It leads to a row, and then to a column of this row.
    where = materialize(where.astype(jnp.int8))
    reached = jnp.cumsum(where.sum(axis=1, dtype=jnp.int32))
    index = randint(bits, jnp.maximum(reached[-1], 1))
    row = jnp.argmax(reached > index).astype(jnp.int32)
    cells = where[row]
    within = reached[row] - cells.sum(dtype=jnp.int32) + jnp.cumsum(cells, dtype=jnp.int32)
    return reached[-1] > 0, row, jnp.argmax(within > index).astype(jnp.int32)
