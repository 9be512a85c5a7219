"""Progress of long work: a bar in a terminal or a notebook, lines in a log.

Work opens a `Progress` and counts. A thread draws, so that the display moves while XLA compiles. The display of the
outermost work also names the work within it.
"""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import TextIO

# Seconds between two drawings of a bar, between two lines, and before the first drawing of a bar that is not forced.
_REDRAW, _LINES, _DELAY = 0.2, 30.0, 1.0
# The shortest step, in seconds, whose time is printed.
_SHORTEST = 0.5


class Verbosity(IntEnum):
    """How much a command prints. Does not affect errors. `QUIET` also hides results."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


_verbosity: Verbosity | None = None  # None outside of commands
_running: list["Progress"] = []  # the outermost work first
_last_line = 0.0  # the time when the last line was printed


@contextmanager
def reporting(level: Verbosity) -> Iterator[None]:
    """Makes the block a command: without a terminal, its progress is a line every 30 seconds."""
    global _verbosity, _last_line
    before, _verbosity, _last_line = _verbosity, level, time.monotonic()
    try:
        yield
    finally:
        _verbosity = before


def verbosity() -> Verbosity | None:
    """Returns the verbosity of the running command; None outside of commands."""
    return _verbosity


def announce(text: str) -> None:
    """Prints a line on standard error, in commands that are not quiet."""
    if _verbosity and sys.stderr is not None:
        drawn = any(work.display is not None and work.display.is_drawn_bar for work in _running)
        with suppress(OSError, ValueError):  # a closed stream must not stop the work
            print(("\r\x1b[K" if drawn else "") + text, file=sys.stderr, flush=True)


def detail(text: str) -> None:
    if _verbosity is Verbosity.VERBOSE:
        announce(text)


class Progress:
    """A context that shows the progress of counted work.

    Args:
      name: the name of the work.
      total: the final count; None if it is unknown.
      unit: the unit of the count, a plural.
      done: the count at the start.
      shown: whether the work is shown, at once. By default, a terminal or notebook shows work that takes over a
        second, and a command prints a line every 30 seconds elsewhere.
    """

    def __init__(
        self, name: str, total: int | None = None, unit: str = "", *, done: int = 0, shown: bool | None = None
    ) -> None:
        self.display: _Display | None = None
        self._name, self._total, self._unit, self._done = name, total, unit, done
        self._note, self._step = "", ""
        self._since, self._first = time.monotonic(), done  # for the remaining time
        self._shown = shown

    def update(self, done: int, note: str = "") -> None:
        """Sets the count, and a text to show after it."""
        self._done, self._note = done, note

    def count(self, more: int = 1) -> None:
        self._done += more

    @contextmanager
    def doing(self, step: str) -> Iterator[None]:
        """Shows the name of a step, such as compiling, instead of the count while the block runs."""
        start, before = time.monotonic(), self._step
        self._step, self._since = step, start
        try:
            yield
        finally:
            self._step, self._since = before, time.monotonic()
        if self._since - start > _SHORTEST:
            detail(f"{self._name}: {step} took {self._since - start:.1f} s")

    @property
    def fraction(self) -> float | None:
        return None if self._total is None else self._done / max(self._total, 1)

    def __str__(self) -> str:
        """Returns the text for a display."""
        seconds = time.monotonic() - self._since
        if self._step or self._total is None:
            return f"{self._name}{self._step and f': {self._step}'}, {seconds:.0f} s"
        done = self._done - self._first
        left = f", {_clock(seconds / done * (self._total - self._done))} left" if done and self.fraction != 1 else ""
        return f"{self._name} {self._done:,}/{self._total:,} {self._unit}{self._note and f', {self._note}'}{left}"

    def __enter__(self) -> "Progress":
        if self._shown is not False:
            _running.append(self)
            if len(_running) == 1:
                self.display = _start_display(self._shown)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.display is not None:
            self.display.end(finished=error is None)
        if self in _running:
            _running.remove(self)


def _start_display(shown: bool | None) -> "_Display | None":
    stream = sys.stderr
    if _verbosity is Verbosity.QUIET or stream is None or stream.closed:
        return None
    at_once = bool(shown) or _verbosity is Verbosity.VERBOSE
    bar = stream.isatty() or "ipykernel" in sys.modules
    return _Display(stream, at_once, bar) if bar or shown or _verbosity is not None else None


class _Display(Thread):
    """A thread that draws a bar or prints lines."""

    def __init__(self, stream: TextIO, at_once: bool, bar: bool) -> None:
        super().__init__(daemon=True)
        self._stream, self._at_once, self._bar, self._drawn = stream, at_once, bar, False
        self._ended: SimpleQueue[None] = SimpleQueue()
        self.start()

    @property
    def is_drawn_bar(self) -> bool:
        return self._bar and self._drawn

    def run(self) -> None:
        with suppress(OSError, ValueError):  # a closed stream must not stop the work
            while True:
                with suppress(Empty):
                    self._ended.get(timeout=max(self._wait(), 0))
                    return
                self._draw()

    def end(self, *, finished: bool) -> None:
        """Ends the thread, and draws the last state if anything was drawn or the work is shown at once."""
        self._ended.put(None)
        self.join()
        if self._drawn or self._at_once:
            with suppress(OSError, ValueError):
                if finished and (self._bar or self._at_once):
                    self._draw()
                if self._bar:
                    self._stream.write("\n")
                    self._stream.flush()

    def _wait(self) -> float:
        if self.is_drawn_bar or (self._at_once and not self._drawn):
            return _REDRAW
        return _DELAY if self._bar else _last_line + _LINES - time.monotonic()

    def _draw(self) -> None:
        global _last_line
        work = list(_running)
        text = "; ".join(map(str, work))
        if self._bar:
            self._draw_bar(work[0].fraction if work else None, text)
        else:
            _last_line = time.monotonic()
            print(text, file=self._stream, flush=True)
        self._drawn = True

    def _draw_bar(self, fraction: float | None, text: str) -> None:
        from tqdm import tqdm  # only displays need it

        if not self._drawn:
            self._print = tqdm.status_printer(self._stream)
        columns = 100
        with suppress(OSError, ValueError):  # a notebook has none
            columns = os.get_terminal_size(self._stream.fileno()).columns or columns
        # The figures are first, because a narrow terminal cuts off the end.
        form = "{desc}" if fraction is None else "{desc} |{bar}|"
        ascii_only = (getattr(self._stream, "encoding", None) or "ascii").lower() not in ("utf-8", "utf8")
        self._print(
            tqdm.format_meter(fraction or 0, 1, 0, ncols=columns, prefix=text, bar_format=form, ascii=ascii_only)
        )


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (f"{hours}:{minutes:02d}" if hours else f"{minutes}") + f":{seconds:02d}"
