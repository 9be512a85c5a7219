"""The command ``elitelanes dataset``."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from elitelanes_jax._util.errors import pluralize
from elitelanes_jax.cli.arguments import (
    COMPILING,
    Commands,
    add_command,
    add_options,
    add_shared,
    naming_options,
    read_options,
)
from elitelanes_jax.cli.executors import add_executors, open_pool
from elitelanes_jax.cli.program import say

if TYPE_CHECKING:
    from elitelanes_jax.dataset.tables import DatasetRecord


def add_dataset(commands: Commands) -> None:
    from elitelanes_jax.dataset.spec import DatasetSpec

    command = add_command(
        commands,
        "dataset",
        _dataset,
        help="make a dataset for segmentation",
        description="Evolves maps of mixed sizes, or takes given ones, draws them, and writes "
        "pictures, labels and metadata in splits. After an interruption or a kill, the same "
        "command resumes.",
        epilog=COMPILING,
    )
    add_shared(command, "--out")
    add_options(command, DatasetSpec())
    add_executors(command)
    add_shared(command, "--force", "--cores", "--quiet")


def _dataset(options: argparse.Namespace) -> int:
    from elitelanes_jax.dataset.planning import plan_dataset
    from elitelanes_jax.dataset.spec import DatasetSpec

    spec = read_options(options, DatasetSpec())
    # The plan checks the options together with tiles and objects, so its errors are about options.
    with naming_options(DatasetSpec()):
        plan = plan_dataset(spec)
    # This module loads JAX. Wrong options are refused without it.
    from elitelanes_jax.dataset.make import make_planned
    from elitelanes_jax.search.compile_cache import use_compile_cache

    use_compile_cache()
    # While the dataset is made, only errors about `furnish` are about an option. Others may name a
    # file that has the name of an option.
    with naming_options(DatasetSpec(), "furnish"), open_pool(options) as pool:
        about = make_planned(plan, options.out, force=options.force, pool=pool)
    # A part has only some pictures, so it has no table of classes yet.
    if spec.part is None:
        say(describe_dataset(about, options.out))
    else:
        index, count = spec.part
        maps = f"maps {spec.map_indices[0]} to {spec.map_indices[-1]}"
        say(f"part {index} of {count}, {maps}, in {options.out}; elitelanes merge joins all parts")
    return 0


def describe_dataset(about: "DatasetRecord", out: Path) -> str:
    """Returns a table of a dataset's classes in each split, from its record."""
    # The first row has the names of the splits.
    table = {"": about["pictures"], "pictures": about["pictures"].values()}
    for class_ in about["classes"]:
        cells = []
        for pixels in about["class_pixels"].values():
            # A split without pictures has no pixels.
            share = pixels[class_["label"]] / max(sum(pixels), 1)
            cells.append(f"{share:.2%}")
        table[class_["name"]] = cells
    lines = [
        f"{head:14}  " + "  ".join(f"{cell:>10}" for cell in cells) for head, cells in table.items()
    ]
    pictures = pluralize(sum(about["pictures"].values()), "picture")
    return "\n".join([*lines, f"{pictures} in {out}; how to load them: {out / 'README.md'}"])
