"""Turns signals into `KeyboardInterrupt`, and raises it again if it was lost."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]

# Whether a signal came since the block of `catch_interrupts` began.
_interrupted = False


@contextmanager
def catch_interrupts() -> Iterator[None]:
    """Makes SIGINT, SIGTERM and SIGHUP raise `KeyboardInterrupt` in its block.

    Signals that are ignored stay ignored. While the exception is handled, another signal raises
    nothing, so that cleanup can finish. While a module loads, a signal raises nothing, because
    native modules crash; `raise_if_interrupted` raises it later. If Python drops the exception,
    nothing is printed.
    """
    global _interrupted
    _interrupted = False
    # Python would print the traceback of a `KeyboardInterrupt` that it drops, such as in a
    # destructor.
    hook = sys.unraisablehook

    def report_dropped(dropped: "sys.UnraisableHookArgs") -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            hook(dropped)

    sys.unraisablehook = report_dropped
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook
        _interrupted = False


def was_interrupted() -> bool:
    """Returns whether a signal came in the block of `catch_interrupts`.

    Native code may replace the `KeyboardInterrupt` by another error.
    """
    return _interrupted


def raise_if_interrupted() -> None:
    """Raises `KeyboardInterrupt` if a signal came whose exception was lost.

    Python drops exceptions in callbacks of the garbage collector, and JAX's native code drops them
    in comparisons. So work that counts its steps calls this function.
    """
    if _interrupted and not _is_handled():
        raise KeyboardInterrupt


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _interrupted
    _interrupted = True
    # The flag is set in any case, so that a signal during an import is not lost.
    if not _is_loading(frame):
        raise_if_interrupted()


def _is_loading(frame: FrameType | None) -> bool:
    while frame is not None and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


def _is_handled() -> bool:
    """Returns whether the calling thread handles a `KeyboardInterrupt`.

    This includes the handling of an error that followed from it.
    """
    error = sys.exc_info()[1]
    # Cleanup may fail with another error while it handles the interruption.
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None
