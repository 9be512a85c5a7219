"""Prints the centre lines of duckietown-world's lanes: for each turn 101 points `[x, y]`, in tiles.

The lane enters in the middle of the tile's west side, at x = -0.5, and y points to the left.
"""

import json
import logging

logging.disable(logging.CRITICAL)

from duckietown_world.world_duckietown.tile_template import load_tile_types  # noqa: E402

crossing = load_tile_types()["4way"].children["a"].children
lines = {}
for turn in ("go_right", "go_straight", "go_left"):
    lane = crossing[turn]
    last = len(lane.control_points) - 1
    points = (lane.center_point(number / 100 * last) for number in range(101))
    lines[turn] = [[float(point[0, 2]), float(point[1, 2])] for point in points]
print(json.dumps(lines))
