"""Rides as films, the camera next to the map, or as trails on the map."""

import errno
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from operator import itemgetter
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, whole
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import new_file
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.drive._camera import Camera, Sight, look, pack_sight
from elitelanes_jax.drive._levels import Level
from elitelanes_jax.drive._objects import Objects, make_objects
from elitelanes_jax.drive.lanes import Pose, lane_point
from elitelanes_jax.drive.rides import RATE, Rides
from elitelanes_jax.drive.robot import TILE, Robot
from elitelanes_jax.formats.road_map import RoadMap, as_map
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.tiles.object_set import load_objects
from elitelanes_jax.tiles.rendering import Picture, check_tile_px, choose_tiles, render
from elitelanes_jax.tiles.tileset import TileSet

# A GIF shows every third frame, half as large. Otherwise it is ten times a film's size.
_GIF_STEP, _GIF_SCALE = 3, 0.5

# Red, green and blue of trails. More trails repeat them.
_COLOURS = (
    (255, 90, 60),
    (60, 170, 255),
    (255, 210, 40),
    (170, 90, 255),
    (40, 220, 150),
    (255, 120, 200),
)

# The number of bytes to write after a failure. On a full disk they raise an error that says why.
_ROOM = 2**20

# The frames that are rendered at once.
_BATCH = 32

# The height of a film and the largest width of the map in it, in pixels.
_HEIGHT, _WIDEST = 480, 1280

# The width of the camera's picture in a film, in pixels.
_VIEW_WIDTH = 640

# The most objects in a view.
_MOST_SEEN = 32

# The bits of the fraction of a pixel.
_BITS = 4

# Measures of trails and robots as shares of a tile's side, because maps differ in size.
_LINE = 1 / 20

_START_RADIUS = 1 / 12

_GOAL_RADIUS = 0.18

_OUTLINE = 1 / 40

_ROBOT_LENGTH = 0.18 / TILE

_ROBOT_WIDTH = Robot.width / TILE

# Red, green and blue of the robot.
_ROBOT_FILL, _ROBOT_EDGE = (255, 255, 255), (20, 20, 20)


@name_wrong_arguments
@runs_jax
def trails(
    source: UserValue, tiles: TileSet, rides: Rides, *, tile_px: int = 64, chosen: UserValue = None
) -> NDArray[np.uint8]:
    """Draws the trails of rides on the map, RGB uint8 ``[H·P, W·P, 3]``.

    A trail has a dot at the start and a ring at the goal. The ring is where the goal's lane enters
    the tile. A robot that enters on another lane has not reached the goal.

    Raises:
      InputError: for a map that the tiles cannot draw (see `render`), or rides on another map.
    """
    check_named("tiles", instance(TileSet), tiles)
    check_named("rides", instance(Rides), rides)
    road_map = _map_of(rides, source)
    picture = render(road_map, tiles, tile_px=tile_px, chosen=chosen).image.copy()
    goals = _goals(rides.levels, tiles.lane_offset)
    for index in range(len(rides.steps)):
        _draw_trail(picture, rides, index, rides.steps[index], goals[index], tile_px)
    return picture


def _map_of(rides: Rides, source: UserValue) -> RoadMap:
    """Returns the map of rides; raises `InputError` if the rides are on another one."""
    road_map = check_named("source", as_map, source)
    # Levels have links alone, so the map is compared without other connections.
    driven_codes = np.asarray(rides.levels.grid)
    map_codes = linked_codes(road_map.codes)
    if driven_codes.shape[1:] != map_codes.shape or (driven_codes != map_codes).any():
        raise InputError("rides", "rides on the map", "rides on another one")
    return road_map


@name_wrong_arguments
@runs_jax
def film(
    source: UserValue,
    tiles: TileSet,
    rides: Rides,
    index: int = 0,
    *,
    tile_px: int = 128,
    chosen: UserValue = None,
) -> Iterator[NDArray[np.uint8]]:
    """Draws a ride frame by frame, 30 per second.

    A frame has the camera's picture, and next to it the map with the robot. Of a `RoadMap` both
    show its objects: the map shows all, and the camera the nearest ones that stand, with one
    picture for each kind.

    Yields:
      RGB uint8 ``[480, width, 3]``, all of one width.

    Raises:
      InputError: at the call, for a map that the tiles cannot draw (see `render`), a ride that does
        not exist, or rides on another map.
    """
    check_named("tiles", instance(TileSet), tiles)
    check_named("rides", instance(Rides), rides)
    index = check_named("index", whole(0, len(rides.steps) - 1), index)
    road_map = _map_of(rides, source)
    size = check_tile_px(tile_px)
    if chosen is None:
        chosen = choose_tiles(road_map.codes, tiles)
    # The camera draws objects itself, in front of the tiles. The map beside it needs them in its
    # picture.
    picture = render(road_map.codes, tiles, tile_px=size, chosen=chosen)
    # A map without objects has None.
    objects = jax.tree.map(itemgetter(0), make_objects([road_map]))
    see = partial(_see, _make_sight(picture, size, road_map), objects, road_map.codes)
    if road_map.objects:
        picture = render(road_map, tiles, tile_px=size, chosen=chosen)
    background, side = _shrink(picture.image, road_map.codes.shape)
    goal = _goals(rides.levels, tiles.lane_offset)[index]
    # The frames are drawn later, when the caller may have written to its arrays.
    rides = jax.tree.map(frozen_copy, rides)
    return _draw_frames(rides, index, see, background, side, goal)


def _draw_frames(
    rides: Rides,
    index: int,
    see: Callable[[Pose], Array],
    background: NDArray[np.uint8],
    side: float,
    goal: NDArray[np.float32],
) -> Iterator[NDArray[np.uint8]]:
    """Yields the frames of a ride on the picture of its map, whose tiles have a side in pixels.

    `see` returns the camera's pictures at poses.
    """
    x, y, theta = rides.x[index], rides.y[index], rides.theta[index]
    last = int(rides.steps[index])
    for start in range(0, last + 1, _BATCH):
        # The last batch repeats the last frame, so that all batches have one size, and run one
        # program.
        steps = np.minimum(np.arange(start, start + _BATCH), last)
        poses = Pose(x[steps], y[steps], theta[steps])
        views = np.asarray(see(poses))
        for step, view in zip(range(start, last + 1), views, strict=False):
            plan = background.copy()
            _draw_trail(plan, rides, index, step, goal, side)
            _draw_robot(plan, x[step], y[step], theta[step], side)
            yield np.concatenate([view, plan], axis=1)


def _make_sight(picture: Picture, size: int, road_map: RoadMap) -> Sight:
    """Returns what the camera sees of a map, from the map's picture without its objects."""
    camera = Camera(rows=_HEIGHT, columns=_VIEW_WIDTH, objects=_MOST_SEEN)
    views = load_objects().views_by_kind if road_map.objects else None
    # Each cell has its own picture, because blended tiles all differ. `_see` chooses it.
    images, labels = _cells(picture.image, size), _cells(picture.labels, size)
    return pack_sight(images, labels, {0: [(0, 0)]}, camera, views)


def _shrink(picture: NDArray[np.uint8], shape: tuple[int, ...]) -> tuple[NDArray[np.uint8], float]:
    """Shrinks the picture of a map to a film's height.

    Returns the picture, and the side of a tile in pixels.
    """
    rows, columns = shape
    side = min(_HEIGHT / rows, _WIDEST / columns)
    # Films have even sides.
    width = max(round(side * columns) // 2 * 2, 2)
    height = round(side * rows)
    shrunk = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    below = _HEIGHT - height
    return np.pad(np.asarray(shrunk, np.uint8), [(0, below), (0, 0), (0, 0)]), side


def _cells(layer: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Cuts a layer of a map into the pictures of its cells.

    The layer is ``[H·P, W·P, ...]``, and the result ``[H·W, P, P, ...]``.
    """
    height = layer.shape[0] // size
    width = layer.shape[1] // size
    channels = layer.shape[2:]
    cells = layer.reshape(height, size, width, size, *channels).swapaxes(1, 2)
    return cells.reshape(height * width, size, size, *channels)


@runs_jax
@jax.jit
def _see(
    sight: Sight, objects: Objects | None, grid: Int8[Array, "H W"], poses: Pose
) -> UInt8[Array, "N rows columns 3"]:
    """Returns the camera's picture at each pose.

    The sight has a picture for each cell of the grid, row by row.
    """
    pictures = np.stack(np.divmod(np.arange(grid.size), 4), axis=-1).reshape(*grid.shape, 2)
    return jax.vmap(lambda pose: look(pose, grid, sight, objects, chosen=pictures).image)(poses)


def write_film(file: Path, frames: Iterator[NDArray[np.uint8]]) -> int:
    """Writes frames as an MP4 film, or as a GIF if the name says so, whole or not at all.

    Returns the number of frames. A GIF has every third frame, half as large. It is made in memory,
    with up to 1.5 MB for each of its frames. An `OSError` names the file.
    """
    with new_file(file) as unfinished_file:
        if file.suffix.lower() == ".gif":
            return _write_gif(unfinished_file, frames)
        return _write_mp4(unfinished_file, frames)


def _write_mp4(file: Path, frames: Iterator[NDArray[np.uint8]]) -> int:
    count = 0
    writer = None
    for frame in frames:
        if writer is None:
            codec = cv2.VideoWriter.fourcc("m", "p", "4", "v")
            height, width = frame.shape[:2]
            writer = cv2.VideoWriter(_name_for_ffmpeg(file), codec, RATE, (width, height))
        # OpenCV's colours are blue, green and red.
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
        count += 1
    if writer is not None:
        writer.release()
    # The writer reports no failure, such as a full disk.
    if _count_frames(file) != count:
        # Python's own write raises the error of a full disk. If it succeeds, the failure is another
        # one.
        with file.open("ab") as stream:
            stream.write(bytes(_ROOM))
        raise OSError(errno.EIO, "cannot be written as a film")
    return count


def _name_for_ffmpeg(file: Path) -> str:
    """Returns the name of a film for OpenCV, which writes and reads films with FFmpeg."""
    # Of a relative name with a colon, FFmpeg takes the text before the colon for a protocol.
    return str(file.absolute())


def _count_frames(file: Path) -> int:
    film = cv2.VideoCapture(_name_for_ffmpeg(file))
    count = 0
    while film.grab():
        count += 1
    return count


def _write_gif(file: Path, frames: Iterator[NDArray[np.uint8]]) -> int:
    shown_frames = islice(frames, 0, None, _GIF_STEP)
    animation = cv2.Animation()
    animation.frames = [_half_as_large(frame) for frame in shown_frames]
    # Durations are in milliseconds.
    animation.durations = [1000 * _GIF_STEP // RATE] * len(animation.frames)
    _, content = cv2.imencodeanimation(".gif", animation)
    file.write_bytes(content.tobytes())
    return len(animation.frames)


def _half_as_large(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Shrinks a frame to the size of a GIF, in OpenCV's order of colours."""
    small = cv2.resize(frame, None, fx=_GIF_SCALE, fy=_GIF_SCALE, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small[..., ::-1])


@runs_jax
def _goals(levels: Level, lane_offset: float) -> NDArray[np.float32]:
    """Returns where lanes enter the goals' tiles, ``[N, 2]``, x and y."""
    # All movements of a node begin at the same point, so any turn will do.
    entering = Movement(*levels.goal, turn=jnp.int32(1))
    goal = lane_point(entering, 0.0, lane_offset=lane_offset)
    return np.stack(goal[:2], axis=1)


def _draw_trail(
    picture: NDArray[np.uint8],
    rides: Rides,
    index: int,
    steps: int,
    goal: NDArray[np.float32],
    side: float,
) -> None:
    colour = _COLOURS[index % len(_COLOURS)]
    points = np.stack([rides.x[index], rides.y[index]], axis=1)[: int(steps) + 1]
    thick = max(round(side * _LINE), 1)
    cv2.polylines(picture, [_dots(points, side)], False, colour, thick, cv2.LINE_AA, _BITS)
    # OpenCV fills a circle whose thickness is -1.
    for middle, share, thickness in ((points[0], _START_RADIUS, -1), (goal, _GOAL_RADIUS, thick)):
        dot = _dots(middle, side)[0, 0].tolist()
        radius = round(side * share * 2**_BITS)
        cv2.circle(picture, dot, radius, colour, thickness, cv2.LINE_AA, _BITS)


def _draw_robot(picture: NDArray[np.uint8], x: float, y: float, theta: float, side: float) -> None:
    """Draws a robot as a triangle, whose tip is ahead."""
    # The picture's y points down, and angles are counter-clockwise.
    ahead = np.array([np.cos(theta), -np.sin(theta)])
    left = np.array([-np.sin(theta), -np.cos(theta)])
    middle = np.array([x, y])
    tip = middle + _ROBOT_LENGTH / 2 * ahead
    rear = middle - _ROBOT_LENGTH / 2 * ahead
    rear_left = rear + _ROBOT_WIDTH / 2 * left
    rear_right = rear - _ROBOT_WIDTH / 2 * left
    shape = _dots(np.array([rear_left, rear_right, tip]), side)
    thickness = max(round(side * _OUTLINE), 1)
    cv2.fillPoly(picture, [shape], _ROBOT_FILL, cv2.LINE_AA, _BITS)
    cv2.polylines(picture, [shape], True, _ROBOT_EDGE, thickness, cv2.LINE_AA, _BITS)


def _dots(points: NDArray[np.floating], side: float) -> NDArray[np.int32]:
    """Returns positions in tiles as OpenCV's ``[N, 1, 2]``, whose last bits are fractions.

    The positions are ``[N, 2]`` or ``[2]``.
    """
    return np.rint(points * side * 2**_BITS).astype(np.int32).reshape(-1, 1, 2)
