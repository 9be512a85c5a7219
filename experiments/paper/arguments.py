"""The command line of the three studies of the paper."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from elitelanes_jax import InputError, __version__
from elitelanes_jax.network import check_shape
from experiments.common import add_cores, whole
from experiments.paper.readings import READINGS
from experiments.paper.runs import METHODS, Settings

__all__ = ["add_arguments", "check_arguments"]


def add_arguments(parser: argparse.ArgumentParser, sizes: Sequence[tuple[int, int]], seeds: int, out: str) -> None:
    """Adds the options for methods, sizes, seeds, generations, reading and folder, with these defaults."""
    names = ", ".join(METHODS)
    parser.add_argument("--methods", nargs="+", default=METHODS, metavar="NAME", help=f"some of {names}; default all")
    parser.add_argument("--sizes", nargs="+", type=_size, default=sizes, metavar="SIZE", help="such as 12 or 9x14")
    runs = parser.add_mutually_exclusive_group()
    runs.add_argument(
        "--seeds", type=whole(1, 2**20), default=seeds, metavar="N", help=f"runs of each method; default {seeds}"
    )
    runs.add_argument("--paper", action="store_const", dest="seeds", const=4, help="4 runs, as in the paper")
    parser.add_argument("--seed", type=whole(0, 2**32 - 1), default=0, metavar="N", help="random seed; default 0")
    parser.add_argument(
        "--generations", type=whole(1), default=200, metavar="N", help="generations of 40 grids; default 200"
    )
    parser.add_argument("--reading", default="ours", metavar="NAME", help=f"one of {', '.join(READINGS)}; default ours")
    add_cores(parser)
    parser.add_argument("--out", type=Path, default=Path(out), metavar="DIR", help=f"folder of results; default {out}")


def _size(text: str) -> tuple[int, int]:
    try:
        sides = [int(side) for side in text.split("x")]
        return check_shape(sides * 2 if len(sides) == 1 else sides, new=True)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a size, 12 or 9x14, sides from 2 to 1024, got {text!r}") from None


def check_arguments(program: str, options: argparse.Namespace) -> tuple[Settings, dict[str, object]]:
    """Checks the options.

    Returns:
      The settings of the runs, and a record that says which command the results are from.

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
    names = ("methods", "sizes", "seeds", "seed", "generations", "reading")
    command = {"program": program, "version": __version__} | {name: getattr(options, name) for name in names}
    return Settings(options.seeds, options.seed, options.generations, READINGS[options.reading]), command
