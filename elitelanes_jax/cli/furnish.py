"""The command ``elitelanes furnish``."""

import argparse

from elitelanes_jax._util.checks import check_named, name, path, whole
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.cli.arguments import Commands, add_map, checked_by
from elitelanes_jax.cli.program import say

_EXAMPLES = """examples:
  elitelanes furnish map.json signs --out signed.json
  elitelanes furnish map.json all trees=0.4 duckies=6 --seed 3 --out furnished.json
  elitelanes furnish map.json signs street_names own.toml --unique-tags --out named.json
"""


def add_furnish(commands: Commands) -> None:
    """Adds the command to a parser's."""
    command = commands.add_parser(
        "furnish",
        help="place signs, buildings, trees, vehicles and duckies on a map",
        description="Places signs by Duckietown's rules, and other objects at random; replaces the map's objects.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_map(command)
    command.add_argument(
        "furnish",
        type=checked_by(name),
        nargs="+",
        metavar="WHAT",
        help="signs, street_names, all, amounts such as duckies=6 or trees=0.2: below 1 a share of the cells without "
        "road, and a file .toml or .json with objects of your own",
    )
    command.add_argument(
        "--unique-tags", action="store_true", help="refuse to use a tag number twice; the same as the word unique_tags"
    )
    command.add_argument("--out", type=checked_by(path), required=True, metavar="FILE", help="a new map file, .json")
    command.add_argument(
        "--seed", type=checked_by(whole(0, 2**32 - 1)), default=0, metavar="N", help="of the places; by default 0"
    )
    command.set_defaults(action=_furnish)


def _furnish(options: argparse.Namespace) -> int:
    from elitelanes_jax._util.files import check_new
    from elitelanes_jax.formats.road_map import read_map
    from elitelanes_jax.maps.furnishing.placing import furnish
    from elitelanes_jax.maps.furnishing.spec import parse_furnish

    spec = check_named("furnish", parse_furnish, options.furnish + ["unique_tags"] * options.unique_tags)
    check_new(options.out)
    road_map = read_map(options.map)
    try:
        furnished = furnish(road_map, spec, seed=options.seed)
    except InputError as error:
        raise InputError(f"{options.map}: {error}") from None
    furnished.save(options.out)
    say(f"{pluralize(len(furnished.objects or ()), 'object')} in {options.out}")
    return 0
