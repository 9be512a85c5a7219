"""Rides to look at: the way of a robot across a map, as a film of its camera beside the map, or as trails on one."""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Pytree, UserValue
from elitelanes_jax.drive.camera import Camera, look, make_atlas
from elitelanes_jax.drive.lane_drive import LaneDrive, LaneDriveParams
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.drive.levels import Level, make_levels
from elitelanes_jax.drive.pure_pursuit import pure_pursuit
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.formats.rides import RIDES
from elitelanes_jax.tiles.render import check_tile_px, choose_tiles, render, scale_tiles
from elitelanes_jax.tiles.tileset import TileSet

__all__ = ["POLICIES", "Rides", "film", "make_rides", "rides_to_json", "trails", "write_film"]

POLICIES = ("route", "random")
"""Drivers: one that follows the route to the goal, and one whose wheels turn at random."""

_RATE = 30
_COLOURS = ((255, 90, 60), (60, 170, 255), (255, 210, 40), (170, 90, 255), (40, 220, 150), (255, 120, 200))
_BATCH = 32  # frames that are rendered at once


class Rides(NamedTuple):
    """Rides on one map.

    Attributes:
      levels: a batch of N.
      x: float32 ``[N, steps + 1]``, tiles east; it stands still after the end of a ride.
      y: float32 ``[N, steps + 1]``, tiles south.
      theta: float32 ``[N, steps + 1]``, radians counter-clockwise from east.
      steps: int ``[N]``, thirtieths of a second until the end.
      success: bool ``[N]``, the goal was reached.
    """

    levels: Level
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    theta: NDArray[np.float32]
    steps: NDArray[np.int32]
    success: NDArray[np.bool_]


def make_rides(grid: ArrayLike, count: int = 1, *, policy: str = "route", seconds: float = 60, seed: int = 0) -> Rides:
    """Drives on a map, from starts and to goals drawn at random.

    Args:
      grid: codes ``[H, W]``.
      count: N, how many rides.
      policy: one of `POLICIES`.
      seconds: after which a ride ends.
      seed: of starts, goals and all that is random.

    Raises:
      InputError: for a bad grid, one without a lane, or another policy.
    """
    if policy not in POLICIES:
        raise InputError(f"policy: expected one of {', '.join(POLICIES)}, got {policy!r}")
    drawing, driving = jax.random.split(jax.random.key(seed))
    levels = make_levels(drawing, np.asarray(grid)[None], count, least=4)
    steps = max(round(seconds * _RATE), 1)
    poses, lengths, success = jax.device_get(_drive(driving, LaneDriveParams(levels), policy, steps))
    return Rides(jax.device_get(levels), poses[:, 0], poses[:, 1], poses[:, 2], lengths, success)


@partial(jax.jit, static_argnames=("policy", "steps"))
@partial(jax.vmap, in_axes=(0, 0, None, None, None))
def _drive_one(key: Pytree, level: Level, params: LaneDriveParams, policy: str, steps: int) -> Pytree:
    _, state = LaneDrive.reset_to_level(jax.random.fold_in(key, 0), level, params)
    poses = jnp.broadcast_to(jnp.stack(state.pose)[:, None], (3, steps + 1))

    def go(number: Pytree, carry: Pytree) -> Pytree:
        state, poses, over, length, success = carry
        moving = jax.random.fold_in(key, number)
        action = pure_pursuit(state, params)
        if policy == "random":
            action = jax.random.uniform(jax.random.fold_in(moving, 0), (2,))
        done = LaneDrive.step(moving, state, action, params)
        state = jax.tree.map(lambda new, old: jnp.where(over, old, new), done.state, state)
        success, length = success | (done.info.success & ~over), length + ~over
        return state, poses.at[:, number].set(jnp.stack(state.pose)), over | done.terminated, length, success

    first = state, poses, jnp.bool_(False), jnp.int32(0), jnp.bool_(False)
    _, poses, _, length, success = jax.lax.fori_loop(1, steps + 1, go, first)
    return poses, length, success


def _drive(key: Pytree, params: LaneDriveParams, policy: str, steps: int) -> Pytree:
    keys = jax.random.split(key, params.levels.grid.shape[0])
    return _drive_one(keys, params.levels, params, policy, steps)


def trails(
    grid: ArrayLike, tiles: TileSet, rides: Rides, *, tile_px: int = 64, chosen: UserValue = None
) -> NDArray[np.uint8]:
    """Draws the trails of rides on the map, RGB uint8 ``[H·P, W·P, 3]``: a dot at the start, a ring at the goal.

    Raises:
      InputError: for a map that the tiles cannot draw (see `render`).
    """
    picture = render(grid, tiles, tile_px=tile_px, chosen=chosen).image.copy()
    for number in range(len(rides.steps)):
        _draw_trail(picture, rides, number, rides.steps[number], tile_px)
    return picture


def film(
    grid: ArrayLike, tiles: TileSet, rides: Rides, number: int = 0, *, tile_px: int = 64, chosen: UserValue = None
) -> Iterator[NDArray[np.uint8]]:
    """Draws a ride frame by frame, 30 a second: the camera's picture, and beside it the map with the robot.

    Yields:
      RGB uint8 ``[480, width, 3]``, all of one width.

    Raises:
      InputError: for a map that the tiles cannot draw (see `render`).
    """
    grid, size = np.asarray(grid), check_tile_px(tile_px)
    chosen = choose_tiles(grid, tiles) if chosen is None else chosen
    scaled = scale_tiles(tiles, size)
    atlas = make_atlas(scaled["image"], scaled["labels"])
    place = jnp.asarray(chosen[..., 0] * 4 + chosen[..., 1], jnp.int32)
    camera = Camera(rows=480, columns=640)
    background = render(grid, tiles, tile_px=size, chosen=chosen).image
    width = round(480 * grid.shape[1] / grid.shape[0]) // 2 * 2  # films have even sides
    last = int(rides.steps[number])
    for start in range(0, last + 1, _BATCH):
        steps = np.minimum(np.arange(start, start + _BATCH), last)
        poses = Pose(*(part[number][steps] for part in (rides.x, rides.y, rides.theta)))
        views = np.asarray(_look(poses, place, atlas, camera))
        for step, view in zip(range(start, last + 1), views, strict=False):
            plan = background.copy()
            _draw_trail(plan, rides, number, step, size)
            _draw_robot(plan, rides.x[number, step], rides.y[number, step], rides.theta[number, step], size)
            shrunk = cv2.resize(plan, (width, 480), interpolation=cv2.INTER_AREA)
            yield np.concatenate([view, shrunk], axis=1)


@jax.jit
def _look(poses: Pose, place: Pytree, atlas: Pytree, camera: Camera) -> Pytree:
    return jax.vmap(lambda pose: look(jax.random.key(0), pose, place, atlas, camera).image)(poses)


def write_film(file: Path, frames: Iterator[NDArray[np.uint8]]) -> int:
    """Writes frames as an MP4 film, whole or not at all; returns how many there were.

    Raises:
      OSError: that names the file, if it cannot be written.
    """
    aside = file.with_name(f".{file.stem}.part.mp4")
    count, writer = 0, None
    try:
        for frame in frames:
            if writer is None:
                writer = cv2.VideoWriter(str(aside), cv2.VideoWriter.fourcc(*"mp4v"), _RATE, frame.shape[1::-1])
                if not writer.isOpened():
                    raise OSError(0, "cannot be written as a film", str(file))
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
            count += 1
        if writer is not None:
            writer.release()
        aside.replace(file)
    finally:
        aside.unlink(missing_ok=True)
    return count


def rides_to_json(grid: ArrayLike, rides: Rides) -> str:
    """Writes rides as `read_rides` reads them: the map, and of each ride its poses, 30 a second, to its end."""
    listed = []
    for number, steps in enumerate(rides.steps.tolist()):
        poses = {name: getattr(rides, name)[number, : steps + 1] for name in ("x", "y", "theta")}
        goal = [int(part[number]) for part in (rides.levels.goal.row, rides.levels.goal.column)]
        ride = {"goal": goal, "success": bool(rides.success[number])}
        listed.append(ride | {name: np.round(values.astype(float), 4).tolist() for name, values in poses.items()})
    return json.dumps({"format": RIDES, "rate": _RATE, "codes": np.asarray(grid).tolist(), "rides": listed}) + "\n"


def _draw_trail(picture: NDArray[np.uint8], rides: Rides, number: int, steps: int, size: int) -> None:
    colour = _COLOURS[number % len(_COLOURS)]
    points = np.stack([rides.x[number], rides.y[number]], axis=1)[: int(steps) + 1]
    thick = max(size // 20, 1)
    dots = np.rint(points * size * 16).astype(np.int32)
    cv2.polylines(picture, [dots.reshape(-1, 1, 2)], False, colour, thick, cv2.LINE_AA, 4)
    start = tuple(int(part) for part in dots[0])
    cv2.circle(picture, start, size * 16 // 12, colour, -1, cv2.LINE_AA, 4)
    goal = rides.levels.goal
    middle = [(int(part[number]) * 2 + 1) * size * 8 for part in (goal.column, goal.row)]
    cv2.circle(picture, (middle[0], middle[1]), size * 16 // 4, colour, thick, cv2.LINE_AA, 4)


def _draw_robot(picture: NDArray[np.uint8], x: float, y: float, theta: float, size: int) -> None:
    length, half = 0.18 / TILE, 0.075 / TILE
    ahead, left = np.array([np.cos(theta), -np.sin(theta)]), np.array([-np.sin(theta), -np.cos(theta)])
    middle = np.array([x, y])
    corners = [middle + a * ahead + b * left for a, b in ((-length / 2, half), (-length / 2, -half), (length / 2, 0))]
    shape = np.rint(np.array(corners) * size * 16).astype(np.int32).reshape(-1, 1, 2)
    cv2.fillPoly(picture, [shape], (255, 255, 255), cv2.LINE_AA, 4)
    cv2.polylines(picture, [shape], True, (20, 20, 20), max(size // 40, 1), cv2.LINE_AA, 4)
