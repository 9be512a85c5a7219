"""Plans of moves: each draws a change from random bits."""

from collections.abc import Callable
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int32, UInt32

from elitelanes_jax.network.bits import randint
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.optimizers._changes import (
    COPIED,
    CYCLIC,
    FLIPPED,
    FROM_MATE,
    MIRRORED,
    REFITTED,
    TOGGLED,
    TRANSPOSED,
    WINDOW,
    Change,
)


class Draws:
    """What the plans draw from random bits, uint32 [7], on a grid of a shape.

    bits[0:4] give a position. In bits[4], 1 and 2 give directions, axes or mirror images, 4 a
    transposition, and 8 the axis of a displacement. bits[5:7] give its offset. Only one plan is
    applied, so plans share the bits.
    """

    def __init__(self, bits: UInt32[Array, " 7"], shape: tuple[int, ...]):
        self.bits, self.shape = bits, np.array(shape, np.int32)

    @cached_property
    def block(self) -> tuple[Int32[Array, " 2"], Int32[Array, " 2"]]:
        """The first row and column, and the last row and column, of a block.

        Two rows and two columns are drawn independently and sorted. With probability 1/8 a side is
        at the grid's edge instead, so that half a network, rotated or mirrored, completes another
        half.
        """
        ends = randint(self.bits[:4].reshape(2, 2), self.shape[:, None])
        # The lowest bits, on which `randint` hardly depends, draw the edges.
        is_at_edge = self.bits[:4].reshape(2, 2) & 7 == 0
        first = jnp.where(is_at_edge[:, 0], 0, jnp.minimum(ends[:, 0], ends[:, 1]))
        last = jnp.where(is_at_edge[:, 1], self.shape - 1, jnp.maximum(ends[:, 0], ends[:, 1]))
        return first, last

    @cached_property
    def stretch(self) -> tuple[Bool[Array, ""], Int32[Array, " 2"], Int32[Array, " 2"]]:
        """Whether a stretch runs east, and its first and last row and column."""
        height, width = self.shape
        east = self.bits[0] & 1 == 0
        line = randint(self.bits[1], jnp.where(east, height, width))
        ends = randint(self.bits[2:4], jnp.where(east, width, height))
        # A stretch that runs east has one row, the line, and ends at two columns.
        is_line = _either(east)
        first = jnp.where(is_line, line, jnp.minimum(*ends))
        last = jnp.where(is_line, line, jnp.maximum(*ends))
        return east, first, last


Plan = Callable[[Draws], Change]


def _plan_link(draws: Draws) -> Change:
    # The links to the east come first, row by row, then the links to the south.
    height, width = draws.shape
    across = height * (width - 1)
    drawn = randint(draws.bits[0], across + (height - 1) * width)
    east = drawn < across
    index = jnp.where(east, drawn, drawn - across)
    length = jnp.where(east, width - 1, width)
    row = jax.lax.div(index, length)
    first = jnp.stack([row, index - row * length])
    return Change(first, first + (~_either(east)).astype(jnp.int32), TOGGLED)


def _plan_corner(draws: Draws) -> Change:
    first = randint(draws.bits[:2], draws.shape - 1)
    return Change(first, first + 1, TOGGLED)


def _plan_outline(draws: Draws) -> Change:
    # The size is drawn before the position. Two random corners would make large sizes rare.
    span = 1 + randint(draws.bits[:2], draws.shape - 1)
    first = randint(draws.bits[2:4], draws.shape - span)
    return Change(first, first + span, TOGGLED)


def _plan_street(draws: Draws) -> Change:
    _, first, last = draws.stretch
    return Change(first, last, TOGGLED)


def _plan_straight(draws: Draws) -> Change:
    east, first, last = draws.stretch
    return Change(first, last, jnp.where(east, EAST | WEST, NORTH | SOUTH))


def _plan_clearing(draws: Draws) -> Change:
    first, last = draws.block
    return Change(first, last, 0)


def _plan_mirroring(draws: Draws) -> Change:
    first, last = draws.block
    across = draws.bits[4] & 1 == 0
    how = jnp.where(across, MIRRORED, FLIPPED)
    # A mirrored row or column i of the block is copied from first + last - i.
    offset = jnp.where(_either(across), 0, first + last)
    return Change(first, last, COPIED, how, offset)


def _plan_slide(draws: Draws) -> Change:
    first, last = draws.block
    # Either the rows of the block slide, over the whole width, or its columns over the whole
    # height.
    slides = _either(draws.bits[4] & 1 == 0)
    step = jnp.where(draws.bits[4] & 2 == 0, -1, 1)
    return Change(
        first=jnp.where(slides, first, 0),
        last=jnp.where(slides, last, draws.shape - 1),
        code=COPIED,
        how=CYCLIC,
        offset=jnp.where(slides, step, 0),
    )


def _plan_transplant(draws: Draws) -> Change:
    return _plan_mate_block(draws, np.zeros(2, np.int32))


def _plan_displaced_transplant(draws: Draws) -> Change:
    first, last = draws.block
    # The source is any block of this size inside the grid.
    offset = randint(draws.bits[5:7], draws.shape - (last - first)) - first
    return _plan_mate_block(draws, jnp.where(_either(draws.bits[4] & 8 == 0), offset, 0))


def plan_refit(draws: Draws) -> Change:
    size = np.minimum(draws.shape, WINDOW)
    first = randint(draws.bits[:2], draws.shape - size + 1)
    return Change(first, first + size - 1, REFITTED)


def _plan_mate_block(draws: Draws, offset: Int[ArrayLike, " 2"]) -> Change:
    """Plans to copy a block from the mate, transformed.

    Without a transformation, each tile comes from `offset` rows below it and columns to its right.
    """
    height, width = draws.shape
    # Transposing changes the shape, so only a square grid draws its bit.
    symmetry_bits = 7 if height == width else 3
    symmetry = (draws.bits[4] & symmetry_bits).astype(jnp.int32)
    mirrored = symmetry & 1 > 0
    flipped = symmetry & 2 > 0
    transposed = symmetry & 4 > 0
    flags = ((mirrored, MIRRORED), (flipped, FLIPPED), (transposed, TRANSPOSED))
    how = FROM_MATE + sum(jnp.where(is_chosen, flag, 0) for is_chosen, flag in flags)
    backwards = jnp.stack([flipped, mirrored])
    first, last = draws.block
    # The mate as a whole is mirrored, so row i comes from the row that is as far from the other
    # end.
    return Change(first, last, COPIED, how, jnp.where(backwards, draws.shape - 1 - offset, offset))


def _either(rows: Bool[Array, ""]) -> Bool[Array, " 2"]:
    """Returns a flag for rows and its opposite for columns."""
    return np.array([True, False]) == rows


# The plan of each move, by the name of its weight.
PLANS: dict[str, Plan] = {
    "link": _plan_link,
    "corner": _plan_corner,
    "outline": _plan_outline,
    "street": _plan_street,
    "straight": _plan_straight,
    "clear": _plan_clearing,
    "mirror": _plan_mirroring,
    "slide": _plan_slide,
    "transplant": _plan_transplant,
    "displaced": _plan_displaced_transplant,
    "refit": plan_refit,
}
