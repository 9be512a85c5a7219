"""The console script ``elitelanes``, and ``python -m elitelanes_jax``.

It imports next to nothing before it catches signals: until then Python ends an interrupted program with a traceback.
"""

import gc
import os
import signal
import sys


def run() -> None:
    """Runs the command line of the process; modules load within, so that an interruption is caught from the start."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # not on every system
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(130))  # until `leave` has its own
    # Most of what is allocated while modules load and JAX traces is kept: to look for garbage is a fifth of the time.
    gc.set_threshold(100_000)
    for name, level in (("OPENCV_LOG_LEVEL", "SILENT"), ("OPENCV_FFMPEG_LOGLEVEL", "-8")):
        os.environ.setdefault(name, level)  # a line for each frame of a film on a full disk: the command says it in one
    from elitelanes_jax.cli.program import leave

    leave(_main)


def _main() -> int:
    from elitelanes_jax.cli.main import main

    return main(sys.argv[1:])


if __name__ == "__main__":
    run()
