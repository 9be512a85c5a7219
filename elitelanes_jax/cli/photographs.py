"""The commands on photographs of tiles: ``elitelanes tiles cut`` and ``elitelanes tiles read``."""

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from elitelanes_jax._util.checks import FLOOR_SIDE, file_named, floor_shape, folder, path, real
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import check_new, free_name, never_replacing
from elitelanes_jax._util.folders import check_renamable, output_folder
from elitelanes_jax.cli.arguments import Commands, add_command, add_shared, checked_by, naming
from elitelanes_jax.cli.program import say, warn
from elitelanes_jax.formats.road_map import RoadMap, read_map
from elitelanes_jax.network.codes import KIND_OF

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from elitelanes_jax.photographs.cutting import Cut
    from elitelanes_jax.photographs.lenses import Lens
    from elitelanes_jax.photographs.proposals import Proposal
    from elitelanes_jax.photographs.reading import Photograph
    from elitelanes_jax.tiles.tileset import TileSet

_PIXEL = real(-1e6, 1e6, unit="pixels")


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
    _add_floor(command)
    command.add_argument(
        "--map", type=checked_by(path), metavar="MAP", help="the map that is laid, in any direction"
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
    _add_floor(command)
    command.add_argument(
        "--against", type=checked_by(path), metavar="MAP", help="the map that was planned"
    )
    named = checked_by(file_named(".json"))
    command.add_argument("--out", type=named, metavar="FILE", help="a new map file, .json")


def _add_floor(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--size",
        type=checked_by(FLOOR_SIDE),
        nargs=2,
        metavar=("ROWS", "COLUMNS"),
        help="tiles of the floor",
    )
    command.add_argument(
        "--corners",
        type=checked_by(_PIXEL),
        nargs=8,
        action="append",
        metavar="X",
        help="the corners of the tiles in the photograph, roughly: x and y in pixels, clockwise "
        "from the top left one; by default they are found. Repeat it for each photograph",
    )
    command.add_argument(
        "--exact",
        action="store_true",
        help="take --corners as they are; by default they are fitted to the photograph",
    )
    command.add_argument(
        "--camera",
        type=checked_by(path),
        metavar="FILE",
        help="calibration of the camera, .yaml as ROS writes it",
    )


class _CutPhotographs(NamedTuple):
    """What was cut out of the photographs of a command.

    Attributes:
      cuts: the tiles.
      used: the photographs whose tiles were found, as the user names them, and where the tiles are.
      refused: a line for each other photograph.
      proposals: for the sheet, where the tiles may be in each photograph that has an outline.
      pictures: for the sheet, these photographs with the outlines of their tiles.
    """

    cuts: "list[Cut]"
    used: "list[tuple[Path, Proposal]]"
    refused: list[str]
    proposals: "list[Proposal]"
    pictures: "list[NDArray[np.uint8]]"


def _cut(options: argparse.Namespace) -> int:
    # What the options alone show to be wrong is refused before a photograph is read.
    plan = _read_plan(options.map)
    shape = _shape(options, plan)
    corners = _corners_of_each(options, options.photos)
    out: Path = options.out
    _check_replaceable(out, overwrite=options.overwrite)
    photographs = _cut_photographs(options, corners, shape, plan)
    if not photographs.cuts:
        raise _nothing_cut_error(photographs, options.photos[0])
    earlier_set = _write_set(out, photographs, overwrite=options.overwrite)
    say("\n".join(_describe_set(photographs, out, earlier_set)))
    if not photographs.refused:
        return 0
    # The set lacks the tiles of these photographs. A script learns it from the exit code, which is
    # that of a command whose photographs are all refused.
    warn("\n".join(f"refused: {line}" for line in photographs.refused))
    return 2


def _check_replaceable(out: Path, *, overwrite: bool) -> None:
    """Checks that a folder has no files, or can be renamed to make room for another one."""
    if not _has_files(out):
        return
    if not overwrite:
        raise InputError(
            f"{out}: expected a folder that is new or empty, got one with files; "
            "--overwrite replaces it"
        )
    check_renamable(out)


def _has_files(out: Path) -> bool:
    return out.is_dir() and any(out.iterdir())


def _cut_photographs(
    options: argparse.Namespace,
    corners: Sequence[list[float] | None],
    shape: tuple[int, int],
    plan: "NDArray[np.int8] | None",
) -> _CutPhotographs:
    """Cuts tiles out of the photographs in which they are found.

    Only one photograph is in memory at a time.
    """
    from elitelanes_jax.photographs.cutting import cut_tiles
    from elitelanes_jax.photographs.proposals import SURE
    from elitelanes_jax.photographs.reading import Photograph
    from elitelanes_jax.photographs.sheet import draw_proposal

    # One camera has taken all photographs.
    lens = _read_lens(options)
    photographs = _CutPhotographs([], [], [], [], [])
    for file, corners_of_file in zip(options.photos, corners, strict=True):
        try:
            photograph = Photograph.read(file, lens)
            with _naming_photograph(file, photograph):
                proposal = _propose(
                    photograph, shape, corners_of_file, exact=options.exact, codes=plan
                )
        except InputError as error:
            # The tiles of the other photographs are still written, because finding them may have
            # taken minutes.
            message = str(error)
            named = message if message.startswith(f"{file}: ") else f"{file}: {message}"
            photographs.refused.append(named)
            continue
        # A photograph that is refused stays on the sheet, where its outlines show what went wrong.
        photographs.proposals.append(proposal)
        photographs.pictures.append(draw_proposal(photograph, proposal))
        if proposal.score < SURE:
            photographs.refused.append(f"{file}: {proposal.advice}")
            continue
        photographs.used.append((file, proposal))
        photographs.cuts.extend(cut_tiles(photograph, proposal, photographs.cuts))
    return photographs


def _nothing_cut_error(photographs: _CutPhotographs, first_file: Path) -> InputError:
    """Returns the error for photographs that gave no tile."""
    refused = photographs.refused
    if not refused:
        # The outlines were found, and no kind in them is sure.
        return InputError(f"{first_file}: expected tiles of a sure kind, got none")
    more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
    return InputError(refused[0] + more)


def _write_set(out: Path, photographs: _CutPhotographs, *, overwrite: bool) -> Path | None:
    """Writes the tiles with proposed masks, and the sheet.

    Returns where the earlier files of the folder are kept, None if it had none. After an error they
    are back in their place.
    """
    from elitelanes_jax.photographs.cutting import write_cuts
    from elitelanes_jax.photographs.sheet import draw_sheet
    from elitelanes_jax.tiles.masking import proposal_sheet
    from elitelanes_jax.tiles.rendering import write_png

    kept = None
    if overwrite and _has_files(out):
        # Renamed, so that nothing in it is lost.
        kept = out.rename(free_name(out, f"{out.name}.before"))
    try:
        # The folder appears complete or not at all.
        with output_folder(out, {"command": "tiles cut"}) as work:
            masked = write_cuts(work.files, photographs.cuts)
            tiles = proposal_sheet("Tiles and their masks", masked)
            title = f"Tiles cut into {out.name}"
            sheet = draw_sheet(title, photographs.pictures, photographs.proposals, tiles)
            write_png(work.files / "sheet.png", sheet)
    except BaseException:
        if kept is not None and not out.exists():
            kept.rename(out)
        raise
    return kept


def _describe_set(photographs: _CutPhotographs, out: Path, earlier_set: Path | None) -> list[str]:
    """Returns lines about a tile set that was written.

    They name its tiles, what was left out, and what to correct.
    """
    from elitelanes_jax.tiles.tileset import inspect_tiles

    # What was cut comes first, then what needs the user's attention.
    lines = _summary(photographs, out)
    if earlier_set is not None:
        lines.append(f"the earlier set is kept as {earlier_set}")
    # The set is checked as `tiles check` does it, because the pictures are the user's.
    _, problems = inspect_tiles(out, lines=True)
    if problems:
        lines += [f"to correct: {problem}" for problem in problems]
    else:
        lines.append(f"checked: no problems in {out}")
    return lines


def _summary(photographs: _CutPhotographs, out: Path) -> list[str]:
    cuts, used = photographs.cuts, photographs.used
    # The counts show which kinds of tiles the set still lacks.
    kinds = Counter(KIND_OF[cut.code] for cut in cuts)
    listed = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    tiles, sources = pluralize(len(cuts), "tile"), pluralize(len(used), "photograph")
    lines = [
        f"{tiles} of {sources} in {out}: {listed}",
        f"look at the outlines and masks on {out / 'sheet.png'}",
    ]
    lines += [f"{cut.name} is nearly a copy of {cut.copy_of}" for cut in cuts if cut.copy_of]
    for file, proposal in used:
        # A tile of an unsure kind was not cut, and the user can add it by hand.
        for cell in _unsure_cells(proposal.sure):
            place = _describe_cell(*cell)
            lines.append(f"{file}: left out the tile at {place}, its kind is unsure")
    return lines


def _unsure_cells(sure: "ArrayLike") -> list[list[int]]:
    """Returns row and column, from 0, of the cells whose kind is unsure."""
    import numpy as np

    from elitelanes_jax.photographs.proposals import SURE

    return np.argwhere(np.asarray(sure) < SURE).tolist()


def _describe_cell(row: int, column: int) -> str:
    return f"row {row + 1}, column {column + 1}"


class _Floor(NamedTuple):
    """The map of a floor as it was read.

    Attributes:
      codes: int8 ``[H, W]``.
      sure: float ``[H, W]``, how sure each code is, 0 to 1.
    """

    codes: "NDArray[np.int8]"
    sure: "NDArray[np.float64]"


def _read(options: argparse.Namespace) -> int:
    from elitelanes_jax.formats.sketch import draw_text
    from elitelanes_jax.tiles.tileset import load_tiles

    plan = _read_plan(options.against)
    shape = _shape(options, plan)
    # A single tile is no floor to read, and the default of --size means one.
    if shape == (1, 1):
        if plan is not None:
            raise InputError(f"{options.against}: expected a map of 2 tiles or more, got 1")
        got = "none" if options.size is None else "1 1"
        raise InputError(
            f"--size: expected the rows and columns of a floor of 2 tiles or more, got {got}"
        )
    # The command takes one photograph, and so one set of corners.
    (corners,) = _corners_of_each(options, [options.photo])
    if options.out is not None:
        check_new(options.out)
    floor = _read_floor(options, shape, corners, load_tiles(options.tiles))
    if plan is not None:
        # The photograph may be taken from any side of the floor.
        floor = _turn_to_plan(floor, plan, options.against)
    unsure = _unsure_cells(floor.sure)
    # The map comes first, then unsure tiles, then differences from the plan.
    lines = [draw_text(floor.codes)]
    lines += [f"{_describe_cell(row, column)}: unsure" for row, column in unsure]
    if plan is not None:
        lines += _compare(floor.codes, plan, options.against)
    if options.out is not None:
        with never_replacing(options.out):
            RoadMap(floor.codes, unsure=unsure or None).save(options.out)
    say("\n".join(lines), asked=True)
    return 0


def _read_floor(
    options: argparse.Namespace,
    shape: tuple[int, int],
    corners: list[float] | None,
    tiles: "TileSet",
) -> _Floor:
    """Reads the map of the floor in a photograph, seen from the photograph's side."""
    import numpy as np

    from elitelanes_jax.photographs.proposals import SURE
    from elitelanes_jax.photographs.reading import Photograph

    photograph = Photograph.read(options.photo, _read_lens(options))
    with _naming_photograph(options.photo, photograph):
        proposal = _propose(photograph, shape, corners, exact=options.exact, tiles=tiles)
    # A floor that was not found has no codes that mean anything.
    if proposal.score < SURE:
        raise InputError(f"{options.photo}: {proposal.advice}")
    return _Floor(np.array(proposal.codes, np.int8), np.array(proposal.sure))


def _turn_to_plan(floor: _Floor, plan: "NDArray[np.int8]", plan_file: Path) -> _Floor:
    """Turns a floor to the direction in which it agrees most with a plan."""
    import numpy as np

    from elitelanes_jax.photographs.comparison import turn_floor, turn_to_plan

    with naming(plan_file):
        turns = turn_to_plan(floor.codes, plan)
    # The certainty of each cell turns with its code.
    return _Floor(turn_floor(floor.codes, turns), np.rot90(floor.sure, turns))


def _compare(codes: "NDArray[np.int8]", plan: "NDArray[np.int8]", plan_file: Path) -> list[str]:
    """Returns a line for each tile that differs from a plan, and a line with their number."""
    from elitelanes_jax.photographs.comparison import find_differences

    differences = find_differences(codes, plan)
    count = pluralize(len(differences), "tile")
    verb = "differs" if len(differences) == 1 else "differ"
    return [
        *map(str, differences),
        f"{count} of {codes.size} {verb} from {plan_file}",
    ]


def _read_plan(file: Path | None) -> "NDArray[np.int8] | None":
    """Returns the codes of the map that was planned; None without one.

    A map that is larger than any photographed floor is refused, and so is one without roads.
    """
    if file is None:
        return None
    codes = read_map(file).codes
    with naming(file):
        floor_shape(codes.shape)
    if not codes.any():
        raise InputError(f"{file}: expected a map with roads, got none")
    return codes


def _shape(options: argparse.Namespace, plan: "NDArray[np.int8] | None") -> tuple[int, int]:
    """Returns the rows and columns of the floor.

    They are those of the plan, or of --size; (1, 1) for single tiles.
    """
    if plan is None:
        return (1, 1) if options.size is None else tuple(options.size)
    shape = plan.shape
    if options.size is not None and tuple(options.size) != shape:
        raise InputError(
            f"--size: expected {shape[0]} {shape[1]} like the map, "
            f"got {options.size[0]} {options.size[1]}"
        )
    return shape


def _corners_of_each(
    options: argparse.Namespace, files: Sequence[Path]
) -> Sequence[list[float] | None]:
    """Returns the corners in each photograph, x and y by turns; None if they are to be found."""
    if options.corners is None:
        # Without corners there is nothing to take exactly.
        if options.exact:
            raise InputError("--exact: expected --corners, got none")
        return [None] * len(files)
    if len(options.corners) != len(files):
        raise InputError(
            "--corners: expected the option once for each of "
            f"{pluralize(len(files), 'photograph')}, got it for {len(options.corners)}"
        )
    return options.corners


def _read_lens(options: argparse.Namespace) -> "Lens | None":
    from elitelanes_jax.photographs.lenses import read_lens

    return None if options.camera is None else read_lens(options.camera)


@contextmanager
def _naming_photograph(file: Path, photograph: "Photograph") -> Iterator[None]:
    """Names a photograph in an error as the user does.

    Photographs of several folders may have the same name, such as image.png.
    """
    try:
        yield
    except InputError as error:
        start, message = f"{photograph.name}: ", str(error)
        if message.startswith(start):
            raise InputError(f"{file}: {message.removeprefix(start)}") from None
        raise


def _propose(
    photograph: "Photograph",
    shape: tuple[int, int],
    corners: list[float] | None,
    *,
    exact: bool,
    codes: "NDArray[np.int8] | None" = None,
    tiles: "TileSet | None" = None,
) -> "Proposal":
    """Proposes where the tiles are in a photograph.

    `corners` are pixels of the file's picture. Without corners, the tiles are found.
    """
    import numpy as np

    from elitelanes_jax.photographs.proposals import propose_tiles

    # Without corners, the outlines are found in the photograph.
    if corners is None:
        return propose_tiles(photograph, shape=shape, codes=codes, tiles=tiles)
    # The user reads the corners in the file. The picture that was read may be smaller, and is
    # straightened for a known lens.
    points = photograph.pixels_of(np.array(corners, float).reshape(4, 2))
    try:
        return propose_tiles(
            photograph, shape=shape, corners=points, codes=codes, tiles=tiles, fit=not exact
        )
    except InputError as error:
        message = str(error)
        # The message names the function's argument, which is the option here.
        if message.startswith("corners: "):
            raise InputError(f"--{message}") from None
        raise
