"""The command ``elitelanes generate``."""

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from elitelanes_jax._util.errors import NotEnoughMapsError, pluralize
from elitelanes_jax._util.progress import detail
from elitelanes_jax.cli.arguments import (
    COMPILING,
    Commands,
    add_cores,
    add_force,
    add_options,
    add_out,
    add_scheduler,
    add_verbosity,
    naming_options,
    read_options,
)
from elitelanes_jax.cli.program import program_name, say

if TYPE_CHECKING:
    from elitelanes_jax.formats.road_map import RoadMap

_KEPT = "; the elites are kept: fewer maps need no new search, and more evaluations extend it"

_COLUMNS = (
    "fitness",
    "cyclomatic",
    "crossings",
    "bridges",
    "adjacent_crossings",
    "adjacent_turns",
    "straight_score",
)


_EXAMPLES = """examples:
  elitelanes generate --size 12 12 --maps 16 --out maps
  elitelanes generate --where crossings=6..10 straight_share=0.3..0.6 --out in-range
  elitelanes generate --rules duckietown --size 9 9 --maps 4 --out floor-plans
  elitelanes generate --style town --size 9 9 --maps 24 --out towns

'elitelanes metrics' lists the metrics that --where, --axes and --weights name.
"""


def add_generate(commands: Commands) -> None:
    from elitelanes_jax.maps.spec import GenerateSpec

    command = commands.add_parser(
        "generate",
        help="evolve maps and draw them",
        description="Evolves maps that are valid, different and spread over the niches; draws them with their masks.",
        epilog=f"{_EXAMPLES}\n{COMPILING}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_out(command)
    add_options(command, GenerateSpec())
    add_scheduler(command)
    add_force(command)
    add_cores(command)
    add_verbosity(command)
    command.set_defaults(action=_generate)


def _generate(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.spec import GenerateSpec

    spec = read_options(options, GenerateSpec())
    from elitelanes_jax._util.folders import has_unfinished
    from elitelanes_jax.maps.generation import generate
    from elitelanes_jax.search.compile_cache import use_compile_cache

    detail(f"compiled programs are kept in {use_compile_cache() or 'no folder'}")
    try:
        with naming_options(GenerateSpec(), "furnish", "axes", "where"):
            if options.scheduler is None:
                maps = generate(spec, options.out, force=options.force)
            else:
                from elitelanes_jax.maps.cluster import dask_executor, generate_on

                with dask_executor(options.scheduler) as executor:
                    maps = generate_on(executor, spec, options.out, force=options.force)
    except NotEnoughMapsError as error:
        raise NotEnoughMapsError(f"{error}{_KEPT if has_unfinished(options.out) else ''}") from None
    if spec.part is None:
        explore = f"{program_name()} explore {shlex.quote(str(options.out))} --open shows all elites"
        say(f"{describe_maps(maps, spec.maps, options.out)}\n{explore}")
    else:
        index, count = spec.part
        seeds = f"seeds {spec.seed_indices[0]} to {spec.seed_indices[-1]}"
        say(f"part {index} of {count}, {seeds}, in {options.out}; elitelanes merge joins all parts")
    return 0


def describe_maps(maps: "Sequence[RoadMap]", wanted: int, out: Path) -> str:
    """Returns a table of the maps that were written to a folder."""
    heads = ("map", *(name.replace("_", " ") for name in _COLUMNS))
    lines = ["  ".join(heads)]
    for index, road_map in enumerate(maps):
        figures = {"fitness": road_map.fitness} | dict(road_map.metrics or {})
        row = [f"{index:04d}", *(str(figures[name]) for name in _COLUMNS)]
        lines.append("  ".join(cell.rjust(len(head)) for cell, head in zip(row, heads, strict=True)))
    of = f" of {wanted:,}" if len(maps) < wanted else ""
    sheet = f"{'it is' if len(maps) == 1 else 'all of them'} on {out / 'contact-sheet.png'}"
    lines.append(f"{pluralize(len(maps), 'map')}{of} in {out / 'maps'}, {sheet}")
    differences = [(road_map.metrics or {}).get("difference_from_examples") for road_map in maps]
    known = [share for share in differences if share is not None]
    if known:
        lines.append(f"they differ from the nearest example map in {min(known):.0%} to {max(known):.0%} of their cells")
    return "\n".join(lines)
