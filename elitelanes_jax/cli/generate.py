"""The commands that write folders of maps: ``elitelanes generate``, ``merge`` and ``pick``."""

import argparse
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from elitelanes_jax._util.checks import path, real
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.folders import has_unfinished
from elitelanes_jax.cli.arguments import (
    COMPILING,
    Commands,
    add_command,
    add_options,
    add_shared,
    checked_by,
    naming_options,
    read_options,
)
from elitelanes_jax.cli.executors import add_executors, open_pool
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


def add_generate(commands: Commands) -> None:
    from elitelanes_jax.maps.spec import GenerateSpec

    command = add_command(
        commands,
        "generate",
        _generate,
        help="evolve maps and draw them",
        description="Evolves maps that are valid, different and spread over the niches; draws them "
        "with their masks.",
        notes=f"""examples:
  elitelanes generate --size 12 12 --maps 16 --out maps
  elitelanes generate --where crossings=6..10 straight_share=0.3..0.6 --out in-range
  elitelanes generate --rules duckietown --size 9 9 --maps 4 --out floor-plans
  elitelanes generate --style town --size 9 9 --maps 24 --out towns

'elitelanes metrics' lists the metrics that --where, --axes and --weights name.

{COMPILING}""",
    )
    add_shared(command, "--out")
    add_options(command, GenerateSpec())
    add_executors(command)
    command.add_argument(
        "--floor",
        type=checked_by(real(0, 600, unit="metres, a number", exclusive=True)),
        nargs=2,
        metavar=("WIDTH", "DEPTH"),
        help="instead of --size: metres from west to east and from north to south; the size is the "
        "largest with tiles of 0.585 m and room for signs around the map",
    )
    add_shared(command, "--force", "--cores", "--quiet")


def _generate(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.planning import plan_run
    from elitelanes_jax.maps.spec import GenerateSpec

    if options.floor is not None:
        options.size = _size_for_floor(options)
    with _naming_floor(options):
        spec = read_options(options, GenerateSpec())
        with naming_options(GenerateSpec()):
            run = plan_run(spec)
    # This module loads JAX. Wrong options are refused without it.
    from elitelanes_jax.maps.generation import generate_planned
    from elitelanes_jax.search.compile_cache import use_compile_cache

    # Later commands read the compiled programs from a folder.
    use_compile_cache()
    try:
        # While maps are made, only errors about `furnish` are about an option. Others may name a
        # file that has the name of an option.
        with naming_options(GenerateSpec(), "furnish"), open_pool(options) as pool:
            maps = generate_planned(run, options.out, force=options.force, pool=pool)
    except NotEnoughMapsError as error:
        # A user who knows that the elites are kept does not search again for fewer maps.
        raise NotEnoughMapsError(f"{error}{_KEPT if has_unfinished(options.out) else ''}") from None
    if spec.part is None:
        # The line can be pasted into a shell, also for a folder with spaces in its name.
        explore = (
            f"{program_name()} explore {shlex.quote(str(options.out))} --open shows all elites"
        )
        lines = [describe_maps(maps, spec.maps, options.out), explore]
        if options.floor is not None:
            width, depth = options.floor
            lines.insert(
                1,
                f"{spec.size[0]} x {spec.size[1]} tiles each, for a floor of "
                f"{width:g} x {depth:g} m",
            )
        say("\n".join(lines))
    else:
        index, count = spec.part
        seeds = f"seeds {spec.seed_indices[0]} to {spec.seed_indices[-1]}"
        joins = f"{program_name()} merge joins all parts"
        say(f"part {index} of {count}, {seeds}, in {options.out}; {joins}")
    return 0


def _size_for_floor(options: argparse.Namespace) -> tuple[int, int]:
    """Returns the size of maps for the floor that is named instead of a size."""
    from elitelanes_jax.maps.furnishing.floors import floor_size

    # argparse stores only options that were given, so this attribute means --size.
    if hasattr(options, "size"):
        floor = " ".join(f"{side:g}" for side in options.floor)
        raise InputError("--floor", "none with --size", floor)
    try:
        return floor_size(*options.floor)
    except InputError as error:
        raise error.replace(subject=f"--{error.subject}") from None


@contextmanager
def _naming_floor(options: argparse.Namespace) -> Iterator[None]:
    """Makes errors about a size in its block name --floor, if the size follows from it."""
    try:
        yield
    except InputError as error:
        if options.floor is None or error.subject != "--size":
            raise
        raise error.replace(subject="--floor") from None


def add_merge(commands: Commands) -> None:
    command = add_command(
        commands,
        "merge",
        _merge,
        help="join the parts of a run or a dataset",
        description="Joins the results of elitelanes generate --part or dataset --part, and writes "
        "the folder of a run without parts.",
    )
    command.add_argument(
        "parts",
        type=checked_by(path),
        nargs="+",
        metavar="PART",
        help="folders of all parts, in any order",
    )
    add_shared(command, "--out", "--force", "--quiet")


def _merge(options: argparse.Namespace) -> int:
    # The first part says whether a run or a dataset is joined, and the merge compares the others
    # with it.
    if (options.parts[0] / "dataset.json").is_file():
        from elitelanes_jax.cli.dataset import describe_dataset
        from elitelanes_jax.dataset.joining import merge_dataset

        about = merge_dataset(options.parts, options.out, force=options.force)
        say(describe_dataset(about, options.out))
        return 0
    from elitelanes_jax.maps.parts import merge

    # A merge writes as many maps as the run without parts, so none is missing.
    maps = merge(options.parts, options.out, force=options.force)
    say(describe_maps(maps, len(maps), options.out))
    return 0


def add_pick(commands: Commands) -> None:
    from elitelanes_jax.maps.spec import PickSpec

    command = add_command(
        commands,
        "pick",
        _pick,
        help="choose more, other or filtered maps from archives of generate",
        description="Chooses maps among the elites of earlier searches, and draws them, without "
        "another search.",
        notes="""examples:
  elitelanes pick maps/archive.npz --maps 40 --out more
  elitelanes pick maps/archive.npz --unlike maps/maps/*/map.json --out others
  elitelanes pick maps/archive.npz --where bridges=0 crossings=..40 --out without-bridges
""",
    )
    command.add_argument(
        "archives",
        type=checked_by(path),
        nargs="+",
        metavar="ARCHIVE",
        help="an archive.npz, of maps of one size",
    )
    add_shared(command, "--out")
    add_options(command, PickSpec())
    add_shared(command, "--force")
    command.add_argument(
        "--force-archive",
        action="store_true",
        help="like --force, but also replace a folder with an archive.npz, which pick does not "
        "write again",
    )
    add_shared(command, "--quiet")


def _pick(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.spec import PickSpec

    spec = read_options(options, PickSpec())
    # This module loads JAX. Wrong options are refused without it.
    from elitelanes_jax.maps.picking import pick

    # Only the archives say whether these options fit: which features were measured, and the size.
    with naming_options(PickSpec(), "furnish", "axes", "where"):
        maps = pick(
            spec,
            options.archives,
            options.out,
            force=options.force,
            force_archive=options.force_archive,
        )
    say(describe_maps(maps, spec.maps, options.out))
    return 0


def describe_maps(maps: "Sequence[RoadMap]", wanted: int, out: Path) -> str:
    """Returns a table of the maps that were written to a folder."""
    heads = ("map", *(name.replace("_", " ") for name in _COLUMNS))
    lines = ["  ".join(heads)]
    for index, road_map in enumerate(maps):
        # A map's fitness is no metric, but has a column too.
        figures = {"fitness": road_map.fitness} | dict(road_map.metrics or {})
        row = [f"{index:04d}", *(str(figures[name]) for name in _COLUMNS)]
        lines.append(
            "  ".join(cell.rjust(len(head)) for cell, head in zip(row, heads, strict=True))
        )
    count = pluralize(len(maps), "map")
    # Fewer maps than asked for are named as such, and are no error here.
    if len(maps) < wanted:
        count += f" of {wanted:,}"
    they_are = "it is" if len(maps) == 1 else "all of them"
    lines.append(f"{count} in {out / 'maps'}, {they_are} on {out / 'contact-sheet.png'}")
    lines += _advice_on_crossings([dict(road_map.metrics or {}) for road_map in maps])
    return "\n".join(lines)


def _advice_on_crossings(metrics: "Sequence[Mapping[str, float]]") -> list[str]:
    """Says how many maps have no crossing, and what crossings an inventory has left."""
    lines = []
    counts = [figures["crossings"] for figures in metrics]
    bare = counts.count(0)
    if bare:
        verb = "has" if bare == 1 else "have"
        line = f"{bare} of {pluralize(len(counts), 'map')} {verb} no crossing"
        # The user may have asked for such maps.
        if bare < len(counts):
            line += "; --where crossings=1.. asks for one"
        lines.append(line)
    # The names are those of `choose_maps`, which adds them with an inventory.
    left = [
        figures.get("crossings3_left", 0) + figures.get("crossings4_left", 0) for figures in metrics
    ]
    if any(left):
        more = max(max(counts), min(counts) + 1)
        span = f"{min(left)} to {max(left)}" if min(left) < max(left) else f"{max(left)}"
        lines.append(
            f"{span} of the shelf's {counts[0] + left[0]} crossings are left; "
            f"--where crossings={more}.. asks for maps that use more"
        )
    return lines
