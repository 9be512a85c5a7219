"""What the project's commands share: arguments, messages, exit codes.

What the user got wrong ends in one line on standard error and exit code 2, too few maps or too little memory in exit
code 1, an interruption in 130. A fault of the program keeps its traceback.
"""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from elitelanes_jax.errors import InputError, NotEnoughMapsError, short
from elitelanes_jax.interrupts import catch_interrupts

__all__ = [
    "Parser",
    "add_drawing",
    "add_wishes",
    "fail",
    "folder_name",
    "guarded",
    "leave",
    "metres",
    "name",
    "number",
    "say",
    "weight",
    "whole",
    "wishes_in",
]

_INTERRUPTED = 130
_WISHES = ("method", "preset", "evaluations", "generations", "axes", "where", "weights", "fix", "rules")


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, and exit code 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")


def whole(least: int, most: int = 2**31 - 1) -> Callable[[str], int]:
    """A type of argument: a whole number within limits."""

    def parse(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = least - 1
        if not least <= number <= most:
            limit = f"{least} or more" if most == 2**31 - 1 else f"{least} to {most}"
            raise argparse.ArgumentTypeError(f"expected a whole number, {limit}, got {short(text, 40)!r}")
        return number

    return parse


def metres(text: str) -> float:
    """A type of argument: a length over 0."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"expected metres, a number over 0, got {short(text, 40)!r}")
    return number


def weight(text: str) -> tuple[str, int]:
    """A type of argument: a name, an equals sign and a whole number."""
    key, _, number = text.partition("=")
    try:
        return key.strip(), int(number)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected NAME=N with a whole number, got {short(text, 40)!r}") from None


def number(text: str) -> float:
    """A type of argument: a number, 0 or more."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number, 0 or more, got {short(text, 40)!r}")
    return value


def name(text: str) -> str:
    """A type of argument: any text but the empty one."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"expected a name, got {text!r}")
    return text


def folder_name(text: str) -> Path:
    """A type of argument: a path."""
    return Path(name(text))


def add_drawing(command: argparse.ArgumentParser) -> None:
    """Adds the arguments of a command that draws."""
    command.add_argument("--tiles", type=folder_name, metavar="DIR", help="tile pictures; by default the package's own")
    command.add_argument(
        "--tile-px", type=whole(16, 512), default=64, metavar="N", help="side of a tile in pixels; by default 64"
    )


def add_wishes(command: argparse.ArgumentParser, evaluations: int) -> None:
    """Adds the arguments of a command that evolves maps: the fields of `elitelanes_jax.wishes.Wishes`.

    Args:
      command: that evolves.
      evaluations: of each run, where no budget is given.
    """
    command.add_argument("--method", type=name, default="map-elites", help="map-elites (the default), ea, pso or gwo")
    command.add_argument(
        "--preset", type=name, default="tuned", help="settings of the method: tuned (the default), paper, or standard"
    )
    budget = command.add_mutually_exclusive_group()
    budget.add_argument(
        "--evaluations", type=whole(0), metavar="N", help=f"how many grids each run evaluates; by default {evaluations}"
    )
    budget.add_argument("--generations", type=whole(0), metavar="N", help="of each run, in place of evaluations")
    ranges = "ranges that every map meets, such as crossings=6..10, bridges=0 or straight_share=0.3.."
    for flag, kind, form, use in (
        ("--axes", name, "NAME:BINS", "of the niches, such as straight_share:10"),
        ("--where", name, "NAME=LOW..HIGH", ranges),
        ("--weights", weight, "NAME=N", "of the fitness, such as dead_ends=480"),
    ):
        command.add_argument(flag, type=kind, nargs="+", action="extend", default=[], metavar=form, help=use)
    command.add_argument(
        "--fix",
        type=folder_name,
        metavar="FILE",
        help="JSON rows of tile codes that every map keeps, null where free",
    )
    command.add_argument("--rules", type=name, metavar="NAME", help="rules that every map keeps: duckietown")


def wishes_in(options: argparse.Namespace) -> dict[str, Any]:
    """The fields of `elitelanes_jax.wishes.Wishes` that were given."""
    given = {name: value for name, value in vars(options).items() if name in _WISHES and value is not None}
    return {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}


def guarded(program: str, action: Callable[[], int], interrupted: str) -> int:
    """Does what a command does; returns its exit code.

    Args:
      program: its name, to stand before messages.
      action: returns 0 when all went well.
      interrupted: what to say of the state in which an interruption leaves things.
    """
    try:
        return action()
    except InputError as error:
        return fail(program, str(error), 2)
    except NotEnoughMapsError as error:
        return fail(program, str(error), 1)
    except OSError as error:
        return fail(program, f"{error.filename}: {error.strerror}" if error.filename else str(error), 2)
    except KeyboardInterrupt:
        return fail(program, f"interrupted; {interrupted}", _INTERRUPTED)
    except Exception as error:
        if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):  # the latter is how JAX says it
            return fail(program, "not enough memory; fewer seeds, smaller maps or smaller tiles need less", 1)
        raise


def leave(main: Callable[[], int]) -> NoReturn:
    """Runs a program's main function as the program."""
    with catch_interrupts():
        code = main()
        if code == _INTERRUPTED:
            # At once: while a compiler thread is still at work, the interpreter's own way out crashes.
            sys.stderr.flush()
            os._exit(code)
    raise SystemExit(code)


def fail(program: str, message: str, code: int) -> int:
    """Says in one line what went wrong, even of a file that has several in its name, and returns the code."""
    print(f"{program}: " + "\\n".join(message.splitlines()), file=sys.stderr)
    return code


def say(text: str) -> None:
    """Prints what was done. That it cannot be printed does not undo it."""
    try:
        print(text.encode(sys.stdout.encoding or "ascii", "backslashreplace").decode(sys.stdout.encoding or "ascii"))
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or it would be tried again at the end
