"""The commands ``export`` and ``show``."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from elitelanes_jax.command import folder_name, metres, name, say
from elitelanes_jax.errors import InputError

__all__ = ["FORMATS", "Format", "add_export", "add_show"]

# What is slow to import is imported by the formats that need it.


class Format(NamedTuple):
    """A format that maps are exported to.

    Attributes:
      suffix: of its files.
      text: of a file, from the codes ``[H, W]`` of a map; of a table, from names and codes of all of them.
      takes: the options of the command that it has, keyword arguments of `text`.
      table: whether all maps come in one file.
    """

    suffix: str
    text: Callable[..., str]
    takes: tuple[str, ...] = ()
    table: bool = False


def _duckietown(codes: Any, **options: Any) -> str:
    from elitelanes_jax.exports.duckietown import to_duckietown

    return to_duckietown(codes, **options)


def _graphml(codes: Any) -> str:
    from elitelanes_jax.exports.graph import tile_graph, to_graphml

    return to_graphml(tile_graph(codes))


def _reduced_graphml(codes: Any) -> str:
    from elitelanes_jax.exports.graph import reduced_graph, to_graphml

    return to_graphml(reduced_graph(codes))


def _network(codes: Any, to: str, tile_size: float | None = None) -> str:
    from elitelanes_jax.exports.sumo import Streets, network

    streets = Streets() if tile_size is None else Streets(tile=tile_size)
    return network(codes, to, streets).text


def _json(names: Sequence[str], grids: Sequence[Any]) -> str:
    from elitelanes_jax.exports.table import to_json

    return to_json(_measured(names, grids))


def _csv(names: Sequence[str], grids: Sequence[Any]) -> str:
    from elitelanes_jax.exports.table import to_csv

    return to_csv(_measured(names, grids))


def _measured(names: Sequence[str], grids: Sequence[Any]) -> list[Any]:
    from elitelanes_jax.compile_cache import use_compile_cache
    from elitelanes_jax.exports.table import measured

    use_compile_cache()
    return measured(names, grids)


FORMATS = {
    "duckietown": Format(".yaml", _duckietown, takes=("tile_size", "ground", "dead_ends")),
    "graphml": Format(".graphml", _graphml),
    "graphml-reduced": Format(".graphml", _reduced_graphml),
    "sumo": Format(".net.xml", partial(_network, to="net"), takes=("tile_size",)),
    "opendrive": Format(".xodr", partial(_network, to="opendrive"), takes=("tile_size",)),
    "json": Format(".json", _json, table=True),
    "csv": Format(".csv", _csv, table=True),
}
"""All formats, by the name that ``--to`` takes."""

# The options that some formats take.
_OPTIONS = ("tile_size", "ground", "dead_ends")


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
    command.add_argument("--to", type=name, required=True, metavar="FORMAT", help=", ".join(FORMATS))
    command.add_argument(
        "--out",
        type=folder_name,
        required=True,
        metavar="PATH",
        help="a new file, if it ends as those of the format do or is a table; else a folder, new or empty",
    )
    command.add_argument(
        "--tile-size",
        type=metres,
        metavar="METRES",
        help="side of a tile; by default 0.585, as Duckietown has it, or 30 for sumo and opendrive",
    )
    command.add_argument(
        "--ground",
        type=name,
        metavar="KIND",
        help="of cells without a road: grass (the default), floor, asphalt, empty",
    )
    command.add_argument(
        "--dead-ends",
        type=name,
        metavar="HOW",
        help="grass: take roads that lead nowhere back to the last crossing; refuse them by default",
    )
    command.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> int:
    from elitelanes_jax.folders import new_folder
    from elitelanes_jax.roadmap import read_map

    if options.to not in FORMATS:
        raise InputError(f"--to: expected one of {', '.join(FORMATS)}, got {options.to!r}")
    target = FORMATS[options.to]
    given = {key: getattr(options, key) for key in _OPTIONS if getattr(options, key) is not None}
    for key in given:
        if key not in target.takes:
            able = ", ".join(known for known, other in FORMATS.items() if key in other.takes)
            raise InputError(f"--{key.replace('_', '-')}: expected it with {able} alone, got it with {options.to}")
    grids = [read_map(file).codes for file in options.maps]
    if target.table:
        _write_new(options.out, target.text(list(map(str, options.maps)), grids))
    elif options.out.name.endswith(target.suffix):
        if len(grids) > 1:
            raise InputError(f"--out: expected a folder for {len(grids)} maps, got a file, {options.out}")
        _write_new(options.out, _text(target, options.maps[0], grids[0], given))
    elif options.out.name.endswith((".yml", ".xml", *(known.suffix for known in FORMATS.values()))):
        raise InputError(f"--out: expected a folder, or a file that ends in {target.suffix}, got {options.out}")
    else:
        places = _places(options.maps, target.suffix)
        with new_folder(options.out) as folder:
            for file, codes, place in zip(options.maps, grids, places, strict=True):
                (folder / place).write_text(_text(target, file, codes, given), encoding="utf-8", newline="\n")
    say(f"{len(grids)} {'map' if len(grids) == 1 else 'maps'} in {options.out}")
    return 0


def _text(target: Format, file: Path, codes: Any, given: dict[str, Any]) -> str:
    try:
        return target.text(codes, **given)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def _places(files: Sequence[Path], suffix: str) -> list[str]:
    """A file name for each map: what tells it from the others, such as 0003 for maps/0003/map.json."""
    stems = [file.absolute().with_suffix("") for file in files]
    stems = [stem.parent if stem.name == "map" else stem for stem in stems]
    root = os.path.commonpath([stem.parent for stem in stems])
    places = ["-".join(stem.relative_to(root).parts) + suffix for stem in stems]
    for number, place in enumerate(places):
        if place in places[:number]:
            raise InputError(f"{files[number]}: expected maps of different names, got two for {place}")
    return places


def _write_new(file: Path, text: str) -> None:
    from elitelanes_jax.folders import write_whole

    if file.exists():
        raise InputError(f"{file}: expected a file that is new, got one that is there")
    write_whole(file, text.encode())


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
