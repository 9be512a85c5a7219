"""Arguments that the experiments share."""

import argparse
from pathlib import Path
from typing import Any

from readings import READINGS
from runs import METHODS

from elitelanes_jax import InputError, __version__
from elitelanes_jax._util.checks import path, whole
from elitelanes_jax.cli.arguments import add_cores, checked_by
from elitelanes_jax.network import check_shape

__all__ = ["add_settings", "checked_settings"]


def add_settings(parser: argparse.ArgumentParser, *, sizes: list[tuple[int, int]], seeds: int, out: str) -> None:
    """Adds the options for methods, sizes, seeds, generations, reading and folder, with these defaults."""
    parser.add_argument("--methods", nargs="+", default=list(METHODS), metavar="NAME", help=f"of {', '.join(METHODS)}")
    parser.add_argument("--sizes", nargs="+", type=_size, default=sizes, metavar="SIZE", help="12, or 9x14 tiles")
    number = parser.add_mutually_exclusive_group()
    number.add_argument(
        "--seeds",
        type=checked_by(whole(1, 2**20)),
        default=seeds,
        metavar="N",
        help=f"runs of each method; by default {seeds}",
    )
    number.add_argument(
        "--paper", action="store_const", dest="seeds", const=4, help="4 runs of each method, as in the paper"
    )
    parser.add_argument(
        "--seed", type=checked_by(whole(0, 2**32 - 1)), default=0, metavar="N", help="seed of everything random"
    )
    parser.add_argument(
        "--generations", type=checked_by(whole(1)), default=200, metavar="N", help="of 40 grids; by default 200"
    )
    parser.add_argument("--reading", default="ours", metavar="NAME", help=f"of the paper: {', '.join(READINGS)}")
    add_cores(parser)
    parser.add_argument("--out", type=checked_by(path), default=Path(out), metavar="DIR", help=f"by default {out}")


def _size(text: str) -> tuple[int, int]:
    try:
        sides = [int(side) for side in text.split("x")]
        return check_shape(sides * 2 if len(sides) == 1 else sides, new=True)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a size, 12 or 9x14, sides from 2 to 1024, got {text!r}") from None


def checked_settings(program: str, options: argparse.Namespace) -> dict[str, Any]:
    """Checks the options; returns the settings that the results belong to.

    Raises:
      InputError: for an unknown method or reading.
    """
    for method in options.methods:
        if method not in METHODS:
            raise InputError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    if options.reading not in READINGS:
        raise InputError(f"reading: expected one of {', '.join(READINGS)}, got {options.reading!r}")
    options.methods = [method for method in METHODS if method in options.methods]
    options.sizes = list(dict.fromkeys(options.sizes))
    about = {"program": program, "version": __version__}
    return about | {
        name: getattr(options, name) for name in ("methods", "sizes", "seeds", "seed", "generations", "reading")
    }
