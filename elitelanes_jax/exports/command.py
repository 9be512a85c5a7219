"""The commands ``export`` and ``show``."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from elitelanes_jax.command import folder_name, metres, name, number, say
from elitelanes_jax.errors import InputError, short

__all__ = ["add_export", "add_show"]

# What is slow to import is imported by the formats that need it.


class _Files(NamedTuple):
    """What a map becomes: a text for each suffix of the format, and what another program had to say."""

    texts: tuple[str, ...]
    warnings: tuple[str, ...] = ()


class _Format(NamedTuple):
    """A format that has files for each map: their suffixes, what makes their texts, and the options that this takes."""

    suffixes: tuple[str, ...]
    files: Callable[..., _Files]
    takes: tuple[str, ...] = ()


def _duckietown(codes: Any, **settings: Any) -> _Files:
    from elitelanes_jax.exports.duckietown import to_duckietown

    return _Files((to_duckietown(codes, **settings),))


def _graphml(codes: Any, reduced: bool) -> _Files:
    from elitelanes_jax.exports.graph import reduced_graph, tile_graph, to_graphml

    return _Files((to_graphml((reduced_graph if reduced else tile_graph)(codes)),))


def _sumo(codes: Any, to: str, **measures: Any) -> _Files:
    from elitelanes_jax.exports.sumo import Streets, network, plain_xml

    streets = Streets(**{"tile" if key == "tile_size" else key: value for key, value in measures.items()})
    if to == "plain":
        return _Files(plain_xml(codes, streets))
    text, warnings = network(codes, to, streets)
    return _Files((text,), tuple(f"netconvert: {line.removeprefix('Warning: ')}" for line in warnings))


_STREETS = ("tile_size", "lane", "speed", "right_of_way")
_PLAIN = (".nod.xml", ".edg.xml", ".con.xml")

# By the names that --to takes: formats of a map, and of tables.
_FORMATS = {
    "duckietown": _Format((".yaml",), _duckietown, ("tile_size", "ground", "dead_ends")),
    "graphml": _Format((".graphml",), partial(_graphml, reduced=False)),
    "graphml-reduced": _Format((".graphml",), partial(_graphml, reduced=True)),
    "sumo": _Format((".net.xml",), partial(_sumo, to="net"), _STREETS),
    "sumo-plain": _Format(_PLAIN, partial(_sumo, to="plain"), _STREETS),
    "opendrive": _Format((".xodr",), partial(_sumo, to="opendrive"), _STREETS),
}
_TABLES = ("json", "csv")
_OPTIONS = dict.fromkeys(option for known in _FORMATS.values() for option in known.takes)

_ENDINGS = (".yml", ".xml", ".json", ".csv", *(suffix for known in _FORMATS.values() for suffix in known.suffixes))

# Every format can hold it: what is refused of it is a setting, or a package that is missing, and no fault of a map.
_LOOP = [[6, 3], [12, 9]]

_MOST_WARNINGS = 3


def add_export(commands: Any) -> None:
    """Adds the command ``export`` to a parser's commands."""
    command = commands.add_parser(
        "export",
        help="maps for other programs, or a table of their metrics",
        description="Writes maps for other programs: Duckietown's map files, graphs, networks, tables of metrics.",
    )
    command.add_argument(
        "maps", type=folder_name, nargs="+", metavar="MAP", help="a map.json, or a map of Duckietown, .yaml"
    )
    command.add_argument("--to", type=name, required=True, metavar="FORMAT", help=", ".join((*_FORMATS, *_TABLES)))
    command.add_argument(
        "--out",
        type=folder_name,
        required=True,
        metavar="PATH",
        help="a new file, if it ends as the one of the format does or is a table; else a folder, new or empty",
    )
    command.add_argument(
        "--tile-size",
        type=metres,
        metavar="METRES",
        help="side of a tile; by default 0.585, as Duckietown has it, or 30 for networks",
    )
    command.add_argument(
        "--ground",
        type=name,
        metavar="KIND",
        help="of Duckietown's cells without a road: grass (the default), floor, asphalt, empty",
    )
    command.add_argument(
        "--dead-ends",
        type=name,
        metavar="HOW",
        help="grass: take roads that lead nowhere back to the last crossing, for Duckietown; refuse them by default",
    )
    command.add_argument("--lane", type=metres, metavar="METRES", help="width of a network's lanes; by default 3.2")
    command.add_argument(
        "--speed", type=number, metavar="M/S", help="limit in a network, in metres a second; by default 8.33"
    )
    command.add_argument(
        "--right-of-way",
        type=name,
        metavar="HOW",
        help="at a network's crossings: allway_stop (the default), priority, right_before_left, traffic_light",
    )
    command.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> int:
    from elitelanes_jax.roadmap import read_map

    if options.to not in (*_FORMATS, *_TABLES):
        raise InputError(f"--to: expected one of {', '.join((*_FORMATS, *_TABLES))}, got {short(repr(options.to))}")
    settings = {key: getattr(options, key) for key in _OPTIONS if getattr(options, key) is not None}
    for key in settings:
        able = [to for to, known in _FORMATS.items() if key in known.takes]
        if options.to not in able:
            flag = f"--{key.replace('_', '-')}"
            raise InputError(f"{flag}: expected it with {', '.join(able)} alone, got it with {options.to}")
    seen: set[str] = set()
    for file in options.maps:
        if os.path.realpath(file) in seen:
            raise InputError(f"{file}: expected each map once, got it twice")
        seen.add(os.path.realpath(file))
    target = _FORMATS.get(options.to)
    if target:
        target.files(_LOOP, **settings)
    grids = [read_map(file).codes for file in options.maps]
    if target:
        _warn(_write_maps(options.maps, grids, target, settings, options.out))
    else:
        _write_new(options.out, _table(options.to, list(map(str, options.maps)), grids))
    lines = [f"{len(grids)} {'map' if len(grids) == 1 else 'maps'} in {options.out}"]
    if options.dead_ends == "grass":
        lines.append(_left_out(grids))
    say("\n".join(lines))
    return 0


def _write_maps(
    files: Sequence[Path], grids: Sequence[Any], target: _Format, settings: dict[str, Any], out: Path
) -> list[str]:
    """Writes what maps become, to a file or a folder; returns the warnings."""
    from elitelanes_jax.folders import new_folder, write_whole

    warnings: list[str] = []

    def texts(file: Path, codes: Any) -> tuple[str, ...]:
        try:
            made = target.files(codes, **settings)
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        warnings.extend(f"{file}: {warning}" for warning in made.warnings)
        return made.texts

    only = target.suffixes[0] if len(target.suffixes) == 1 else None
    if only and out.name.lower().endswith(only):
        if len(grids) > 1:
            raise InputError(f"--out: expected a folder for {len(grids)} maps, got a file, {out}")
        _write_new(out, *texts(files[0], grids[0]))
    elif out.name.lower().endswith(_ENDINGS):
        expected = f"a folder, or a file that ends in {only}" if only else "a folder"
        raise InputError(f"--out: expected {expected}, got {out}")
    else:
        places = _places(files)
        with new_folder(out) as folder:
            for file, codes, place in zip(files, grids, places, strict=True):
                for suffix, text in zip(target.suffixes, texts(file, codes), strict=True):
                    try:
                        write_whole(folder / (place + suffix), text.encode())
                    except OSError as error:  # names the folder as it is called before it is whole
                        raise OSError(error.errno, error.strerror, str(out / (place + suffix))) from None
    return warnings


def _places(files: Sequence[Path]) -> list[str]:
    """A file name for each map, but for its suffix: what tells it from the others, as 0003 does maps/0003/map.json."""
    stems = [Path(os.path.normpath(file.absolute())).with_suffix("") for file in files]
    stems = [stem.parent if stem.name == "map" else stem for stem in stems]
    root = os.path.commonpath([stem.parent for stem in stems])
    places = ["-".join(stem.relative_to(root).parts) for stem in stems]
    taken: dict[str, Path] = {}
    for file, place in zip(files, places, strict=True):
        if taken.setdefault(place, file) is not file:
            raise InputError(f"{file}: expected maps of different names, got two for {place}")
    return places


def _write_new(file: Path, text: str) -> None:
    from elitelanes_jax.folders import write_whole

    if file.exists():
        raise InputError(f"{file}: expected a file that is new, got one that is there")
    write_whole(file, text.encode(errors="surrogateescape"))  # a table has names of files, whatever they are made of


def _warn(warnings: Sequence[str]) -> None:
    for warning in warnings[:_MOST_WARNINGS]:
        print(f"elitelanes: {short(warning, 200)}", file=sys.stderr)
    if len(warnings) > _MOST_WARNINGS:
        print(f"elitelanes: {_MOST_WARNINGS} of {len(warnings)} warnings shown", file=sys.stderr)


def _left_out(grids: Sequence[Any]) -> str:
    from elitelanes_jax.exports.duckietown import without_dead_ends

    tiles = sum(int((codes != 0).sum()) for codes in grids)
    left = sum(int((without_dead_ends(codes) != 0).sum()) for codes in grids)
    return f"{tiles - left} of {tiles} tiles left out: roads that lead nowhere"


def _table(to: str, names: Sequence[str], grids: Sequence[Any]) -> str:
    from elitelanes_jax.exports.table import to_csv, to_json

    return (to_csv if to == "csv" else to_json)(_measured(names, grids))


def _measured(names: Sequence[str], grids: Sequence[Any]) -> list[Any]:
    from elitelanes_jax.compile_cache import use_compile_cache
    from elitelanes_jax.exports.table import measured

    use_compile_cache()
    return measured(names, grids)


def add_show(commands: Any) -> None:
    """Adds the command ``show`` to a parser's commands."""
    command = commands.add_parser("show", help="draw a map in the terminal, with its metrics")
    command.add_argument("map", type=folder_name, metavar="MAP", help="a map.json, or a map of Duckietown, .yaml")
    command.set_defaults(run=_show)


def _show(options: argparse.Namespace) -> int:
    import textwrap

    from elitelanes_jax.exports.boxes import boxes
    from elitelanes_jax.roadmap import read_map

    codes = read_map(options.map).codes
    (figures,) = _measured([str(options.map)], [codes])
    drawn = boxes(codes)
    try:
        drawn.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        drawn = boxes(codes, ascii_only=True)
    words = [f"{figures.pop('height')} x {figures.pop('width')} tiles"]
    words += [f"{key.replace('_', ' ')} {round(value, 3)}" for key, value in figures.items() if key != "file"]
    say(drawn + "\n\n" + "\n".join(textwrap.wrap(", ".join(words), 100)))
    return 0
