"""The console script ``elitelanes``, and ``python -m elitelanes_jax``.

Signals are caught before modules are imported, because Python ends a program that is interrupted
earlier with a traceback.
"""

import gc
import os
import signal
import sys
from contextlib import suppress


def run() -> None:
    """Runs the command line of the process."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        # Not every system has all three.
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            # This holds until `leave` has its own handlers.
            signal.signal(number, _stop)
    # Most objects made while modules load and JAX traces are kept. Looking for garbage took a fifth
    # of that time. The modules have some 200,000 objects.
    gc.set_threshold(400_000)
    for name, level in (("OPENCV_LOG_LEVEL", "SILENT"), ("OPENCV_FFMPEG_LOGLEVEL", "-8")):
        # On a full disk OpenCV prints a line per frame; the command prints one.
        os.environ.setdefault(name, level)
    from elitelanes_jax.cli.program import leave

    leave(_main)


def _stop(*_: object) -> None:
    """Ends the program, which has only loaded modules so far."""
    with suppress(OSError):
        # Standard error may be closed. It is not buffered here, as `os._exit` flushes nothing.
        os.write(2, b"elitelanes: interrupted\n")
    os._exit(130)


def _main() -> int:
    from elitelanes_jax.cli.program import INTERRUPTED, fail

    try:
        from elitelanes_jax.cli.main import main

        return main(sys.argv[1:])
    except KeyboardInterrupt:
        # No command ran at that moment. A command says what an interruption leaves.
        return fail("elitelanes", "interrupted", INTERRUPTED)


if __name__ == "__main__":
    run()
