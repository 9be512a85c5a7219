"""Object sets: folders with pictures of what stands on maps.

An object set has a folder for each object, such as ``duckie_1``. Each has

- ``object.toml``: ``kind``, one of `OBJECT_KINDS`; ``height`` and ``footprint = [length, width]``,
  in metres; optional ``tag = [middle, side]``, for an AprilTag in front: how high its middle is,
  and the side of its black square;
- ``image.png``: the object from its front, with transparency. Its lowest row is the floor, its top
  row the height, and its middle column the middle of the object. Tags on the floor, of height 0,
  have none;
- ``image_45.png`` and other numbers of degrees, 1 to 359, all optional: the object from other
  sides. The viewer stands this many degrees counter-clockwise from the object's front, as seen from
  above. The nearest view is drawn. With ``image.png`` alone all sides look the same;
- ``top.png``: the object from above, as large as the footprint, its front to the right. Without it,
  views from above show ``image.png``, lying on the floor, its top ahead.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from hashlib import sha256
from math import cos, degrees, radians
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    check_named,
    is_folder,
    is_real,
    listed,
    path,
    path_exists,
    whole,
)
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import read_toml
from elitelanes_jax._util.types import Plain, Untyped, UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import (
    OBJECT_KINDS,
    OPAQUE,
    MapObject,
    base_kind,
    check_kind,
    nearest_view,
)
from elitelanes_jax.formats.tags import LARGEST_TAG
from elitelanes_jax.tiles._lots import draw_lots
from elitelanes_jax.tiles.files import read_picture
from elitelanes_jax.tiles.pasting import Placed, paste

# The keys that object.toml needs, and the one that it may have.
_KEYS = ("kind", "height", "footprint")
_TAG = "tag"
# The largest height and footprint in metres.
_MOST = 10


@dataclass(frozen=True, eq=False)
class ObjectPictures:
    """The pictures of an object.

    Attributes:
      name: the name of its folder.
      kind: one of `OBJECT_KINDS`.
      height: metres from the lowest to the top row of the views.
      footprint: length and width in metres of the picture from above.
      tag: metres from the floor to the middle of its AprilTag, and the side of the tag's black
        square; None without.
      views: uint8 ``[rows, columns, 4]``, RGB and opacity, by degrees counter-clockwise from the
        front; sorted.
      top: uint8 ``[rows, columns, 4]``, from above, its front to the right.
    """

    name: str
    kind: str
    height: float
    footprint: tuple[float, float]
    tag: tuple[float, float] | None
    views: Mapping[int, NDArray[np.uint8]]
    top: NDArray[np.uint8]

    def __post_init__(self) -> None:
        """Copies the pictures, see `frozen_copy`."""
        views = {angle: frozen_copy(view) for angle, view in self.views.items()}
        object.__setattr__(self, "views", views)
        object.__setattr__(self, "top", frozen_copy(self.top))

    def view(self, angle: float) -> NDArray[np.uint8]:
        """Returns the view that is nearest to an angle.

        The angle is in radians counter-clockwise from the front.
        """
        return self.views[nearest_view(self.views, degrees(angle))]


@dataclass(frozen=True, eq=False)
class ObjectSet:
    """A set of pictures of objects.

    Attributes:
      name: the name of its folder.
      pictures: sorted by name.
    """

    name: str
    pictures: tuple[ObjectPictures, ...]

    def __post_init__(self) -> None:
        """Checks that the pictures are those of objects."""
        pictures = check_named("pictures", listed(ObjectPictures), self.pictures)
        object.__setattr__(self, "pictures", tuple(pictures))

    @cached_property
    def kinds(self) -> dict[str, tuple[ObjectPictures, ...]]:
        """The pictures of each kind in the set."""
        kinds: dict[str, tuple[ObjectPictures, ...]] = {}
        for pictures in self.pictures:
            kinds[pictures.kind] = (*kinds.get(pictures.kind, ()), pictures)
        return kinds

    @property
    def views_by_kind(self) -> dict[str, Mapping[int, NDArray[np.uint8]]]:
        """The views of the first object of each kind, by degrees.

        The cameras of `elitelanes_jax.drive` take them. They show kinds of one's own, such as
        "other:helicopter", as "other".
        """
        return {
            kind: pictures[0].views for kind, pictures in self.kinds.items() if kind in OBJECT_KINDS
        }

    @cached_property
    def digest(self) -> str:
        """A digest of all pictures and sizes."""
        digest = sha256()
        for pictures in self.pictures:
            about = pictures.name, pictures.kind, pictures.height, pictures.footprint, pictures.tag
            digest.update(repr(about).encode())
            for angle, pixels in (*pictures.views.items(), ("top", pictures.top)):
                digest.update(repr((angle, pixels.shape)).encode() + pixels.tobytes())
        return digest.hexdigest()[:16]

    def choose(
        self, objects: Sequence[MapObject], seed: int | list[int] = 0
    ) -> list[ObjectPictures]:
        """Chooses pictures for each object at random among those of its kind.

        If an object has an AprilTag, its pictures show it.

        Raises:
          InputError: for a kind without pictures in the set, or a seed that is not whole numbers.
        """
        lots = draw_lots(seed, (len(objects),))
        chosen = []
        for thing, lot in zip(objects, lots, strict=True):
            choices = self._of_kind(thing.kind)
            chosen.append(_with_own_tag(choices[int(lot * len(choices))], thing))
        return chosen

    def choices(self, thing: MapObject) -> list[ObjectPictures]:
        """Returns all pictures among which `choose` draws for an object.

        Raises:
          InputError: for a kind without pictures in the set.
        """
        return [_with_own_tag(pictures, thing) for pictures in self._of_kind(thing.kind)]

    def _of_kind(self, kind: str) -> tuple[ObjectPictures, ...]:
        choices = self.kinds.get(kind) or self.kinds.get(base_kind(kind))
        if not choices:
            known = ", ".join(self.kinds)
            raise InputError("objects", f"kinds that the set {self.name!r} has ({known})", kind)
        return choices


def _with_own_tag(pictures: ObjectPictures, thing: MapObject) -> ObjectPictures:
    return pictures if thing.tag is None else _with_tag(pictures, thing.tag)


# Painting a tag takes some milliseconds, and a town has the same tags in each of its views.
@lru_cache(maxsize=1024)
def _with_tag(pictures: ObjectPictures, number: int) -> ObjectPictures:
    """Returns the pictures of an object with an AprilTag of that number, where it has one."""
    if pictures.tag is None:
        return pictures
    middle, side = pictures.tag
    if not pictures.height:
        # The object is a tag on the floor.
        top = pictures.top
        # The pixels of a metre.
        metre = top.shape[1] / pictures.footprint[0]
        side_px = side * metre
        painted = _paint_tag(top, number, top.shape[0] / 2, side_px, side_px)
        return replace(pictures, top=painted)
    views = {}
    for angle, pixels in pictures.views.items():
        metre = pixels.shape[0] / pictures.height
        row = pixels.shape[0] - middle * metre
        # A tag that is seen from an angle is narrower. From behind it is not seen.
        wide = side * metre * cos(radians(angle))
        is_seen = wide > 1
        views[angle] = _paint_tag(pixels, number, row, side * metre, wide) if is_seen else pixels
    return replace(pictures, views=views)


@name_wrong_arguments
def draw_tag(number: UserValue) -> NDArray[np.uint8]:
    """Draws an AprilTag of the family 36h11, uint8 ``[8, 8]``, 0 or 255.

    The result is the black square of the tag, with one pixel for each bit.

    Raises:
      InputError: for a number that is not 0 to 586.
    """
    number = check_named("tag", whole(0, LARGEST_TAG), number)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    # OpenCV has the family upside down: only then is the first row of tag 0 the first six bits of
    # its code.
    return np.asarray(cv2.aruco.generateImageMarker(family, number, 8)[::-1, ::-1], np.uint8)


def _paint_tag(
    pixels: NDArray[np.uint8], number: int, row: float, high: float, wide: float
) -> NDArray[np.uint8]:
    """Paints an AprilTag around the middle column of a picture.

    White is as bright as the brightest pixels of the tag that it replaces.
    """
    left, top = (pixels.shape[1] - wide) / 2, row - high / 2
    old = pixels[round(top) : round(top + high), round(left) : round(left + wide), :3]
    white = np.percentile(old, 95, axis=(0, 1)) if old.size else np.full(3, 255)
    # Eight pixels for each bit keep the edges of bits sharp when the tag is interpolated.
    tag = np.repeat(draw_tag(number), 8, axis=0).repeat(8, axis=1)
    colours = tag[..., None] / 255 * white
    picture = np.dstack([colours, np.full(tag.shape, 255)]).astype(np.uint8)
    place = np.array([[wide / len(tag), 0, left], [0, high / len(tag), top], [0, 0, 1]])
    painted = np.ascontiguousarray(pixels[..., :3])
    paste(painted, [Placed(picture, place)])
    return np.dstack([painted, pixels[..., 3]])


def lay_flat(thing: MapObject, pictures: ObjectPictures, tile_px: int) -> Placed:
    """Places an object on a map as seen from above, in pixels of the rendered map.

    `tile_px` is the side of a tile in pixels.
    """
    rows, columns = pictures.top.shape[:2]
    # The pixels of a metre.
    scale = tile_px / TILE_SIZE
    # An object of another height than its pictures is larger or smaller as a whole.
    if pictures.height:
        scale *= thing.height / pictures.height
    # The picture is centred, scaled, turned counter-clockwise as seen, and moved.
    centre = np.array([[1, 0, -columns / 2], [0, 1, -rows / 2], [0, 0, 1]])
    size = np.diag(
        [pictures.footprint[0] * scale / columns, pictures.footprint[1] * scale / rows, 1]
    )
    cosine, sine = np.cos(thing.angle), np.sin(thing.angle)
    turn = np.array(
        [[cosine, sine, thing.x * tile_px], [-sine, cosine, thing.y * tile_px], [0, 0, 1]]
    )
    return Placed(pictures.top, turn @ size @ centre)


def lay_all_flat(
    objects: Sequence[MapObject], pictures: Sequence[ObjectPictures], tile_px: int
) -> tuple[list[Placed], list[int]]:
    """Places the objects of a map as `lay_flat` does, the lowest object first.

    Returns the placed objects and their indices on the map.
    """
    order = sorted(range(len(objects)), key=lambda index: objects[index].height)
    return [lay_flat(objects[index], pictures[index], tile_px) for index in order], order


@name_wrong_arguments
def default_objects() -> Path:
    """Returns the folder of the object set that comes with the package."""
    # An installed package has the pictures next to this file. A checkout has them in its top
    # folder.
    installed = Path(__file__).parent / "objects"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "objects"


@cache
def _default_set() -> ObjectSet:
    return _load(default_objects())


@name_wrong_arguments
def load_objects(folder: ObjectSet | str | Path | None = None) -> ObjectSet:
    """Loads an object set.

    Args:
      folder: the folder of the set, or a loaded set, which is returned; by default the package's
        own.

    Raises:
      InputError: for a fault of the folder; the message names the file.
    """
    if isinstance(folder, ObjectSet):
        return folder
    if folder is None:
        return _default_set()
    return _load(check_named("objects", path, folder))


def _load(folder: Path) -> ObjectSet:
    if not is_folder(folder):
        got = "a file" if path_exists(folder) else "none"
        raise InputError(folder, "a folder of objects", got)
    # A folder with one of these files was meant as an object, and is refused without the other.
    object_folders: set[Path] = set()
    for name in ("image.png", "object.toml"):
        object_folders.update(file.parent for file in folder.glob(f"*/{name}"))
    if not object_folders:
        raise InputError(folder, "folders with object.toml and image.png, such as duckie_1", "none")
    pictures = tuple(_load_pictures(object_folder) for object_folder in sorted(object_folders))
    return ObjectSet(folder.resolve().name, pictures)


def _load_pictures(folder: Path) -> ObjectPictures:
    about = _read_about(folder / "object.toml")
    files = _view_files(folder)
    if about.height and 0 not in files:
        raise InputError(folder, "image.png, the view from the front", "none")
    views = {angle: _read(files[angle]) for angle in sorted(files)}
    footprint, above = about.footprint, folder / "top.png"
    if above.is_file():
        top = _read(above)
    elif about.height:
        # Without a picture from above, the front lies on the floor with its top ahead.
        front = views[0]
        footprint = about.height, about.height * front.shape[1] / front.shape[0]
        top = np.rot90(front, -1)
    else:
        raise InputError(folder, "top.png, as the height is 0", "none")
    return ObjectPictures(folder.name, about.kind, about.height, footprint, about.tag, views, top)


def _view_files(folder: Path) -> dict[int, Path]:
    """Returns the files of views, by degrees.

    Any other name is an error, because the view would never be drawn, or be drawn for two numbers.
    """
    views = {0: folder / "image.png"} if (folder / "image.png").is_file() else {}
    for file in sorted(folder.glob("image_*.png")):
        number = re.fullmatch(r"image_([1-9][0-9]{0,2})", file.stem)
        if number is None or int(number[1]) > 359:
            expected = "views image_1.png to image_359.png"
            raise InputError(folder, expected, file.name, "rename other pictures")
        views[int(number[1])] = file
    return views


class _About(NamedTuple):
    """What object.toml says, see `ObjectPictures`."""

    kind: str
    height: float
    footprint: tuple[float, float]
    tag: tuple[float, float] | None


def _read_about(file: Path) -> _About:
    about = read_toml(file, str(file))
    known_keys = (*_KEYS, _TAG)
    # Of unknown and missing keys, the first one in the alphabet is named.
    for key in sorted({*about, *_KEYS}):
        if key not in known_keys:
            known = ", ".join(known_keys)
            raise InputError(file, f"the keys {known}", quote(key))
        if key not in about:
            raise InputError(file, f"the keys {', '.join(_KEYS)}", f"no {key}")
    kind = check_named(str(file), check_kind, about["kind"])
    height: Untyped = about["height"]
    is_flat = OBJECT_KINDS[base_kind(kind)].height == 0
    # Tags on the floor have height 0, and all other objects are higher.
    if is_flat and not (is_real(height) and height == 0):
        raise InputError(f"{file}: height", "0 for tags on the floor", quote(height, 40))
    if not is_flat and not (is_real(height) and 0 < height <= _MOST):
        raise InputError(f"{file}: height", f"metres over 0, to {_MOST}", quote(height, 40))
    footprint = _read_pair(about["footprint"])
    if footprint is None or not all(0 < side <= _MOST for side in footprint):
        got = quote(about["footprint"], 40)
        raise InputError(f"{file}: footprint", "[length, width] in metres", got)
    tag = None
    if _TAG in about:
        tag = _read_pair(about[_TAG])
        if tag is None or not (0 <= tag[0] <= _MOST and 0 < tag[1] <= _MOST):
            raise InputError(f"{file}: tag", "[middle, side] in metres", quote(about[_TAG], 40))
    return _About(kind, float(height), footprint, tag)


def _read_pair(value: Plain) -> tuple[float, float] | None:
    """Returns a list of two numbers; None for anything else."""
    if not isinstance(value, list) or len(value) != 2 or not all(map(is_real, value)):
        return None
    return float(value[0]), float(value[1])


def _read(file: Path) -> NDArray[np.uint8]:
    problems: list[str] = []
    picture = read_picture(file, problems)
    if problems:
        raise InputError("", "", problems[0])
    if picture is None:
        # A folder or a link that leads nowhere has the name of a view.
        raise InputError(file, "a PNG file", "none")
    if picture.ndim != 3 or picture.shape[2] != 4 or not (picture[..., 3] >= OPAQUE).any():
        raise InputError(
            file, "a picture with transparency and some pixels that are opaque", "one without"
        )
    return picture
