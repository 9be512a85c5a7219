"""Views of a map from a robot on its lanes.

A view is a pose, a pinhole camera, and the warp of a rendered map.

One 3 x 3 matrix maps the ground to a picture, as for views from above; points behind the camera
have a third coordinate of 0 or less. Picture and labels are sampled at the same points: the picture
four times per pixel, from a map that is smaller at a larger distance, and averaged; labels once, at
the nearest pixel of the map.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._transforms import Viewpoints
from elitelanes_jax.drive.robot import TILE, Robot
from elitelanes_jax.formats.objects import NEAR, MapObject
from elitelanes_jax.lanes.curves import LANE_OFFSET
from elitelanes_jax.lanes.movements import Movement, movements_of
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.tiles.object_set import ObjectPictures, lay_flat
from elitelanes_jax.tiles.pasting import Placed

_F = TypeVar("_F", np.float32, np.float64)

# Gym-duckietown's horizons: a blue sky, a wall, darkness, a white hall; RGB.
_HORIZONS = ((115, 210, 255), (165, 150, 125), (40, 40, 40), (235, 235, 235))
# The centre of the first pixel. OpenCV's coordinates refer to the centres of pixels.
_CENTRE = np.float32(0.5)
# The samples per pixel in each direction.
_FINER = 2
# The distance of the white line from the tile's edge, in tiles.
_WHITE_LINE = 0.09
# The radius of a robot in metres.
_ROBOT = Robot().width / 2
# The most further poses that are drawn until the robot touches no object. With a dozen robots in
# the lanes of a 5 x 5 town, a pose touches an object in one of seven cases, so 64 poses end only
# where objects fill the lanes.
_TRIES = 64
# The number of sizes of the map: whole, a half, a quarter and so on.
LEVELS = 6
# The least inverse depth of the ground in 1 / metres. Rays with less do not meet it.
_LEAST_INVERSE_DEPTH = 1e-6
# The farthest point on a map in pixels. OpenCV's range ends at larger distances.
_FARTHEST = 1e6


class Viewpoint(NamedTuple):
    """A camera at a position on a map.

    Attributes:
      matrix: float64 ``[3, 3]``, maps points (x, y) of the rendered map, in pixels, to points of
        the picture. The third coordinate is the depth in metres; it is 0 or less behind the camera.
      size: (rows, columns) of the picture.
      sky: the colour of the sky, RGB.
      tile_px: side of a tile of the rendered map in pixels.
      lines: the stretch of a tile at its white lines, in tiles; positive if they shift outwards.
      about: the fields ``d``, ``phi``, ``curvature``, ``pose``, ``movement``, ``nearest`` and
        ``camera`` of the metadata.
    """

    matrix: Float[NDArray, "3 3"]
    size: tuple[int, int]
    sky: tuple[int, int, int]
    tile_px: int
    lines: float
    about: dict[str, Plain]


class _Place(NamedTuple):
    """A pose on a lane, in the units of the metadata.

    Attributes:
      movement: the row and the column of the tile, the heading of entry, and the turn.
      d: the distance to the left of the lane's centre in tiles.
      phi: the angle to the left of the lane in radians.
      curvature: the curvature of the lane to the left, in 1 / tile.
      x: the position on the map, in tiles to the east.
      y: the position on the map, in tiles to the south.
      theta: the direction of the robot in radians, counter-clockwise from east.
    """

    movement: dict[str, int]
    d: float
    phi: float
    curvature: float
    x: float
    y: float
    theta: float


def draw_viewpoint(
    rng: np.random.Generator,
    viewpoints: Viewpoints,
    codes: Int[NDArray, "H W"],
    tile_px: int,
    objects: Sequence[MapObject] = (),
    lane_offset: float = LANE_OFFSET,
) -> Viewpoint:
    """Draws a pose on the lanes of a map, and its camera.

    Raises `InputError` for a map without a lane.

    The movement is drawn uniformly from all movements of the map; the position along it, the offset
    and the angle are uniform too. If the robot would touch an object, another pose is drawn, at
    most 64 times. Lanes run `lane_offset` tiles to the right of the road's middle.
    """
    movements = _movements_of(np.asarray(codes, np.int8).tobytes(), codes.shape)
    if not movements.row.size:
        raise InputError("maps: expected lanes for the camera, got a map without any")
    place = _draw_place(rng, viewpoints, movements, lane_offset)
    # The wobble changes the camera as if it were mounted anew for each view.
    lower, tilt, wide = 1 + rng.uniform(-1, 1, 3) * viewpoints.wobble
    sky = _HORIZONS[rng.integers(len(_HORIZONS))]
    lines = float(rng.uniform(-1, 1) * viewpoints.lines)
    # Further poses are drawn last. Therefore objects elsewhere change nothing.
    for _ in range(_TRIES):
        if not _touches(place, objects):
            break
        place = _draw_place(rng, viewpoints, movements, lane_offset)

    # A camera looks straight down at most.
    height, pitch = float(viewpoints.height * lower), float(min(viewpoints.pitch * tilt, 90))
    # At 180 degrees the focal length would be 0.
    field_of_view = float(min(viewpoints.field_of_view * wide, 175))
    # These values are on the lane that was drawn. The nearest lane may be another one, such as on a
    # crossing.
    on_lane = {"d": place.d, "phi": place.phi, "curvature": place.curvature}
    x, y, theta = place.x, place.y, place.theta
    camera = {
        "height": height,
        "forward": viewpoints.forward,
        "pitch": pitch,
        "field_of_view": field_of_view,
    }
    about = {
        **on_lane,
        "pose": {"x": x, "y": y, "theta": theta},
        "nearest": _nearest(movements, x, y, theta, lane_offset) or on_lane,
        "movement": place.movement,
        "camera": camera | {"sky": sky} | ({"lines": lines} if viewpoints.lines else {}),
    }
    size = (viewpoints.rows, viewpoints.columns)
    # Points of the map in pixels become tiles, then metres from the robot, then metres from the
    # camera on the ground, and then points of the picture.
    to_robot = _to_robot(x, y, theta) @ np.diag([1 / tile_px, 1 / tile_px, 1])
    # The ground has height 0, and the camera is ahead of the robot's middle.
    onto_ground = np.array([[1, 0, -viewpoints.forward], [0, 1, 0], [0, 0, 0], [0, 0, 1]])
    matrix = camera_matrix(camera, size) @ onto_ground @ to_robot
    return Viewpoint(matrix, size, sky, tile_px, lines, about)


@lru_cache(maxsize=64)
def _movements_of(codes: bytes, shape: tuple[int, int]) -> Movement:
    """Returns the movements of a map, once for all views of the map."""
    return movements_of(np.frombuffer(codes, np.int8).reshape(shape))


def _draw_place(
    rng: np.random.Generator, viewpoints: Viewpoints, movements: Movement, lane_offset: float
) -> _Place:
    index = rng.integers(movements.row.size)
    movement = Movement(*(int(field[index]) for field in movements))
    row, column, heading, turn = movement
    # All three numbers are drawn before they are scaled, so that ranges do not change other
    # numbers.
    along, beside, turned = rng.uniform(0, 1), *rng.uniform(-1, 1, 2)
    d, phi = beside * viewpoints.offset, np.radians(turned * viewpoints.heading)
    # The direction of a turn: 1 to the left, -1 to the right, 0 straight on.
    bend = turn - 1
    # A turn is a quarter of a circle around a corner of the tile. The road's middle is half a tile
    # from this corner, and the lane is farther away on a left turn.
    radius = 0.5 + lane_offset * bend
    angle = along * np.pi / 2 * bend
    # Forward and left of the middle of the side by which the tile is entered.
    forward = (radius - bend * d) * np.sin(abs(angle)) if bend else along
    left = bend * (0.5 - (radius - bend * d) * np.cos(angle)) if bend else d - lane_offset
    ahead_x, ahead_y = SIDES[heading].right, SIDES[heading].down
    # SIDES has the direction ahead. The direction to the left is (ahead_y, -ahead_x), because y
    # points down.
    x = column + 0.5 + (forward - 0.5) * ahead_x + left * ahead_y
    y = row + 0.5 + (forward - 0.5) * ahead_y - left * ahead_x
    theta = np.arctan2(-ahead_y, ahead_x) + angle + phi
    # The angle is brought to -pi to pi, without -pi.
    theta = float(np.pi - (np.pi - theta) % (2 * np.pi))
    return _Place(
        movement._asdict(), float(d), float(phi), bend / radius, float(x), float(y), theta
    )


def _touches(place: _Place, objects: Sequence[MapObject]) -> bool:
    """Returns whether a robot touches an object, as in `LaneDrive`.

    Tags on the floor are not touched.
    """
    return any(
        thing.height > 0
        and np.hypot(thing.x - place.x, thing.y - place.y) * TILE <= thing.radius + _ROBOT
        for thing in objects
    )


def _nearest(
    movements: Movement, x: float, y: float, theta: float, lane_offset: float
) -> dict[str, Plain]:
    """Returns the offset, the heading error and the curvature on the nearest lane.

    The nearest lane is on the pose's tile, and is chosen as `lane_pose` does. For a tile without
    lanes the table is empty.
    """
    nearest: dict[str, Plain] = {}
    least_rank = np.inf
    # Only lanes of the pose's own tile are candidates, so few movements are compared.
    on_tile = (movements.row == int(np.floor(y))) & (movements.column == int(np.floor(x)))
    for row, column, heading, turn in zip(*(field[on_tile] for field in movements), strict=True):
        ahead_x, ahead_y = SIDES[heading].right, SIDES[heading].down
        # The pose in the frame of the movement: tiles ahead of and to the left of the middle of the
        # side of entry.
        forward = (x - column - 0.5) * ahead_x + (y - row - 0.5) * ahead_y + 0.5
        left = (x - column - 0.5) * ahead_y - (y - row - 0.5) * ahead_x
        # A movement's turn is 0 right, 1 straight or 2 left.
        bend = turn - 1
        # On a turn, the offset is the difference from the lane's radius, and the lane's direction
        # changes with the angle around the corner.
        radius, inward = 0.5 + lane_offset * bend, 0.5 - bend * left
        d = bend * (radius - np.hypot(forward, inward)) if bend else left + lane_offset
        phi = (
            theta
            - np.arctan2(-ahead_y, ahead_x)
            - (bend * np.arctan2(forward, inward) if bend else 0)
        )
        # The angle is brought to -pi to pi, so that angles from both sides can be compared.
        phi = np.pi - (np.pi - phi) % (2 * np.pi)
        # Lanes that lead the other way count as far away.
        rank = abs(d) + 100 * (np.cos(phi) <= 0)
        if rank < least_rank:
            least_rank = rank
            nearest = {"d": float(d), "phi": float(phi), "curvature": float(bend / radius)}
    return nearest


def see(
    image: UInt8[NDArray, "h w 3"], viewpoint: Viewpoint, ground: tuple[int, int, int]
) -> UInt8[NDArray, "rows columns 3"]:
    """Draws the camera's view of a rendered map. Beyond the map there is ground of one colour."""
    sizes = [image]

    def whole_map(rank: int, x: NDArray[np.float32], y: NDArray[np.float32]) -> MapPart:
        # A smaller map is made when a view needs it.
        while len(sizes) <= rank:
            half = tuple(max(side // 2, 1) for side in sizes[-1].shape[1::-1])
            sizes.append(
                np.asarray(cv2.resize(sizes[-1], half, interpolation=cv2.INTER_AREA), np.uint8)
            )
        smaller = sizes[rank]
        # Halved sides are rounded down. Therefore the scale is not always a power of 2.
        across, down = (
            now / before
            for now, before in zip(smaller.shape[1::-1], image.shape[1::-1], strict=True)
        )
        return MapPart(smaller, x * across - _CENTRE, y * down - _CENTRE)

    return see_parts(whole_map, viewpoint, ground)


class MapPart(NamedTuple):
    """A part of a map, at one of its sizes, and the points that are seen in it.

    Attributes:
      picture: uint8 ``[h, w, C]``, RGB and further channels that are not used.
      x: float32 ``[rows, columns]``, columns of the picture; a whole number is the centre of a
        pixel.
      y: float32 ``[rows, columns]``, rows of the picture; a whole number is the centre of a pixel.
    """

    picture: UInt8[NDArray, "h w C"]
    x: NDArray[np.float32]
    y: NDArray[np.float32]


def see_parts(
    part_of: Callable[[int, NDArray[np.float32], NDArray[np.float32]], MapPart],
    viewpoint: Viewpoint,
    ground: tuple[int, int, int],
    channels: int = 3,
) -> UInt8[NDArray, "rows columns 3"]:
    """Draws the camera's view of a map whose parts are made when they are seen.

    Args:
      part_of: (number of halvings of the map, x and y of points of the whole map in pixels) -> a
        part with these points. It may overwrite the points. What it has beyond its part must be
        beyond the map.
      viewpoint: the viewpoint of the camera.
      ground: the colour beyond the map.
      channels: the number of channels of the parts, 3 or 4. OpenCV samples four channels in less
        than half the time of three.
    """
    rows, columns = viewpoint.size
    outside, above = (
        np.array([*colour, 0][:channels], np.uint8) for colour in (ground, viewpoint.sky)
    )
    rays = find_rays(viewpoint, _FINER)
    # Rows of pixels that show sky alone are not averaged.
    plain = rays.sky // _FINER
    fine = np.empty((rows * _FINER - plain * _FINER, columns * _FINER, channels), np.uint8)
    # These rows of sky share a row of pixels with ground.
    horizon = rays.sky - plain * _FINER
    fine[:horizon] = above
    # This is a view of the same array. The rays on the ground are sampled into it.
    on_ground = fine[horizon:]
    # Distant rows are sampled from smaller maps, so that nothing aliases.
    for rank, lines in _runs(_levels(rays)):
        part = part_of(rank, rays.x[lines], rays.y[lines])
        _sample(part.picture, part.x, part.y, cv2.INTER_LINEAR, outside.tolist(), on_ground[lines])
    view = np.empty((rows, columns, 3), np.uint8)
    # A row of bytes is copied in a tenth of the time of many colours.
    view.reshape(rows, -1)[:plain] = np.tile(above[:3], columns)
    if plain < rows:
        mean = np.asarray(cv2.resize(fine, (columns, rows - plain), interpolation=cv2.INTER_AREA))
        view[plain:] = mean if channels == 3 else cv2.cvtColor(mean, cv2.COLOR_RGBA2RGB)
    return view


def see_labels(
    labels: UInt8[NDArray, "h w"], viewpoint: Viewpoint
) -> UInt8[NDArray, "rows columns"]:
    """Draws the camera's view of a mask or labels.

    The result has the nearest pixel of the map, and 0 beyond the map and above the horizon.
    """
    rays = find_rays(viewpoint, 1)
    seen = np.zeros(viewpoint.size, np.uint8)
    # OpenCV refuses an array without rows.
    if len(rays.x):
        _sample(
            labels, rays.x - _CENTRE, rays.y - _CENTRE, cv2.INTER_NEAREST, (0,), seen[rays.sky :]
        )
    return seen


def _to_robot(x: float, y: float, theta: float) -> Float[NDArray, "3 3"]:
    """Returns the matrix from positions on the map to positions relative to a pose.

    The positions on the map are in tiles. The results are in metres ahead and to the left of the
    pose.
    """
    # A position relative to the robot is turned back by the robot's direction.
    cosine, sine = np.cos(theta), np.sin(theta)
    # North is -y on the map, which changes the signs of both entries for y.
    turn = np.array([[cosine, -sine, 0], [-sine, -cosine, 0], [0, 0, 1]])
    return np.asarray(
        np.diag([TILE, TILE, 1]) @ turn @ np.array([[1, 0, -x], [0, 1, -y], [0, 0, 1]])
    )


def camera_matrix(camera: Mapping[str, float], size: tuple[int, int]) -> Float[NDArray, "3 4"]:
    """Returns the matrix from positions relative to a camera to points of its picture.

    The positions are in metres ahead of the camera, to the left, and above the ground. The camera
    has its height, pitch and field of view, as in a viewpoint's ``about``; `size` is (rows,
    columns).
    """
    rows, columns = size
    # The field of view is from the upper to the lower edge.
    focal = rows / 2 / np.tan(np.radians(camera["field_of_view"]) / 2)
    # The camera is tilted downwards by its pitch.
    cosine, sine = np.cos(np.radians(camera["pitch"])), np.sin(np.radians(camera["pitch"]))
    # Right, down and depth in the camera's frame.
    down = [-sine, 0, -cosine, camera["height"] * cosine]
    depth = [cosine, 0, -sine, camera["height"] * sine]
    seen = np.array([[0, -1, 0, 0], down, depth])
    return np.asarray(np.array([[focal, 0, columns / 2], [0, focal, rows / 2], [0, 0, 1]]) @ seen)


class _Standing(NamedTuple):
    """An object in a view.

    Attributes:
      depth: metres ahead of the camera, by which objects hide each other; infinite on the floor.
      object_index: the index of the object on the map.
      placed: its picture in the view.
      distance: metres from the camera.
    """

    depth: float
    object_index: int
    placed: Placed
    distance: float


def place_objects(
    objects: Sequence[MapObject],
    pictures: Sequence[ObjectPictures],
    viewpoint: Viewpoint,
    tile_px: int,
) -> tuple[list[Placed], list[int], list[float]]:
    """Places objects with their pictures in a view from a robot.

    `tile_px` is that of the rendered map.

    Each picture stands upright, parallel to the picture's rows, so that its rows stay rows of the
    view. It is not turned towards the camera, but its view is chosen by the direction from which
    the camera sees it.

    Returns the pictures from back to front, the objects' indices, and their distances from the
    camera in metres.
    """
    pose, camera = viewpoint.about["pose"], viewpoint.about["camera"]
    # Positions on the map become metres ahead of and to the left of the camera.
    cosine, sine = np.cos(pose["theta"]), np.sin(pose["theta"])
    standing = []
    for index, (thing, views) in enumerate(zip(objects, pictures, strict=True)):
        # On the map y points south.
        east, north = (thing.x - pose["x"]) * TILE, (pose["y"] - thing.y) * TILE
        ahead, left = east * cosine + north * sine - camera["forward"], north * cosine - east * sine
        distance = float(np.hypot(ahead, left))
        # A picture without height is on the ground. It is seen like the map, and hides no upright
        # picture.
        if not views.height:
            flat = lay_flat(thing, views, tile_px)
            placed = flat._replace(matrix=viewpoint.matrix @ flat.matrix)
            standing.append(_Standing(np.inf, index, placed, distance))
        elif ahead > NEAR:
            # The view of the picture depends on the direction from the object to the camera,
            # relative to the object's front.
            towards = np.arctan2(-left, -ahead) + pose["theta"] - thing.angle
            pixels = views.view(towards)
            rows, columns = pixels.shape[:2]
            metre = thing.height / rows
            # From (column, row) of the picture to metres ahead, to the left and upwards.
            position = np.array(
                [
                    [0, 0, ahead],
                    [-metre, 0, left + columns / 2 * metre],
                    [0, -metre, thing.height],
                    [0, 0, 1],
                ]
            )
            placed = Placed(pixels, camera_matrix(camera, viewpoint.size) @ position)
            standing.append(_Standing(ahead, index, placed, distance))
    # Distant pictures come first, so that nearer ones cover them. The index decides between equal
    # depths.
    standing.sort(key=lambda item: (-item.depth, item.object_index))
    return (
        [item.placed for item in standing],
        [item.object_index for item in standing],
        [item.distance for item in standing],
    )


class Rays(NamedTuple):
    """Where the rays of pixels meet the ground.

    Attributes:
      x: float32 ``[R, columns]``, columns of the rendered map in pixels, for the rows of the
        picture that meet the ground. These are the last R ones, because no camera rolls.
      y: float32 ``[R, columns]``, rows of the rendered map in pixels.
      sky: the number of rows above these, which do not meet the ground.
    """

    x: Float32[NDArray, "R columns"]
    y: Float32[NDArray, "R columns"]
    sky: int


def find_rays(viewpoint: Viewpoint, finer: int) -> Rays:
    """Returns where the rays of a viewpoint meet the ground.

    A pixel has `finer` rays in each direction.
    """
    rows, columns = (side * finer for side in viewpoint.size)
    # The inverse matrix leads from points of the picture back to the map.
    back = np.linalg.inv(viewpoint.matrix)
    # Rays lead through the centres of equal parts of each pixel.
    u, v = (np.arange(columns) + 0.5) / finer, (np.arange(rows) + 0.5) / finer
    # No camera rolls. Therefore a row has one depth, and back[2, 0] is 0 except for rounding.
    inverse_depth = back[2, 1] * v + back[2, 2]
    sky = rows - int(np.count_nonzero(inverse_depth > _LEAST_INVERSE_DEPTH))
    v, depth = v[sky:], 1 / inverse_depth[sky:]
    along = np.stack([u, np.ones(columns)])
    places = []
    for axis in range(2):
        # Along a row the depth is constant, so coordinates on the map grow by equal steps.
        step, start = back[axis, 0] * depth, (back[axis, 1] * v + back[axis, 2]) * depth
        # A product of matrices takes a quarter of the time of a product and a sum of arrays.
        place = (np.column_stack([step, start]) @ along).astype(np.float32)
        # All coordinates of a row are between these two, so they tell whether a ray may be too far.
        if max(np.abs(start).max(), np.abs(start + step * columns).max()) > _FARTHEST:
            np.clip(place, -_FARTHEST, _FARTHEST, out=place)
        places.append(_shift_lines(place, viewpoint.tile_px, -viewpoint.lines))
    x, y = places
    return Rays(x, y, sky)


def _shift_lines(places: NDArray[_F], tile_px: int, lines: float) -> NDArray[_F]:
    """Shifts coordinates away from the middle of each tile.

    The shift is `lines` tiles at the usual place of the white line.
    """
    if not lines:
        return places
    # A sine has no shift in the middle and at the edges of a tile, where neighbours have to meet.
    sides = np.sin(places * (2 * np.pi / tile_px)) * np.float32(
        lines * tile_px / np.sin(2 * np.pi * _WHITE_LINE)
    )
    return np.asarray(places - sides, places.dtype)


def _levels(rays: Rays) -> Int[NDArray, " R"]:
    """Returns how often the map is halved for each row of samples.

    The distance between a row's samples is the root of the area between four of them.
    """
    middle = rays.x.shape[1] // 2
    left_x, x = rays.x[:, middle - 1 : middle + 1].T
    left_y, y = rays.y[:, middle - 1 : middle + 1].T
    # A row has one depth. Therefore the two samples in its middle stand for all.
    right = np.hypot(x - left_x, y - left_y)
    down = np.zeros_like(right)
    down[:-1] = np.hypot(x[1:] - x[:-1], y[1:] - y[:-1])
    # The last row has no row below it and gets the distance of the row above.
    down[-1:] = down[-2:-1]
    apart = np.sqrt(np.maximum(right * down, 1e-12))
    return np.clip(np.floor(np.log2(np.maximum(apart, 1))), 0, LEVELS - 1).astype(int)


def _runs(levels: Int[NDArray, " R"]) -> Iterator[tuple[int, slice]]:
    """Yields neighbouring rows of one level: the level, and the rows.

    Shifted lines may mix levels. All rows between two rows of a higher level then have this level,
    so that its part of the map is made once.
    """
    joined = levels.copy()
    for level in range(1, LEVELS):
        rows = np.flatnonzero(levels == level)
        if len(rows):
            joined[rows[0] : rows[-1] + 1] = level
    # A run starts where the level changes.
    starts = np.flatnonzero(np.diff(joined, prepend=-1)).tolist()
    for start, end in zip(starts, [*starts[1:], len(joined)], strict=True):
        yield int(joined[start]), slice(start, end)


def _sample(
    layer: NDArray[np.uint8],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    interpolation: int,
    outside: Sequence[int],
    sampled: NDArray[np.uint8],
) -> None:
    """Samples a layer at some points into the rows `sampled`.

    Beyond the layer the rows get the colour `outside`.
    """
    cv2.remap(layer, x, y, interpolation, sampled, cv2.BORDER_CONSTANT, outside)
