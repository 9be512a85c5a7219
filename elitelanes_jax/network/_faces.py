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
from elitelanes_jax.network.xla import PaddedLayout

# Sweeps before the costlier method for long corridors. Random grids need fewer: about 50 at 64 x 64.
_PATIENCE = 60

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
    followable = initial.dtype != np.uint8
    closed = initial.dtype.type(np.iinfo(initial.dtype).max)  # or-ed onto a label it loses every comparison

    def sweep(labels: Array, walls: Links, into: Array) -> Array:
        """Gives each corner the least label among itself and its open neighbours.

        Writes to `into`, another vector than `labels`, so that XLA computes it in place and in one pass. Both ends of
        the vector belong to the outer face and do not change.
        """
        length = labels.size - 2 * stride

        def cut(vector: Array, start: int) -> Array:
            return lax.slice_in_dim(vector, start, start + length)

        least = cut(labels, stride)
        for neighbour, wall in (
            (cut(labels, 0), cut(walls.east, stride)),  # north
            (cut(labels, 2 * stride), cut(walls.east, 2 * stride)),  # south
            (cut(labels, stride - 1), cut(walls.south, stride)),  # west
            (cut(labels, stride + 1), cut(walls.south, stride + 1)),  # east
        ):
            least = jnp.minimum(least, neighbour | wall)
        return lax.dynamic_update_slice(into, least, (stride,))

    def propagate(labels: Array, walls: Links) -> tuple[Array, Array]:
        """Sweeps to and fro between two vectors until they are equal, or for `_PATIENCE` sweeps."""
        patience = _PATIENCE if followable else initial.size

        def sweep_twice(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
            here, there, _, done = carry
            there = sweep(here, walls, there)
            here = sweep(there, walls, here)
            # XLA computes the largest difference faster than whether there is any.
            return here, there, jnp.max(here ^ there, initial=0) > 0, done + 2

        def unsettled(carry: tuple[Array, Array, Array, Array]) -> Array:
            _, _, changing, done = carry
            return changing & (done < patience)

        changing = labels[:1].any() | True
        labels, _, changing, _ = lax.while_loop(unsettled, sweep_twice, (labels, labels, changing, jnp.int32(0)))
        return labels, changing

    def hook_and_jump(labels: Array, walls: Links, changing: Array) -> Array:
        """Passes each better label to the corner that the old label names, then follows every label once.

        Each round shortens a corridor by a factor, so that the longest spiral takes about log(corners) rounds: the idea
        of Shiloach and Vishkin (1982), in the form of FastSV (Zhang, Azad and Hu, 2020).
        """
        starts = jnp.repeat(jnp.arange(labels.size // initial.size) * initial.size, initial.size)

        def once_more(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            before, _ = carry
            after = sweep(before, walls, before)
            labels = after.at[starts + before].min(after)
            return labels[starts + labels], jnp.any(before != after)

        return lax.while_loop(lambda carry: carry[1], once_more, (labels, changing))[0]

    def wall(codes: Array, side: int, opposite: int, ahead: int) -> Array:
        """Returns `closed` where a tile is linked to the tile `ahead` cells later in the vector, and 0 elsewhere.

        `find_links` finds the same links in each grid. With walls made from those, a search takes 1.1 times as long.
        """
        here, there = codes[:-ahead] & side > 0, codes[ahead:] & opposite > 0
        return jnp.pad(jnp.where(here & there, closed, initial.dtype.type(0)), (0, ahead))

    @jax.custom_batching.custom_vmap
    def label(padded: Array) -> Array:
        batch = padded.shape[:-1]
        if 0 in batch:
            return jnp.zeros((*batch, initial.size), initial.dtype)
        codes = padded.reshape(-1)
        walls = Links(wall(codes, EAST, WEST, 1), wall(codes, SOUTH, NORTH, stride))
        # Or-ed with 0, so that inside `jax.shard_map` the labels belong to the same devices as the walls.
        labels = jnp.broadcast_to(initial, (*batch, initial.size)).reshape(-1) | (walls.east & 0)
        labels, changing = propagate(labels, walls)
        if followable:
            labels = hook_and_jump(labels, walls, changing)
        return labels.reshape(*batch, initial.size)

    @label.def_vmap
    def _(axis_size: int, batched: list[bool], padded: Array) -> tuple[Array, bool]:
        return label(padded), True

    return label
