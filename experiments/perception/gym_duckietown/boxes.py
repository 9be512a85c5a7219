"""Draws pictures of furnished maps in gym-duckietown, with the boxes of their objects, without a display.

    python boxes.py OUT COUNT ROWS COLUMNS SEED MAP ...

Runs in an environment of its own: make gym-duckietown. Each MAP is the name of one of gym-duckietown's maps, or a
Duckietown file. OUT gets a folder for each map with COUNT pictures, in the layout of `elitelanes dataset --format
coco`: `images/test`, and `annotations/objects_test.json`. Complete folders stay as they are. Robots are in lanes, up to
0.1 tile beside the middle and 30 degrees turned. The camera has 640 x 480 pixels. Pictures are averages of these
pixels. A box is around the pixels that change when its object is not drawn.
"""

import contextlib
import io
import json
import logging
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import yaml

logging.disable(logging.CRITICAL)

import pyglet  # noqa: E402

pyglet.options["headless"] = True
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    from gym_duckietown.simulator import Simulator

HEIGHT, WIDTH = 480, 640
_LIST = Path("annotations") / "objects_test.json"
_ASIDE, _TURNED = 0.1, math.radians(30)


def draw_pose(env: Simulator, random: np.random.Generator) -> tuple[np.ndarray, float]:
    """Returns a position near the middle of a lane, and an angle."""
    while True:
        i, j = env.drivable_tiles[random.integers(len(env.drivable_tiles))]["coords"]
        position = (np.array([i, 0, j]) + random.random(3) * [1, 0, 1]) * env.road_tile_size
        point, tangent = env.closest_curve_point(position, random.uniform(-math.pi, math.pi))
        if point is not None:
            left = np.array([tangent[2], 0, -tangent[0]])
            aside = random.uniform(-_ASIDE, _ASIDE) * env.road_tile_size
            return point + aside * left, math.atan2(-tangent[2], tangent[0]) + random.uniform(-_TURNED, _TURNED)


def seen_objects(env: Simulator, image: np.ndarray) -> Iterator[tuple[str, list[int]]]:
    """Yields the kind and the box, x, y, width and height, of each object in a picture."""
    ahead = np.array([math.cos(env.cur_angle), 0, -math.sin(env.cur_angle)])
    for thing in env.objects:
        if (np.array(thing.pos) - env.cur_pos) @ ahead < -1:  # no object reaches a metre
            continue
        thing.visible = False
        changed = (env.render_obs() != image).any(axis=-1)
        thing.visible = True
        if changed.any():
            yield str(thing.kind), [int(part) for part in cv2.boundingRect(changed.astype(np.uint8))]


def draw_map(env: Simulator, folder: Path, count: int, rows: int, columns: int, random: np.random.Generator) -> None:
    """Writes the pictures of one map and the file of their boxes."""
    (folder / "images" / "test").mkdir(parents=True, exist_ok=True)
    images, boxes, kinds = list[dict](), list[dict](), list[str]()
    for number in range(count):
        env.cur_pos, env.cur_angle = draw_pose(env, random)
        picture, file = env.render_obs(), f"{number:06d}.png"
        small = cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / "images" / "test" / file), small[..., ::-1])
        images.append({"id": number, "file_name": file, "height": rows, "width": columns})
        for kind, (x, y, wide, high) in seen_objects(env, picture):
            if kind not in kinds:
                kinds.append(kind)
            box = [x * columns / WIDTH, y * rows / HEIGHT, wide * columns / WIDTH, high * rows / HEIGHT]
            one = {"id": len(boxes) + 1, "image_id": number, "category_id": kinds.index(kind) + 1, "iscrowd": 0}
            boxes.append(one | {"bbox": box, "area": box[2] * box[3]})
    categories = [{"id": index, "name": kind} for index, kind in enumerate(kinds, 1)]
    (folder / "annotations").mkdir(exist_ok=True)
    (folder / _LIST).write_text(json.dumps({"images": images, "annotations": boxes, "categories": categories}) + "\n")


def main(out: Path, count: int, rows: int, columns: int, seed: int, names: list[str]) -> None:
    """Draws all maps."""
    env = Simulator(map_name="loop_empty", domain_rand=False, camera_width=WIDTH, camera_height=HEIGHT, seed=seed)
    for index, name in enumerate(names):
        folder = out / Path(name).stem
        if (folder / _LIST).exists():
            continue
        if name.endswith(".yaml"):
            env._interpret_map(yaml.safe_load(Path(name).read_text(encoding="utf-8")))
        else:
            env._load_map(name)
        env.reset()
        draw_map(env, folder, count, rows, columns, np.random.default_rng([seed, index]))
        print(f"{folder.name}: {count} pictures, {index + 1} of {len(names)} maps", flush=True)


if __name__ == "__main__":
    count, rows, columns, seed = map(int, sys.argv[2:6])
    main(Path(sys.argv[1]), count, rows, columns, seed, sys.argv[6:])
