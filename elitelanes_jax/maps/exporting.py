"""The formats that maps are exported to: for each its files, and the settings that it takes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypedDict, Unpack

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.checks import (
    SEED,
    TILE_PX,
    check_named,
    coordinates,
    is_real,
    nonblank,
    none_or,
    one_of,
    path,
    real,
    text_name,
    whole,
)
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import OptionValue, UserValue
from elitelanes_jax.formats.dt_maps import LAYERS
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import Standing
from elitelanes_jax.formats.road_map import RoadMap, as_map
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import LANE_OFFSET
from elitelanes_jax.maps.furnishing.signs import crossings

if TYPE_CHECKING:
    from elitelanes_jax.tiles.tileset import TileSet


class Format(NamedTuple):
    """A format with files for each map.

    Attributes:
      suffixes: the suffixes of the files.
      convert: (map, name of its files without suffix, settings) -> the content of each file.
      takes: the settings of `FormatOptions` that it has.
      limits: map -> what of the map the programs that read the format cannot use.
      prefix: the prefix of the names of the files.
      catalogue: (folder, the files of all maps in it) -> more files of the folder by name; None for
        a format without.
    """

    suffixes: tuple[str, ...]
    convert: Callable[..., str | bytes | Iterable[str | bytes]]
    takes: tuple[str, ...] = ()
    limits: Callable[[RoadMap], list[str]] = lambda road_map: []
    prefix: str = ""
    catalogue: Callable[[Path, list[Path]], dict[str, bytes]] | None = None

    def paths(self, name: str) -> list[str]:
        """Returns the path of each file of a map in its folder; `name` is theirs without suffix."""
        return [f"{self.prefix}{name}{suffix}" for suffix in self.suffixes]

    def files(self, road_map: RoadMap, name: str, **settings: UserValue) -> dict[str, bytes]:
        """Returns the content of each file of a map by its path; `name` is theirs without suffix.

        `settings` are those of one or several formats.
        """
        taken = {setting: value for setting, value in settings.items() if setting in self.takes}
        made = self.convert(road_map, name, **taken)
        contents = (made,) if isinstance(made, str | bytes) else made
        files: dict[str, bytes] = {}
        for file, content in zip(self.paths(name), contents, strict=True):
            files[file] = content.encode() if isinstance(content, str) else content
        return files


# At 256 pixels a tile the robot of MuJoCo sees lines with sharp edges. At 64 its picture differs
# three times as much from the one at 384, which is the size of the tiles' own pictures. A graphics
# card may refuse pictures with sides of over 8192 pixels.
_SHARP_PX, _MOST_PX, _LEAST_PX = 256, 8192, 16

# A format imports its modules when it runs: all formats together would take 40 ms.


def without_ends(road_map: RoadMap, dead_ends: str | None = None) -> RoadMap:
    """Returns a map, without roads that lead nowhere if `dead_ends` asks for it.

    Raises `InputError` if all roads of the map lead nowhere.
    """
    if dead_ends is None:
        return road_map
    from elitelanes_jax.formats.duckietown import without_dead_ends

    codes = without_dead_ends(road_map.codes)
    if road_map.codes.any() and not codes.any():
        tiles = np.count_nonzero(road_map.codes)
        raise InputError(
            "grid", "a road that forms a loop", f"{tiles} tiles, all on roads to dead ends"
        )
    return replace(road_map, codes=codes)


def _duckietown(road_map: RoadMap, name: str, dead_ends: str | None = None, **size: float) -> str:
    from elitelanes_jax.formats.duckietown import to_duckietown

    return to_duckietown(without_ends(road_map, dead_ends).codes, objects=road_map.objects, **size)


def _dt_maps(
    road_map: RoadMap, name: str, dead_ends: str | None = None, **size: float
) -> Iterable[str]:
    from elitelanes_jax.formats.dt_maps import to_dt_maps

    return to_dt_maps(without_ends(road_map, dead_ends), **size).values()


def _duckiematrix(
    road_map: RoadMap, name: str, dead_ends: str | None = None, **size: float
) -> Iterable[str]:
    from elitelanes_jax.formats.dt_maps import to_duckiematrix

    return to_duckiematrix(without_ends(road_map, dead_ends), **size).values()


def _without_lanes_of_sdk(road_map: RoadMap) -> list[str]:
    # Code 15 is the 4-way crossing.
    four_way = np.argwhere(road_map.codes == 15).tolist()
    if not four_way:
        return []
    return [
        f"duckietown-sdk 0.2.0 has no lanes on 4-way tiles, here {len(four_way)}, "
        f"the first at {describe_cell(*four_way[0])}; "
        "generate --where crossings4=0..0 makes maps without them"
    ]


class _Measures(TypedDict, total=False):
    """The settings of a format of streets, see `Streets`."""

    tile_size: float
    lane: float
    speed: float
    right_of_way: str
    origin: tuple[float, float]


def _sumo(road_map: RoadMap, name: str, **measures: Unpack[_Measures]) -> Iterable[str]:
    from elitelanes_jax.formats.sumo import to_sumo

    return to_sumo(road_map, name, Streets(**measures))


def _opendrive(road_map: RoadMap, name: str, **measures: Unpack[_Measures]) -> str:
    from elitelanes_jax.formats.opendrive import to_opendrive

    return to_opendrive(road_map, Streets(**measures), name=name)


def _lanelet2(road_map: RoadMap, name: str, **measures: Unpack[_Measures]) -> str:
    from elitelanes_jax.formats.lanelet2 import to_lanelet2

    return to_lanelet2(road_map, Streets(**measures))


def _commonroad(road_map: RoadMap, name: str, **measures: Unpack[_Measures]) -> str:
    from elitelanes_jax.formats.commonroad import to_commonroad

    return to_commonroad(road_map, Streets(**measures))


def _pufferdrive(
    road_map: RoadMap, name: str, traffic_seed: int = 0, **measures: Unpack[_Measures]
) -> Iterable[str | bytes]:
    from elitelanes_jax.formats.pufferdrive import to_pufferdrive

    return to_pufferdrive(road_map, name, Streets(**measures), seed=traffic_seed)


def _scenarionet(
    road_map: RoadMap, name: str, traffic_seed: int = 0, **measures: Unpack[_Measures]
) -> bytes:
    from elitelanes_jax.formats.scenarionet import to_scenarionet

    return to_scenarionet(road_map, name, Streets(**measures), seed=traffic_seed)


def _index_scenarios(folder: Path, files: list[Path]) -> dict[str, bytes]:
    from elitelanes_jax.formats.scenarionet import index_scenarios

    return index_scenarios(folder, files)


def _movingai(road_map: RoadMap, name: str, **cells: int) -> Iterable[str]:
    from elitelanes_jax.formats.movingai import to_movingai

    return to_movingai(road_map.codes, f"{name}.map", **cells)


def lane_offset_of(tiles: "TileSet | None") -> float:
    """Returns the `lane_offset` of a tile set. None stands for the package's own set."""
    return LANE_OFFSET if tiles is None else tiles.lane_offset


class _FloorSettings(TypedDict, total=False):
    """The settings of a format with a picture of the floor, see `FormatOptions`."""

    tile_size: float
    tiles: "TileSet"
    tile_px: int


def _floor(
    road_map: RoadMap, tiles: "TileSet | None" = None, tile_px: int | None = None, **size: float
) -> tuple[bytes, float, list[Standing]]:
    """Returns the picture of a map, the side of a tile, and the objects on the map.

    The picture shows the tags on the floor. The objects are those that stand on the map.
    """
    # Drawing needs OpenCV, which other formats do not wait for.
    from elitelanes_jax.tiles.rendering import png_of, render, standing_objects

    if tile_px is None:
        tile_px = max(_LEAST_PX, min(_SHARP_PX, _MOST_PX // max(road_map.codes.shape)))
    objects = road_map.objects or ()
    # Tags on the floor are part of the picture. Other objects stand on it.
    tags = tuple(thing for thing in objects if not thing.height)
    image = render(replace(road_map, objects=tags), tiles, tile_px=tile_px).image
    return png_of(image), size.get("tile_size", TILE_SIZE), standing_objects(objects)


def _gltf(road_map: RoadMap, name: str, **settings: Unpack[_FloorSettings]) -> bytes:
    from elitelanes_jax.formats.gltf import to_gltf

    picture, size, standing = _floor(road_map, **settings)
    return to_gltf(road_map.codes.shape, picture, size, standing)


def _mujoco(road_map: RoadMap, name: str, **settings: Unpack[_FloorSettings]) -> tuple[str, bytes]:
    from elitelanes_jax.formats.mujoco import to_mjcf

    picture, size, standing = _floor(road_map, **settings)
    lane_offset = lane_offset_of(settings.get("tiles"))
    return to_mjcf(road_map.codes, f"{name}.png", size, standing, lane_offset), picture


def _usd(road_map: RoadMap, name: str, **settings: Unpack[_FloorSettings]) -> tuple[str, bytes]:
    from elitelanes_jax.formats.usd import to_usd

    picture, size, standing = _floor(road_map, **settings)
    return to_usd(road_map.codes.shape, f"{name}.png", size, standing), picture


_STREETS = ("tile_size", "lane", "speed", "right_of_way", "origin")
# These formats have no place on earth.
_TRAFFIC = (*_STREETS[:-1], "traffic_seed")
_FLOOR = ("tile_size", "tiles", "tile_px")

FORMATS = {
    "duckietown": Format((".yaml",), _duckietown, ("tile_size", "dead_ends")),
    "dt-maps": Format(
        tuple(f"/{layer}.yaml" for layer in LAYERS), _dt_maps, ("tile_size", "dead_ends")
    ),
    "duckiematrix": Format(
        tuple(f"/{layer}.yaml" for layer in LAYERS),
        _duckiematrix,
        ("tile_size", "dead_ends"),
        _without_lanes_of_sdk,
    ),
    "sumo": Format((".nod.xml", ".edg.xml", ".con.xml", ".netccfg"), _sumo, _STREETS),
    "opendrive": Format((".xodr",), _opendrive, _STREETS),
    "lanelet2": Format((".osm",), _lanelet2, _STREETS),
    "commonroad": Format((".xml",), _commonroad, _STREETS),
    "pufferdrive": Format((".bin", ".json"), _pufferdrive, _TRAFFIC),
    "scenarionet": Format(
        (".pkl",), _scenarionet, _TRAFFIC, prefix="sd_", catalogue=_index_scenarios
    ),
    "gltf": Format((".glb",), _gltf, _FLOOR),
    "mujoco": Format((".xml", ".png"), _mujoco, _FLOOR),
    "usd": Format((".usda", ".png"), _usd, _FLOOR),
    "movingai": Format((".map", ".scen"), _movingai, ("cells",)),
}
"""The formats of a map, by the names that ``--to`` takes."""

LOOP = RoadMap(np.array([[6, 3], [12, 9]], np.int8))
"""A map that every format can hold: an error with it is one of a setting or a missing package."""

# Each format checks the range of its settings itself, so these checks are wide.
_metres = none_or(real(0, unit="metres, a number", exclusive=True))
_name = none_or(nonblank)


@dataclass(frozen=True)
class FormatOptions(Record):
    """Settings of some formats.

    Attributes:
      tile_size: side of a tile; by default 0.585, as Duckietown has it, or 30 for networks
      dead_ends: grass: remove roads that lead nowhere, in the formats of Duckietown, which refuse
        them by default
      lane: width of a network's lanes; by default 3.2
      speed: limit in a network, in metres a second; by default 8.33
      right_of_way: at a network's crossings: allway_stop (the default), priority,
        right_before_left, traffic_light
      origin: latitude and longitude of a network's south-west corner, in degrees; by default 0 9
      traffic_seed: seed of the cars of pufferdrive and scenarionet; by default 0
      tiles: folder of the tile pictures of a floor; by default the package's own
      tile_px: side of a tile in a floor's picture, in pixels; by default 256, or less over 32 tiles
        a side
      cells: cells of a robot's map along a tile's side, 5 to 256; by default 5
    """

    tile_size: float | None = option(None, _metres, "METRES")
    dead_ends: str | None = option(None, none_or(one_of("grass")), "HOW")
    lane: float | None = option(None, _metres, "METRES")
    speed: float | None = option(None, none_or(real(0)), "M/S")
    right_of_way: str | None = option(None, _name, "HOW")
    origin: tuple[float, float] | None = option(None, none_or(coordinates), ("LAT", "LON"))
    traffic_seed: int | None = option(None, none_or(SEED), "N")
    tiles: Path | None = option(None, none_or(path), "DIR")
    tile_px: int | None = option(None, none_or(TILE_PX), "N")
    cells: int | None = option(None, none_or(whole(5, 256)), "N")

    def chosen(self) -> dict[str, UserValue]:
        """Returns the settings that are not None, by name."""
        return {key: value for key, value in self.values().items() if value is not None}

    def loaded(self) -> dict[str, OptionValue]:
        """Returns the chosen settings with the tile set in place of its folder.

        Therefore all maps have equal tiles. Raises `InputError` for a bad tile set.
        """
        settings = self.chosen()
        if self.tiles is not None:
            from elitelanes_jax.tiles.tileset import load_tiles

            settings["tiles"] = load_tiles(self.tiles)
        return settings

    def limits(self, to: str, road_map: RoadMap, tiles: "TileSet | None" = None) -> list[str]:
        """Returns what a format cannot use of a map, of its pictures, or of a setting.

        `tiles` is the tile set that `loaded` returns. Without one, the package's own is used.
        """
        limits = list(FORMATS[to].limits(road_map))
        if road_map.drawn is not None and "tiles" in FORMATS[to].takes:
            from elitelanes_jax.tiles.rendering import describe_other_pictures
            from elitelanes_jax.tiles.tileset import own_tiles

            if line := describe_other_pictures(road_map, tiles or own_tiles()):
                limits.append(line)
        takes_rule = self.right_of_way is not None and "right_of_way" in FORMATS[to].takes
        if takes_rule and not crossings(road_map.codes):
            limits.append(
                f"no right of way {self.right_of_way} is written, because the map has no crossing"
            )
        return limits

    def check_taken_by(self, *names: str) -> None:
        """Checks that each setting is one of a format among the names; raises `InputError`."""
        for setting in self.chosen():
            able = [to for to, known in FORMATS.items() if setting in known.takes]
            # It is enough if one of the formats takes the setting.
            if not set(able) & set(names):
                with_them = f"with {', '.join(names)}" if names else "without a format"
                value = getattr(self, setting)
                numbers = value if isinstance(value, tuple) else (value,)
                got = " ".join(
                    f"{number:g}" if is_real(number) else str(number) for number in numbers
                )
                hint = f"this setting is for {', '.join(able)}"
                raise InputError(setting, f"none {with_them}", got, hint)


@name_wrong_arguments
def export(
    road_map: UserValue,
    to: str,
    options: FormatOptions = FormatOptions(),
    *,
    name: str = "map",
) -> dict[str, bytes]:
    """Returns the files of a map for another program, as the command ``elitelanes export`` writes.

    Args:
      road_map: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      to: a format of the command, except ``csv``: duckietown, dt-maps, duckiematrix, sumo,
        opendrive, lanelet2, commonroad, pufferdrive, scenarionet, gltf, mujoco, usd, movingai.
      options: settings of the format.
      name: the name of the files, without suffix. Some files name others, or their map.

    Returns:
      The content of each file, by its path in a folder. The same map gives the same bytes. For
      scenarionet the command also writes the files that `formats.scenarionet.index_scenarios`
      returns.

    Raises:
      InputError: for another format, a setting that the format does not have, a bad map, or a map
        that the format cannot hold; the message says which. Also if a package that the format
        needs is not installed.
    """
    target = FORMATS[check_named("to", one_of(*FORMATS), to)]
    options.check_taken_by(to)
    stem = check_named("name", text_name, name)
    return target.files(as_map(road_map), stem, **options.loaded())
