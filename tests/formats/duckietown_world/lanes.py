"""Loads Duckietown maps by duckietown-world, in an environment of its own, and prints the graphs of their lanes.

python lanes.py MAP.yaml ...: a line of JSON for each file, `{"nodes": N, "lanes": [[start, end], ...]}`. A start or end
is `[row, column, row, column]`, the tile that is left there and the one that is entered; both are read off the lane's
point and heading, so that nothing is taken from our side. Of a map with roads that lead nowhere no graph is made: then
the line is `{"incomplete": MESSAGE}`.
"""

import json
import logging
import sys
from pathlib import Path

import numpy as np
import yaml

logging.disable(logging.CRITICAL)

from duckietown_world.world_duckietown.map_loading import construct_map  # noqa: E402
from duckietown_world.world_duckietown.segmentify import get_skeleton_graph  # noqa: E402


def border(point, tile_size, height):
    place = np.asarray(point.p) / tile_size
    heading = np.array([np.cos(point.theta), np.sin(point.theta)])
    tiles = [np.floor(place - heading / 4), np.floor(place + heading / 4)]
    return [int(number) for x, y in tiles for number in (height - 1 - y, x)]  # its rows count from the south


for name in sys.argv[1:]:
    values = yaml.safe_load(Path(name).read_text(encoding="utf-8"))
    try:
        graph = get_skeleton_graph(construct_map(values)).G
    except Exception as error:
        if "Completeness assumption" not in str(error):
            raise
        print(json.dumps({"incomplete": str(error)}))
        continue
    height, tile_size = len(values["tiles"]), values["tile_size"]
    borders = {node: border(point, tile_size, height) for node, point in graph.nodes(data="point")}
    lanes = [[borders[start], borders[end]] for start, end in graph.edges()]
    print(json.dumps({"nodes": graph.number_of_nodes(), "lanes": lanes}))
