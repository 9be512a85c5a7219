"""The frame of all programs of the project: messages, exit codes, signals.

A user's mistake ends in one line on standard error and exit code 2, too few maps or too little memory in exit code 1,
an interruption in 130. A fault of the program keeps its traceback.
"""

import os
import sys
from collections.abc import Callable
from typing import NoReturn

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError
from elitelanes_jax._util.progress import Loudness, loudness, reporting
from elitelanes_jax.cli.signals import catch_interrupts

__all__ = ["fail", "guarded", "leave", "say"]

_INTERRUPTED = 130


def guarded(program: str, action: Callable[[], int], interrupted: str, loud: Loudness = Loudness.NORMAL) -> int:
    """Does what a command does; returns its exit code.

    Args:
      program: its name, for messages.
      action: returns 0 when all went well.
      interrupted: the state in which an interruption leaves things, for the message.
      loud: how much it says of its work.
    """
    try:
        with reporting(loud):
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
    """Runs a program's main function as the program; interrupted outside of `guarded`, it ends without a word."""
    with catch_interrupts():
        try:
            code = main()
        except KeyboardInterrupt:
            code = _INTERRUPTED
        if code == _INTERRUPTED:
            # At once: while a compiler thread is still at work, the interpreter's own way out crashes.
            sys.stderr.flush()
            os._exit(code)
    raise SystemExit(code)


def fail(program: str, message: str, code: int) -> int:
    """Prints one line that says what went wrong, even of a file that has several in its name; returns the code."""
    print(f"{program}: " + "\\n".join(message.splitlines()), file=sys.stderr)
    return code


def say(text: str) -> None:
    """Prints what was done, unless the command is quiet. A failure to print does not undo it."""
    if loudness() is Loudness.QUIET:
        return
    try:
        print(text.encode(sys.stdout.encoding or "ascii", "backslashreplace").decode(sys.stdout.encoding or "ascii"))
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or it would be tried again at the end
