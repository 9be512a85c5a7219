"""The commands on photographs of tiles: ``elitelanes tiles cut`` and ``elitelanes tiles read``."""

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from elitelanes_jax._util.checks import FLOOR_SIDE, file_named, folder, path, real
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import check_new, free_name, never_replacing
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.cli.arguments import Commands, add_command, add_shared, checked_by, naming
from elitelanes_jax.cli.program import say
from elitelanes_jax.formats.road_map import RoadMap, read_map
from elitelanes_jax.network.codes import KIND_OF

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from elitelanes_jax.tiles.photographs.cutting import Cut
    from elitelanes_jax.tiles.photographs.proposals import Proposal
    from elitelanes_jax.tiles.photographs.reading import Lens, Photograph

_PIXEL = real(-1e6, 1e6, unit="pixels")


def add_cut(commands: Commands) -> None:
    command = add_command(
        commands,
        "cut",
        _cut,
        help="cut a tile set out of photographs",
        description="Finds the tiles in photographs and writes a tile set: a square picture of each tile, its proposed "
        "masks, and sheet.png to check all by eye. A photograph shows one tile, or a floor of --size or --map.",
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
        description="Draws the map of a floor in the terminal, and names tiles that are unsure. With --against, names "
        "the tiles that differ from a plan.",
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
        help="the corners of the tiles in the photograph, roughly: x and y in pixels, clockwise from the top left one; "
        "by default they are found. Repeat it for each photograph",
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


def _cut(options: argparse.Namespace) -> int:
    from elitelanes_jax.tiles.masking import proposal_sheet
    from elitelanes_jax.tiles.photographs.cutting import cut_tiles, write_cuts
    from elitelanes_jax.tiles.photographs.proposals import SURE
    from elitelanes_jax.tiles.photographs.sheet import draw_proposal, draw_sheet
    from elitelanes_jax.tiles.rendering import write_png
    from elitelanes_jax.tiles.tileset import inspect_tiles

    laid = None if options.map is None else read_map(options.map).codes
    shape = _shape(options, laid)
    out: Path = options.out
    existing = out.is_dir() and any(out.iterdir())
    if existing and not options.overwrite:
        raise InputError(
            f"{out}: expected a folder that is new or empty, got one with files; --overwrite replaces it"
        )
    cuts: list[Cut] = []
    proposals, pictures = [], []
    lens = _lens(options)
    for index, file in enumerate(options.photos):
        photograph = _photograph(file, lens)
        proposal = _propose(photograph, options, index, shape, codes=laid)
        proposals.append(proposal)
        pictures.append(draw_proposal(photograph, proposal))
        if proposal.score >= SURE:
            cuts += cut_tiles(photograph, proposal, cuts)
    refused = [
        f"{proposal.photo}: {proposal.advice}" for proposal in proposals if proposal.score < SURE
    ]
    if not cuts:
        more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
        raise InputError(
            refused[0] + more
            if refused
            else f"{options.photos[0]}: expected tiles of a sure kind, got none"
        )
    # Renamed, so that nothing in it is lost.
    kept = out.rename(free_name(out, f"{out.name}.before")) if existing else None
    try:
        with output_folder(out, {"command": "tiles cut"}) as work:
            tiles = proposal_sheet("Tiles and their masks", write_cuts(work.files, cuts))
            write_png(
                work.files / "sheet.png",
                draw_sheet(f"Tiles cut into {out.name}", pictures, proposals, tiles),
            )
    except BaseException:
        if kept is not None and not out.exists():
            kept.rename(out)
        raise
    lines = _summary(cuts, proposals, out) + [f"refused: {line}" for line in refused]
    lines += [] if kept is None else [f"the earlier set is kept as {kept}"]
    problems = inspect_tiles(out, lines=True)[1]
    lines += [f"to correct: {problem}" for problem in problems] or [
        f"checked: no problems in {out}"
    ]
    say("\n".join(lines))
    return 0


def _summary(cuts: "list[Cut]", proposals: "list[Proposal]", out: Path) -> list[str]:
    from elitelanes_jax.tiles.photographs.proposals import SURE

    kinds = Counter(KIND_OF[cut.code] for cut in cuts)
    listed = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    used = sum(proposal.score >= SURE for proposal in proposals)
    lines = [
        f"{pluralize(len(cuts), 'tile')} of {pluralize(used, 'photograph')} in {out}: {listed}"
    ]
    lines += [f"look at the outlines and masks on {out / 'sheet.png'}"]
    lines += [f"{cut.name} is nearly a copy of {cut.copy_of}" for cut in cuts if cut.copy_of]
    for proposal in proposals:
        if proposal.score >= SURE:
            lines += [
                f"{proposal.photo}: left out the tile at {place}, its kind is unsure"
                for place in _unsure(proposal)
            ]
    return lines


def _unsure(proposal: "Proposal") -> list[str]:
    from elitelanes_jax.tiles.photographs.proposals import SURE

    return [
        f"row {row + 1}, column {column + 1}"
        for row, sures in enumerate(proposal.sure)
        for column, sure in enumerate(sures)
        if sure < SURE
    ]


def _read(options: argparse.Namespace) -> int:
    from elitelanes_jax.formats.sketch import draw_text
    from elitelanes_jax.tiles.photographs.comparison import (
        find_differences,
        turn_floor,
        turn_to_plan,
    )
    from elitelanes_jax.tiles.photographs.proposals import SURE
    from elitelanes_jax.tiles.tileset import load_tiles

    plan = None if options.against is None else read_map(options.against).codes
    shape = _shape(options, plan)
    if shape == (1, 1):
        got = "none" if options.size is None else "1 1"
        raise InputError(
            f"--size: expected the rows and columns of a floor of 2 tiles or more, got {got}"
        )
    if options.out is not None:
        check_new(options.out)
    tiles = load_tiles(options.tiles)
    proposal = _propose(_photograph(options.photo, _lens(options)), options, 0, shape, tiles=tiles)
    if proposal.score < SURE:
        raise InputError(f"{options.photo}: {proposal.advice}")
    codes, sure = _arrays(proposal)
    lines = []
    if plan is not None:
        with naming(options.against):
            turns = turn_to_plan(codes, plan)
        import numpy as np

        codes, sure = turn_floor(codes, turns), np.rot90(sure, turns)
    unsure = [[row, column] for row, column in zip(*(sure < SURE).nonzero(), strict=True)]
    unsure = [[int(row), int(column)] for row, column in unsure]
    lines.append(draw_text(codes))
    lines += [f"row {row + 1}, column {column + 1}: unsure" for row, column in unsure]
    if plan is not None:
        differences = find_differences(codes, plan)
        lines += [str(difference) for difference in differences]
        count = pluralize(len(differences), "tile")
        verb = "differs" if len(differences) == 1 else "differ"
        lines.append(f"{count} of {codes.size} {verb} from {options.against}")
    if options.out is not None:
        with never_replacing(options.out):
            RoadMap(codes, unsure=unsure or None).save(options.out)
    say("\n".join(lines), asked=True)
    return 0


def _arrays(proposal: "Proposal") -> "tuple[NDArray[np.int8], NDArray[np.float64]]":
    import numpy as np

    return np.array(proposal.codes, np.int8), np.array(proposal.sure)


def _shape(options: argparse.Namespace, laid: "NDArray[np.int8] | None") -> tuple[int, int]:
    """Returns rows and columns of the floor: of the map, or as given; (1, 1) for single tiles."""
    if laid is None:
        return (1, 1) if options.size is None else tuple(options.size)
    shape = laid.shape
    if options.size is not None and tuple(options.size) != shape:
        raise InputError(
            f"--size: expected {shape[0]} {shape[1]} like the map, got {options.size[0]} {options.size[1]}"
        )
    return shape


def _lens(options: argparse.Namespace) -> "Lens | None":
    from elitelanes_jax.tiles.photographs.reading import read_lens

    return None if options.camera is None else read_lens(options.camera)


def _photograph(file: Path, lens: "Lens | None") -> "Photograph":
    from elitelanes_jax.tiles.photographs.reading import read_photograph

    return read_photograph(file, lens)


def _propose(
    photograph: "Photograph",
    options: argparse.Namespace,
    index: int,
    shape: tuple[int, int],
    **given: UserValue,
) -> "Proposal":
    import numpy as np

    from elitelanes_jax.tiles.photographs.proposals import propose_tiles

    photos = options.photos if hasattr(options, "photos") else [options.photo]
    corners = options.corners
    if corners is not None and len(corners) != len(photos):
        raise InputError(
            f"--corners: expected the option once for each of {pluralize(len(photos), 'photograph')}, "
            f"got it for {len(corners)}"
        )
    if corners is None and options.exact:
        raise InputError("--exact: expected --corners, got none")
    if corners is None:
        return propose_tiles(photograph, shape=shape, **given)
    points = photograph.pixels_of(np.array(corners[index], float).reshape(4, 2))
    try:
        return propose_tiles(
            photograph, shape=shape, corners=points, fit=not options.exact, **given
        )
    except InputError as error:
        raise InputError(str(error).replace("corners: ", "--corners: ", 1)) from None
