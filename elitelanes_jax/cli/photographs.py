"""The commands on photographs of tiles: ``elitelanes tiles cut`` and ``elitelanes tiles read``."""

import argparse
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.checks import FLOOR_SIDE, file_named, floor_shape, folder, path, real
from elitelanes_jax._util.errors import InputError, list_some, pluralize
from elitelanes_jax._util.files import check_new, never_replacing, new_file
from elitelanes_jax._util.folders import check_renamable
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.cli.arguments import Commands, add_command, add_shared, checked_by, naming
from elitelanes_jax.cli.program import say, warn
from elitelanes_jax.formats.road_map import RoadMap, read_map
from elitelanes_jax.network.codes import KIND_OF
from elitelanes_jax.network.plain_metrics import cut_to_roads

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from elitelanes_jax.photographs.floors import CutFloors, Floor
    from elitelanes_jax.photographs.lenses import Lens

_PIXEL = real(-1e6, 1e6, unit="pixels")
# The most copies that a line names.
_MOST_NAMED = 8


class _Plan(NamedTuple):
    """A map that is planned or laid.

    Attributes:
      file: the file or folder that it was read from.
      codes: int8 ``[H, W]``.
    """

    file: Path
    codes: "NDArray[np.int8]"


def _read_plan(text: UserValue) -> _Plan:
    """Reads a map, which has roads and is no larger than a photographed floor."""
    file = path(text)
    codes = read_map(file).codes
    with naming(file):
        floor_shape(codes.shape)
    if not codes.any():
        raise InputError(file, "a map with roads", "none")
    return _Plan(file, codes)


def _read_camera(text: UserValue) -> "Lens":
    from elitelanes_jax.photographs.lenses import read_lens

    return read_lens(path(text))


def add_cut(commands: Commands) -> None:
    command = add_command(
        commands,
        "cut",
        _cut,
        help="cut a tile set out of photographs",
        description="Finds the tiles in photographs and writes a tile set: a square picture of "
        "each tile, its proposed masks, and sheet.png to check all by eye. A photograph shows one "
        "tile, or a floor of --size or --map. If a photograph is refused, the tiles of the others are "
        "written, and the exit code is 2.",
        notes="""examples:
  elitelanes tiles cut turn.jpg straight.jpg crossing.jpg --out my-tiles
  elitelanes tiles cut floor.jpg --size 3 4 --out my-tiles
  elitelanes tiles cut long.jpg square.jpg --size 2 6 --size 4 4 --out my-tiles
  elitelanes tiles cut floor.jpg --map town.json --corners 210 330 1710 290 1890 1310 90 1250 --out my-tiles
""",
    )
    command.add_argument(
        "photos", type=checked_by(path), nargs="+", metavar="PHOTO", help="JPEG or PNG files"
    )
    command.add_argument(
        "--out",
        type=checked_by(folder),
        required=True,
        metavar="DIR",
        help="folder of the tile set, new or empty",
    )
    _add_floor(command, takes_several=True)
    command.add_argument(
        "--map",
        type=checked_by(_read_plan),
        action="append",
        metavar="MAP",
        help="the map that is laid, in any direction. Repeat it for floors of several maps",
    )
    command.add_argument(
        "--overwrite",
        action="store_true",
        help="also replace an existing tile set, which is kept next to it",
    )


def add_read(commands: Commands) -> None:
    command = add_command(
        commands,
        "read",
        _read,
        help="read the map of a laid floor from a photograph",
        description="Draws the map of a floor in the terminal, and names tiles that are unsure. "
        "With --against, names the tiles that differ from a plan.",
    )
    command.add_argument("photo", type=checked_by(path), metavar="PHOTO", help="a JPEG or PNG file")
    add_shared(command, "--tiles")
    _add_floor(command, takes_several=False)
    command.add_argument(
        "--against", type=checked_by(_read_plan), metavar="MAP", help="the map that was planned"
    )
    named = checked_by(file_named(".json"))
    command.add_argument("--out", type=named, metavar="FILE", help="a new map file, .json")
    command.add_argument(
        "--picture",
        type=checked_by(file_named(".png")),
        metavar="FILE",
        help="a new picture, .png: the photograph with the names of cells, unsure tiles, and what "
        "differs from the plan",
    )


def _add_floor(command: argparse.ArgumentParser, *, takes_several: bool) -> None:
    """Adds what the user knows of the floor in a photograph, or of those in several photographs."""
    repeat_size = repeat_corners = ""
    if takes_several:
        repeat_size = ". Repeat it for each photograph if the floors differ"
        repeat_corners = ". Repeat it for each photograph"
    command.add_argument(
        "--size",
        type=checked_by(FLOOR_SIDE),
        nargs=2,
        action="append",
        metavar=("ROWS", "COLUMNS"),
        help=f"tiles of the floor{repeat_size}",
    )
    command.add_argument(
        "--corners",
        type=checked_by(_PIXEL),
        nargs=8,
        action="append",
        metavar=("X", "Y") * 4,
        help="the corners of the tiles in the photograph, roughly: x and y in pixels, clockwise "
        f"from the top left one; by default they are found{repeat_corners}",
    )
    command.add_argument(
        "--exact",
        action="store_true",
        help="take --corners as they are; by default they are fitted to the photograph",
    )
    command.add_argument(
        "--camera",
        type=checked_by(_read_camera),
        metavar="FILE",
        help="calibration of the camera, .yaml of ROS, OpenCV or Kalibr",
    )


def _cut(options: argparse.Namespace) -> int:
    from elitelanes_jax.photographs.floors import cut_floors, write_set

    # What the options alone show to be wrong is refused before a photograph is read.
    floors = _floors(options, options.photos, options.map)
    _check_replaceable(options.out, overwrite=options.overwrite)
    cut = cut_floors(floors, options.camera)
    if not cut.cuts:
        raise _nothing_cut_error(cut, floors[0].file)
    earlier_set = write_set(options.out, cut)
    lines = _describe_set(cut, options.out)
    if earlier_set is not None:
        lines.append(f"the earlier set is kept as {earlier_set}")
    say("\n".join([*lines, *_check_set(options.out)]))
    if not cut.refused:
        return 0
    # The set lacks the tiles of these photographs. A script learns it from the exit code, which is
    # that of a command whose photographs are all refused.
    warn("\n".join(f"refused: {line}" for line in cut.refused))
    return 2


def _check_replaceable(out: Path, *, overwrite: bool) -> None:
    """Checks that a folder can be written: it is new or empty, or is replaced."""
    check_renamable(out)
    expected = "a folder that is new or empty"
    if out.exists() and not out.is_dir():
        raise InputError(out, expected, "a file")
    if out.is_dir() and any(out.iterdir()) and not overwrite:
        raise InputError(out, expected, "one with files", "--overwrite replaces it")


def _nothing_cut_error(cut: "CutFloors", first_file: Path) -> InputError:
    """Returns the error for photographs that gave no tile."""
    if not cut.refused:
        # The outlines were found, and no kind in them is sure.
        return InputError(first_file, "tiles of a sure kind", "none")
    more = f" (and {len(cut.refused) - 1} more)" if len(cut.refused) > 1 else ""
    return InputError("", "", cut.refused[0] + more)


def _describe_set(cut: "CutFloors", out: Path) -> list[str]:
    """Returns lines about the tiles that were cut, and about those that were left out."""
    # The counts show which kinds of tiles the set still lacks.
    kinds = Counter(KIND_OF[tile.code] for tile in cut.cuts)
    listed = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    tiles, sources = pluralize(len(cut.cuts), "tile"), pluralize(len(cut.used), "photograph")
    lines = [
        f"{tiles} of {sources} in {out}: {listed}",
        f"look at the outlines and masks on {out / 'sheet.png'}",
    ]
    copies = [tile.name for tile in cut.cuts if tile.copy_of]
    if copies:
        lines.append(f"nearly copies of other tiles: {list_some(copies, _MOST_NAMED)}")
    for proposal in cut.used:
        # A tile of an unsure kind was not cut, and the user can add it by hand.
        for row, column in proposal.unsure_cells:
            cell = describe_cell(row, column)
            if proposal.codes[row][column]:
                lines.append(f"{proposal.photo}: left out the tile at {cell}, its kind is unsure")
            else:
                lines.append(f"{proposal.photo}: left out {cell}, unsure whether a tile is there")
    return lines


def _check_set(folder: Path) -> list[str]:
    """Returns lines about what to correct in a set that was cut, and where its lanes run."""
    from elitelanes_jax.tiles.sides import measure_lanes
    from elitelanes_jax.tiles.tileset import inspect_tiles

    # The set is checked as `tiles check` does it, because the pictures are the user's.
    tiles, problems = inspect_tiles(folder, lines=True)
    if tiles is None:
        return [f"to correct: {problem}" for problem in problems]
    lanes = measure_lanes(tiles.tiles)
    if lanes.is_trusted:
        written = f"{lanes}: lane_offset of the set"
    else:
        written = f"{lanes}, which is not sure: lane_offset is {tiles.lane_offset:g}"
    return [written, f"checked: no problems in {folder}"]


def _read(options: argparse.Namespace) -> int:
    from elitelanes_jax.formats.sketch import draw_text
    from elitelanes_jax.photographs.floors import find_floor
    from elitelanes_jax.photographs.laid import read_laid
    from elitelanes_jax.tiles.tileset import load_tiles

    plan: _Plan | None = options.against
    (floor,) = _floors(options, [options.photo], None if plan is None else [plan])
    # A single tile is no floor to read, and the default of --size means one.
    if floor.shape == (1, 1):
        if plan is not None:
            raise InputError(plan.file, "a map of 2 tiles or more", "1")
        got = "none" if options.size is None else "1 1"
        raise InputError("--size", "the rows and columns of a floor of 2 tiles or more", got)
    for file in (options.out, options.picture):
        if file is not None:
            check_new(file)
    # The plan does not tell the kinds. It is what they are compared with.
    tiles = load_tiles(options.tiles)
    photograph, proposal = find_floor(floor, options.camera, tiles, trusts_map=False)
    # A floor that was not found has no codes that mean anything.
    if not proposal.is_sure:
        raise InputError("", "", proposal.refusal)
    # The photograph may be taken from any side of the floor.
    laid = read_laid(proposal, None if plan is None else plan.codes)
    # The map comes first, then unsure tiles, then differences from the plan.
    lines = [draw_text(laid.codes, named=True)]
    lines += [f"{describe_cell(*cell)}: unsure" for cell in laid.unsure]
    if plan is not None:
        verb = "differs" if len(laid.differences) == 1 else "differ"
        count = pluralize(len(laid.differences), "tile")
        lines += map(str, laid.differences)
        lines.append(f"{count} of {laid.codes.size} {verb} from {plan.file}")
    # The stack renames the files when both are written. If one cannot be written, neither appears.
    with ExitStack() as stack:
        if options.out is not None:
            part = _new_file(stack, options.out)
            RoadMap(laid.codes, unsure=laid.unsure or None).save(part)
        if options.picture is not None:
            from elitelanes_jax.photographs.sheet import draw_laid
            from elitelanes_jax.tiles.rendering import write_png

            part = _new_file(stack, options.picture)
            write_png(part, draw_laid(photograph, proposal, laid))
    say("\n".join(lines), asked=True)
    return 0


def _new_file(stack: ExitStack, file: Path) -> Path:
    """Returns a path to write to, which the stack renames to a file that must not exist."""
    stack.enter_context(never_replacing(file))
    return stack.enter_context(new_file(file))


_T = TypeVar("_T")


def _floors(
    options: argparse.Namespace, files: Sequence[Path], plans: Sequence[_Plan] | None
) -> "list[Floor]":
    """Returns what the options say of the floor in each photograph."""
    import numpy as np

    from elitelanes_jax.photographs.floors import Floor

    sizes = for_each("--size", options.size or [None], files)
    maps = for_each("--map", plans or [None], files)
    # Without corners there is nothing to take exactly.
    if options.exact and not options.corners:
        raise InputError("--exact", "--corners", "none")
    corners = options.corners or [None] * len(files)
    if len(corners) != len(files):
        raise InputError(
            "--corners",
            f"the option once for each of {pluralize(len(files), 'photograph')}",
            f"it for {len(corners)}",
        )
    floors = []
    for file, size, plan, points in zip(files, sizes, maps, corners, strict=True):
        shape = (1, 1) if size is None else tuple(size)
        if plan is not None:
            laid_shape = cut_to_roads(plan.codes).shape
            _check_size(size, plan.codes.shape, laid_shape)
            shape = laid_shape
        codes = None if plan is None else plan.codes
        pixels = None if points is None else np.array(points, float).reshape(4, 2)
        floors.append(Floor(file, shape, codes, pixels, options.exact))
    return floors


def _check_size(
    size: Sequence[int] | None, map_shape: tuple[int, ...], laid_shape: tuple[int, ...]
) -> None:
    """Checks that a size, if it is given, is that of the map or of the map without its empty border."""
    if size is None or tuple(size) in (map_shape, laid_shape):
        return
    expected = f"{map_shape[0]} {map_shape[1]} like the map"
    if laid_shape != map_shape:
        expected += f", or {laid_shape[0]} {laid_shape[1]} without its empty border"
    raise InputError("--size", expected, f"{size[0]} {size[1]}")


def for_each(option: str, values: Sequence[_T], files: Sequence[Path]) -> Sequence[_T]:
    """Returns the value of an option for each photograph: one for all, or one for each."""
    if len(values) == 1:
        return [*values] * len(files)
    if len(values) != len(files):
        expected = "the option once"
        if len(files) > 1:
            expected += f", or once for each of {len(files)} photographs"
        raise InputError(option, expected, f"it {len(values)} times")
    return values
