"""The command ``elitelanes pick``."""

import argparse

from elitelanes_jax._util.checks import path
from elitelanes_jax.cli.arguments import (
    Commands,
    add_force,
    add_options,
    add_out,
    add_verbosity,
    checked_by,
    naming_options,
    read_options,
)
from elitelanes_jax.cli.generate import describe_maps
from elitelanes_jax.cli.program import say

_EXAMPLES = """examples:
  elitelanes pick maps/archive.npz --maps 40 --out more
  elitelanes pick maps/archive.npz --unlike maps/maps/*/map.json --out others
  elitelanes pick maps/archive.npz --where bridges=0 crossings=..40 --out without-bridges
"""


def add_pick(commands: Commands) -> None:
    from elitelanes_jax.maps.spec import PickSpec

    command = commands.add_parser(
        "pick",
        help="choose more, other or filtered maps from archives of generate",
        description="Chooses maps among the elites of earlier searches, and draws them, without another search.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "archives", type=checked_by(path), nargs="+", metavar="ARCHIVE", help="an archive.npz, of maps of one size"
    )
    add_out(command)
    add_options(command, PickSpec())
    add_force(command)
    command.add_argument(
        "--force-archive",
        dest="force",
        action="store_const",
        const="archive",
        help="like --force, but also replace a folder with an archive.npz, which pick does not write again",
    )
    add_verbosity(command)
    command.set_defaults(action=_pick)


def _pick(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.spec import PickSpec

    spec = read_options(options, PickSpec())
    from elitelanes_jax.maps.picking import pick

    with naming_options(PickSpec(), "furnish", "axes", "where"):
        maps = pick(
            spec, options.archives, options.out, force=bool(options.force), force_archive=options.force == "archive"
        )
    say(describe_maps(maps, spec.maps, options.out))
    return 0
