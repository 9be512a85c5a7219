"""Pictures of objects, for cameras."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int32, UInt8, UInt32

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.formats.objects import OPAQUE, nearest_view

SIDE = 64
"""The default number of rows and columns of pictures of objects, a multiple of 32."""

# The default number of views, evenly around an object.
_VIEWS = 8

INDEX_BITS = 27
"""The bits for the index of a pixel in all pictures."""


class Billboards(NamedTuple):
    """Pictures of objects, for cameras: V views of each of N objects.

    Billboards of a `Sight` have an object for each of `OBJECT_KINDS`. A view is a picture. The R
    rows of all pictures are one after another. Each row has S pixels, and shorter rows are filled
    up with transparent pixels.

    Attributes:
      pixels: uint32 ``[R * S]``, red, green and blue from the lowest byte, row by row.
      opaque: uint32 ``[R, S / 32]``, a bit for each pixel of a row, the first one the lowest.
      aspect: float32 ``[N, V]``, width over height.
      first: int32 ``[N, V]``, the first row.
      rows: int32 ``[N, V]``, the number of rows.
      columns: int32 ``[N, V]``, the number of columns.
    """

    pixels: UInt32[Array, " N"]
    opaque: UInt32[Array, "R W"]
    aspect: Float[Array, "N V"]
    first: Int32[Array, "N V"]
    rows: Int32[Array, "N V"]
    columns: Int32[Array, "N V"]


class Floor(NamedTuple):
    """The objects on the floor of a map. A batch has N in front of every shape.

    Attributes:
      indices: int32 ``[F]``, of the map's objects, ascending. -1 fills up a batch.
      length: float32 ``[F]``, metres along the object's angle.
      width: float32 ``[F]``, metres.
    """

    indices: Int32[Array, " F"]
    length: Float[Array, " F"]
    width: Float[Array, " F"]


def pack_billboards(
    objects: Sequence[Mapping[int, AnyArray]], side: int | None = SIDE, views: int = _VIEWS
) -> Billboards:
    """Packs the views of objects, by degrees. An object without any view is not shown.

    Args:
      objects: the views of each object.
      side: the side of the packed pictures in pixels, a multiple of 32; None to keep the pictures'
        sizes.
      views: the number of packed views of each object, evenly around it.

    Raises:
      InputError: for arrays of other shapes, or too many objects, whose pixels 27 bits count.
    """
    packed, aspect = [], np.ones((len(objects), views), np.float32)
    for index, pictures in enumerate(objects):
        for view in range(views):
            picture = np.zeros((1, 1, 4), np.uint8)
            if pictures:
                picture = _check_picture(pictures[nearest_view(pictures, 360 / views * view)])
            rows, columns = picture.shape[:2]
            aspect[index, view] = columns / rows
            if side is not None:
                # Each pixel shows the nearest pixel of the original.
                down, across = ((np.arange(side) + 0.5) * size // side for size in (rows, columns))
                picture = picture[down.astype(int)[:, None], across.astype(int)]
            packed.append(picture)
    sizes = np.array([picture.shape[:2] for picture in packed])
    ends = np.cumsum(sizes[:, 0])
    # A word holds the opacity of 32 pixels.
    stride = -(-sizes[:, 1].max() // 32) * 32
    if ends[-1] * stride > 2**INDEX_BITS:
        most = int(len(objects) * 2**INDEX_BITS / (ends[-1] * stride))
        raise InputError(
            "objects", f"at most {most} different objects, counting each AprilTag", len(objects)
        )
    pixels = np.zeros((ends[-1], stride, 4), np.uint8)
    for picture, end in zip(packed, ends, strict=True):
        pixels[end - len(picture) : end, : picture.shape[1]] = picture
    opaque = np.packbits(pixels[..., 3] >= OPAQUE, axis=1, bitorder="little")
    words = opaque.view("<u4").astype(np.uint32)
    # The label of what is no road is 0.
    pixels[..., 3] = 0
    colours = pixels.view("<u4").reshape(-1).astype(np.uint32)
    tables = (ends - sizes[:, 0], *sizes.T)
    return Billboards(
        *map(jnp.asarray, (colours, words, aspect)),
        *(jnp.asarray(table.reshape(aspect.shape), jnp.int32) for table in tables),
    )


def _check_picture(picture: AnyArray) -> UInt8[np.ndarray, "rows columns 4"]:
    picture = np.asarray(picture)
    has_pixels = picture.ndim == 3 and picture.shape[2] == 4 and picture.size > 0
    if not has_pixels or picture.dtype != np.uint8:
        raise InputError("objects", "uint8 [rows, columns, 4]", f"{picture.dtype} {picture.shape}")
    return picture
