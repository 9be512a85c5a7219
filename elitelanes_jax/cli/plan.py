"""The command ``elitelanes plan``."""

import argparse

from elitelanes_jax._util.checks import path, real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.arguments import Commands, add_map, checked_by
from elitelanes_jax.cli.program import say


def add_plan(commands: Commands) -> None:
    """Adds the command to a parser's."""
    command = commands.add_parser(
        "plan",
        help="a plan to build a map from: tiles, tape, signs",
        description="Writes a plan to build a map from: where each tile lies, the sides of the floor, the signs, and a "
        "bill of tiles and tape. A PDF also has a check-list.",
    )
    add_map(command)
    command.add_argument(
        "--out",
        type=checked_by(path),
        required=True,
        metavar="FILE",
        help="a new file that ends in .pdf, .svg or .png",
    )
    command.add_argument(
        "--tile-size",
        type=checked_by(real(0.55, 2, unit="metres")),
        default=None,
        metavar="METRES",
        help="side of a tile; by default 0.585, as Duckietown has it",
    )
    command.set_defaults(action=_plan)


def _plan(options: argparse.Namespace) -> int:
    from elitelanes_jax._util.files import check_new
    from elitelanes_jax.formats.duckietown import TILE_SIZE
    from elitelanes_jax.formats.plan import write_plan
    from elitelanes_jax.formats.road_map import read_map

    road_map = read_map(options.map)
    check_new(options.out)
    try:
        plan = write_plan(road_map, options.out, tile_size=options.tile_size or TILE_SIZE)
    except InputError as error:
        words = str(error)
        named = {"file: ": "--out: ", "map: ": f"{options.map}: "}
        raise type(error)(
            next((new + words.removeprefix(old) for old, new in named.items() if words.startswith(old)), words)
        ) from None
    across, down = plan.floor
    tape = ", ".join(f"{metres:.2f} m {colour}" for colour, metres in plan.tape.items())
    say(f"{len(plan.placed)} tiles on {across:.2f} x {down:.2f} m, tape: {tape}; the plan is {options.out}")
    return 0
