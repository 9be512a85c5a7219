"""Pictures of gym-duckietown at random poses on lanes, with labels and lane poses, in a file.

    python -m experiments.perception.gym_duckietown.pictures {development,test} --out FILE [--style NAME] [--poses N]
        [--no-labels]

Pictures of test maps serve for figures alone. Those of development maps serve to train a network on gym-duckietown's
own pictures, which shows the limit. A network that finds lane poses needs no labels, and pictures without them take a
third of the time.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, UInt8
from numpy.typing import NDArray

from elitelanes_jax import load_tiles
from elitelanes_jax.drive import Camera, Pose, Sight, lane_pose, look, make_sight
from elitelanes_jax.tiles import TileSet, choose_tiles, propose_masks
from experiments.common import Parser, leave, run, whole
from experiments.perception.gym_duckietown.nets import COLUMNS, ROWS
from experiments.perception.gym_duckietown.world import DuckietownMap, World, data_folder, random_poses, read_maps

__all__ = [
    "CLASSES",
    "KINDS",
    "STYLES",
    "TILE",
    "TILE_KINDS",
    "Pictures",
    "classes_of",
    "label_tiles",
    "main",
    "our_views",
    "read_pictures",
    "shrink",
    "take",
]

STYLES = ("photos", "synthetic")
KINDS = ("straight", "curve", "crossing")

TILE = 0.585
"""The side of a tile in metres."""

CLASSES = ("beyond", "road", "stop line", "separator", "white line")
"""The classes of gym-duckietown's label pictures, in `LABELS`' order, and white lines."""

_COLOURS = np.array(  # the last one is beyond the tiles, see `bridge`
    [(127, 127, 127), (0, 0, 0), (255, 0, 0), (255, 255, 0), (255, 255, 255), (255, 0, 255)]
)

TILE_KINDS = ("straight", "curve_left", "curve_right", "3way_left", "3way_right", "4way")
"""The kinds of tiles with a road, as gym-duckietown names them."""

_BRIGHT = 130  # of the darkest channel: asphalt is darker, and white tape is not

_CURVATURES = np.array([-1 / 0.3, 0, 1 / 0.7], np.float32)  # of a right turn, straight on, a left turn, in 1 / tiles
_PORTION = 16  # poses of one request: larger pictures are not kept

Reduce = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]


class Pictures(NamedTuple):
    """Pictures of gym-duckietown. The first three fields are those of `train.Views`.

    Attributes:
      images: uint8 ``[N, 120, 160, 3]``.
      labels: uint8 ``[N, 120, 160]``, indices of `LABELS`, of the map without objects.
      lanes: float32 ``[N, 3]``, gym-duckietown's lane pose in tiles and radians, and our curvature in 1 / tiles.
      ours: float32 ``[N, 2]``, our lane pose at the same pose.
      kinds: uint8 ``[N]``, indices of `KINDS`.
      objects: bool ``[N]``, whether the map has objects.
      white: bool ``[N, 120, 160]``, white lines, which are background in the labels.
      fitting: uint8 ``[N, 120, 160]``, labels from our masks of the style's own tiles, where the pictures show them.
      fitting_white: bool ``[N, 120, 160]``, the white lines of these labels.
    """

    images: UInt8[NDArray, "N 120 160 3"]
    labels: UInt8[NDArray, "N 120 160"]
    lanes: Float[NDArray, "N 3"]
    ours: Float[NDArray, "N 2"]
    kinds: UInt8[NDArray, " N"]
    objects: NDArray[np.bool_]
    white: Bool[NDArray, "N 120 160"]
    fitting: UInt8[NDArray, "N 120 160"]
    fitting_white: Bool[NDArray, "N 120 160"]


def classes_of(images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns the indices in `CLASSES`, uint8 ``[...]``, of pictures of labels ``[..., 3]``: the nearest colour."""
    found = np.zeros(images.shape[:-1], np.uint8)
    nearest = np.full(images.shape[:-1], np.inf, np.float32)
    for index, colour in enumerate(_COLOURS):
        away = ((images.astype(np.float32) - colour) ** 2).sum(axis=-1)
        found[away < nearest] = index % len(CLASSES)
        nearest = np.minimum(nearest, away)
    return found


def shrink(images: UInt8[NDArray, "N 480 640 3"]) -> UInt8[NDArray, "N 120 160 3"]:
    """Scales pictures to the size that the networks see, by area."""
    small = [cv2.resize(image, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA) for image in images]
    return np.stack(small).astype(np.uint8)


def take(world: World, place: DuckietownMap, style: str, count: int, seed: int, *, labels: bool = True) -> Pictures:
    """Takes pictures of a map at random poses. Poses where gym-duckietown finds no lane are left out.

    Without `labels`, all labels are 0.
    """
    poses = random_poses(place.codes, count, seed)
    near = jax.vmap(partial(lane_pose, place.codes))(Pose(*poses.T.astype(np.float32)))
    codes = place.codes[np.floor(poses[:, 1]).astype(int), np.floor(poses[:, 0]).astype(int)]
    ways = np.array([int(code).bit_count() for code in codes])
    kinds = np.where(ways > 2, 2, np.where(np.isin(codes, (5, 10)), 0, 1)).astype(np.uint8)
    images, lane, objects = _look(world, place, style, poses, shrink)
    if labels:
        classes, white = _look_at_labels(world, place, poses, {})
        fitting, fitting_white = _look_at_labels(world, place, poses, label_tiles(style))
    else:
        classes = fitting = np.zeros(images.shape[:-1], np.uint8)
        white = fitting_white = np.zeros(images.shape[:-1], bool)
    lanes = np.column_stack([lane / (TILE, 1), _CURVATURES[np.asarray(near.movement.turn)]]).astype(np.float32)
    ours = np.column_stack([near.d, near.phi]).astype(np.float32)
    found = np.isfinite(lanes).all(axis=1)
    taken = Pictures(images, classes, lanes, ours, kinds, np.full(count, objects), white, fitting, fitting_white)
    return Pictures(*(np.compress(found, part, axis=0) for part in taken))


@cache
def label_tiles(style: str) -> dict[str, UInt8[NDArray, "H W 3"]]:
    """Draws a picture of labels for each kind of tile, from our masks of the style's picture of it.

    Bright pixels outside of the masks are white lines.
    """
    drawn = {}
    for kind in TILE_KINDS:
        file = data_folder() / "textures" / "tiles-processed" / style / kind / "texture.jpg"
        image = np.asarray(cv2.imread(str(file)))[..., ::-1].copy()
        classes = np.where(image.min(axis=-1) > _BRIGHT, CLASSES.index("white line"), 0)
        masks = propose_masks(image)
        for label, name in enumerate(("road", "red", "yellow"), start=1):
            classes[masks[name]] = label
        # Larger pixels: OpenGL mixes neighbouring ones, and a mixed colour may be that of a third class.
        drawn[kind] = np.kron(_COLOURS[classes].astype(np.uint8), np.ones((4, 4, 1), np.uint8))
    return drawn


def _look_at_labels(
    world: World, place: DuckietownMap, poses: Float[NDArray, "N 3"], tiles: dict[str, NDArray[np.uint8]]
) -> tuple[UInt8[NDArray, "N 120 160"], Bool[NDArray, "N 120 160"]]:
    """Returns labels and white lines, of gym-duckietown's own pictures of labels or of other ones for `tiles`."""
    # Nearest pixels, as our labels are.
    labels, *_ = _look(world, place, "labels", poses, lambda seen: classes_of(seen[:, 2::4, 2::4]), tiles)
    white = labels == CLASSES.index("white line")
    labels[white] = 0
    return labels, white


def _look(
    world: World,
    place: DuckietownMap,
    style: str,
    poses: Float[NDArray, "N 3"],
    reduce: Reduce,
    tiles: dict[str, NDArray[np.uint8]] | None = None,
) -> tuple[NDArray[np.uint8], Float[NDArray, "N 2"], bool]:
    """Returns reduced pictures, lane poses, and whether the map has objects. `tiles` replaces pictures of tiles."""
    about = world.load(place, style=style, **(tiles or {}))
    images, lanes = [], []
    for first in range(0, len(poses), _PORTION):
        answer = world.ask("look", poses=poses[first : first + _PORTION])
        images.append(reduce(answer["image"]))
        lanes.append(answer["lane"])
    return np.concatenate(images), np.concatenate(lanes), len(about["objects"]) > 0


def our_views(
    codes: NDArray[np.int8], poses: Float[NDArray, "N 3"], tiles: TileSet | None = None
) -> UInt8[NDArray, "N 480 640 3"]:
    """Draws our camera's pictures at poses, by default with the package's own tiles."""
    tiles = load_tiles() if tiles is None else tiles
    sight, chosen = make_sight(tiles, tile_px=384), choose_tiles(codes, tiles)
    return np.asarray(_look_from(Pose(*poses.T.astype(np.float32)), codes, sight, chosen))


@jax.jit
def _look_from(
    poses: Pose, codes: Int[ArrayLike, "H W"], sight: Sight, chosen: Int[ArrayLike, "H W 2"]
) -> UInt8[Array, "N 480 640 3"]:
    """Draws our camera's pictures at poses. A program serves all maps of a size."""
    sight = sight._replace(camera=Camera(rows=480, columns=640))  # its numbers are constants of the program
    return jax.vmap(lambda pose: look(pose, codes, sight, chosen=chosen).image)(poses)


def read_pictures(file: Path) -> Pictures:
    """Reads the file of `main`."""
    with np.load(file) as arrays:
        return Pictures(*(arrays[name] for name in Pictures._fields))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("pictures", __doc__)
    parser.add_argument("part", choices=("development", "test"))
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".npz")
    parser.add_argument("--style", choices=STYLES, default="photos")
    parser.add_argument("--poses", type=whole(1, 10_000), default=30, metavar="N", help="on each map; default 30")
    parser.add_argument("--only", choices=("people", "towns"), help="people's maps, or our towns; default both")
    parser.add_argument("--no-labels", dest="labels", action="store_false", help="draw no labels; all are 0")
    options = parser.parse_args(arguments)
    return run("pictures", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    with World() as world:
        maps = read_maps(options.part, options.only)
        take_from = partial(take, world, style=options.style, count=options.poses, labels=options.labels)
        parts = [take_from(place, seed=index) for index, place in enumerate(maps)]
    pictures = Pictures(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(options.out, **pictures._asdict())
    print(f"{len(pictures.images)} pictures of {len(maps)} maps in {options.out}")


if __name__ == "__main__":
    leave(main())
