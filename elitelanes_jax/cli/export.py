"""The commands that write maps for other programs: ``elitelanes export`` and ``pack``."""

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.checks import ends_as_file, nonblank, path
from elitelanes_jax._util.errors import InputError, pluralize, quote
from elitelanes_jax._util.files import file_key, never_replacing, write_atomic
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.progress import announce_at_end
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.cli.arguments import (
    Commands,
    Once,
    add_command,
    add_options,
    add_shared,
    checked_by,
    naming,
    naming_options,
    read_options,
)
from elitelanes_jax.cli.program import say
from elitelanes_jax.formats.road_map import RoadMap, read_map
from elitelanes_jax.maps.exporting import (
    FORMATS,
    LOOP,
    Format,
    FormatOptions,
    without_ends,
)
from elitelanes_jax.maps.faults import warn_of_faults

# The format of a table of metrics, which has one file for all maps.
_TABLE = "csv"


def add_export(commands: Commands) -> None:
    command = add_command(
        commands,
        "export",
        _export,
        help="maps for other programs, or a table of their metrics",
        description="Writes maps for other programs: Duckietown's map files, networks, floors, "
        "tables of metrics.",
    )
    command.add_argument(
        "maps",
        type=checked_by(path),
        nargs="+",
        metavar="MAP",
        help="a map.json, or a map of Duckietown: .yaml, or a folder of layers; "
        "or a folder with such maps",
    )
    command.add_argument(
        "--to",
        type=checked_by(nonblank),
        # `pack --to` takes several formats. The first one would be dropped here without a word.
        action=Once,
        default=argparse.SUPPRESS,
        required=True,
        metavar="FORMAT",
        help=", ".join((*FORMATS, _TABLE)),
    )
    command.add_argument(
        "--out",
        type=checked_by(path),
        required=True,
        metavar="PATH",
        help="a new file, if it has the format's suffix or is a table; "
        "otherwise a folder, new or empty",
    )
    add_options(command, FormatOptions())


def _export(options: argparse.Namespace) -> int:
    # The message of argparse's `choices` has another form, and does not shorten the text.
    if options.to not in (*FORMATS, _TABLE):
        raise InputError("--to", f"one of {', '.join((*FORMATS, _TABLE))}", quote(options.to))
    # Options are checked before the maps are read, which may be many.
    settings = read_options(options, FormatOptions())
    options.maps = _files_of_maps(options.maps)
    with naming_options(FormatOptions()):
        settings.check_taken_by(options.to)
    if options.to == _TABLE:
        _export_table(options)
    else:
        _export_files(options, FORMATS[options.to], settings)
    return 0


def _files_of_maps(sources: Sequence[Path]) -> list[Path]:
    """Returns the files of maps: those that are named, and those in the folders that are named.

    A file that is named twice is written once.
    """
    from elitelanes_jax.maps.given import map_files

    files: list[Path] = []
    for source in sources:
        # The maps of a dataset are in its records, and not in files of their own.
        if (source / "dataset.json").is_file():
            raise InputError(
                source, "files of maps", "a dataset", "elitelanes pack exports its maps"
            )
        files += map_files(source)
    by_place: dict[Path, Path] = {}
    for file in files:
        by_place.setdefault(file.resolve(), file)
    return [*by_place.values()]


def _export_table(options: argparse.Namespace) -> None:
    """Writes a table with the metrics of all maps."""
    from elitelanes_jax.formats.table import measure_maps, table_to_csv

    # All maps are read before the file is written, so that a damaged one leaves no file.
    grids = [read_map(file).codes for file in options.maps]
    # The rows of the table have the maps' files as names.
    names = [str(file) for file in options.maps]
    _write_new(options.out, table_to_csv(measure_maps(names, grids)).encode())
    say(f"{pluralize(len(grids), 'map')} in {options.out}")


def _export_files(options: argparse.Namespace, target: Format, settings: FormatOptions) -> None:
    """Writes the files of a format for each map."""
    with naming_options(FormatOptions()):
        loaded = settings.loaded()
        # Writing a small map refuses bad options before any map is read.
        target.files(LOOP, "map", **loaded)
    maps = {file: read_map(file) for file in options.maps}
    # All files are written before anything is announced, so that a failed export says only its
    # error.
    _write_maps(maps, target, loaded, options.out)
    for file, road_map in maps.items():
        # Faults and limits are those of the map as it was written.
        written = without_ends(road_map, settings.dead_ends)
        warn_of_faults(str(file), written)
        for limit in settings.limits(options.to, written, loaded.get("tiles")):
            announce_at_end(str(file), limit)
    say(f"{pluralize(len(maps), 'map')} in {options.out}")
    if settings.dead_ends == "grass":
        _say_left_out([road_map.codes for road_map in maps.values()])


def _say_left_out(grids: Sequence[Int8[np.ndarray, "H W"]]) -> None:
    from elitelanes_jax.formats.duckietown import without_dead_ends

    tiles = sum(np.count_nonzero(codes) for codes in grids)
    written = sum(np.count_nonzero(without_dead_ends(codes)) for codes in grids)
    say(f"{tiles - written} of {tiles} tiles left out: roads that lead nowhere")


def _write_maps(
    maps: Mapping[Path, RoadMap], target: Format, settings: Mapping[str, UserValue], out: Path
) -> None:
    """Writes the files of maps, to a file or a folder."""

    def contents(file: Path, name: str) -> dict[str, bytes]:
        with naming(file), naming_options(FormatOptions()):
            return target.files(maps[file], name, **settings)

    # A format of one file for each map can be asked for by the name of that file. Several files, or
    # a catalogue of all maps, need a folder.
    only = None
    if len(target.suffixes) == 1 and target.catalogue is None:
        only = target.suffixes[0]
    # A single file is written under exactly the name that the user gave.
    if only and out.name.lower().endswith(only):
        if len(maps) > 1:
            raise InputError("--out", f"a folder for {len(maps)} maps", f"a file, {out}")
        for file in maps:
            _write_new(out, *contents(file, out.name[: -len(only)]).values())
        return
    # A name such as maps.txt was meant for a file, and would make a folder of this name.
    if ends_as_file(out):
        expected = f"a folder, or a file that ends in {only}" if only else "a folder"
        raise InputError("--out", expected, out)
    # In a folder, each map has a file name of its own.
    names = _names(list(maps))
    with output_folder(out, {"command": "export"}) as work:
        written: list[Path] = []
        for file, stem in names.items():
            for place, content in contents(file, stem).items():
                written.append(work.files / place)
                write_atomic(written[-1], content)
        # A catalogue lists the files, so it is written after them.
        if target.catalogue is not None:
            for index_name, content in target.catalogue(work.files, written).items():
                write_atomic(work.files / index_name, content)


def _names(files: Sequence[Path]) -> dict[Path, str]:
    """Returns a file name for each map, without suffix: 0003 for maps/0003/map.json.

    If two maps have the same name, all names begin with as many folders as tell the maps apart.
    """
    # Maps of a run are all called map.json, so the names of their folders tell them apart.
    stems = [_stem(file) for file in files]
    folders_and_names = [stem.relative_to(stem.anchor).parts for stem in stems]
    names: list[str] = []
    keys: list[str] = []
    for count in range(1, max(map(len, folders_and_names)) + 1):
        # With each round the names have one more folder.
        names = ["-".join(parts[-count:]) for parts in folders_and_names]
        keys = list(map(file_key, names))
        if len(set(keys)) == len(keys):
            return dict(zip(files, names, strict=True))
    # Even all folders do not tell these maps apart, for example if only their suffixes differ.
    second = next(index for index in range(len(keys)) if keys[index] in keys[:index])
    first = keys.index(keys[second])
    got = f"two for {stems[second].name}"
    if names[first] != names[second]:
        got += " on file systems that ignore case"
    got += f"; the other is {files[first]}"
    raise InputError(files[second], "maps of different names", got)


def _stem(file: Path) -> Path:
    """Returns what names a map: its file without suffix, or the folder of a map.json."""
    # A path such as ".." has no name of its own.
    path = Path(os.path.normpath(file.absolute()))
    if not path.is_dir():
        path = path.with_suffix("")
    # The root has no name.
    return path.parent if path.name == "map" and path.parent.name else path


def _write_new(file: Path, content: bytes) -> None:
    with never_replacing(file):
        write_atomic(file, content)


def add_pack(commands: Commands) -> None:
    from elitelanes_jax.maps.spec import PackSpec

    command = add_command(
        commands,
        "pack",
        _pack,
        help="maps for other programs, with splits, trips and checksums",
        description="Writes a folder with maps for other programs, splits that share no niche, and "
        "trips with their exact lengths. After an interruption or a kill, the same command "
        "resumes.",
    )
    command.add_argument(
        "sources",
        type=checked_by(path),
        nargs="+",
        metavar="FILE|DIR",
        help="a folder of generate, pick, dataset or pack, or files of maps",
    )
    add_shared(command, "--out")
    add_options(command, PackSpec())
    add_shared(command, "--force", "--quiet")


def _pack(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.spec import PackSpec

    spec = read_options(options, PackSpec())
    from elitelanes_jax.maps.packing import pack

    with naming_options(PackSpec()):
        about = pack(spec, options.sources, options.out, force=options.force)
    # The line says how many maps and niches each split has.
    splits = []
    for split, part in about["splits"].items():
        splits.append(
            f"{split} {pluralize(part['maps'], 'map')} of {pluralize(part['niches'], 'niche')}"
        )
    say(f"{pluralize(about['maps']['number'], 'map')} in {options.out}: {', '.join(splits)}")
    return 0
