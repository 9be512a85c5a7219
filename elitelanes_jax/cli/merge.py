"""The command ``elitelanes merge``."""

import argparse

from elitelanes_jax._util.checks import folder, path
from elitelanes_jax.cli.arguments import Commands, add_force, add_verbosity, checked_by
from elitelanes_jax.cli.generate import describe_maps
from elitelanes_jax.cli.program import say


def add_merge(commands: Commands) -> None:
    """Adds the command to a parser's."""
    command = commands.add_parser(
        "merge",
        help="put the parts of a run together",
        description="Puts together what elitelanes generate --part has found, and writes the folder that one run "
        "writes without parts.",
    )
    command.add_argument(
        "parts",
        type=checked_by(path),
        nargs="+",
        metavar="PART",
        help="folders of all the parts, in any order",
    )
    command.add_argument(
        "--out", type=checked_by(folder), required=True, metavar="DIR", help="folder to write to, new or empty"
    )
    add_force(command)
    add_verbosity(command)
    command.set_defaults(action=_merge)


def _merge(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.generation import merge

    maps = merge(options.parts, options.out, force=options.force)
    say(describe_maps(maps, len(maps), options.out))
    return 0
