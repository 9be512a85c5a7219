"""Signals that ask a program to end, as `KeyboardInterrupt` in its main thread."""

import os
import signal
import threading
from types import FrameType

__all__ = ["catch_interrupts"]

# JAX's hook into the garbage collector: Python only prints what is raised in there, and goes on.
_DEAF = "_xla_gc_callback"


def catch_interrupts() -> None:
    """Lets SIGINT, SIGTERM and SIGHUP raise `KeyboardInterrupt`, each unless it is ignored, as under ``nohup``."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # not every system has all
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_name == _DEAF:
            again = threading.Timer(0.01, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt
