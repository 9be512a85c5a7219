"""The faces into which the roads of a grid divide the plane, and counts from them.

The faces are the planar dual of the grid's road graph. A grid's road graph is drawn in the plane,
on the lattice of tiles. Its dual lives on the lattice of corner points between tiles. Two
neighbouring corners belong to the same face if no road runs between them, and all corners on the
border belong to the outer face.

    tile --- tile     tile     tile     a road between two tiles separates the corners beside it;
         .       .        .             without one, both corners belong to the same face
    tile     tile --- tile     tile
         a    |   b        c            the road between a and b separates these two corners;
    tile     tile     tile     tile     b and c belong to the same face

Once the faces are labelled, Euler's formula gives these counts exactly, without a spanning tree or
a search:

    cyclomatic number = faces - 1 (the outer one)
    components        = tiles - roads + cyclomatic number
    a road is a bridge if and only if the same face is on both its sides

Corner (r, c) is south-east of tile (r, c) and has the tile's index in the padded layout. In this
layout, an empty row comes before the tiles and an empty cell after each row. The inner corners have
rows 0..H-2 and columns 0..W-2; every other index belongs to the outer face. The road east of a tile
separates the tile's corner from the corner to the north. The road south of it separates the corner
from the one to the west. Therefore each neighbour is a shift of one vector.
"""

from collections.abc import Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array, Bool, Int, Int8, UInt

from elitelanes_jax._util.types import Tree, Untyped
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.xla import PaddedLayout, materialize

# The sweeps before the costlier method for long corridors. Random grids need fewer.
_PATIENCE = 60

# The steps that a label goes in every other sweep. At 12 x 12, evaluation with 4 steps takes 1.2
# times as long.
_FAR = 3

# The pairs of sweeps between two checks whether labels still change, for grids end to end and for
# grids side by side. A GPU waits for the processor at each check.
_PAIRS, _PAIRS_BESIDE = 2, 4

# The label of the outer face. It is less than all others, so it spreads over the whole face.
_OUTER = 0


class Links(NamedTuple):
    """The links of a grid, as vectors ``[size]`` of its layout.

    A link is a road between two neighbouring tiles.

    Attributes:
      east: whether the tile and its eastern neighbour are linked.
      south: whether the tile and its southern neighbour are linked.
    """

    east: Bool[Array, " size"]
    south: Bool[Array, " size"]


def find_links(layout: PaddedLayout, padded: Int[Array, " padded"]) -> Links:
    """Finds the pairs of neighbouring tiles that connect to each other."""
    here = layout.here(padded)
    return Links(
        east=(here & EAST > 0) & (layout.east(padded) & WEST > 0),
        south=(here & SOUTH > 0) & (layout.south(padded) & NORTH > 0),
    )


class Faces(NamedTuple):
    """The faces of a grid, as vectors ``[size]`` of its layout.

    Attributes:
      first: whether the corner is the first one of an inner face.
      east_bridge: whether the link to the east is a bridge.
      south_bridge: whether the link to the south is a bridge.
    """

    first: Bool[Array, " size"]
    east_bridge: Bool[Array, " size"]
    south_bridge: Bool[Array, " size"]


def find_faces(layout: PaddedLayout, padded: Int8[Array, " padded"], links: Links) -> Faces:
    """Finds the faces between the roads of one grid. The time hardly depends on their shape."""
    labels = label_faces(layout, padded)
    corner = layout.here(labels)
    initial = layout.here(jnp.asarray(_initial_labels(layout)))
    # The label of a face is the least of its corners' initial labels, so one corner of each face
    # keeps its own. A link is a bridge if both corners beside it belong to the same face.
    return Faces(
        first=(corner == initial) & (initial != _OUTER),
        east_bridge=links.east & (corner == layout.north(labels)),
        south_bridge=links.south & (corner == layout.west(labels)),
    )


def label_faces(layout: PaddedLayout, padded: Int8[Array, " padded"]) -> UInt[Array, " padded"]:
    """Labels the corners of one grid by their face.

    The outer face has the label 0, and each inner face has another label. Labels are less than the
    length of the padded vector.
    """
    return _label_faces.bind(padded, layout=layout)


@cache
def _initial_labels(layout: PaddedLayout) -> np.ndarray:
    """Returns the label that each corner of the padded layout starts with.

    The labels of inner corners are unique and rising. All other corners have the label of the outer
    face. Fewer than 255 inner corners, such as those of 16 x 16 tiles, have labels 1, 2, 3 and so
    on. Such a label fits a byte, so that a sweep is cheapest. In larger grids the label is the
    corner's index, so that a label leads to its corner.
    """
    indices = np.arange((layout.height + 2) * layout.stride)
    rows, columns = indices // layout.stride, indices % layout.stride
    inner = (rows >= 1) & (rows < layout.height) & (columns < layout.width - 1)
    count = (layout.height - 1) * (layout.width - 1)
    if count < np.iinfo(np.uint8).max:
        return np.where(inner, np.cumsum(inner), _OUTER).astype(np.uint8)
    wide = np.uint16 if indices.size < np.iinfo(np.uint16).max else np.uint32
    return np.where(inner, indices, _OUTER).astype(wide)


class _Arrangement(NamedTuple):
    """How the grids of a batch lie in one array of cells.

    Empty rows at both ends give every corner its neighbours. Laid end to end, as one long vector,
    grids suit the caches of a processor. Laid side by side, with the cells of a grid far apart,
    they suit a GPU, whose threads read four neighbouring numbers at once.
    """

    layout: PaddedLayout
    beside: bool

    @property
    def initial(self) -> np.ndarray:
        """The labels of one grid before the first sweep."""
        return _initial_labels(self.layout)

    @property
    def margin(self) -> int:
        """The number of empty cells at each end."""
        return (_FAR - 1) * self.layout.stride

    @property
    def closed(self) -> "np.unsignedinteger[Any]":
        """The value of a wall.

        Its bits are all set, so that a label or-ed with it is never the least one.
        """
        return self.initial.dtype.type(np.iinfo(self.initial.dtype).max)

    @property
    def labels_name_corners(self) -> bool:
        """Whether a label is the index of a corner."""
        return self.initial.dtype != np.uint8

    def arrange(self, grids: Array) -> Array:
        """Lays out grids ``[N, padded]``."""
        if self.beside:
            return _extend(grids.T, self.margin, self.margin)
        rows = grids.reshape(-1, self.layout.stride)
        return materialize(_extend(rows, _FAR - 1, _FAR - 1)).reshape(-1)

    def take_apart(self, cells: Array, shape: Sequence[Untyped]) -> Array:
        """Returns the grids again, without the empty rows, in the shape of the batch.

        Its sizes may be symbols of `jax.export`.
        """
        cells = cells[self.margin : cells.shape[0] - self.margin]
        if self.beside:
            cells = cells.T
        return cells.reshape(shape)

    def store(self, cells: Tree) -> Tree:
        """Makes XLA for GPUs store arrays.

        Otherwise XLA would compute them again for each use, or copy them.
        """
        return lax.optimization_barrier(cells) if self.beside else cells

    def named_corners(self, labels: Array) -> tuple[Array, ...]:
        """Returns the indices of the corners that labels name."""
        if self.beside:
            return self.margin + labels.astype(jnp.int32), jnp.arange(labels.shape[1])
        # A label is an index within its own grid, so the index of the grid's first cell is added.
        count = (labels.size - 2 * self.margin) // self.initial.size
        first_of_grid = self.margin + jnp.arange(count) * self.initial.size
        first_of_grid = jnp.pad(jnp.repeat(first_of_grid, self.initial.size), self.margin)
        return (first_of_grid + labels.astype(jnp.int32),)


def _extend(cells: Array, before: int, after: int) -> Array:
    """Adds zeros along the first axis."""
    return jnp.pad(cells, [(before, after), *[(0, 0)] * (cells.ndim - 1)])


def _label(
    padded: Int8[Array, "*B padded"], *, layout: PaddedLayout, beside: bool
) -> UInt[Array, "*B padded"]:
    """Labels the corners of grids on a layout, all grids together.

    The label of a corner is the least label of its face.
    """
    arrangement = _Arrangement(layout, beside)
    initial = arrangement.initial
    if 0 in padded.shape[:-1]:
        return jnp.zeros(padded.shape, initial.dtype)
    grids = padded.reshape(-1, initial.size)
    walls = _find_walls(arrangement, arrangement.arrange(grids))
    # The labels are or-ed with 0 from the walls, so that inside `jax.shard_map` they are on the
    # same devices as the walls.
    labels = arrangement.arrange(jnp.broadcast_to(initial, grids.shape)) | (walls.east & 0)
    labels, changing = _propagate(arrangement, labels, walls)
    if arrangement.labels_name_corners:
        labels = _hook_and_jump(arrangement, labels, walls, changing)
    return arrangement.take_apart(labels, padded.shape)


class _Walls(NamedTuple):
    """The value `closed` for each link of a tile, and 0 elsewhere.

    A road is a wall between the two corners beside it. `find_links` finds the same links in each
    grid. With walls made from those, a search takes 1.1 times as long.

    Attributes:
      east: the walls along the links to the east, each between the tile's corner and the corner to
        the north.
      south: the walls along the links to the south, each between the tile's corner and the corner
        to the west.
    """

    east: Array
    south: Array


def _find_walls(arrangement: _Arrangement, codes: Array) -> _Walls:
    """Finds the walls between the corners of grids."""
    stride = arrangement.layout.stride

    def wall(side: int, opposite: int, ahead: int) -> Array:
        # The last cells are padding, which has no link ahead.
        linked = (codes[:-ahead] & side > 0) & (codes[ahead:] & opposite > 0)
        values = jnp.where(linked, arrangement.closed, arrangement.initial.dtype.type(0))
        return _extend(values, 0, ahead)

    walls: _Walls = arrangement.store(_Walls(wall(EAST, WEST, 1), wall(SOUTH, NORTH, stride)))
    return walls


def _far_walls(arrangement: _Arrangement, walls: _Walls) -> _Walls:
    """Returns walls between corners `_FAR` steps apart.

    There is a wall if any of these steps crosses a wall.
    """

    def any_wall(walls: Array, step: int) -> Array:
        # Steps lead south or east to a cell. The wall at this cell cuts the last step, and the
        # walls at the cells before it cut the earlier steps. Steps that leave a row or a grid pass
        # through corners of the outer face, so they never connect two inner faces.
        before = (_FAR - 1) * step
        far = walls[before:]
        for start in range(0, before, step):
            far |= walls[start : start + far.shape[0]]
        return _extend(far, before, 0)

    far: _Walls = arrangement.store(
        _Walls(any_wall(walls.east, arrangement.layout.stride), any_wall(walls.south, 1))
    )
    return far


def _sweep(
    arrangement: _Arrangement, labels: Array, walls: _Walls, into: Array, steps: int
) -> Array:
    """Gives each corner the least label among its own and those of four corners.

    The four corners are `steps` steps away, in each direction. Corners behind a wall do not count.
    Writes to `into`, whose both ends are those of `labels`: they belong to the outer face and do
    not change. With another array than `labels`, XLA computes the sweep in place and in one pass.
    """
    stride = arrangement.layout.stride
    margin = arrangement.margin + stride
    # `len` would refuse the symbolic sizes of `jax.export`.
    length = labels.shape[0] - 2 * margin

    def shifted(cells: Array, ahead: int) -> Array:
        return lax.slice_in_dim(cells, margin + ahead, margin + ahead + length)

    least = shifted(labels, 0)
    for ahead, wall in (
        # These are the neighbours to the north, south, west and east. A link to the east is a wall
        # on the way north or south. It is stored at the southern one of the two corners, and a link
        # to the south at the eastern one.
        (-steps * stride, shifted(walls.east, 0)),
        (steps * stride, shifted(walls.east, steps * stride)),
        (-steps, shifted(walls.south, 0)),
        (steps, shifted(walls.south, steps)),
    ):
        least = jnp.minimum(least, shifted(labels, ahead) | wall)
    swept: Array = arrangement.store(lax.dynamic_update_slice_in_dim(into, least, margin, 0))
    return swept


def _propagate(arrangement: _Arrangement, labels: Array, walls: _Walls) -> tuple[Array, Array]:
    """Sweeps to and fro between two arrays until they are equal.

    If labels name corners, it stops after about `_PATIENCE` sweeps.

    Every other sweep goes `_FAR` steps, because corridors mostly run straight. The longest corridor
    of a batch then takes two thirds as many sweeps.

    Returns the labels, and whether they still change.
    """
    far_walls = _far_walls(arrangement, walls)
    pairs = _PAIRS_BESIDE if arrangement.beside else _PAIRS

    def sweep_on(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        near, far, _, sweeps = carry
        for _ in range(pairs):
            far = _sweep(arrangement, near, far_walls, far, _FAR)
            near = _sweep(arrangement, far, walls, near, 1)
        # If the last sweep, which goes one step, changes nothing, neighbours in a face have equal
        # labels. The corner whose initial label is the least of its face has kept it, so all
        # corners of the face have this label. XLA computes the largest difference faster than it
        # computes whether there is a difference.
        changing = jnp.max(near ^ far, initial=0) > 0
        return near, far, changing, sweeps + 2 * pairs

    def unsettled(carry: tuple[Array, Array, Array, Array]) -> Array:
        _, _, changing, sweeps = carry
        return changing & (sweeps < _PATIENCE) if arrangement.labels_name_corners else changing

    # This True is made from the labels, because inside `jax.shard_map` a constant would not be on
    # their devices.
    true = labels[:1].any() | True
    labels, _, changing, _ = lax.while_loop(
        unsettled, sweep_on, (labels, labels, true, jnp.int32(0))
    )
    return labels, changing


def _hook_and_jump(
    arrangement: _Arrangement, labels: Array, walls: _Walls, changing: Array
) -> Array:
    """Passes better labels on along the corners that labels name.

    Each better label goes to the corner that the old label names. Then every corner follows its
    label once. The outer face's label 0 names cell 0, which is outside and keeps it. Each round
    shortens a corridor by a factor, so that the longest spiral takes about
    log(corners) rounds: the idea of Shiloach and Vishkin (1982), in the form of FastSV (Zhang, Azad
    and Hu, 2020).
    """

    def once_more(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        before, _ = carry
        after = _sweep(arrangement, before, walls, before, 1)
        # Hook: the corner that the old label names takes the better label.
        hooked = after.at[arrangement.named_corners(before)].min(after)
        # Jump: every corner takes the label of the corner that its own label names. So all corners
        # with the old label get the better one.
        jumped = hooked[arrangement.named_corners(hooked)]
        return jumped, jnp.any(before != after)

    return lax.while_loop(lambda carry: carry[1], once_more, (labels, changing))[0]


# This is a primitive, so that programs for each kind of device have their own form. It takes
# leading axes, and a batch is one more axis.
_label_faces = Primitive("label_faces")
_label_faces.def_impl(partial(_label, beside=False))
_label_faces.def_abstract_eval(
    lambda padded, *, layout: padded.update(dtype=_initial_labels(layout).dtype)
)
batching.primitive_batchers[_label_faces] = lambda arrays, axes, *, layout: (
    _label_faces.bind(jnp.moveaxis(arrays[0], axes[0], 0), layout=layout),
    0,
)
_end_to_end, _beside = (
    mlir.lower_fun(partial(_label, beside=beside), multiple_results=False)
    for beside in (False, True)
)
mlir.register_lowering(_label_faces, _beside)
mlir.register_lowering(_label_faces, _end_to_end, platform="cpu")
