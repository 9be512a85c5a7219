"""Draws the default object pictures, those in objects/: models of convex solids, from several sides and from above.

    python -m experiments.perception.draw_objects [--out DIR]

Lengths are in metres, for an object of the kind's usual height. x points ahead, y to the left, z up from the floor.
Pictures are orthographic views, so that their rows and columns are lengths. Light comes from above and from the left of
the viewer. Variants of a kind differ in colour and proportion.
"""

import shutil
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.formats import OBJECT_KINDS
from elitelanes_jax.tiles import draw_tag
from experiments.common import Parser, leave, run

Field = NDArray[np.float64]
Colour = tuple[int, int, int]

ROWS = 96
FINER = 3  # samples a pixel in each direction

YELLOW, ORANGE, RED, BLACK, WHITE = (250, 208, 50), (242, 112, 34), (205, 35, 40), (30, 30, 32), (240, 240, 236)
GREY, WOOD, BLUE, GREEN, GLASS = (126, 128, 132), (122, 86, 56), (44, 84, 172), (56, 124, 60), (66, 86, 106)


class Solid(NamedTuple):
    """An ellipsoid, or the points within some planes, ``normals @ (point - centre) <= offsets``.

    Attributes:
      centre: float ``[3]``.
      reach: float ``[3]``, no point is further from the centre along an axis. Of an ellipsoid, its radii.
      colour: RGB.
      normals: float ``[P, 3]``, of length 1; none for an ellipsoid.
      offsets: float ``[P]``.
      face: uint8 ``[S, S, 3]``, the picture on some of the planes, which are upright.
      painted: the indices of these planes.
      half: half of the face's width and height.
    """

    centre: Field
    reach: Field
    colour: Colour
    normals: Field = np.zeros((0, 3))
    offsets: Field = np.zeros(0)
    face: NDArray[np.uint8] = np.zeros((1, 1, 3), np.uint8)
    painted: tuple[int, ...] = ()
    half: tuple[float, float] = (1.0, 1.0)


def box(x: float, y: float, z: float, sides: tuple[float, float, float], colour: Colour) -> Solid:
    """Returns a box by the middle of its floor."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    half = np.array(sides) / 2
    return Solid(np.array([x, y, z + half[2]]), half, colour, normals, np.tile(half, 2))


def board(z: float, width: float, height: float, face: NDArray[np.uint8]) -> Solid:
    """Returns a thin board across x by its floor, painted in front and white behind."""
    return box(0, 0, z, (0.004, width, height), WHITE)._replace(face=face, painted=(0,), half=(width / 2, height / 2))


def ball(x: float, y: float, z: float, radii: tuple[float, float, float], colour: Colour) -> Solid:
    """Returns an ellipsoid by its centre and radii."""
    return Solid(np.array([x, y, z]), np.array(radii), colour)


def cone(x: float, y: float, z: float, radii: tuple[float, float], height: float, colour: Colour) -> Solid:
    """Returns a round stump by the middle of its floor and its radii below and above."""
    below, above = radii
    angle = np.arange(32) * np.pi / 16
    slope = (below - above) / height
    around = np.stack([np.cos(angle), np.sin(angle), np.full(32, slope)], axis=1) / np.hypot(1, slope)
    normals = np.concatenate([around, [[0, 0, 1], [0, 0, -1]]])
    offsets = np.concatenate([np.full(32, (below + above) / 2 / np.hypot(1, slope)), [height / 2] * 2])
    wide = max(radii) * 1.01
    return Solid(np.array([x, y, z + height / 2]), np.array([wide, wide, height / 2]), colour, normals, offsets)


def wheel(x: float, y: float, radius: float, width: float) -> Solid:
    """Returns a wheel on the floor that turns about y."""
    return ball(x, y, radius, (radius, width, radius), BLACK)


def roof(x: float, y: float, z: float, sides: tuple[float, float, float], colour: Colour) -> Solid:
    """Returns a roof by the middle of its floor; its ridge goes along y."""
    length, width, height = sides
    tilt = np.array([height, 0, length / 2]) / np.hypot(height, length / 2)
    normals = np.array([tilt, tilt * (-1, 1, 1), [0, 1, 0], [0, -1, 0], [0, 0, -1]])
    eaves = tilt[0] * length / 2
    offsets = np.array([eaves, eaves, width / 2, width / 2, 0])
    return Solid(np.array([x, y, z]), np.array([length / 2, width / 2, height]), colour, normals, offsets)


Model = list[Solid]
Maker = Callable[[np.random.Generator], Model]


def view(
    model: Model, azimuth: float | None, extent: tuple[float, float, float, float], metre: float
) -> NDArray[np.uint8]:
    """Draws a model, uint8 ``[rows, columns, 4]``, RGB and opacity.

    Args:
      model: the solids.
      azimuth: degrees counter-clockwise from the model's front to the viewer; None for a view from above.
      extent: what is shown, to the right and upwards: left, right, low, high.
      metre: pixels in a metre.
    """
    if azimuth is None:
        right, up = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    else:
        a = np.radians(azimuth)
        right, up = np.array([-np.sin(a), np.cos(a), 0]), np.array([0, 0, 1.0])
    towards = np.cross(right, up)
    light = np.array([-0.4, 0.75, 0.55])
    light /= np.linalg.norm(light)
    left, _, _, high = extent
    columns, rows = (max(1, round((b - a) * metre)) for a, b in (extent[:2], extent[2:]))
    across = left + (np.arange(columns * FINER) + 0.5) / FINER / metre
    down = high - (np.arange(rows * FINER) + 0.5) / FINER / metre
    nearest = np.full((len(down), len(across)), -np.inf)
    picture = np.zeros((*nearest.shape, 4))
    for solid in model:
        # Only the pixels of the solid's bounding box.
        seen = [
            np.flatnonzero(np.abs(places - solid.centre @ axis) <= solid.reach @ np.abs(axis) + 1e-4)
            for places, axis in ((down, up), (across, right))
        ]
        window = np.ix_(*seen)
        origins = across[seen[1]][None, :, None] * right + down[seen[0]][:, None, None] * up - solid.centre
        far, normals, plane = _meet(solid, origins, towards)
        hit = far > nearest[window]
        nearest[window] = np.where(hit, far, nearest[window])
        shade = 0.62 + 0.42 * np.clip(normals[hit] @ np.stack([right, up, towards]).T @ light, 0, 1)
        colour = np.tile(np.array(solid.colour, float), (len(shade), 1))
        for index in solid.painted:
            front, size = plane[hit] == index, len(solid.face)
            point = (origins[hit] + far[hit][:, None] * towards)[front]
            side = point @ np.cross([0, 0, 1.0], solid.normals[index])
            u, v = (1 + side / solid.half[0]) / 2 * size, (1 - point[:, 2] / solid.half[1]) / 2 * size
            colour[front] = solid.face[tuple(np.clip(part.astype(int), 0, size - 1) for part in (v, u))]
        part = picture[window]
        part[hit] = np.column_stack([colour * shade[:, None], np.full(len(shade), 255.0)])
        picture[window] = part
    blocks = picture.reshape(rows, FINER, columns, FINER, 4)
    cover = blocks[..., 3].mean(axis=(1, 3))
    paint = blocks[..., :3].sum(axis=(1, 3)) / np.maximum((blocks[..., 3] > 0).sum(axis=(1, 3)), 1)[..., None]
    return np.clip(np.rint(np.dstack([paint, cover])), 0, 255).astype(np.uint8)


def _meet(solid: Solid, origins: Field, towards: Field) -> tuple[Field, Field, NDArray[np.int_]]:
    """Returns how far lines leave a solid, -inf where they miss it, the normals there, and the indices of its planes.

    Args:
      solid: with its centre at the origin.
      origins: float ``[h, w, 3]``, a point of each line.
      towards: their direction.
    """
    if not len(solid.offsets):
        start, step = origins / solid.reach, towards / solid.reach
        a, b, c = step @ step, start @ step, (start * start).sum(axis=-1) - 1
        root = b * b - a * c
        far = (np.sqrt(np.maximum(root, 0)) - b) / a
        normals = (origins + far[..., None] * towards) / solid.reach**2
        normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        return np.where(root >= 0, far, -np.inf), normals, np.zeros(far.shape, int)
    along = solid.normals @ towards
    room = solid.offsets - origins @ solid.normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = room / along
    last = np.where(along > 1e-9, cut, np.inf)
    first = np.where(along < -1e-9, cut, -np.inf).max(axis=-1)
    plane, far = last.argmin(axis=-1), last.min(axis=-1)
    missed = (far <= first) | ((np.abs(along) <= 1e-9) & (room < 0)).any(axis=-1)
    return np.where(missed, -np.inf, far), solid.normals[plane], plane


def vary(rng: np.random.Generator, colour: Colour, share: float = 0.12) -> Colour:
    """Returns a similar colour."""
    red, green, blue = (int(np.clip(part * rng.uniform(1 - share, 1 + share), 0, 255)) for part in colour)
    return red, green, blue


def pick(rng: np.random.Generator, *colours: Colour) -> Colour:
    """Returns one of some colours, varied."""
    return vary(rng, colours[rng.integers(len(colours))])


def duckie(rng: np.random.Generator) -> Model:
    """Returns a rubber duck."""
    coat, fat, head = vary(rng, YELLOW, 0.06), rng.uniform(0.94, 1.04), rng.uniform(0.0195, 0.0225)
    x, z = 0.014, 0.079 - head
    eyes = [ball(x + 0.84 * head, side * 0.38 * head, z + 0.3 * head, (0.0035,) * 3, BLACK) for side in (-1, 1)]
    return [
        ball(-0.004, 0, 0.024, (0.036 * fat, 0.03 * fat, 0.0245), coat),
        ball(-0.034, 0, 0.036, (0.011, 0.012, 0.011), coat),
        *(ball(-0.008, side * 0.027 * fat, 0.027, (0.02, 0.006, 0.013), vary(rng, coat, 0.04)) for side in (-1, 1)),
        ball(x, 0, z, (head,) * 3, coat),
        ball(x + 1.1 * head, 0, z - 0.22 * head, (0.011, 0.0095, 0.0045), vary(rng, ORANGE)),
        *eyes,
    ]


def traffic_cone(rng: np.random.Generator) -> Model:
    """Returns a cone with one or two white rings."""
    body, wide = vary(rng, ORANGE), rng.uniform(0.017, 0.02)
    cuts = ([0.005, 0.034, 0.052, 0.08], [0.005, 0.026, 0.037, 0.047, 0.058, 0.08])[rng.integers(2)]
    rings = []
    for index, (low, high) in enumerate(pairwise(cuts)):
        radii = tuple(wide + (0.004 - wide) * (z - 0.005) / 0.075 for z in (low, high))
        rings.append(cone(0, 0, low, radii, high - low, vary(rng, WHITE, 0.03) if index % 2 else body))  # type: ignore[arg-type]
    return [box(0, 0, 0, (0.035, 0.035, 0.005), body), cone(0, 0, 0, (0.0245, 0.0245), 0.004, body), *rings]


def barrier(rng: np.random.Generator) -> Model:
    """Returns a striped board on two feet."""
    stripes = np.array([vary(rng, WHITE, 0.03), pick(rng, RED, ORANGE)], np.uint8)
    u, v = np.meshgrid(np.arange(192), np.arange(192))
    face = stripes[((u * 4 + v * (-1, 1)[rng.integers(2)]) // 96) % 2]
    feet = [box(side * 0.1, 0, 0, (0.014, 0.057, 0.012), BLACK) for side in (-1, 1)]
    posts = [box(side * 0.1, 0, 0.01, (0.012, 0.01, 0.03), GREY) for side in (-1, 1)]
    plank = box(0, 0, 0.03, (0.285, 0.012, 0.05), pick(rng, RED, ORANGE))
    return [*feet, *posts, plank._replace(face=face, painted=(1, 4), half=(0.1425, 0.025))]


def duckiebot(rng: np.random.Generator) -> Model:
    """Returns a robot: wheels, a board, a battery and a camera."""
    shell = pick(rng, BLUE, (60, 62, 70), (70, 140, 190))
    return [
        *(wheel(0.03, side * 0.057, 0.033, 0.009) for side in (-1, 1)),
        ball(-0.06, 0, 0.015, (0.015,) * 3, GREY),
        box(0, 0, 0.022, (0.18, 0.092, 0.024), shell),
        box(-0.02, 0, 0.046, (0.1, 0.07, 0.022), BLACK),
        box(-0.03, 0, 0.068, (0.085, 0.06, 0.018), vary(rng, (40, 110, 70))),
        box(0.068, 0, 0.046, (0.02, 0.06, 0.05), shell),
        box(0.08, 0, 0.086, (0.012, 0.03, 0.026), BLACK),
        ball(0.086, 0, 0.099, (0.004, 0.008, 0.008), GLASS),
        box(-0.02, 0, 0.086, (0.004, 0.004, 0.034), GREY),
        *(box(0.0895, side * 0.03, 0.028, (0.001, 0.014, 0.01), (255, 236, 170)) for side in (-1, 1)),
    ]


def _cars(length: float, width: float, high: float, radius: float) -> Model:
    places = [(forward, side) for forward in (-0.32, 0.32) for side in (-1, 1)]
    return [wheel(forward * length, side * (width / 2 - 0.014), radius, 0.014) for forward, side in places]


def bus(rng: np.random.Generator) -> Model:
    """Returns a bus with windows along its sides."""
    paint, length, width, high = pick(rng, (246, 190, 40), RED, BLUE, WHITE), 0.55, 0.171, 0.15
    windows = [
        box(forward, side * 0.0845, 0.082, (0.068, 0.003, 0.04), GLASS)
        for forward in np.linspace(-0.21, 0.19, 6)
        for side in (-1, 1)
    ]
    return [
        *_cars(length, width, high, 0.03),
        box(0, 0, 0.018, (length - 0.004, width - 0.003, high - 0.024), paint),
        box(0, 0, high - 0.006, (length - 0.05, width - 0.03, 0.006), vary(rng, WHITE, 0.05)),
        *windows,
        box(0.2735, 0, 0.07, (0.003, 0.145, 0.055), GLASS),
        box(-0.2735, 0, 0.085, (0.003, 0.12, 0.035), GLASS),
        box(0, 0, 0.052, (length + 0.0005, width, 0.008), vary(rng, BLACK)),
        *(box(0.274, side * 0.06, 0.03, (0.002, 0.022, 0.014), (255, 240, 190)) for side in (-1, 1)),
        *(box(-0.274, side * 0.06, 0.03, (0.002, 0.022, 0.014), RED) for side in (-1, 1)),
    ]


def truck(rng: np.random.Generator) -> Model:
    """Returns a cab and a load."""
    cab, load, length, width = pick(rng, RED, BLUE, GREEN, ORANGE), pick(rng, WHITE, GREY, WOOD), 0.363, 0.157
    tall = rng.uniform(0.185, 0.2)
    return [
        *_cars(length, width, 0.2, 0.032),
        box(0, 0, 0.03, (length, width - 0.03, 0.014), BLACK),
        box(-0.05, 0, 0.044, (length - 0.1, width, 0.2 - 0.044), load),
        box(0.135, 0, 0.03, (0.09, width - 0.012, tall - 0.06), cab),
        box(0.1795, 0, 0.1, (0.003, width - 0.03, tall - 0.145), GLASS),
        *(box(0.148, side * 0.0722, 0.1, (0.045, 0.002, tall - 0.15), GLASS) for side in (-1, 1)),
        *(box(0.18, side * 0.055, 0.044, (0.003, 0.022, 0.014), (255, 240, 190)) for side in (-1, 1)),
        *(box(-0.1805, side * 0.06, 0.05, (0.002, 0.02, 0.012), RED) for side in (-1, 1)),
    ]


def tree(rng: np.random.Generator) -> Model:
    """Returns a spruce or a tree with a round crown."""
    leaves, wide = pick(rng, GREEN, (84, 140, 58), (40, 100, 66)), 0.071
    trunk = cone(0, 0, 0, (0.013, 0.01), 0.12, vary(rng, WOOD))
    if rng.integers(2):
        steps = ((0.05, 1.0, 0.1), (0.1, 0.8, 0.09), (0.15, 0.6, 0.1))
        return [
            trunk,
            *(cone(0, 0, low, (wide * share, 0.003), high, vary(rng, leaves, 0.06)) for low, share, high in steps),
        ]
    crown = [ball(0, 0, 0.17, (0.058, 0.058, 0.08), leaves)]
    for angle in rng.uniform(0, 6.3, 5):
        place = 0.028 * np.cos(angle), 0.028 * np.sin(angle), rng.uniform(0.13, 0.2)
        crown.append(ball(*place, (0.04, 0.04, 0.038), vary(rng, leaves, 0.08)))
    return [trunk, *crown]


def _windows(x: float, y: float, low: float, high: float, count: tuple[int, int], side: str) -> Model:
    across, levels = count
    places = [((index + 0.5) / across - 0.5, level) for index in range(across) for level in range(levels)]
    tall = (high - low) / levels
    solids = []
    for share, level in places:
        z = low + (level + 0.25) * tall
        for sign in (-1, 1):
            centre, sides = (
                ((sign * x / 2, share * y), (0.004, 0.5 * y / across, 0.5 * tall))
                if side == "x"
                else ((share * x, sign * y / 2), (0.5 * x / across, 0.004, 0.5 * tall))
            )
            solids.append(box(*centre, z, sides, GLASS))
    return solids


def house(rng: np.random.Generator) -> Model:
    """Returns a house with a gabled roof."""
    length, width, eaves = 0.36, 0.48, 0.17
    wall, tiles = (
        pick(rng, (226, 205, 170), (200, 120, 96), WHITE, (168, 186, 200)),
        pick(rng, (150, 62, 50), (90, 84, 90)),
    )
    return [
        box(0, 0, 0, (length, width, eaves), wall),
        roof(0, 0, eaves, (0.406, 0.528, 0.3 - eaves), tiles),
        box(-0.1, 0.14, 0.2, (0.04, 0.04, 0.08), vary(rng, (140, 80, 66))),
        *_windows(length, width, 0.03, 0.16, (4, 1), "x"),
        *_windows(length, width, 0.03, 0.16, (3, 1), "y"),
        box(0.1805, 0, 0, (0.006, 0.06, 0.11), vary(rng, WOOD)),
    ]


def building(rng: np.random.Generator) -> Model:
    """Returns a block of several storeys."""
    wall = pick(rng, (190, 178, 160), (150, 160, 172), (196, 150, 120))
    levels = int(rng.integers(4, 7))
    return [
        box(0, 0, 0, (0.53, 0.35, 0.48), wall),
        box(0, 0, 0.48, (0.534, 0.354, 0.01), vary(rng, GREY)),
        box(0.1, 0.05, 0.488, (0.12, 0.1, 0.012), vary(rng, GREY)),
        *_windows(0.53, 0.35, 0.07, 0.47, (4, levels), "x"),
        *_windows(0.53, 0.35, 0.07, 0.47, (6, levels), "y"),
        box(0.2655, 0, 0, (0.004, 0.07, 0.06), vary(rng, WOOD)),
    ]


def traffic_light(rng: np.random.Generator) -> Model:
    """Returns a post with three lamps to each of its four sides."""
    del rng
    lamps = ((0.35, RED), (0.31, (70, 66, 50)), (0.27, (46, 70, 54)))
    return [
        box(0, 0, 0, (0.097, 0.086, 0.012), GREY),
        cone(0, 0, 0.012, (0.012, 0.01), 0.22, GREY),
        box(0, 0, 0.232, (0.06, 0.06, 0.168), BLACK),
        *(ball(side * 0.03, 0, z, (0.007, 0.016, 0.016), colour) for side in (-1, 1) for z, colour in lamps),
        *(ball(0, side * 0.03, z, (0.016, 0.007, 0.016), colour) for side in (-1, 1) for z, colour in lamps),
    ]


def checkerboard(rng: np.random.Generator) -> Model:
    """Returns a board for calibration on a foot."""
    del rng
    u, v = np.meshgrid(np.arange(128), np.arange(128))
    face = np.where((((u // 16) + (v // 16)) % 2)[..., None] > 0, 245, 25).astype(np.uint8).repeat(3, axis=2)
    return [box(0, 0, 0, (0.171, 0.12, 0.01), WOOD), board(0.01, 0.171, 0.16, face)]


def sign(name: str) -> Maker:
    """Returns the maker of a sign: a board of 6.5 cm with the picture above, and one of a tag below, on a stick."""

    def make(rng: np.random.Generator) -> Model:
        del rng
        return [
            cone(0, 0, 0, (0.028, 0.026), 0.008, WOOD),
            cone(-0.006, 0, 0, (0.004, 0.004), 0.17, WOOD),
            board(0.036, 0.072, 0.072, tag_face()),
            board(0.108, 0.183 if name == "street_name" else 0.072, 0.072, sign_face(name)),
        ]

    return make


def tag_face(border: int = 4) -> NDArray[np.uint8]:
    """Draws a board with AprilTag 0, of 80 pixels, in a white border."""
    tag = draw_tag(0).repeat(10, axis=0).repeat(10, axis=1)
    return np.repeat(np.pad(tag, border, constant_values=255)[..., None], 3, axis=2)


_TURNS = {"left_T_intersect": "NSW", "right_T_intersect": "NES", "T_intersect": "ESW", "4_way_intersect": "NESW"}
_ARROWS = {"oneway_left": "W", "oneway_right": "E", "no_left_turn": "W"}
_ARROWS |= {"no_right_turn": "E"}
_ENDS = {"N": (96, 30), "E": (162, 96), "S": (96, 162), "W": (30, 96)}


def sign_face(name: str) -> NDArray[np.uint8]:
    """Draws the picture of a sign, uint8 ``[192, 192, 3]``."""
    face = np.full((192, 192, 3), WHITE, np.uint8)
    middle = (96, 96)
    angles = np.radians(np.arange(8) * 45 + 22.5)
    octagon = np.rint(96 + 88 * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.int32)
    if name == "street_name":
        face = np.full((192, 488, 3), GREEN, np.uint8)
        _write(face, "STREET", 1.5)
        face = np.asarray(cv2.resize(face, (192, 192), interpolation=cv2.INTER_AREA), np.uint8)
    elif name == "stop":
        cv2.fillPoly(face, [octagon], RED)
        _write(face, "STOP", 0.86)
    elif name in _TURNS:
        cv2.fillPoly(face, [np.array([[96, 2], [190, 96], [96, 190], [2, 96]], np.int32)], YELLOW)
        for side in _TURNS[name]:
            cv2.line(face, middle, tuple(48 + part // 2 for part in _ENDS[side]), BLACK, 20)
    elif name in _ARROWS:
        cv2.rectangle(face, (6, 50), (186, 142), BLUE, -1)
        x, y = _ENDS[_ARROWS[name]]
        cv2.arrowedLine(face, (192 - x, y), (x, y), WHITE, 16, tipLength=0.35)
        if name.startswith("no"):
            cv2.circle(face, middle, 84, RED, 14)
            cv2.line(face, (38, 38), (154, 154), RED, 14)
    elif name == "yield":
        cv2.fillPoly(face, [np.array([[6, 20], [186, 20], [96, 180]], np.int32)], RED)
        cv2.fillPoly(face, [np.array([[46, 44], [146, 44], [96, 132]], np.int32)], WHITE)
    elif name == "do_not_enter":
        cv2.circle(face, middle, 88, RED, -1)
        cv2.rectangle(face, (32, 78), (160, 114), WHITE, -1)
    elif name == "t_light_ahead":
        cv2.fillPoly(face, [np.array([[96, 2], [190, 96], [96, 190], [2, 96]], np.int32)], YELLOW)
        cv2.rectangle(face, (72, 44), (120, 148), BLACK, -1)
        for y, colour in ((62, RED), (96, ORANGE), (130, (60, 190, 90))):
            cv2.circle(face, (96, y), 14, colour, -1)
    elif name == "parking":
        cv2.rectangle(face, (8, 8), (184, 184), BLUE, -1)
        _write(face, "P", 4.6)
    elif name in ("pedestrian", "duck_crossing"):
        cv2.fillPoly(face, [np.array([[96, 2], [190, 96], [96, 190], [2, 96]], np.int32)], YELLOW)
        if name == "pedestrian":
            cv2.circle(face, (96, 56), 12, BLACK, -1)
            for start, end in (
                ((96, 68), (96, 112)),
                ((96, 112), (76, 146)),
                ((96, 112), (116, 146)),
                ((72, 88), (120, 88)),
            ):
                cv2.line(face, start, end, BLACK, 10)
        else:
            cv2.ellipse(face, (90, 116), (40, 24), 0, 0, 360, BLACK, -1)
            cv2.circle(face, (118, 80), 20, BLACK, -1)
            cv2.line(face, (132, 84), (152, 84), BLACK, 8)
    return face


def _write(face: NDArray[np.uint8], text: str, scale: float) -> None:
    size, _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 2 * scale, round(9 * min(scale, 2)))
    place = (face.shape[1] // 2 - size[0] // 2, 96 + size[1] // 2)
    cv2.putText(face, text, place, cv2.FONT_HERSHEY_SIMPLEX, 2 * scale, WHITE, round(9 * min(scale, 2)), cv2.LINE_AA)


class Kind(NamedTuple):
    """How a kind is drawn.

    Attributes:
      make: its model.
      variants: how many.
      views: from how many sides, evenly around it; 1 for what is round.
      height: of the model, if it is not the kind's usual height.
    """

    make: Maker
    variants: int = 1
    views: int = 1
    height: float | None = None


KINDS = {
    "duckie": Kind(duckie, 4, 8),
    "cone": Kind(traffic_cone, 4),
    "barrier": Kind(barrier, 3, 8),
    "duckiebot": Kind(duckiebot, 2, 8),
    "bus": Kind(bus, 4, 8, 0.15),
    "truck": Kind(truck, 4, 8),
    "tree": Kind(tree, 4),
    "house": Kind(house, 2, 8, 0.3),
    "building": Kind(building, 2, 8, 0.5),
    "trafficlight": Kind(traffic_light, 1, 8),
    "checkerboard": Kind(checkerboard, 1, 8),
    "other": Kind(lambda rng: [box(0, 0, 0, (0.1, 0.1, 0.1), GREY)], 1, 8),
    **{name: Kind(sign(name.removeprefix("sign_")), 1, 8) for name in OBJECT_KINDS if name.startswith("sign_")},
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("draw_objects", __doc__)
    out = Path(__file__).parents[2] / "objects"
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help="folder of objects; default objects")
    options = parser.parse_args(arguments)
    return run("draw_objects", lambda: draw_all(options.out))


def draw_all(folder: Path, kinds: Sequence[str] = (*KINDS, "floor_tag"), first: int = 1) -> None:
    """Draws the variants of some kinds from a first number on into a folder; from 1 on those of objects/."""
    for index, kind in enumerate(OBJECT_KINDS):
        if kind not in kinds:
            continue
        size, drawn = OBJECT_KINDS[kind], KINDS.get(kind, Kind(lambda rng: []))
        for variant in range(first, first + drawn.variants):
            place = folder / f"{kind}_{variant}"
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir(parents=True)
            pictures = {"top": np.dstack([tag_face(8), np.full((96, 96), 255, np.uint8)])}
            if size.height:
                model = drawn.make(np.random.default_rng([index, variant]))
                pictures = _views(model, kind, drawn)
            for name, pixels in pictures.items():
                file = place / f"{name}.png"
                if not cv2.imwrite(str(file), cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGRA), _SMALL):
                    raise OSError(f"{file}: could not be written")
            about = f'kind = "{kind}"\nheight = {size.height}\nfootprint = [{size.length}, {size.width}]\n'
            about += "tag = [0.072, 0.065]\n" * kind.startswith("sign_") + "tag = [0, 0.054]\n" * (not size.height)
            (place / "object.toml").write_text(about, encoding="utf-8")


def _views(model: Model, kind: str, drawn: Kind) -> dict[str, NDArray[np.uint8]]:
    size = OBJECT_KINDS[kind]
    height = drawn.height or size.height
    length, width = (side / 2 * height / size.height for side in (size.length, size.width))
    pictures = {}
    for azimuth in range(0, 360, 360 // drawn.views):
        a = np.radians(azimuth)
        wide = length if size.is_round else abs(np.sin(a)) * length + abs(np.cos(a)) * width
        metre = min(ROWS / height, ROWS / wide)
        pictures[f"image_{azimuth}" if azimuth else "image"] = view(model, azimuth, (-wide, wide, 0, height), metre)
    metre = ROWS / 2 / max(length, width)
    return pictures | {"top": view(model, None, (-length, length, -width, width), metre)}


_SMALL = [cv2.IMWRITE_PNG_COMPRESSION, 9]

if __name__ == "__main__":
    leave(main())
