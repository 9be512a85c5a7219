"""Maps and pictures as arrays, from which `views` draws."""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
from jaxtyping import Array, Float, Int32, UInt32

from elitelanes_jax.drive._billboards import Billboards, Floor
from elitelanes_jax.drive._objects import Objects

PAVED = 64
"""The bit of a pyramid's label byte that is set where a tile is not ground.

The label is below it.
"""


class Blend(NamedTuple):
    """How the tiles of a map are blended, as `render` blends photographs.

    Attributes:
      tones: float32 ``[N, 3, 2]``, the gain and the offset of each cell and colour.
      meetings: int32 ``[N]``, the sides of each cell where its road meets that of its neighbour.
    """

    tones: Float[Array, "N 3 2"]
    meetings: Int32[Array, " N"]


class SceneMap(NamedTuple):
    """One map of a scene.

    In a batch every shape starts with M, and smaller maps are filled up with empty cells.

    Attributes:
      codes: int32 ``[H, W]``, with a border of empty cells.
      links: int32 ``[H, W]``, the codes' connections that the neighbour returns.
      movements: int32 ``[N, 4]``, row, column, heading and turn, without the border.
      movement_count: int32, the number of movements. Rows after it are not used.
      objects: the objects of the map; None if no map has any.
      choices: int32 ``[O, 2]``, the first of the billboards that may show each object, and how many
        may; None if no map has objects.
      floor: the objects on the floor; None if no map has any.
      cells: int32 ``[N]``, the picture that shows each of the H * W cells; None to draw one for
        each view.
      blend: how the pictures of the cells are blended; None if they are not.
    """

    codes: Int32[Array, "H W"]
    links: Int32[Array, "H W"]
    movements: Int32[Array, "N 4"]
    movement_count: Int32[Array, ""]
    objects: Objects | None = None
    choices: Int32[Array, "O 2"] | None = None
    floor: Floor | None = None
    cells: Int32[Array, " N"] | None = None
    blend: Blend | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Scenes:
    """Maps, and the pictures that show them.

    Scenes are a pytree. Compiled programs contain `lane_offset` and `tile_px`.

    Attributes:
      maps: a batch of M maps.
      pyramid: uint32 ``[T, P]``, each picture of a tile in all sizes, from the largest to one
        pixel, row by row: red, green, blue and label from the lowest byte. Ground is black, and
        only what is not ground has the bit 64 of the label's byte.
      tiles: int32 ``[16, V]``, the pictures that show each code, indices from 0 to T - 1. Shorter
        lists are repeated.
      picture_counts: int32 ``[16]``, the number of pictures that show each code.
      billboards: the pictures of objects; None without objects.
      lane_offset: tiles from the road's middle to the centre of a lane, in the tile set; static.
      tile_px: the side of the largest pictures of tiles in pixels; static.
    """

    maps: SceneMap
    pyramid: UInt32[Array, "T P"]
    tiles: Int32[Array, "16 V"]
    picture_counts: Int32[Array, " 16"]
    billboards: Billboards | None
    lane_offset: float = field(metadata={"static": True})
    tile_px: int = field(metadata={"static": True})

    @property
    def sizes(self) -> tuple[int, ...]:
        """The sides of all sizes of pictures, in pixels."""
        return halved_sizes(self.tile_px)


def halved_sizes(size: int) -> tuple[int, ...]:
    """Returns a size and its halves, rounded down, to 1."""
    return tuple(size >> halvings for halvings in range(size.bit_length()))
