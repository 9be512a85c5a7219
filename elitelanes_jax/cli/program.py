"""The frame of the command line: messages, exit codes, signals.

A user's mistake ends in one line on standard error and exit code 2. The exit code is 1 for too few
maps or too little memory, and 130 for an interruption. A fault of the program keeps its traceback.
"""

import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from shutil import which
from typing import NoReturn, TextIO

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, NotEnoughMemoryError
from elitelanes_jax._util.interruption import catch_interrupts, was_interrupted
from elitelanes_jax._util.memory import is_out_of_memory
from elitelanes_jax._util.progress import is_quiet, reporting

INTERRUPTED = 130
"""The exit code after an interruption."""


def guarded(program: str, action: Callable[[], int], interrupted: str, quiet: bool = False) -> int:
    """Runs the action of a program, which returns 0 if it succeeds; returns the exit code.

    `interrupted` says what an interruption leaves.
    """
    try:
        with reporting(quiet=quiet):
            try:
                return action()
            except Exception:
                # Native code may replace the `KeyboardInterrupt` by an error of its own.
                if was_interrupted():
                    raise KeyboardInterrupt from None
                raise
    except (InputError, NotEnoughMapsError) as error:
        # The package's messages name arguments of Python.
        as_option = re.compile(r"\b(force|force_archive|at_most)=True")
        words = as_option.sub(lambda match: "--" + match[1].replace("_", "-"), str(error))
        # Wrong input has exit code 2, as in argparse, and too few maps have 1.
        return fail(program, words, 2 if isinstance(error, InputError) else 1)
    except OSError as error:
        # An error of the system names the file, and needs no traceback.
        return fail(
            program, f"{error.filename}: {error.strerror}" if error.filename else str(error), 2
        )
    except KeyboardInterrupt:
        return fail(program, f"interrupted; {interrupted}", INTERRUPTED)
    except NotEnoughMemoryError as error:
        return fail(program, str(error), 1)
    except Exception as error:
        # JAX has no error of its own for a platform that it does not find. Its devices tell.
        platforms = os.environ.get("JAX_PLATFORMS")
        if platforms and not _has_devices():
            return fail(
                program,
                f"JAX_PLATFORMS: expected a platform that JAX finds here, got {platforms!r}",
                2,
            )
        if is_out_of_memory(error):
            return fail(
                program,
                "not enough memory; fewer seeds, smaller maps or smaller tiles need less",
                1,
            )
        raise


def _has_devices() -> bool:
    import jax

    try:
        return bool(jax.devices())
    except Exception:
        # Some platforms raise an AssertionError without a message.
        return False


def leave(main: Callable[[], int]) -> NoReturn:
    """Runs a program's main function as the program.

    An interruption outside of `guarded` prints nothing.
    """
    _complete_streams()
    try:
        with catch_interrupts():
            try:
                code = main()
            except KeyboardInterrupt:
                code = INTERRUPTED
            except SystemExit as stop:
                # As Python does for a text.
                code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
            # Text that is still buffered would be lost by `os._exit`.
            for stream in (sys.stdout, sys.stderr):
                _flush(stream)
            if code == INTERRUPTED:
                # The interpreter's own exit crashes while a thread compiles.
                os._exit(code)
        raise SystemExit(code)
    except KeyboardInterrupt:
        # The signal came while the block ended.
        os._exit(INTERRUPTED)


def program_name() -> str:
    """Returns the word that starts the program: a path if its folder is not on the PATH."""
    # The first argument is the path by which the program was started.
    started = Path(sys.argv[0])
    return (
        str(started)
        if started.name == "elitelanes" and which("elitelanes") is None
        else "elitelanes"
    )


def fail(program: str, message: str, code: int) -> int:
    """Prints a message on standard error in one line, and returns the exit code.

    Line breaks in the message are escaped.
    """
    warn(f"{program}: " + "\\n".join(message.splitlines()))
    return code


def warn(text: str) -> None:
    """Prints on standard error, if possible."""
    with suppress(OSError, ValueError):
        _print(sys.stderr, text)


def say(text: str, *, asked: bool = False) -> None:
    """Prints what was done, unless the command is quiet. A failure to print is ignored.

    If the text was `asked` for, a failure raises `OSError`, except for a pipe whose reader has
    stopped.
    """
    if is_quiet():
        return
    try:
        _print(sys.stdout, text)
    except BrokenPipeError:
        pass
    except (OSError, ValueError) as error:
        # A closed stream raises a ValueError.
        if asked:
            raise OSError(
                getattr(error, "errno", None),
                getattr(error, "strerror", str(error)),
                "standard output",
            ) from None


def _print(stream: TextIO | None, text: str) -> None:
    """Prints to a stream, if there is one, and escapes characters that it lacks.

    A stream that fails is given up.
    """
    if stream is None:
        return
    # Some streams that replace standard output have no encoding.
    encoding = stream.encoding or "utf-8"
    try:
        print(text.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)
    except (OSError, ValueError):
        _give_up(stream)
        raise


def _flush(stream: TextIO) -> None:
    try:
        stream.flush()
    except (OSError, ValueError):
        _give_up(stream)


def _give_up(stream: TextIO) -> None:
    """Redirects a stream to nowhere.

    Otherwise the interpreter would try to flush the stream at its end, and complain.
    """
    with suppress(OSError, ValueError):
        # The descriptor of the stream leads to the null device from here on.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _complete_streams() -> None:
    """Opens missing standard streams; otherwise the next opened file would become one."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            # The file gets the lowest free descriptor.
            os.open(os.devnull, os.O_RDWR)
    # Python sets a stream to None if its descriptor is closed.
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)
