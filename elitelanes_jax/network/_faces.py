"""The planar dual of a grid's road graph: the faces into which roads divide the plane, and their consequences.

A grid's road graph is drawn in the plane, on the lattice of tiles. Its dual lives on the lattice of corner points
between tiles. Two neighbouring corners belong to the same face if no road runs between them, and all corners on the
border belong to the outer face.

    tile --- tile     tile     tile       a road between two tiles separates the two corners beside it;
         .       .        .               without one, both corners belong to the same face
    tile     tile --- tile     tile

Once the faces are labelled, Euler's formula gives these counts exactly, without a spanning tree or a search:

    cyclomatic number = faces - 1 (the outer one)
    components        = tiles - roads + cyclomatic number
    a road is a bridge if and only if the same face is on both its sides

Corner (r, c) is south-east of tile (r, c) and has the same index in the padded layout. The inner corners have rows
0..H-2 and columns 0..W-2; every other index belongs to the outer face. The road east of a tile separates the tile's
corner from the corner to the north, and the road south of it from the corner to the west, so that each neighbour is a
shift of one vector.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Int8, UInt

from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.xla import PaddedLayout, materialize

# Sweeps before the costlier method for long corridors. Random grids need fewer.
_PATIENCE = 60

# The steps that a label goes in every other sweep. At 12 x 12, evaluating takes 1.2 times as long with 4 steps.
_FAR = 3

# Pairs of sweeps between two looks at whether labels still change.
_PAIRS = 2

_OUTER = 0


class Links(NamedTuple):
    """The links of a grid, each a road between two neighbouring tiles, as vectors ``[size]`` of its layout."""

    east: Bool[Array, " size"]  # whether the tile and its eastern neighbour are linked
    south: Bool[Array, " size"]  # whether the tile and its southern neighbour are linked


def find_links(layout: PaddedLayout, padded: Int[Array, " padded"]) -> Links:
    """Finds the pairs of neighbouring tiles that connect to each other."""
    here = layout.here(padded)
    return Links(
        east=(here & EAST > 0) & (layout.east(padded) & WEST > 0),
        south=(here & SOUTH > 0) & (layout.south(padded) & NORTH > 0),
    )


class Faces(NamedTuple):
    """The faces of a grid, as vectors ``[size]`` of its layout."""

    first: Bool[Array, " size"]  # whether the corner is the first one of an inner face
    east_bridge: Bool[Array, " size"]  # whether the link to the east is a bridge
    south_bridge: Bool[Array, " size"]  # whether the link to the south is a bridge


def find_faces(layout: PaddedLayout, padded: Int8[Array, " padded"], links: Links) -> Faces:
    """Finds the faces between the roads of one grid. The time hardly depends on their shape."""
    labels = label_faces(layout, padded)
    corner = layout.here(labels)
    initial = layout.here(jnp.asarray(_initial_labels(layout)))
    return Faces(
        first=(corner == initial) & (initial != _OUTER),
        east_bridge=links.east & (corner == layout.north(labels)),
        south_bridge=links.south & (corner == layout.west(labels)),
    )


def label_faces(layout: PaddedLayout, padded: Int8[Array, " padded"]) -> UInt[Array, " padded"]:
    """Labels the corners of one grid by their face: 0 for the outer face, another label for each inner face.

    Labels are less than the length of the padded vector.
    """
    return _labeller(layout)(padded)


@cache
def _initial_labels(layout: PaddedLayout) -> np.ndarray:
    """Returns the label that each corner starts with, on the padded layout: unique and rising, or the outer face's.

    Up to 254 inner corners (16 x 16 tiles) have labels 1, 2, 3 and so on, so that a label fits a byte and a sweep is
    cheapest. In larger grids the label is the corner's index, so that a label leads to its corner.
    """
    indices = np.arange((layout.height + 2) * layout.stride)
    rows, columns = indices // layout.stride, indices % layout.stride
    inner = (rows >= 1) & (rows < layout.height) & (columns < layout.width - 1)
    count = (layout.height - 1) * (layout.width - 1)
    if count < np.iinfo(np.uint8).max:
        return np.where(inner, np.cumsum(inner), _OUTER).astype(np.uint8)
    wide = np.uint16 if indices.size < np.iinfo(np.uint16).max else np.uint32
    return np.where(inner, indices, _OUTER).astype(wide)


@cache
def _labeller(layout: PaddedLayout) -> Callable[[Array], UInt[Array, "... padded"]]:
    """Makes the function from codes, int8 ``[..., padded]``, to labels on the same layout.

    A corner's label is the least initial label of its face. The function takes leading axes and is its own batching
    rule: the grids of a batch are laid end to end, as one long vector, and labelled together.
    """
    initial = _initial_labels(layout)
    stride = layout.stride
    margin = (_FAR - 1) * stride
    followable = initial.dtype != np.uint8
    closed = initial.dtype.type(np.iinfo(initial.dtype).max)  # or-ed onto a label it loses every comparison

    def sweep(labels: Array, walls: Links, into: Array, steps: int) -> Array:
        """Gives each corner the least label among its own and those of corners some steps away without a wall between.

        Writes to `into`, another vector than `labels`, so that XLA computes it in place and in one pass. Both ends of
        the vector belong to the outer face and do not change.
        """
        rows = steps * stride
        length = labels.size - 2 * rows

        def cut(vector: Array, start: int) -> Array:
            return lax.slice_in_dim(vector, start, start + length)

        least = cut(labels, rows)
        for neighbour, wall in (
            (cut(labels, 0), cut(walls.east, rows)),  # north
            (cut(labels, 2 * rows), cut(walls.east, 2 * rows)),  # south
            (cut(labels, rows - steps), cut(walls.south, rows)),  # west
            (cut(labels, rows + steps), cut(walls.south, rows + steps)),  # east
        ):
            least = jnp.minimum(least, neighbour | wall)
        return lax.dynamic_update_slice(into, least, (rows,))

    def propagate(labels: Array, walls: Links) -> tuple[Array, Array]:
        """Sweeps to and fro between two vectors until they are equal; followable labels for `_PATIENCE` sweeps at most.

        Every other sweep goes `_FAR` steps, because corridors mostly run straight. The longest corridor of a batch then
        takes two thirds as many sweeps.
        """
        far_walls = Links(farther(walls.east, stride), farther(walls.south, 1))

        def sweep_on(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
            here, there, _, done = carry
            for _ in range(_PAIRS):
                there = sweep(here, far_walls, there, _FAR)
                here = sweep(there, walls, here, 1)
            # XLA computes the largest difference faster than whether there is any.
            return here, there, jnp.max(here ^ there, initial=0) > 0, done + 2 * _PAIRS

        def unsettled(carry: tuple[Array, Array, Array, Array]) -> Array:
            _, _, changing, done = carry
            return changing & (done < _PATIENCE) if followable else changing

        changing = labels[:1].any() | True
        labels, _, changing, _ = lax.while_loop(unsettled, sweep_on, (labels, labels, changing, jnp.int32(0)))
        return labels, changing

    def farther(walls: Array, step: int) -> Array:
        """Returns walls between corners `_FAR` steps apart: there is one if a wall cuts any of these steps."""
        first = (_FAR - 1) * step
        far = walls[first:]
        for start in range(0, first, step):
            far |= walls[start : start + far.size]
        return jnp.pad(far, (first, 0))

    def hook_and_jump(labels: Array, walls: Links, changing: Array) -> Array:
        """Passes each better label to the corner that the old label names, then follows every label once.

        Each round shortens a corridor by a factor, so that the longest spiral takes about log(corners) rounds: the idea
        of Shiloach and Vishkin (1982), in the form of FastSV (Zhang, Azad and Hu, 2020).
        """
        firsts = margin + jnp.arange((labels.size - 2 * margin) // initial.size) * initial.size
        starts = jnp.pad(jnp.repeat(firsts, initial.size), margin)

        def once_more(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            before, _ = carry
            after = sweep(before, walls, before, 1)
            labels = after.at[starts + before].min(after)
            return labels[starts + labels], jnp.any(before != after)

        return lax.while_loop(lambda carry: carry[1], once_more, (labels, changing))[0]

    def wall(codes: Array, side: int, opposite: int, ahead: int) -> Array:
        """Returns `closed` where a tile is linked to the tile `ahead` cells later in the vector, and 0 elsewhere.

        `find_links` finds the same links in each grid. With walls made from those, a search takes 1.1 times as long.
        """
        here, there = codes[:-ahead] & side > 0, codes[ahead:] & opposite > 0
        return jnp.pad(jnp.where(here & there, closed, initial.dtype.type(0)), (0, ahead))

    def with_margins(grids: Array) -> Array:
        """Joins the grids of a batch, with empty rows at both ends, so that each corner has neighbours there."""
        rows = jnp.pad(grids.reshape(-1, stride), ((_FAR - 1, _FAR - 1), (0, 0)))
        return materialize(rows).reshape(-1)

    @jax.custom_batching.custom_vmap
    def label(padded: Array) -> Array:
        batch = padded.shape[:-1]
        if 0 in batch:
            return jnp.zeros((*batch, initial.size), initial.dtype)
        codes = with_margins(padded)
        walls = Links(wall(codes, EAST, WEST, 1), wall(codes, SOUTH, NORTH, stride))
        # Or-ed with 0, so that inside `jax.shard_map` the labels belong to the same devices as the walls.
        labels = with_margins(jnp.broadcast_to(initial, padded.shape)) | (walls.east & 0)
        labels, changing = propagate(labels, walls)
        if followable:
            labels = hook_and_jump(labels, walls, changing)
        return labels[margin:-margin].reshape(padded.shape)

    @label.def_vmap
    def _(axis_size: int, batched: list[bool], padded: Array) -> tuple[Array, bool]:
        return label(padded), True

    return label
