"""The command ``elitelanes dataset``."""

import argparse

from elitelanes_jax._util.errors import pluralize
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
from elitelanes_jax.cli.program import say


def add_dataset(commands: Commands) -> None:
    from elitelanes_jax.dataset.spec import DatasetSpec

    command = commands.add_parser(
        "dataset",
        help="make a dataset for segmentation",
        description="Evolves maps of mixed sizes, or takes given ones, draws them, and writes pictures, labels and "
        "metadata in splits. After an interruption or a kill, the same command resumes.",
        epilog=COMPILING,
    )
    add_out(command)
    add_options(command, DatasetSpec())
    add_scheduler(command)
    add_force(command)
    add_cores(command)
    add_verbosity(command)
    command.set_defaults(action=_dataset)


def _dataset(options: argparse.Namespace) -> int:
    from elitelanes_jax.dataset.spec import DatasetSpec

    spec = read_options(options, DatasetSpec())
    if spec.maps_from is None:
        with naming_options(DatasetSpec()):
            spec.check_search()
    from elitelanes_jax.dataset.make import make_dataset
    from elitelanes_jax.search.compile_cache import use_compile_cache

    detail(f"compiled programs are kept in {use_compile_cache() or 'no folder'}")
    with naming_options(DatasetSpec(), "hold_out_tiles", "maps_from", "furnish"):
        if options.scheduler is None:
            about = make_dataset(spec, options.out, force=options.force)
        else:
            from elitelanes_jax.maps.cluster import dask_executor

            with dask_executor(options.scheduler) as executor:
                about = make_dataset(spec, options.out, force=options.force, executor=executor)
    lines = [f"{'':14}  " + "  ".join(split.rjust(10) for split in about["pictures"])]
    lines.append(f"{'pictures':14}  " + "  ".join(str(count).rjust(10) for count in about["pictures"].values()))
    for one in about["classes"]:
        counts = [pixels[one["label"]] / max(sum(pixels), 1) for pixels in about["class_pixels"].values()]
        lines.append(f"{one['name']:14}  " + "  ".join(f"{share:10.2%}" for share in counts))
    pictures = pluralize(sum(about["pictures"].values()), "picture")
    lines.append(f"{pictures} in {options.out}; how to load them: {options.out / 'README.md'}")
    say("\n".join(lines))
    return 0
