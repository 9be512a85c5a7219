"""The command ``elitelanes pack``."""

import argparse

from elitelanes_jax._util.checks import folder, path
from elitelanes_jax._util.errors import pluralize
from elitelanes_jax.cli.arguments import (
    Commands,
    add_force,
    add_options,
    add_verbosity,
    checked_by,
    naming_options,
    read_options,
)
from elitelanes_jax.cli.program import say


def add_pack(commands: Commands) -> None:
    """Adds the command to a parser's."""
    from elitelanes_jax.maps.spec import PackSpec

    command = commands.add_parser(
        "pack",
        help="maps for other programs, with splits, trips and checksums",
        description="Writes a folder with maps for other programs, splits that share no niche, and trips with their "
        "exact lengths. After an interruption or a kill, the same command resumes.",
    )
    command.add_argument(
        "sources",
        type=checked_by(path),
        nargs="+",
        metavar="FILE|DIR",
        help="a folder of generate, pick, dataset or pack, or files of maps",
    )
    command.add_argument(
        "--out", type=checked_by(folder), required=True, metavar="DIR", help="folder to write to, new or empty"
    )
    add_options(command, PackSpec())
    add_force(command)
    add_verbosity(command)
    command.set_defaults(action=_pack)


def _pack(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.spec import PackSpec

    spec = read_options(options, PackSpec())
    from elitelanes_jax.maps.packing import pack

    with naming_options(PackSpec(), tile="--tile-size"):
        about = pack(spec, options.sources, options.out, force=options.force)
    splits = (
        f"{name} {pluralize(part['maps'], 'map')} of {pluralize(part['niches'], 'niche')}"
        for name, part in about["splits"].items()
    )
    say(f"{pluralize(about['maps']['number'], 'map')} in {options.out}: {', '.join(splits)}")
    return 0
