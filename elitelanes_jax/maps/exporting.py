"""The formats that maps are exported to: for each its files, and the settings that it takes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from elitelanes_jax._util.checks import name, none_or, path, real, whole
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.road_map import RoadMap

if TYPE_CHECKING:
    from elitelanes_jax.formats.objects import Standing
    from elitelanes_jax.formats.streets import Streets
    from elitelanes_jax.tiles.tileset import TileSet

# Formats import slow modules when they run.


class Files(NamedTuple):
    """The files of a map.

    Attributes:
      contents: a text or bytes for each suffix of the format.
      warnings: of another program.
    """

    contents: tuple[str | bytes, ...]
    warnings: tuple[str, ...] = ()


def as_bytes(content: str | bytes) -> bytes:
    """Returns the bytes of a file; names of files in a table may have bytes that are not UTF-8."""
    return content.encode(errors="surrogateescape") if isinstance(content, str) else content


class Format(NamedTuple):
    """A format with files for each map.

    Attributes:
      suffixes: of the files.
      files: (map, name of its files without suffix, settings) -> the files.
      takes: the settings of `FormatOptions` that it has.
    """

    suffixes: tuple[str, ...]
    files: Callable[..., Files]
    takes: tuple[str, ...] = ()


def _duckietown(road_map: RoadMap, name: str, **settings: UserValue) -> Files:
    from elitelanes_jax.formats.duckietown import to_duckietown

    return Files((to_duckietown(road_map.codes, objects=road_map.objects, **settings),))


def _dt_maps(road_map: RoadMap, name: str, **settings: UserValue) -> Files:
    from elitelanes_jax.formats.dt_maps import to_dt_maps

    return Files(tuple(to_dt_maps(road_map, **settings).values()))


def _graphml(road_map: RoadMap, name: str, reduced: bool) -> Files:
    from elitelanes_jax.formats.graph import reduced_graph, tile_graph, to_graphml

    return Files((to_graphml((reduced_graph if reduced else tile_graph)(road_map.codes)),))


def _sumo(road_map: RoadMap, name: str, **measures: UserValue) -> Files:
    from elitelanes_jax.formats.sumo import network

    text, warnings = network(road_map, _streets(measures))
    return Files((text,), tuple(f"netconvert: {line.removeprefix('Warning: ')}" for line in warnings))


def _sumo_plain(road_map: RoadMap, name: str, **measures: UserValue) -> Files:
    from elitelanes_jax.formats.sumo import plain_xml

    return Files(plain_xml(road_map, _streets(measures)))


def _network(road_map: RoadMap, name: str, to: str, **measures: UserValue) -> Files:
    from elitelanes_jax import formats

    return Files((getattr(formats, f"to_{to}")(road_map, _streets(measures)),))


def _streets(measures: dict[str, UserValue]) -> "Streets":
    from elitelanes_jax.formats.streets import Streets

    return Streets(**{"tile" if key == "tile_size" else key: value for key, value in measures.items()})


@cache
def _tiles(folder: Path | None) -> "TileSet":
    from elitelanes_jax.tiles.tileset import load_tiles

    return load_tiles(folder)


def _floor(road_map: RoadMap, tiles: Path | None = None, tile_px: int = 64) -> tuple[bytes, "list[Standing]"]:
    """Returns the picture of a map with its tags, and the objects that stand on it."""
    from elitelanes_jax.tiles.rendering import png_of, render, stand

    objects = road_map.objects or ()
    tags = tuple(thing for thing in objects if not thing.height)
    image = render(replace(road_map, objects=tags), _tiles(tiles), tile_px=tile_px).image
    return png_of(image), stand(objects)


def _gltf(road_map: RoadMap, name: str, tile_size: float = TILE_SIZE, **drawn: UserValue) -> Files:
    from elitelanes_jax.formats.gltf import to_gltf

    picture, standing = _floor(road_map, **drawn)
    return Files((to_gltf(road_map.codes.shape, picture, tile_size, standing),))


def _mujoco(road_map: RoadMap, name: str, tile_size: float = TILE_SIZE, **drawn: UserValue) -> Files:
    from elitelanes_jax.formats.mujoco import to_mjcf

    picture, standing = _floor(road_map, **drawn)
    return Files((to_mjcf(road_map.codes, f"{name}.png", tile_size, standing), picture))


def _nav2(road_map: RoadMap, name: str, **settings: UserValue) -> Files:
    from elitelanes_jax.formats.nav2 import to_nav2

    return Files(to_nav2(road_map.codes, f"{name}.pgm", **settings))


def _movingai(road_map: RoadMap, name: str, **settings: UserValue) -> Files:
    from elitelanes_jax.formats.movingai import to_movingai

    return Files(to_movingai(road_map.codes, f"{name}.map", **settings))


_STREETS = ("tile_size", "lane", "speed", "right_of_way")
_DT_MAPS = (
    *("/frames.yaml", "/tile_maps.yaml", "/tiles.yaml", "/traffic_signs.yaml", "/ground_tags.yaml", "/citizens.yaml"),
    *("/vehicles.yaml", "/decorations.yaml"),
)
_PLAIN = (".nod.xml", ".edg.xml", ".con.xml")
_FLOOR = ("tile_size", "tiles", "tile_px")

FORMATS = {
    "duckietown": Format((".yaml",), _duckietown, ("tile_size", "ground", "dead_ends")),
    "dt-maps": Format(_DT_MAPS, _dt_maps, ("tile_size", "dead_ends")),
    "graphml": Format((".graphml",), partial(_graphml, reduced=False)),
    "graphml-reduced": Format((".graphml",), partial(_graphml, reduced=True)),
    "sumo": Format((".net.xml",), _sumo, _STREETS),
    "sumo-plain": Format(_PLAIN, _sumo_plain, _STREETS),
    "opendrive": Format((".xodr",), partial(_network, to="opendrive"), _STREETS),
    "lanelet2": Format((".osm",), partial(_network, to="lanelet2"), _STREETS),
    "commonroad": Format((".xml",), partial(_network, to="commonroad"), _STREETS),
    "gltf": Format((".glb",), _gltf, _FLOOR),
    "mujoco": Format((".xml", ".png"), _mujoco, _FLOOR),
    "nav2": Format((".pgm", ".yaml", ".geojson"), _nav2, ("tile_size", "cells")),
    "movingai": Format((".map", ".scen"), _movingai, ("cells",)),
}
"""The formats of a map, by the names that ``--to`` takes."""

LOOP = RoadMap(np.array([[6, 3], [12, 9]], np.int8))
"""A map that every format can hold: an error with it is one of a setting or a missing package."""

_metres = none_or(real(0, unit="metres, a number", exclusive=True))
_name = none_or(name)


@dataclass(frozen=True)
class FormatOptions(Record):
    """Settings of some formats.

    Attributes:
      tile_size: side of a tile; by default 0.585, as Duckietown has it, or 30 for networks
      ground: kind of Duckietown's cells without a road: grass (the default), floor, asphalt, empty
      dead_ends: grass: remove roads that lead nowhere, for Duckietown; by default they are refused
      lane: width of a network's lanes; by default 3.2
      speed: limit in a network, in metres a second; by default 8.33
      right_of_way: at a network's crossings: allway_stop (the default), priority, right_before_left, traffic_light
      tiles: folder of the tile pictures of a floor; by default the package's own
      tile_px: side of a tile in a floor's picture, in pixels; by default 64
      cells: cells of a robot's map along a tile's side, 5 or more; by default 39 for nav2, 5 for movingai
    """

    tile_size: float | None = option(None, _metres, "METRES")
    ground: str | None = option(None, _name, "KIND")
    dead_ends: str | None = option(None, _name, "HOW")
    lane: float | None = option(None, _metres, "METRES")
    speed: float | None = option(None, none_or(real(0)), "M/S")
    right_of_way: str | None = option(None, _name, "HOW")
    tiles: Path | None = option(None, none_or(path), "DIR")
    tile_px: int | None = option(None, none_or(whole(16, 512)), "N")
    cells: int | None = option(None, none_or(whole(5, 256)), "N")

    def given(self) -> dict[str, UserValue]:
        """Returns the settings that are not None, by name."""
        return {key: value for key, value in vars(self).items() if value is not None}
