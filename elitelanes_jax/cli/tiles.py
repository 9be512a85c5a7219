"""The commands ``elitelanes tiles``: checks of a tile set, and proposed masks.

The commands on photographs are in `photographs`.
"""

import argparse
import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from elitelanes_jax._util.checks import path
from elitelanes_jax._util.errors import pluralize
from elitelanes_jax._util.files import free_name, new_file
from elitelanes_jax.cli.arguments import Commands, add_command, checked_by, naming
from elitelanes_jax.cli.editing import add_edit
from elitelanes_jax.cli.photographs import add_cut, add_read
from elitelanes_jax.cli.program import say, warn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def add_tiles(commands: Commands) -> None:
    tiles = commands.add_parser(
        "tiles", help="cut tiles out of photographs, check tile sets, and propose masks"
    )
    below = tiles.add_subparsers(title="commands", required=True, metavar="COMMAND")
    add_cut(below)
    add_read(below)
    add_edit(below)
    check = add_command(below, "check", _check, help="describe a tile set, or list all its errors")
    check.add_argument("folder", type=checked_by(path), metavar="DIR")
    masks = add_command(
        below,
        "masks",
        _masks,
        help="propose masks for photographs, by colour",
        description="Writes road.png, red.png and yellow.png next to each image.png that lacks "
        "them, to be corrected by hand. Ranges of colours are H..H,S..S,V..V: hues 0 to 179, "
        "saturations and values 0 to 255.",
    )
    masks.add_argument("folder", type=checked_by(path), metavar="DIR", help="folder of a tile set")
    colours = (("road", "asphalt"), ("red", "stop lines"), ("yellow", "lane separators"))
    for mask, what in colours:
        masks.add_argument(f"--{mask}", metavar="RANGE", help=f"colours of {what}")
    masks.add_argument(
        "--overwrite",
        action="store_true",
        help="also replace existing masks: those whose colours are given, or all; "
        "a copy of each is kept next to it",
    )


def _check(options: argparse.Namespace) -> int:
    from elitelanes_jax.tiles.sides import describe_lanes
    from elitelanes_jax.tiles.tileset import describe_tiles, inspect_tiles

    tiles, problems = inspect_tiles(options.folder, lines=True)
    # All errors are listed at once, so that the user corrects them together.
    if tiles is None:
        warn("\n".join(problems))
        return 2
    say(f"{describe_tiles(tiles)}\n{describe_lanes(tiles.tiles, tiles.lane_offset)}")
    return 0


def _masks(options: argparse.Namespace) -> int:
    from elitelanes_jax.tiles.masking import COLOURS, mask_folder, parse_colour, proposal_sheet
    from elitelanes_jax.tiles.tileset import MASKS

    named = [mask for mask in MASKS if getattr(options, mask) is not None]
    colours = dict(COLOURS)
    for mask in named:
        # An error about a range names its option.
        with naming(f"--{mask}"):
            colours[mask] = parse_colour(getattr(options, mask))
    sheet = options.folder / "masks.png"
    # With --overwrite, only masks whose colours are named are replaced. Without colours, all are.
    replaced = (named or MASKS) if options.overwrite else ()
    proposals = mask_folder(options.folder, colours, replaced)
    title = "Masks by colour: " + ", ".join(f"{mask} {colours[mask]}" for mask in MASKS)
    masks = {
        file: picture
        for proposal in proposals
        for file, picture in proposal.mask_files(proposal.proposed).items()
    }
    # All copies exist before the first file is replaced.
    kept_as = [_keep(file) for file in masks if file.exists()]
    if sheet.exists():
        _keep(sheet)
    _write_together({sheet: proposal_sheet(title, proposals)} | masks)
    # Masks that exist and were not replaced may have been made by hand.
    unchanged = len(MASKS) * len(proposals) - len(masks)
    written = f"{pluralize(len(masks), 'mask')} of {pluralize(len(proposals), 'tile')}"
    written += f" in {options.folder}"
    if unchanged:
        written += f", {unchanged} existing ones unchanged"
    if kept_as:
        written += f", {len(kept_as)} replaced and kept as {kept_as[0].name} and the like"
    say(f"{written}; all are on {sheet}")
    next_command = f"elitelanes tiles check {options.folder}"
    say(f"correct them by hand in any picture editor, then: {next_command}")
    return 0


def _keep(file: Path) -> Path:
    """Copies a file next to itself under a new name, so that no mask made by hand is lost."""
    copy = free_name(file, f".{file.name}.before")
    shutil.copy2(file, copy)
    return copy


def _write_together(pictures: "dict[Path, NDArray[np.uint8]]") -> None:
    from elitelanes_jax.tiles.rendering import write_png

    # The stack renames the files when all are written. If one cannot be written, none is replaced.
    with ExitStack() as stack:
        for file, pixels in pictures.items():
            write_png(stack.enter_context(new_file(file)), pixels)
