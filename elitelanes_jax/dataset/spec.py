"""The specification of a dataset, and the numbers of maps of each size and split.

This module needs neither JAX nor OpenCV.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import floor, prod
from pathlib import Path
from typing import Self, TypeVar

from elitelanes_jax._util.checks import (
    SEED,
    TILE_PX,
    instance,
    is_whole,
    none_or,
    one_of,
    path,
    whole,
)
from elitelanes_jax._util.engine import part_of
from elitelanes_jax._util.errors import InputError, quote, show_words
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.dataset._transforms import (
    STANDARD,
    Transforms,
    for_camera,
    parse_transforms,
    range_ends,
)
from elitelanes_jax.drive.camera_options import LaneCamera, parse_camera
from elitelanes_jax.maps.furnishing.spec import FurnishSpec, parse_furnish
from elitelanes_jax.maps.given import GivenMaps, parse_given
from elitelanes_jax.maps.spec import SPLITS, parse_part, parse_split
from elitelanes_jax.network.checks import LONGEST_SIDE
from elitelanes_jax.search.resolve import plain_spec
from elitelanes_jax.search.spec import SearchSpec

V = TypeVar("V")

# The default search of a dataset.
_USUAL_SEARCH = SearchSpec(evaluations=100_000)

LAYOUTS = ("imagefolder", "coco", "webdataset", "parquet")
"""The layouts of a dataset's folder."""

# The layouts without a file for each picture.
_SHARDS = ("webdataset", "parquet")

# The longest side that OpenCV warps, and the most pixels that Pillow reads.
_LONGEST_SIDE, _MOST_PIXELS = 32_766, 178_956_970

Sides = tuple[tuple[int, int], ...]
"""The smallest and the largest side: once for squares, or for rows and for columns."""


def parse_sides(size: UserValue) -> Sides:
    """Reads sizes of maps.

    A size is a side in tiles or a range such as ``8..14``, for squares, or two of them, of rows and
    of columns. Two are in a sequence or one text, ``8..10 12``. A range may also be a pair.
    """
    ranges = size
    # The command line gives a text, and Python may give a number or pairs.
    if isinstance(size, str):
        ranges = size.split()
    elif is_whole(size):
        ranges = [size]
    if not isinstance(ranges, Sequence) or len(ranges) not in (1, 2):
        raise InputError(
            "", "a range of sides such as 8..14, or two, of rows and columns", show_words(size)
        )
    return tuple(_parse_range(each) for each in ranges)


def _parse_range(text: UserValue) -> tuple[int, int]:
    """Reads a side, or the smallest and the largest one: ``8``, ``8..14`` or a pair."""
    sides = [whole(2, LONGEST_SIDE)(end) for end in range_ends(text)]
    if len(sides) not in (1, 2) or sides[0] > sides[-1]:
        raise InputError("", "the smallest and the largest side, such as 8..14", quote(text))
    return sides[0], sides[-1]


@dataclass(frozen=True)
class DatasetSpec(Record):
    """A dataset. For more different maps, more runs help, but longer runs hardly do.

    Attributes:
      maps: number of maps
      size: sides of the maps in tiles, such as 8..14 for squares, or 8..10 12..14 for rows and
        columns
      split: shares of the maps for training, validation and test
      views: pictures of each map, each with other tile pictures, in another view
      format: layout: imagefolder, coco, webdataset or parquet
      transforms: how views of the maps vary: none, standard, varied, quarter-turns,
        rotation=DEGREES, scale=LOW..HIGH, perspective=SHARE, crop=PIXELS, light=, contrast=,
        colour=SHARE, blur=PIXELS, noise=LEVELS, background=, shadow=, vignette=, gamma=,
        saturation=, warmth=SHARE, motion=PIXELS, compression=SHARE; by default standard
      camera: views from a robot on the lanes instead of views from above: alone, or with
        rows=PIXELS, columns=PIXELS, offset=TILES, heading=DEGREES, height=METRES, forward=METRES,
        pitch=DEGREES, field_of_view=DEGREES, distortion=K1,K2, wobble=SHARE, lines=TILES
      seed: seed of everything random
      maps_from: files or folders of maps, or lists of maps such as the explorer saves, to draw
        instead of evolving maps; they determine the number of maps and the sizes
      search: the search
      tiles: folder of the tile pictures; by default the package's own
      furnish: objects for each view: all, signs, or amounts such as duckies=6 trees=0.2; by default
        those of given maps
      objects: folder of the pictures of the maps' objects; by default the package's own
      tile_px: side of a tile in pixels; by default 64, with a camera 256
      part: draw only a part of the maps, such as 3/10; elitelanes merge joins the parts
    """

    maps: int = option(1000, whole(1), "N")
    size: Sides = option(((8, 14),), parse_sides, "SIDES", many=True)
    split: tuple[float, float, float] = option(
        (0.8, 0.1, 0.1), parse_split, ("TRAIN", "VALIDATION", "TEST")
    )
    views: int = option(1, whole(1), "N")
    format: str = option("imagefolder", one_of(*LAYOUTS), "NAME")
    transforms: Transforms = option(
        STANDARD, parse_transforms, "NAME[=VALUE]", flag="transform", many=True
    )
    camera: LaneCamera | None = option(None, none_or(parse_camera), "NAME=VALUE", many="*")
    seed: int = option(0, SEED, "N")
    maps_from: GivenMaps | None = option(None, none_or(parse_given), "FILE|DIR", many=True)
    search: SearchSpec = option(_USUAL_SEARCH, instance(SearchSpec))
    tiles: Path | None = option(None, none_or(path), "DIR")
    furnish: FurnishSpec | None = option(None, none_or(parse_furnish), "WHAT", many=True)
    objects: Path | None = option(None, none_or(path), "DIR")
    tile_px: int | None = option(None, none_or(TILE_PX), "N")
    part: tuple[int, int] | None = option(None, none_or(parse_part), "K/N")

    def check_together(self) -> None:
        """Checks the options that depend on each other.

        These are the number of maps, sizes and splits, the camera, and the size of the pictures.
        """
        # Given maps determine the number and the sizes, which the other checks need.
        if self.maps_from is not None:
            self._take_given(self.maps_from)
        shapes = self.shapes
        # Every size has at least one map, so that the sizes are those that the user asked for.
        if self.maps < len(shapes):
            raise InputError("maps", f"one of each size at least, {len(shapes)}", self.maps)
        for name, share, count in zip(SPLITS, self.split, maps_by_split(self), strict=True):
            if share and not count:
                few, got = "maps", str(self.maps)
                if self.maps_from is not None:
                    few = "maps_from"
                    got += self.maps_from.describe_left_out()
                expected = f"enough for one in the split {name}, {share:g} of them"
                raise InputError(few, expected, got, "a split of 1 0 0 trains on all")
        # This raises an error if the transforms do not fit a camera.
        ranges = self.ranges
        if self.part is not None and self.part[1] > self.maps:
            raise InputError("part", f"at most {self.maps} parts, one for each map", self.part[1])
        if self.part is not None and self.format in _SHARDS:
            raise InputError("part", "a format with a file for each picture", self.format)
        # The size of the pictures follows from all options above.
        self._check_pixels()
        # Every crop has to be within the smallest map at the smallest scale.
        low = min(map(min, shapes))
        smallest = low * self.pixels * min(1.0, ranges.scale[0])
        if ranges.crop > smallest:
            raise InputError(
                "transforms",
                (
                    f"a crop within the smallest maps, {low} tiles of {self.pixels} pixels at the "
                    f"smallest scale, {smallest:g} pixels"
                ),
                ranges.crop,
            )

    def replace(self, **values: UserValue) -> Self:
        """Returns the record with new values in some fields.

        If maps were given, `maps` and `size` are determined anew: by the given maps, or by the
        defaults without them.
        """
        # The values of the earlier given maps would otherwise count as the user's own.
        if self.maps_from is not None:
            values = {"maps": DatasetSpec.maps, "size": DatasetSpec.size} | values
        return super().replace(**values)

    def _take_given(self, given: GivenMaps) -> None:
        """Sets the number and the sizes of given maps."""
        usual = _USUAL_SEARCH.options
        # Given maps are not searched for. An option of a search would be ignored.
        names = [name for name, value in self.search.options.items() if usual.get(name) != value]
        if names:
            got = ", ".join(names)
            raise InputError(
                "maps_from", "no options of a search, which given maps do not need", got
            )
        heights, widths = zip(*given.sizes, strict=True)
        # Squares have one range of sides. Otherwise rows and columns have one each.
        size: Sides = ((min(heights), max(heights)),)
        if heights != widths:
            size = (*size, (min(widths), max(widths)))
        self._take("maps", len(given.maps), str)
        self._take("size", size, describe_sides)

    def _take(self, name: str, value: V, tell: Callable[[V], str]) -> None:
        """Sets an option to that of the given maps.

        The user may have given the same value, or none.
        """
        asked = getattr(self, name)
        # A class has the defaults of its fields.
        if asked not in (getattr(DatasetSpec, name), value):
            raise InputError(name, f"that of the given maps, {tell(value)}", tell(asked))
        # The record is frozen, also for its own checks.
        object.__setattr__(self, name, value)

    def _check_pixels(self) -> None:
        """Checks that the pictures can be made and read again."""
        name = "size" if self.tile_px is None else "tile_px"
        # A view may need the whole map in one picture, also with a camera or a crop.
        side = max(map(max, self.shapes)) * self.pixels
        if side > _LONGEST_SIDE:
            raise InputError(name, f"maps of at most {_LONGEST_SIDE} pixels a side", side)
        # A crop is the whole picture. A camera's picture has a size of its own.
        area = self.ranges.crop**2 or max(map(prod, self.shapes)) * self.pixels**2
        if area > _MOST_PIXELS and self.camera is None:
            expected = (
                f"pictures of at most {_MOST_PIXELS} pixels, because Pillow reads no larger ones"
            )
            raise InputError(name, expected, area)

    @property
    def pixels(self) -> int:
        """The side of a tile in pixels: the given one, or a default.

        The default is 64, or 256 with a camera, which comes close to tiles.
        """
        return self.tile_px or (64 if self.camera is None else 256)

    @property
    def ranges(self) -> Transforms:
        """The ranges of the views: `transforms`, with a camera those of light and pixels alone."""
        return self.transforms if self.camera is None else for_camera(self.transforms)

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """(height, width) of the maps, in order."""
        if self.maps_from is not None:
            return self.maps_from.sizes
        # A range includes its largest side.
        rows = range(self.size[0][0], self.size[0][1] + 1)
        if len(self.size) == 1:
            return [(side, side) for side in rows]
        columns = range(self.size[1][0], self.size[1][1] + 1)
        return list(product(rows, columns))

    @property
    def map_indices(self) -> range:
        """The indices of the maps to draw: all, or those of the part."""
        index, count = self.part or (1, 1)
        return part_of(self.maps, index - 1, count)

    def to_plain(self) -> dict[str, UserValue]:
        """Returns plain values for JSON, without the part; for given maps their digest."""
        values = self.values()
        del values["part"]
        return values | {
            "maps_from": self.maps_from and self.maps_from.digest,
            "transforms": self.ranges.values(),
            "camera": self.camera and self.camera.values(),
            "search": plain_spec(self.search),
            "tiles": self.tiles and str(self.tiles),
            "furnish": self.furnish and self.furnish.settings(),
            "objects": self.objects and str(self.objects),
        }


def describe_sides(size: Sequence[Sequence[int]]) -> str:
    """Returns the sizes of maps in words, such as 8 x 8 to 14 x 14.

    If rows and columns vary apart, the words are 3 to 5 x 3 to 4.
    """
    if len(size) == 2 and all(low < high for low, high in size):
        # Given maps may be 3 x 4 and 5 x 3. Then no map has the fewest rows and the fewest columns.
        return " x ".join(f"{low} to {high}" for low, high in size)
    least, most = (f"{size[0][end]} x {size[-1][end]}" for end in (0, 1))
    return least if least == most else f"{least} to {most}"


def maps_by_shape(spec: DatasetSpec) -> dict[tuple[int, int], int]:
    """Returns the number of maps of each size."""
    # The first sizes get one map more if the number cannot be divided evenly.
    least, more = divmod(spec.maps, len(spec.shapes))
    return {shape: least + (index < more) for index, shape in enumerate(spec.shapes)}


def maps_by_split(spec: DatasetSpec) -> tuple[int, int, int]:
    """Returns the number of maps in each split: its share of all maps, rounded."""
    # Halves are rounded up. Python's `round` would round them to even numbers.
    validation, test = (floor(spec.maps * share + 0.5) for share in spec.split[1:])
    # Both roundings together may exceed the number of maps.
    test = min(test, spec.maps - validation)
    return spec.maps - validation - test, validation, test
