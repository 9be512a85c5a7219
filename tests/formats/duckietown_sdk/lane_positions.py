"""Reads folders of layers by duckietown-sdk, in an environment of its own, and looks for the lanes of poses.

python lane_positions.py FILE: a JSON list of questions, each with ``folder``, ``poses``, which are lists of x, y, z and
yaw, and ``shift``, which is added to the positions of tiles. Prints a line of JSON for each: the size of a tile;
``tiles``, the kind, the yaw and whether there is a lane, by column and row; and ``lanes``, the distance from a lane and
the angle to it, or null, for each pose.
"""

import json
import sys
from pathlib import Path

import numpy as np
import yaml
from duckietown.sdk.utils.lane_position import LanePositionCalculator, MapInterpreter, NotInLane


def read_layers(folder, shift):
    """Returns the layers as the Duckiematrix sends them to the interpreter."""
    layers = {}
    for key, name in (("frames", "frames"), ("tiles", "tiles"), ("tile_info", "tile_maps")):
        layers[key] = {"data": yaml.safe_load((folder / f"{name}.yaml").read_text())[name]}
    for name in layers["tiles"]["data"]:
        pose = layers["frames"]["data"][name]["pose"]
        pose["x"], pose["y"] = pose["x"] + shift, pose["y"] + shift
    return layers


def find_lane(calculator, pose):
    try:
        position = calculator.get_lane_pos2(np.array(pose[:3]), pose[3])
    except NotInLane:
        return None
    return float(position.dist), float(position.angle_rad)


def answer(question):
    interpreter = MapInterpreter(read_layers(Path(question["folder"]), question["shift"]))
    calculator = LanePositionCalculator(interpreter)
    tiles = [[*cell, tile["kind"], tile["angle"], tile["drivable"]] for cell, tile in interpreter.grid.items()]
    lanes = [find_lane(calculator, pose) for pose in question["poses"]]
    return {"size": interpreter.road_tile_size, "tiles": tiles, "lanes": lanes}


if __name__ == "__main__":
    for question in json.loads(Path(sys.argv[1]).read_text()):
        print(json.dumps(answer(question)))
