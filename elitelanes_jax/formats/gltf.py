"""The floor of a 3-D simulator: a flat mesh with a map's picture, as binary glTF 2.0 (ISO/IEC 12113).

Objects stand on it as upright pictures. Everything is the same square, which each node of the scene places.
"""

import json
import struct
from collections.abc import Sequence
from math import cos, sin

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, listed
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax.formats.duckietown import TILE_SIZE, check_tile_size
from elitelanes_jax.formats.objects import Standing
from elitelanes_jax.network.checks import check_shape

_FLOATS, _SHORTS = 5126, 5123  # types of components
_Vector = tuple[float, float, float]

_SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}  # linear, with mipmaps, to the edge
_PNG = b"\x89PNG\r\n\x1a\n"
_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)  # of pictures: to the right and down


@name_wrong_arguments
def to_gltf(
    shape: tuple[int, int], picture: bytes, tile_size: float = TILE_SIZE, standing: Sequence[Standing] = ()
) -> bytes:
    """Writes the floor of a map as a glTF file (.glb) that contains the picture, and those of objects.

    As glTF has it, y points up: x is east and -z is north of the map's south-west corner. Programs in which z points up
    turn the floor on import, so that y is north there.

    Args:
      shape: rows and columns of the map.
      picture: a PNG file of the map, such as `tiles.png_of` returns.
      tile_size: side of a tile in metres, 0.01 to 1000.
      standing: objects, such as `tiles.stand` returns. Each is a picture of its front, as high as the object; its
        lower edge is in the middle of the footprint. They grow with the tiles.

    Raises:
      InputError: for a bad shape, picture, size or object.
    """
    check_tile_size(tile_size, most=1000)
    if not isinstance(picture, bytes) or not picture.startswith(_PNG):
        raise InputError(f"picture: expected the content of a PNG file, got {shorten(repr(picture), 16)}")
    depth, width = (side * tile_size for side in check_shape(shape))
    nodes: list[tuple[str, int, *tuple[_Vector, ...]]] = [
        ("floor", 0, (width, 0, 0), (0, 0, -depth), (0, 1, 0), (width / 2, 0, 0))  # right, up, forwards, place
    ]
    pictures = {picture: 0}
    for thing, front, across, _ in check_named("standing", listed(Standing), standing):
        scale, up = tile_size / TILE_SIZE, thing.height * tile_size / TILE_SIZE
        east, south = cos(thing.angle), -sin(thing.angle)  # where it faces
        right = (south * across * scale, 0, -east * across * scale)
        place = thing.x * tile_size, 0, (thing.y - shape[0]) * tile_size
        index = pictures.setdefault(front, len(pictures))
        nodes.append((thing.kind, index, right, (0, up, 0), (east, 0, south), place))
    square = np.column_stack([_CORNERS[:, 0] - 0.5, 1 - _CORNERS[:, 1], 0 * _CORNERS[:, 0]])
    faces = np.array([0, 3, 2, 0, 2, 1], np.uint16)  # anticlockwise from the front
    parts = [square.tobytes(), np.tile(np.array([0, 0, 1], np.float32), (4, 1)).tobytes(), _CORNERS.tobytes()]
    parts += [faces.tobytes(), *pictures]
    starts = np.cumsum([0, *(len(_padded(part)) for part in parts)]).tolist()
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    content = {
        "asset": {"version": "2.0", "generator": "Elite Lanes JAX"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": [
            {"name": name, "mesh": mesh, "matrix": np.column_stack([axes, [0, 0, 0, 1]]).ravel().tolist()}
            for name, mesh, *axes in nodes
        ],
        "meshes": [
            {"primitives": [{"attributes": attributes, "indices": 3, "material": index}]} for index in pictures.values()
        ],
        "materials": [_material(index) for index in pictures.values()],
        "textures": [{"sampler": 0, "source": index} for index in pictures.values()],
        "samplers": [_SAMPLER],
        "images": [{"bufferView": 4 + index, "mimeType": "image/png"} for index in pictures.values()],
        "accessors": [
            _accessor(0, "VEC3", 4) | {"min": square.min(axis=0).tolist(), "max": square.max(axis=0).tolist()},
            _accessor(1, "VEC3", 4),
            _accessor(2, "VEC2", 4),
            _accessor(3, "SCALAR", 6, _SHORTS),
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part)}
            for start, part in zip(starts, parts, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    chunks = _chunk(b"JSON", _padded(json.dumps(content).encode(), b" "))
    chunks += _chunk(b"BIN\0", b"".join(map(_padded, parts)))
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _material(index: int) -> dict[str, object]:
    surface = {"baseColorTexture": {"index": index}, "metallicFactor": 0, "roughnessFactor": 1}
    seen = {"alphaMode": "MASK" if index else "OPAQUE", "doubleSided": bool(index)}
    return {**seen, "pbrMetallicRoughness": surface}


def _accessor(view: int, kind: str, count: int, component: int = _FLOATS) -> dict[str, object]:
    return {"bufferView": view, "componentType": component, "count": count, "type": kind}


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<I4s", len(content), kind) + content


def _padded(content: bytes, fill: bytes = b"\0") -> bytes:
    return content + fill * (-len(content) % 4)
