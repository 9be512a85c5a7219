"""Maps for robots that run nav2 (ROS 2): the occupancy grid of its map server, and the graph of its route server.

Positions are in metres in the frame ``map``: x east and y north of the map's south-west corner. The road between the
white lines is free, all else is occupied. The graph has the lanes: one way each, arcs in four straight edges.
"""

import json
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.checks import check_named, name, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.duckietown import TILE_SIZE, check_tile_size
from elitelanes_jax.formats.streets import LENGTHS, LaneGraph, lane_graph, lane_points
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.movements import linked_codes
from elitelanes_jax.network.roads import on_road

_PIECES = 4  # of an arc: its chords stay within 0.014 tile of it
_FREE = 254  # and 0 is occupied
_MOST_PIXELS = 2**30

_YAML = """image: {image}
mode: trinary
resolution: {resolution:.12g}
origin: [0.0, 0.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.25
"""


class Nav2(NamedTuple):
    """The files of a map.

    Attributes:
      grid: of the map server, a PGM picture.
      about: of the map server, YAML: the picture's name, its resolution and its origin.
      graph: of the route server, GeoJSON.
    """

    grid: bytes
    about: str
    graph: str


def road_cells(codes: ArrayLike, cells: int, most: int) -> NDArray[np.bool_]:
    """Returns whether the centre of each cell is on the road, bool ``[H·cells, W·cells]``, the first row north.

    With 5 `cells` or more along a tile's side, cells of neighbours that are not linked do not touch.

    Raises:
      InputError: for a bad grid, `cells` that are not 5 to 256, or over `most` in all.
    """
    cells = check_named("cells", whole(5, 256), cells)
    links = linked_codes(np.asarray(check_grid(codes)))
    if links.size * cells**2 > most:
        raise InputError(f"cells: expected at most {most:,} in all, got {links.size * cells**2:,}")
    centres = (np.arange(cells) + 0.5) / cells
    tiles = on_road(np.arange(16)[:, None, None], centres, centres[:, None])
    height, width = links.shape
    return np.asarray(tiles[links].swapaxes(1, 2).reshape(height * cells, width * cells))


def to_nav2(codes: ArrayLike, image: str, tile_size: float = TILE_SIZE, cells: int = 39) -> Nav2:
    """Writes a map for nav2, by the rules of its formats; nav2 itself has not read one.

    Args:
      codes: integer codes ``[H, W]``.
      image: the name of the picture's file, next to the YAML file.
      tile_size: side of a tile in metres, 0.01 to 1000.
      cells: pixels along a tile's side, 5 to 256; by default 1.5 cm each.

    Raises:
      InputError: for a bad grid, one without a lane, a bad setting, or over 2**30 pixels.
    """
    check_tile_size(tile_size, most=1000)
    road = road_cells(codes, cells, _MOST_PIXELS)
    graph = lane_graph(codes)
    pixels = road * np.uint8(_FREE)
    picture = b"P5\n%d %d\n255\n" % road.shape[::-1] + pixels.tobytes()
    about = _YAML.format(image=json.dumps(check_named("image", name, image)), resolution=tile_size / cells)
    return Nav2(picture, about, _geojson(graph, len(check_grid(codes)), tile_size))


def _geojson(graph: LaneGraph, height: int, tile_size: float) -> str:
    """Writes the nodes between tiles, those within arcs, and the edges; numbers are unique among all of them."""
    inner = lane_points(graph, height, np.arange(1, _PIECES) / _PIECES)
    starts, ends = lane_points(graph, height, [0, 1]).T
    points = dict(zip(graph.edges.T.ravel().tolist(), np.concatenate([starts, ends]).tolist(), strict=True))
    steps: list[tuple[int, int, float]] = []
    for lane, ((start, end), turn) in enumerate(zip(graph.edges.tolist(), graph.turns.tolist(), strict=True)):
        path = [start, end]
        if turn != 1:
            added = range(len(graph.nodes) + (_PIECES - 1) * lane, len(graph.nodes) + (_PIECES - 1) * (lane + 1))
            points |= dict(zip(added, inner[lane].tolist(), strict=True))
            path = [start, *added, end]
        length = LENGTHS[turn] * tile_size / (len(path) - 1)
        steps += [(one, other, length) for one, other in pairwise(path)]
    metres = {node: [round(x, 6) for x in (at.real * tile_size, at.imag * tile_size)] for node, at in points.items()}
    features = [_feature({"id": node, "frame": "map"}, "Point", point) for node, point in sorted(metres.items())]
    first = max(metres) + 1
    features += [
        _feature(
            {"id": index, "startid": start, "endid": end, "cost": round(length, 6), "overridable": True},
            "MultiLineString",
            [[metres[start], metres[end]]],
        )
        for index, (start, end, length) in enumerate(steps, first)
    ]
    return '{"type": "FeatureCollection", "name": "lanes", "features": [\n' + ",\n".join(features) + "\n]}\n"


def _feature(properties: dict[str, object], kind: str, coordinates: list[object]) -> str:
    geometry = {"type": kind, "coordinates": coordinates}
    return json.dumps({"type": "Feature", "properties": properties, "geometry": geometry})
