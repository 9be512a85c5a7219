"""Signals that end a program, raised as `KeyboardInterrupt` in its main thread until one exception gets through."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_AGAIN, _SOON = 0.1, 0.001  # seconds

_raised = False  # in the current block of `catch_interrupts`


def was_interrupted() -> bool:
    """Returns whether `catch_interrupts` has raised an exception. Native code of NumPy may make another error of it."""
    return _raised


@contextmanager
def catch_interrupts() -> Iterator[None]:
    """Makes SIGINT, SIGTERM and SIGHUP raise `KeyboardInterrupt` in its block. Signals that are ignored stay ignored.

    An exception can be lost: Python only prints an exception in a callback of the garbage collector, and JAX's native
    code drops an exception in a comparison that it calls. So it is raised again every tenth of a second. It is not
    raised while it is handled, so that cleaning up is not disturbed. While a module loads it waits, because native
    modules such as NumPy's and JAX's would crash or print a traceback; it is raised a millisecond after, before the
    command announces its work.
    """
    global _raised
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    _raised = False
    hook = sys.unraisablehook
    repeats = hasattr(signal, "setitimer")  # not on every system

    def interrupt(number: int, frame: FrameType | None) -> None:
        global _raised
        loading = repeats and _is_loading(frame)
        if loading or (repeats and number != signal.SIGALRM):
            signal.setitimer(signal.ITIMER_REAL, _SOON if loading else _AGAIN, _AGAIN)
        if not loading and not _is_handled():
            _raised = True
            raise KeyboardInterrupt

    def unraisable(lost: "sys.UnraisableHookArgs") -> None:
        if not (repeats and isinstance(lost.exc_value, KeyboardInterrupt)):
            hook(lost)

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    if repeats:
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, interrupt)
    sys.unraisablehook = unraisable
    try:
        yield
    finally:
        if repeats:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook, _raised = hook, False


def _is_loading(frame: FrameType | None) -> bool:
    while frame is not None and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


def _is_handled() -> bool:
    """Returns whether the main thread handles a `KeyboardInterrupt`, or an error that followed from it."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None
