"""Loads Duckietown maps in gym-duckietown, in an environment of its own, without a display.

python look.py LINES MAP.yaml ...: prints a line of JSON for each map:

- ``pose_error``: the largest distance of an object's pose from the file's, in metres or radians.
- ``poses``, ``collisions``: robots in the middle of lanes, and those that gym-duckietown finds in collision with a
  static object.
- ``lines``, ``both``: stop lines, and those from which both signs are seen: each changes at least 30 of 640 x 480
  pixels when it is removed. The robot is in its lane, 0.3 to 0.6 tile before the line. At most LINES lines of each map.
"""

import contextlib
import io
import json
import logging
import math
import sys
from pathlib import Path

import numpy as np
import yaml

logging.disable(logging.CRITICAL)

import pyglet  # noqa: E402

pyglet.options["headless"] = True
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    from gym_duckietown.simulator import Simulator, get_agent_corners

_LEAST_PIXELS, _POSES = 30, 50


def poses_in_lanes(env, random):
    """Yields poses in the middle of lanes: a position and an angle."""
    for _ in range(_POSES):
        i, j = env.drivable_tiles[random.integers(len(env.drivable_tiles))]["coords"]
        position = (np.array([i, 0, j]) + random.random(3) * [1, 0, 1]) * env.road_tile_size
        point, tangent = env.closest_curve_point(position, random.uniform(-math.pi, math.pi))
        yield point, math.atan2(-tangent[2], tangent[0])


def sign_pairs(env):
    """Yields the two signs of each stop line, and the directions ahead and to the left of its driver."""
    signs = [thing for thing in env.objects if thing.kind.startswith("sign_")]
    for topology in (thing for thing in signs if thing.kind.endswith("_intersect")):
        back = np.array([math.cos(topology.angle), 0, -math.sin(topology.angle)])
        left = np.array([-back[2], 0, back[0]])  # of the driver, whose heading is the opposite of `back`
        for control in signs:
            apart = (control.pos - np.array(topology.pos)) / env.road_tile_size
            is_control = control.kind in ("sign_stop", "sign_t_light_ahead")
            faces = abs(control.angle - topology.angle) < 0.01
            if is_control and faces and abs(apart @ back) < 0.01 and 1 < apart @ left < 1.5:
                yield topology, control, -back, left


def changed(image, env, thing):
    """Returns the number of pixels that change when an object is not drawn."""
    thing.visible = False
    without = env.render_obs()
    thing.visible = True
    return int((image != without).any(axis=-1).sum())


def look(env, values, most, random):
    """Returns the figures of one map."""
    env._interpret_map(values)
    env.reset()
    height, error = env.grid_height * env.road_tile_size, 0.0
    for thing, found in zip((values.get("objects") or {}).values(), env.objects, strict=True):
        pose = thing["pose"]["~SE2Transform"]
        turned = math.remainder(found.angle - math.radians(pose["theta_deg"]), 2 * math.pi)
        error = max(error, abs(found.pos[0] - pose["p"][0]), abs(height - found.pos[2] - pose["p"][1]), abs(turned))
    hits = [bool(env._collision(get_agent_corners(*pose))) for pose in poses_in_lanes(env, random)]
    pairs = list(sign_pairs(env))
    seen = []
    for index in random.permutation(len(pairs))[:most]:
        topology, control, ahead, left = pairs[index]
        side = env.road_tile_size
        middle = np.array(topology.pos) + (0.58 * left - 0.58 * ahead) * side
        env.cur_pos = middle - ((0.5 + random.uniform(0.3, 0.6)) * ahead + 0.2 * left) * side
        env.cur_angle = math.atan2(-ahead[2], ahead[0])
        image = env.render_obs()
        seen.append(min(changed(image, env, topology), changed(image, env, control)) >= _LEAST_PIXELS)
    figures = {"pose_error": error, "poses": len(hits), "collisions": sum(hits)}
    return figures | {"stop_lines": len(pairs), "lines": len(seen), "both": sum(seen)}


def main(most, files):
    """Prints the figures of each map."""
    random = np.random.default_rng(0)
    env = Simulator(map_name="loop_empty", domain_rand=False, camera_width=640, camera_height=480, seed=1)
    for file in files:
        values = yaml.safe_load(Path(file).read_text(encoding="utf-8"))
        print(json.dumps({"file": file} | look(env, values, most, random)), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
