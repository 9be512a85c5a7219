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
        description="Writes a plan to build a map from: where each tile lies, the sides of the floor, signs and "
        "objects, and a bill of tiles and tape. A PDF also has a check-list.",
    )
    add_map(command)
    out = "a new file that ends in .pdf, .svg or .png"
    command.add_argument("--out", type=checked_by(path), required=True, metavar="FILE", help=out)
    command.add_argument(
        "--tile-size",
        type=checked_by(real(0.55, 2, unit="metres")),
        default=0.585,
        metavar="METRES",
        help="side of a tile; by default 0.585, as Duckietown has it",
    )
    command.set_defaults(action=_plan)


def _plan(options: argparse.Namespace) -> int:
    from elitelanes_jax._util.files import check_new
    from elitelanes_jax.formats.plan import write_plan
    from elitelanes_jax.formats.road_map import read_map

    road_map = read_map(options.map)
    check_new(options.out)
    try:
        plan = write_plan(road_map, options.out, tile_size=options.tile_size)
    except InputError as error:
        words = str(error).replace("file: ", "--out: ", 1).replace("map: ", f"{options.map}: ", 1)
        raise type(error)(words) from None
    tape = ", ".join(f"{metres:.2f} m {colour}" for colour, metres in plan.tape.items())
    say(f"{len(plan.placed)} tiles on {plan.floor[0]:g} x {plan.floor[1]:g} m, tape {tape}, in {options.out}")
    return 0
