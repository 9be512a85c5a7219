"""gym-duckietown as a program that answers requests, in an environment of its own and without a display.

    python bridge.py ROWS COLUMNS

Requests come on standard input, answers go to standard output, both as `send` writes them. A request has a `do`: the
name of a method of `World`, and its arguments. An answer has the method's results, or `error`, one line. Poses are
ours: tiles east and south of the map's north-west corner, and radians counter-clockwise from east.
"""

import contextlib
import io
import logging
import math
import os
import struct
import sys
import tempfile
from types import SimpleNamespace
from typing import IO, Any

import numpy as np

__all__ = ["receive", "send"]

Arrays = dict[str, Any]

_MARK = "<q"  # the length of a message, in bytes, in front of it
_PLAIN = (1.0, 0.0, 1.0)  # beyond the tiles in pictures of labels


def send(stream: IO[bytes], **values: object) -> None:
    """Writes a message: arrays, numbers and texts by name."""
    content, arrays = io.BytesIO(), {name: np.asarray(value) for name, value in values.items()}
    np.savez(content, **arrays)  # type: ignore[arg-type, unused-ignore]
    stream.write(struct.pack(_MARK, content.tell()) + content.getvalue())
    stream.flush()


def receive(stream: IO[bytes]) -> Arrays | None:
    """Reads a message; None at the end of the stream. Numbers and texts are plain values."""
    head = stream.read(struct.calcsize(_MARK))
    if not head:
        return None
    with np.load(io.BytesIO(stream.read(*struct.unpack(_MARK, head)))) as content:
        return {name: content[name] if content[name].ndim else content[name].item() for name in content.files}


class World:
    """One map of gym-duckietown, and one robot on it. Each method answers a request."""

    def __init__(self, rows: int, columns: int) -> None:
        logging.disable(logging.CRITICAL)
        import pyglet

        pyglet.options["headless"] = True
        from gym_duckietown import simulator

        self._simulator = simulator
        self._env = simulator.Simulator(
            "loop_empty", domain_rand=False, camera_width=columns, camera_height=rows, seed=1, max_steps=10**9
        )

    def load(self, text: str, style: str = "photos", domain_rand: bool = False, **pictures: Any) -> Arrays:
        """Loads a map from the text of its file. `style` is photos, synthetic, or labels.

        `pictures` are shown on tiles instead of those of the style, by gym-duckietown's kind of tile.
        """
        import yaml

        env = self._env
        values = yaml.safe_load(text)
        if not isinstance(values, dict) or not values.get("tiles"):
            raise ValueError("expected a map of Duckietown with tiles")
        env._interpret_map(values)
        if not env.drivable_tiles:
            raise ValueError("expected drivable tiles, got none")
        env.style = "segmentation" if style == "labels" else style
        env.domain_rand, env.start_pose, env.distortion = domain_rand, [[0.1, 0, 0.1], 0], False
        env.seed(0)
        env.reset()
        if style == "labels":
            self._light_all()
        self._show(pictures)
        drivable = np.array([bool(tile and tile["drivable"]) for tile in env.grid])
        kinds = [thing.kind for thing in env.objects] or np.zeros(0, "U1")
        drivable = drivable.reshape(env.grid_height, env.grid_width)
        return {"tile_size": env.road_tile_size, "drivable": drivable, "objects": kinds}

    def _show(self, pictures: Any) -> None:
        """Replaces the pictures of tiles."""
        from gym_duckietown import graphics
        from PIL import Image

        with tempfile.TemporaryDirectory() as folder:
            for kind, picture in pictures.items():
                # load_texture keeps each file's texture for good, and the name of this folder is new.
                file = f"{folder}/{kind}.png"
                Image.fromarray(picture).convert("RGBA").save(file)
                texture = graphics.Texture(graphics.load_texture(file), tex_name=kind, rng=None)
                for tile in self._env.grid:
                    if tile["kind"] == kind:
                        tile["texture"] = texture

    def _light_all(self) -> None:
        """Shows the tiles' colours as they are, without light, objects, and triangles on the ground."""
        from pyglet import gl

        env = self._env
        gl.glLightfv(gl.GL_LIGHT0, gl.GL_AMBIENT, (gl.GLfloat * 4)(1, 1, 1, 1))
        env.horizon_color = env.ground_color = _PLAIN
        env.tri_vlist = SimpleNamespace(draw=lambda mode: None)
        for thing in env.objects:
            thing.visible = False

    def look(self, poses: Any) -> Arrays:
        """Returns the pictures at poses ``[N, 3]``, and the lane pose there (NaN off the lanes)."""
        return {"image": np.stack([self._picture(pose) for pose in poses]), "lane": self._lanes(poses)}

    def instances(self, poses: Any) -> Arrays:
        """Returns the pictures at poses, and for each pixel 0 or the index plus 1 of the object that is seen.

        An object is seen in the pixels that change when it is not drawn, and where several change a pixel, the object
        that is nearest to the camera.
        """
        env, images, found = self._env, [], []
        for pose in poses:
            image = self._picture(pose)
            seen = np.zeros(image.shape[:2], np.uint16)
            apart = [np.linalg.norm(np.array(thing.pos) - env.cur_pos) for thing in env.objects]
            for index in np.argsort(apart)[::-1]:
                thing = env.objects[index]
                shown, thing.visible = thing.visible, False
                seen[(env.render_obs() != image).any(axis=-1)] = index + 1
                thing.visible = shown
            images.append(image)
            found.append(seen)
        return {"image": np.stack(images), "instances": np.stack(found)}

    def start(self, pose: Any) -> Arrays:
        """Puts the robot at a pose, at rest, and returns what it sees."""
        env = self._env
        self._put(pose)
        resting = self._simulator.geometry.se2_from_linear_angular([0, 0], 0)
        place = env.cartesian_from_weird(env.cur_pos, env.cur_angle)
        make = self._simulator.get_DB18_nominal(delay=0.15)
        env.state = make.initialize(c0=(place, resting), t0=0)
        return self._seen()

    def step(self, action: Any, frames: int = 1) -> Arrays:
        """Turns the wheels for a number of thirtieths of a second; the last one is seen."""
        env = self._env
        for _ in range(frames):
            env.update_physics(np.clip(action, -1, 1))
        return self._seen()

    def _seen(self) -> Arrays:
        """Returns the picture, the pose, the lane pose, and whether the robot is on the road and has hit something."""
        env, side = self._env, self._env.road_tile_size
        pose = np.array([env.cur_pos[0] / side, env.cur_pos[2] / side, env.cur_angle])
        hit = bool(env._collision(self._simulator.get_agent_corners(env.cur_pos, env.cur_angle)))
        values = {"pose": pose, "lane": self._lanes([pose])[0], "on_road": bool(env._drivable_pos(env.cur_pos))}
        return {"image": env.render_obs(), "hit": hit, **values}

    def _put(self, pose: Any) -> None:
        side = self._env.road_tile_size
        self._env.cur_pos = np.array([pose[0] * side, 0.0, pose[1] * side])
        self._env.cur_angle = float(pose[2])

    def _picture(self, pose: Any) -> Any:
        self._put(pose)
        return self._env.render_obs()

    def _lanes(self, poses: Any) -> Any:
        """Returns metres and radians to the left of the lane, ``[N, 2]``; gym-duckietown counts to the right."""
        side, found = self._env.road_tile_size, []
        for x, y, theta in poses:
            try:
                there = self._env.get_lane_pos2(np.array([x * side, 0.0, y * side]), theta)
                found.append((-there.dist, -there.angle_rad))
            except self._simulator.NotInLane:
                found.append((math.nan, math.nan))
        return np.array(found)


def main(rows: int, columns: int) -> None:
    """Answers requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the simulator prints lines
    with contextlib.redirect_stdout(io.StringIO()):
        world = World(rows, columns)
        while (request := receive(sys.stdin.buffer)) is not None:
            try:
                values = getattr(world, request.pop("do"))(**request)
            except Exception as error:
                reason = error.__cause__ or error.__context__ or error
                values = {"error": " ".join(f"{type(reason).__name__}: {reason}".split())[:300]}
            send(answers, **values)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
