"""The floor of a 3-D simulator: a flat mesh with a map's picture, as binary glTF 2.0 (ISO/IEC 12113)."""

import json
import struct

import numpy as np

from elitelanes_jax.formats.duckietown import TILE_SIZE, check_tile_size

_FLOATS, _SHORTS = 5126, 5123  # types of components
_SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}  # linear, with mipmaps, to the edge
_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)  # east and south of the north-west corner


def to_gltf(shape: tuple[int, int], picture: bytes, tile_size: float = TILE_SIZE) -> bytes:
    """Writes the floor of a map as a glTF file (.glb) that contains the picture.

    As glTF has it, y points up: x is east and -z is north of the map's south-west corner. Programs in which z points up
    turn the floor on import, so that y is north there.

    Args:
      shape: rows and columns of the map.
      picture: a PNG file of the map, such as `tiles.png_of` returns.
      tile_size: side of a tile in metres, 0.01 to 1000.

    Raises:
      InputError: for a bad size.
    """
    check_tile_size(tile_size, most=1000)
    depth, width = np.array(shape, np.float32) * np.float32(tile_size)
    corners = np.stack([_CORNERS[:, 0] * width, 0 * _CORNERS[:, 0], (_CORNERS[:, 1] - 1) * depth], axis=-1)
    up = np.tile(np.array([0, 1, 0], np.float32), (4, 1))
    faces = np.array([0, 3, 2, 0, 2, 1], np.uint16)  # anticlockwise from above
    parts = [corners.tobytes(), up.tobytes(), _CORNERS.tobytes(), faces.tobytes(), picture]
    starts = np.cumsum([0, *(len(_padded(part)) for part in parts)]).tolist()
    content = {
        "asset": {"version": "2.0", "generator": "Elite Lanes JAX"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "floor", "mesh": 0}],
        "meshes": [
            {
                "name": "floor",
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}
                ],
            }
        ],
        "materials": [
            {
                "name": "floor",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1},
            }
        ],
        "textures": [{"sampler": 0, "source": 0}],
        "samplers": [_SAMPLER],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "accessors": [
            _accessor(0, "VEC3", 4) | {"min": corners.min(axis=0).tolist(), "max": corners.max(axis=0).tolist()},
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


def _accessor(view: int, kind: str, count: int, component: int = _FLOATS) -> dict[str, object]:
    return {"bufferView": view, "componentType": component, "count": count, "type": kind}


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<I4s", len(content), kind) + content


def _padded(content: bytes, fill: bytes = b"\0") -> bytes:
    return content + fill * (-len(content) % 4)
