"""The command ``elitelanes merge``."""

import argparse

from elitelanes_jax._util.checks import path
from elitelanes_jax.cli.arguments import Commands, add_force, add_out, add_verbosity, checked_by
from elitelanes_jax.cli.generate import describe_maps
from elitelanes_jax.cli.program import say


def add_merge(commands: Commands) -> None:
    command = commands.add_parser(
        "merge",
        help="join the parts of a run",
        description="Joins the results of elitelanes generate --part, and writes the folder of a run without parts.",
    )
    command.add_argument(
        "parts", type=checked_by(path), nargs="+", metavar="PART", help="folders of all parts, in any order"
    )
    add_out(command)
    add_force(command)
    add_verbosity(command)
    command.set_defaults(action=_merge)


def _merge(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.generation import merge

    maps = merge(options.parts, options.out, force=options.force)
    say(describe_maps(maps, len(maps), options.out))
    return 0
