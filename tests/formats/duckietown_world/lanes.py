"""Loads Duckietown maps by duckietown-world, in an environment of its own, and prints the graphs of their lanes.

python lanes.py MAP.yaml ...: a line of JSON for each file, `{"nodes": N, "lanes": [[start, end], ...], "on_tiles":
[[start, end], ...]}`: the lanes of the skeleton graph, and those that they are made of, each on one tile. A start or
end is `[row, column, row, column]`, the tile that is left there and the one that is entered; both are read off the
lane's point and heading, so that nothing is taken from our side. Of a map with roads that lead nowhere no graph is
made: then the line is `{"incomplete": MESSAGE}`.
"""

import json
import logging
import sys
from functools import cache
from pathlib import Path

import numpy as np
import yaml

logging.disable(logging.CRITICAL)

from duckietown_world.world_duckietown import tile  # noqa: E402
from duckietown_world.world_duckietown.map_loading import construct_map  # noqa: E402
from duckietown_world.world_duckietown.segmentify import get_skeleton_graph  # noqa: E402

# It looks for five textures of each tile among all of its files, and takes most of its time for that.
tile.get_if_exists = cache(tile.get_if_exists)


def border(point, tile_size, height):
    place = np.asarray(point.p) / tile_size
    heading = np.array([np.cos(point.theta), np.sin(point.theta)])
    tiles = [np.floor(place - heading / 4), np.floor(place + heading / 4)]
    return [int(number) for x, y in tiles for number in (height - 1 - y, x)]  # its rows count from the south


def between_borders(graph, points, tile_size, height):
    borders = {node: border(point, tile_size, height) for node, point in points.items()}
    return [[borders[start], borders[end]] for start, end in graph.edges()]


for name in sys.argv[1:]:
    values = yaml.safe_load(Path(name).read_text(encoding="utf-8"))
    try:
        skeleton = get_skeleton_graph(construct_map(values))
    except Exception as error:
        if "Completeness assumption" not in str(error):
            raise
        print(json.dumps({"incomplete": str(error)}))
        continue
    graph, on_tiles, size = skeleton.G, skeleton.G0, (values["tile_size"], len(values["tiles"]))
    points = {node: meeting.point for node, meeting in on_tiles.nodes(data="meeting_point")}
    found = {
        "nodes": graph.number_of_nodes(),
        "lanes": between_borders(graph, dict(graph.nodes(data="point")), *size),
        "on_tiles": between_borders(on_tiles, points, *size),
    }
    print(json.dumps(found))
