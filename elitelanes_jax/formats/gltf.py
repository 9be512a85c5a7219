"""The floor of a 3-D simulator, as binary glTF 2.0 (ISO/IEC 12113).

The floor is a flat mesh with a map's picture. Objects stand on it as upright pictures. Everything
is the same square, which each node of the scene places.
"""

import json
import struct
from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

import numpy as np

from elitelanes_jax.formats.duckietown import TILE_SIZE, check_tile_size
from elitelanes_jax.formats.objects import Standing

# The numbers of glTF for 32-bit floats and for unsigned 16-bit integers.
_FLOATS, _SHORTS = 5126, 5123

# The picture is sampled linearly, with mipmaps. It is not repeated beyond its edges.
_SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}
_PNG = b"\x89PNG\r\n\x1a\n"

# The corners of a picture, by (right, down).
_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)
# The corners of the square that shows it, by (right, up, forwards), and the normal at each of them.
_SQUARE = np.array([(-0.5, 1, 0), (0.5, 1, 0), (0.5, 0, 0), (-0.5, 0, 0)], np.float32)
_NORMALS = np.array([(0, 0, 1)] * 4, np.float32)
# Two triangles are a square. Their corners are anticlockwise as seen from the front, which is the
# side that glTF shows.
_TRIANGLES = np.array([0, 3, 2, 0, 2, 1], np.uint16)

# The indices of these four arrays, both as accessors and as views of the buffer. The views of
# pictures follow.
_POSITION, _NORMAL, _PICTURE_POSITION, _INDEX = range(4)

_Vector = tuple[float, float, float]


class _Node(NamedTuple):
    """A square of the scene.

    Attributes:
      name: the name of the node.
      picture: the index of its picture.
      right: its right side, in metres.
      up: its height.
      forwards: the direction that it faces, of length 1.
      place: the position of the middle of its lower edge, in metres.
    """

    name: str
    picture: int
    right: _Vector
    up: _Vector
    forwards: _Vector
    place: _Vector


def to_gltf(
    shape: tuple[int, int],
    picture: bytes,
    tile_size: float = TILE_SIZE,
    standing: Sequence[Standing] = (),
) -> bytes:
    """Writes the floor of a map as a glTF file (.glb).

    The file contains the picture of the map, and those of objects.

    As glTF has it, y points up: x is east and -z is north of the map's south-west corner. Programs
    in which z points up turn the floor on import, so that y is north there.

    Args:
      shape: rows and columns of the map.
      picture: a PNG file of the map.
      tile_size: side of a tile in metres, 0.01 to 1000.
      standing: objects. Each is a picture of its front, as high as the object; its lower edge is in
        the middle of the footprint. They grow with the tiles.

    Raises:
      InputError: for a bad size.
    """
    check_tile_size(tile_size, most=1000)
    rows, columns = shape
    # Pictures are keys with their index, because equal objects share a picture.
    pictures = {picture: 0}
    nodes = [_floor(columns * tile_size, rows * tile_size)]
    for item in standing:
        index = pictures.setdefault(item.picture, len(pictures))
        nodes.append(_upright(item, index, tile_size, rows))
    parts = [_SQUARE.tobytes(), _NORMALS.tobytes(), _CORNERS.tobytes(), _TRIANGLES.tobytes()]
    # The keys of a dictionary are in the order of their indices.
    parts += pictures
    content = _scene(nodes, len(pictures)) | _buffer(parts)
    # The length of a chunk is a multiple of 4. JSON is filled up with spaces, the buffer with
    # zeros.
    chunks = _chunk(b"JSON", _padded(json.dumps(content).encode(), b" "))
    chunks += _chunk(b"BIN\0", b"".join(map(_padded, parts)))
    # The head has the version and the length of the file, with its own 12 bytes.
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _floor(width: float, depth: float) -> _Node:
    """Returns the node of the floor: its lower edge is the map's south side."""
    return _Node("floor", 0, (width, 0, 0), (0, 0, -depth), (0, 1, 0), (width / 2, 0, 0))


def _upright(item: Standing, picture: int, tile_size: float, rows: int) -> _Node:
    """Returns the node of an object that stands on the floor."""
    thing, scale = item.thing, tile_size / TILE_SIZE
    # Angles are counter-clockwise from east, and z points south.
    east, south = cos(thing.angle), -sin(thing.angle)
    return _Node(
        name=thing.kind,
        picture=picture,
        right=(south * item.width * scale, 0, -east * item.width * scale),
        up=(0, thing.height * tile_size / TILE_SIZE, 0),
        forwards=(east, 0, south),
        place=(thing.x * tile_size, 0, (thing.y - rows) * tile_size),
    )


def _scene(nodes: list[_Node], pictures: int) -> dict[str, object]:
    """Returns the parts of the JSON that say what is seen.

    Each picture has a mesh, a material and a texture.
    """
    attributes = {"POSITION": _POSITION, "NORMAL": _NORMAL, "TEXCOORD_0": _PICTURE_POSITION}
    placed = []
    for node in nodes:
        axes = [node.right, node.up, node.forwards, node.place]
        # A matrix has its columns one after the other: three axes and the place.
        matrix = np.column_stack([axes, [0, 0, 0, 1]]).ravel().tolist()
        placed.append({"name": node.name, "mesh": node.picture, "matrix": matrix})
    meshes, materials, textures, images = [], [], [], []
    for index in range(pictures):
        primitive = {"attributes": attributes, "indices": _INDEX, "material": index}
        meshes.append({"primitives": [primitive]})
        materials.append(_material(index))
        textures.append({"sampler": 0, "source": index})
        images.append({"bufferView": _INDEX + 1 + index, "mimeType": "image/png"})
    return {
        "asset": {"version": "2.0", "generator": "Elite Lanes JAX"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": placed,
        "meshes": meshes,
        "materials": materials,
        "textures": textures,
        "samplers": [_SAMPLER],
        "images": images,
    }


def _buffer(parts: list[bytes]) -> dict[str, object]:
    """Returns the parts of the JSON that say where arrays and pictures are in the binary chunk."""
    # Positions need their bounds in glTF. Other arrays do not.
    extent = {"min": _SQUARE.min(axis=0).tolist(), "max": _SQUARE.max(axis=0).tolist()}
    accessors = [
        _accessor(_POSITION, "VEC3", 4) | extent,
        _accessor(_NORMAL, "VEC3", 4),
        _accessor(_PICTURE_POSITION, "VEC2", 4),
        _accessor(_INDEX, "SCALAR", 6, _SHORTS),
    ]
    views = []
    start = 0
    for part in parts:
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(part)})
        start += len(_padded(part))
    return {"accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": start}]}


def _material(index: int) -> dict[str, object]:
    surface = {"baseColorTexture": {"index": index}, "metallicFactor": 0, "roughnessFactor": 1}
    is_floor = index == 0
    # Objects have transparent pixels, and are seen from behind too. The floor is opaque, and seen
    # from above alone.
    return {
        "alphaMode": "OPAQUE" if is_floor else "MASK",
        "doubleSided": not is_floor,
        "pbrMetallicRoughness": surface,
    }


def _accessor(view: int, kind: str, count: int, component: int = _FLOATS) -> dict[str, object]:
    return {"bufferView": view, "componentType": component, "count": count, "type": kind}


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<I4s", len(content), kind) + content


def _padded(content: bytes, fill: bytes = b"\0") -> bytes:
    return content + fill * (-len(content) % 4)
