"""The command ``elitelanes dataset``."""

import argparse
from typing import Any

from elitelanes_jax.command import add_drawing, add_wishes, fail, folder_name, name, number, say, whole, wishes_in

__all__ = ["add_dataset"]

_GOES_ON = "what is complete stays, and the same command goes on from there"


def add_dataset(commands: Any) -> None:
    """Adds the command to a parser's."""
    command = commands.add_parser(
        "dataset",
        help="make a dataset for segmentation",
        description="Evolves maps of mixed sizes, draws them, and writes pictures, labels and metadata in splits. "
        "Interrupted or killed, it goes on when it is started again.",
    )
    command.add_argument(
        "--out", type=folder_name, required=True, metavar="DIR", help="folder to write to, new, empty or begun before"
    )
    command.add_argument("--maps", type=whole(1), default=1000, metavar="N", help="how many maps; by default 1000")
    command.add_argument(
        "--size",
        type=whole(2, 1024),
        nargs=2,
        default=[8, 14],
        metavar=("LEAST", "MOST"),
        help="smallest and largest side of the square maps, in tiles; by default 8 14",
    )
    command.add_argument(
        "--split",
        type=number,
        nargs=3,
        default=[0.8, 0.1, 0.1],
        metavar=("TRAIN", "VALIDATION", "TEST"),
        help="shares of the maps; by default 0.8 0.1 0.1",
    )
    command.add_argument(
        "--views",
        type=whole(1),
        default=1,
        metavar="N",
        help="how often each map is drawn, from other tile pictures and in another view; by default 1",
    )
    command.add_argument(
        "--hold-out-tiles", action="store_true", help="draw the test from tile pictures that no other split shows"
    )
    command.add_argument(
        "--format", type=name, default="imagefolder", help="imagefolder (the default), mmseg, coco or plain"
    )
    command.add_argument(
        "--transform",
        type=name,
        nargs="+",
        default=["standard"],
        metavar="NAME[=VALUE]",
        help="how views of the maps vary: standard (the default) or none, quarter-turns, rotation=DEGREES, "
        "scale=LOW..HIGH, perspective=SHARE, crop=PIXELS, light=, contrast=, colour=SHARE, blur=PIXELS, noise=LEVELS",
    )
    command.add_argument(
        "--workers", type=whole(1, 1024), metavar="N", help="threads that draw; by default one for each processor"
    )
    command.add_argument(
        "--seed", type=whole(0, 2**32 - 1), default=0, metavar="N", help="of everything random; by default 0"
    )
    add_wishes(command, evaluations=100_000)
    add_drawing(command)
    command.set_defaults(run=_dataset, interrupted=_GOES_ON)


def _dataset(options: argparse.Namespace) -> int:
    from elitelanes_jax.compile_cache import use_compile_cache
    from elitelanes_jax.dataset import Settings, make_dataset
    from elitelanes_jax.transforms import read_transforms

    use_compile_cache()
    given = {name: getattr(options, name) for name in Settings._fields if hasattr(options, name)}
    given |= {"size": tuple(options.size), "split": tuple(options.split)}
    wishes = Settings().wishes._replace(**wishes_in(options))
    settings = Settings(**given, transforms=read_transforms(options.transform), wishes=wishes)
    try:
        about = make_dataset(settings, options.out, workers=options.workers)
    except OSError as error:
        return fail("elitelanes", f"{error.filename or options.out}: {error.strerror or error}; {_GOES_ON}", 2)
    lines = [f"{'':14}  " + "  ".join(split.rjust(10) for split in about["pictures"])]
    lines.append(f"{'pictures':14}  " + "  ".join(str(count).rjust(10) for count in about["pictures"].values()))
    for one in about["classes"]:
        counts = [pixels[one["label"]] / max(sum(pixels), 1) for pixels in about["class_pixels"].values()]
        lines.append(f"{one['name']:14}  " + "  ".join(f"{share:10.2%}" for share in counts))
    lines.append(
        f"{sum(about['pictures'].values())} pictures in {options.out}; how to load them: {options.out / 'README.md'}"
    )
    say("\n".join(lines))
    return 0
