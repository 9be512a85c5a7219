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
    nothing, so that cleanup can finish. A signal that comes while modules load raises the exception
    when they are loaded, because native modules crash. If Python drops the exception, nothing is
    printed, and `raise_if_interrupted` raises it again.
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
        if sys.getprofile() is _raise_when_loaded:
            sys.setprofile(None)
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
    if _is_loading(frame):
        # Python calls a profiler at the end of each function, and so at the end of the import.
        sys.setprofile(_raise_when_loaded)
    else:
        raise_if_interrupted()


def _raise_when_loaded(frame: FrameType, event: str, argument: object) -> None:
    """Raises `KeyboardInterrupt` at the end of the outermost import."""
    if event == "return" and _imports(frame) and not _is_loading(frame.f_back):
        sys.setprofile(None)
        raise_if_interrupted()


def _is_loading(frame: FrameType | None) -> bool:
    """Returns whether a frame, or one that it returns to, imports a module."""
    while frame is not None and not _imports(frame):
        frame = frame.f_back
    return frame is not None


def _imports(frame: FrameType) -> bool:
    return frame.f_code.co_filename == "<frozen importlib._bootstrap>"


def _is_handled() -> bool:
    """Returns whether the calling thread handles a `KeyboardInterrupt`.

    This includes the handling of an error that followed from it.
    """
    error = sys.exc_info()[1]
    # Cleanup may fail with another error while it handles the interruption.
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None
