"""The commands ``elitelanes export`` and ``elitelanes show``."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from elitelanes_jax._util.checks import ends_as_file, name, none_or, path, real
from elitelanes_jax._util.errors import InputError, pluralize, shorten
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.cli.arguments import Commands, add_options, checked_by, naming_options, read_options
from elitelanes_jax.cli.program import say, warn

if TYPE_CHECKING:
    from elitelanes_jax.formats.road_map import RoadMap

# Formats import slow modules when they run.


class _Files(NamedTuple):
    """The files of a map: a text for each suffix of the format, and the warnings of another program."""

    texts: tuple[str, ...]
    warnings: tuple[str, ...] = ()


class _Format(NamedTuple):
    """A format with files for each map: their suffixes, the function that makes their texts, and its options."""

    suffixes: tuple[str, ...]
    files: Callable[..., _Files]
    takes: tuple[str, ...] = ()


def _duckietown(road_map: "RoadMap", **settings: UserValue) -> _Files:
    from elitelanes_jax.formats.duckietown import to_duckietown

    return _Files((to_duckietown(road_map.codes, objects=road_map.objects, **settings),))


def _dt_maps(road_map: "RoadMap", **settings: UserValue) -> _Files:
    from elitelanes_jax.formats.dt_maps import to_dt_maps

    return _Files(tuple(to_dt_maps(road_map, **settings).values()))


def _graphml(road_map: "RoadMap", reduced: bool) -> _Files:
    from elitelanes_jax.formats.graph import reduced_graph, tile_graph, to_graphml

    return _Files((to_graphml((reduced_graph if reduced else tile_graph)(road_map.codes)),))


def _sumo(road_map: "RoadMap", to: str, **measures: UserValue) -> _Files:
    from elitelanes_jax.formats.sumo import Streets, network, plain_xml

    streets = Streets(**{"tile" if key == "tile_size" else key: value for key, value in measures.items()})
    if to == "plain":
        return _Files(plain_xml(road_map.codes, streets))
    text, warnings = network(road_map.codes, to, streets)
    return _Files((text,), tuple(f"netconvert: {line.removeprefix('Warning: ')}" for line in warnings))


_STREETS = ("tile_size", "lane", "speed", "right_of_way")
_DT_MAPS = (
    *("/frames.yaml", "/tile_maps.yaml", "/tiles.yaml", "/traffic_signs.yaml", "/ground_tags.yaml", "/citizens.yaml"),
    *("/vehicles.yaml", "/decorations.yaml"),
)
_PLAIN = (".nod.xml", ".edg.xml", ".con.xml")

# By the names that --to takes: the formats of a map, and those of tables.
FORMATS = {
    "duckietown": _Format((".yaml",), _duckietown, ("tile_size", "ground", "dead_ends")),
    "dt-maps": _Format(_DT_MAPS, _dt_maps, ("tile_size",)),
    "graphml": _Format((".graphml",), partial(_graphml, reduced=False)),
    "graphml-reduced": _Format((".graphml",), partial(_graphml, reduced=True)),
    "sumo": _Format((".net.xml",), partial(_sumo, to="net"), _STREETS),
    "sumo-plain": _Format(_PLAIN, partial(_sumo, to="plain"), _STREETS),
    "opendrive": _Format((".xodr",), partial(_sumo, to="opendrive"), _STREETS),
}
TABLES = ("json", "csv")

# Every format can hold this map: an error with it is one of a setting or a missing package.
_LOOP = [[6, 3], [12, 9]]

_MOST_WARNINGS = 3

_metres = none_or(real(0, unit="metres, a number", exclusive=True))
_name = none_or(name)


@dataclass(frozen=True)
class _FormatOptions(Record):
    """Settings of some formats.

    Attributes:
      tile_size: side of a tile; by default 0.585, as Duckietown has it, or 30 for networks
      ground: kind of Duckietown's cells without a road: grass (the default), floor, asphalt, empty
      dead_ends: grass: remove roads that lead nowhere, for Duckietown; by default they are refused
      lane: width of a network's lanes; by default 3.2
      speed: limit in a network, in metres a second; by default 8.33
      right_of_way: at a network's crossings: allway_stop (the default), priority, right_before_left, traffic_light
    """

    tile_size: float | None = option(None, _metres, "METRES")
    ground: str | None = option(None, _name, "KIND")
    dead_ends: str | None = option(None, _name, "HOW")
    lane: float | None = option(None, _metres, "METRES")
    speed: float | None = option(None, none_or(real(0)), "M/S")
    right_of_way: str | None = option(None, _name, "HOW")


def add_export(commands: Commands) -> None:
    """Adds the command ``export`` to a parser's commands."""
    command = commands.add_parser(
        "export",
        help="maps for other programs, or a table of their metrics",
        description="Writes maps for other programs: Duckietown's map files, graphs, networks, tables of metrics.",
    )
    command.add_argument(
        "maps", type=checked_by(path), nargs="+", metavar="MAP", help="a map.json, or a map of Duckietown, .yaml"
    )
    command.add_argument(
        "--to", type=checked_by(name), required=True, metavar="FORMAT", help=", ".join((*FORMATS, *TABLES))
    )
    command.add_argument(
        "--out",
        type=checked_by(path),
        required=True,
        metavar="PATH",
        help="a new file, if it ends as the one of the format does or is a table; else a folder, new or empty",
    )
    add_options(command, _FormatOptions())
    command.set_defaults(action=_export)


def _export(options: argparse.Namespace) -> int:
    from elitelanes_jax.formats.road_map import RoadMap, read_map

    if options.to not in (*FORMATS, *TABLES):
        raise InputError(f"--to: expected one of {', '.join((*FORMATS, *TABLES))}, got {shorten(repr(options.to))}")
    settings = {key: value for key, value in vars(read_options(options, _FormatOptions())).items() if value is not None}
    for key in settings:
        able = [to for to, known in FORMATS.items() if key in known.takes]
        if options.to not in able:
            flag = f"--{key.replace('_', '-')}"
            raise InputError(f"{flag}: expected it with {', '.join(able)} alone, got it with {options.to}")
    seen: set[str] = set()
    for file in options.maps:
        if os.path.realpath(file) in seen:
            raise InputError(f"{file}: expected each map once, got it twice")
        seen.add(os.path.realpath(file))
    target = FORMATS.get(options.to)
    if target:
        with naming_options(_FormatOptions(), tile="--tile-size"):
            target.files(RoadMap(np.array(_LOOP, np.int8)), **settings)
    maps = [read_map(file) for file in options.maps]
    grids = [road_map.codes for road_map in maps]
    if target:
        _warn(_write_maps(options.maps, maps, target, settings, options.out))
    else:
        _write_new(options.out, _table(options.to, list(map(str, options.maps)), grids))
    lines = [f"{pluralize(len(grids), 'map')} in {options.out}"]
    if settings.get("dead_ends") == "grass":
        lines.append(_left_out(grids))
    say("\n".join(lines))
    return 0


def _write_maps(
    files: Sequence[Path], maps: "Sequence[RoadMap]", target: _Format, settings: dict[str, UserValue], out: Path
) -> list[str]:
    """Writes the files of maps, to a file or a folder; returns the warnings."""
    from elitelanes_jax._util.files import write_atomic
    from elitelanes_jax._util.folders import output_folder

    warnings: list[str] = []

    def texts(file: Path, road_map: "RoadMap") -> tuple[str, ...]:
        try:
            made = target.files(road_map, **settings)
        except InputError as error:
            raise InputError(f"{file}: {error}".replace("dead_ends='grass'", "--dead-ends grass")) from None
        warnings.extend(f"{file}: {warning}" for warning in made.warnings)
        return made.texts

    only = target.suffixes[0] if len(target.suffixes) == 1 else None
    if only and out.name.lower().endswith(only):
        if len(maps) > 1:
            raise InputError(f"--out: expected a folder for {len(maps)} maps, got a file, {out}")
        _write_new(out, *texts(files[0], maps[0]))
    elif ends_as_file(out):
        expected = f"a folder, or a file that ends in {only}" if only else "a folder"
        raise InputError(f"--out: expected {expected}, got {out}")
    else:
        places = _places(files)
        with output_folder(out, {"command": "export"}) as work:
            for file, road_map, place in zip(files, maps, places, strict=True):
                for suffix, text in zip(target.suffixes, texts(file, road_map), strict=True):
                    (work.files / (place + suffix)).parent.mkdir(exist_ok=True)
                    write_atomic(work.files / (place + suffix), text.encode())
    return warnings


def _places(files: Sequence[Path]) -> list[str]:
    """Returns a file name for each map, without suffix: the part of its path that differs, 0003 of 0003/map.json."""
    stems = [Path(os.path.normpath(file.absolute())).with_suffix("") for file in files]
    stems = [stem.parent if stem.name == "map" else stem for stem in stems]
    root = os.path.commonpath([stem.parent for stem in stems])
    places = ["-".join(stem.relative_to(root).parts) for stem in stems]
    first: dict[str, Path] = {}
    for file, place in zip(files, places, strict=True):
        if first.setdefault(place, file) is not file:
            raise InputError(f"{file}: expected maps of different names, got two for {place}")
    return places


def _write_new(file: Path, text: str) -> None:
    from elitelanes_jax._util.files import check_new, write_atomic

    check_new(file)
    write_atomic(file, text.encode(errors="surrogateescape"))  # a table has names of files, whatever they are made of


def _warn(warnings: Sequence[str]) -> None:
    for warning in warnings[:_MOST_WARNINGS]:
        warn(f"elitelanes: {shorten(warning, 200)}")
    if len(warnings) > _MOST_WARNINGS:
        warn(f"elitelanes: {_MOST_WARNINGS} of {len(warnings)} warnings shown")


def _left_out(grids: Sequence[AnyArray]) -> str:
    from elitelanes_jax.formats.duckietown import without_dead_ends

    tiles = sum(int((codes != 0).sum()) for codes in grids)
    left = sum(int((without_dead_ends(codes) != 0).sum()) for codes in grids)
    return f"{tiles - left} of {tiles} tiles left out: roads that lead nowhere"


def _table(to: str, names: Sequence[str], grids: Sequence[AnyArray]) -> str:
    from elitelanes_jax.formats.table import measure_maps, table_to_csv, table_to_json

    return (table_to_csv if to == "csv" else table_to_json)(measure_maps(names, grids))


def add_show(commands: Commands) -> None:
    """Adds the command ``show`` to a parser's commands."""
    command = commands.add_parser("show", help="draw a map in the terminal, with its metrics")
    command.add_argument("map", type=checked_by(path), metavar="MAP", help="a map.json, or a map of Duckietown, .yaml")
    command.set_defaults(action=_show)


def _show(options: argparse.Namespace) -> int:
    import textwrap

    from elitelanes_jax.formats.road_map import read_map
    from elitelanes_jax.formats.table import measure_maps
    from elitelanes_jax.formats.text import draw_text

    codes = read_map(options.map).codes
    (figures,) = measure_maps([str(options.map)], [codes])
    drawn = draw_text(codes)
    try:
        drawn.encode(getattr(sys.stdout, "encoding", None) or "ascii")
    except UnicodeEncodeError:
        drawn = draw_text(codes, ascii_only=True)
    words = [f"{figures.pop('height')} x {figures.pop('width')} tiles"]
    words += [f"{key.replace('_', ' ')} {round(value, 3)}" for key, value in figures.items() if key != "file"]
    say(drawn + "\n\n" + "\n".join(textwrap.wrap(", ".join(words), 100)), asked=True)
    return 0
