"""Loads folders of layers by dt-maps, in an environment of its own.

python layers.py FOLDER ...: prints a line of JSON for each folder: the numbers of objects in each layer, and ``loose``,
the ends of lanes at which no lane of another tile begins or ends. Ends beside 4-way tiles do not count, because the
library has no lanes for these tiles.
"""

import json
import math
import sys

from dt_maps import Map
from dt_maps.graph.tiles import get_tile_graph


def look(folder):
    """Returns the figures of one folder."""
    layers = Map.from_disk("map", folder).layers
    (tile_map,) = layers.tile_maps.values()
    size, ends, crossings = tile_map.tile_size.x, {}, []
    for tile in layers.tiles.values():
        pose = tile.frame.pose
        if tile["type"].value == "4way":
            crossings.append(pose)
            continue
        for _, node in get_tile_graph(tile, tile_map).nodes.data():
            x, y, _ = node["position"]
            c, s = math.cos(pose.yaw), math.sin(pose.yaw)
            place = (round(100 * (x * c - y * s + pose.x) + 0.37), round(100 * (x * s + y * c + pose.y) + 0.37))
            ends.setdefault(place, set()).add(tile.key)
    loose = [
        (x, y)
        for (x, y), tiles in ends.items()
        if len(tiles) == 1
        and not any(max(abs(x / 100 - pose.x), abs(y / 100 - pose.y)) < 0.52 * size for pose in crossings)
    ]
    signs = [(sign.type.value, sign.id, sign.frame.pose.x) for sign in layers.traffic_signs.values()]
    duckies = [(duckie.color.value, duckie.frame.pose.x) for duckie in layers.citizens.values()]
    robots = [(robot.configuration.value, robot.frame.pose.x) for robot in layers.vehicles.values()]
    return {"signs": len(signs), "duckies": len(duckies), "robots": len(robots), "loose": len(loose)}


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        print(json.dumps(look(folder)))
