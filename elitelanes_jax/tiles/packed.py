"""Tile and object sets that travel as few bytes to workers that have this package."""

import pickle
from dataclasses import fields
from io import BytesIO
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Plain, Untyped
from elitelanes_jax.tiles.object_set import ObjectSet, load_objects
from elitelanes_jax.tiles.rendering import png_of
from elitelanes_jax.tiles.tileset import TileSet, own_tiles


class Pictures(NamedTuple):
    """The sets of pictures that maps are drawn with, small when pickled.

    The package's own sets are named by their digests, and the receiver reads its own files. If they
    differ, unpickling raises `InputError`. The pictures of other sets are sent as PNG, which loses
    nothing.

    Attributes:
      tiles: the tile set of the roads.
      objects: None to draw no objects.
    """

    tiles: TileSet
    objects: ObjectSet | None

    def __reduce__(self) -> tuple[Untyped, ...]:
        content = BytesIO()
        _Packer(content).dump(tuple(self))
        return _unpack, (content.getvalue(),)


def _unpack(content: bytes) -> Pictures:
    return Pictures(*pickle.loads(content))


class _Packer(pickle.Pickler):
    """Pickles sets of pictures in fewer bytes than pickle does."""

    def reducer_override(self, value: Untyped) -> Untyped:
        if isinstance(value, TileSet) and _describe(value) == _describe(own_tiles()):
            return _own_tiles_like, (_describe(value),)
        if isinstance(value, ObjectSet):
            own_objects = load_objects()
            if (value.name, value.digest) == (own_objects.name, own_objects.digest):
                return _own_objects_like, (value.digest,)
        if isinstance(value, TileSet | ObjectSet):
            # Pickle would also send what their properties have computed.
            return type(value), tuple(getattr(value, field.name) for field in fields(value))
        if isinstance(value, np.ndarray) and value.dtype == bool:
            return _read_mask, (png_of(value.astype(np.uint8)),)
        if isinstance(value, np.ndarray):
            return _read_pixels, (png_of(value),)
        return NotImplemented


def _describe(tiles: TileSet) -> dict[str, Plain]:
    """Returns all fields of a tile set as plain values, with a digest of its pictures."""
    # Pictures of maps do not depend on the spread.
    return tiles.to_plain() | {"lane_offset_spread": tiles.lane_offset_spread}


def _own_tiles_like(about: dict[str, Plain]) -> TileSet:
    """Returns the package's own tile set, if it is the one of the sender."""
    tiles = own_tiles()
    if _describe(tiles) != about:
        raise InputError("", f"the package's tiles {about}, as here", _describe(tiles))
    return tiles


def _own_objects_like(digest: str) -> ObjectSet:
    """Returns the package's own object set, if it is the one of the sender."""
    objects = load_objects()
    if objects.digest != digest:
        raise InputError("", f"the package's objects {digest}, as here", objects.digest)
    return objects


def _read_pixels(content: bytes) -> NDArray[np.uint8]:
    """Returns the pixels of a PNG file: grey, RGB, or RGB and opacity."""
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    # The file can be read, because `png_of` wrote it.
    assert pixels is not None
    if pixels.ndim == 3:
        swap = cv2.COLOR_BGR2RGB if pixels.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
        pixels = cv2.cvtColor(pixels, swap)
    return np.asarray(pixels, np.uint8)


def _read_mask(content: bytes) -> NDArray[np.bool_]:
    """Returns the mask in a grey PNG file."""
    return _read_pixels(content) > 0
