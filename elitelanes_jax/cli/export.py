"""The commands ``elitelanes export`` and ``elitelanes show``."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from elitelanes_jax._util.checks import ends_as_file, name, path
from elitelanes_jax._util.errors import InputError, pluralize, shorten
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.cli.arguments import Commands, add_options, checked_by, naming_options, read_options
from elitelanes_jax.cli.program import say, warn
from elitelanes_jax.formats.road_map import RoadMap, read_map
from elitelanes_jax.maps.exporting import FORMATS, LOOP, Format, FormatOptions, as_bytes

TABLES = ("json", "csv")

_MOST_WARNINGS = 3


def add_export(commands: Commands) -> None:
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
        help="a new file, if it has the format's suffix or is a table; otherwise a folder, new or empty",
    )
    add_options(command, FormatOptions())
    command.set_defaults(action=_export)


def _export(options: argparse.Namespace) -> int:
    if options.to not in (*FORMATS, *TABLES):
        raise InputError(f"--to: expected one of {', '.join((*FORMATS, *TABLES))}, got {shorten(repr(options.to))}")
    settings = read_options(options, FormatOptions()).given()
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
        with naming_options(FormatOptions(), tile="--tile-size"):
            target.files(LOOP, "map", **settings)
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
    files: Sequence[Path], maps: Sequence[RoadMap], target: Format, settings: dict[str, UserValue], out: Path
) -> list[str]:
    """Writes the files of maps, to a file or a folder; returns the warnings."""
    from elitelanes_jax._util.files import write_atomic
    from elitelanes_jax._util.folders import output_folder

    warnings: list[str] = []

    def contents(file: Path, road_map: RoadMap, name: str) -> tuple[str | bytes, ...]:
        try:
            with naming_options(FormatOptions()):
                made = target.files(road_map, name, **settings)
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        warnings.extend(f"{file}: {warning}" for warning in made.warnings)
        return made.contents

    only = target.suffixes[0] if len(target.suffixes) == 1 else None
    if only and out.name.lower().endswith(only):
        if len(maps) > 1:
            raise InputError(f"--out: expected a folder for {len(maps)} maps, got a file, {out}")
        _write_new(out, *contents(files[0], maps[0], out.name[: -len(only)]))
    elif ends_as_file(out):
        expected = f"a folder, or a file that ends in {only}" if only else "a folder"
        raise InputError(f"--out: expected {expected}, got {out}")
    else:
        names = _names(files)
        with output_folder(out, {"command": "export"}) as work:
            for file, road_map, stem in zip(files, maps, names, strict=True):
                for suffix, content in zip(target.suffixes, contents(file, road_map, stem), strict=True):
                    write_atomic(work.files / (stem + suffix), as_bytes(content))
    return warnings


def _names(files: Sequence[Path]) -> list[str]:
    """Returns a file name for each map, without suffix: the part of its path that differs, 0003 for 0003/map.json."""
    stems = [Path(os.path.normpath(file.absolute())).with_suffix("") for file in files]
    stems = [stem.parent if stem.name == "map" else stem for stem in stems]
    root = os.path.commonpath([stem.parent for stem in stems])
    names = ["-".join(stem.relative_to(root).parts) for stem in stems]
    first: dict[str, Path] = {}
    for file, stem in zip(files, names, strict=True):
        if first.setdefault(stem, file) is not file:
            raise InputError(f"{file}: expected maps of different names, got two for {stem}")
    return names


def _write_new(file: Path, content: str | bytes) -> None:
    from elitelanes_jax._util.files import check_new, write_atomic

    check_new(file)
    write_atomic(file, as_bytes(content))


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
    command = commands.add_parser("show", help="draw a map in the terminal, with its metrics")
    command.add_argument("map", type=checked_by(path), metavar="MAP", help="a map.json, or a map of Duckietown, .yaml")
    command.set_defaults(action=_show)


def _show(options: argparse.Namespace) -> int:
    import textwrap

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
