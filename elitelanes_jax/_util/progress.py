"""Progress of long work: a bar in a terminal or a notebook, lines in a log.

Work opens a `Progress` and counts in it. One thread draws, so that the display goes on while a compiler is at work.
Work within other work has no display of its own: it is named in that of the outermost.
"""

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import TextIO

# In seconds: between two drawings of a bar, between two lines, before a bar is shown that nobody asked for, and the
# shortest step whose time is told.
_REDRAW, _LINES, _DELAY, _TOLD = 0.2, 30.0, 1.0, 0.5


class Loudness(IntEnum):
    """The amount that a command says: results and errors are not part of it, but that a quiet one has no results."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


_loudness: Loudness | None = None  # None outside of commands
_at_work: list["Progress"] = []  # the outermost first
_last_line = 0.0  # when it was printed


@contextmanager
def reporting(level: Loudness) -> Iterator[None]:
    """Makes the work in its block that of a command: off a terminal its progress is a line every 30 seconds."""
    global _loudness, _last_line
    before, _loudness, _last_line = _loudness, level, time.monotonic()
    try:
        yield
    finally:
        _loudness = before


def loudness() -> Loudness | None:
    """Returns the loudness of the command at work, None outside of commands."""
    return _loudness


def announce(text: str) -> None:
    """Prints a line on standard error, in commands that are not quiet."""
    if _loudness and sys.stderr is not None:
        with suppress(OSError, ValueError):  # the stream may be closed, and the work goes on
            print(("\r\x1b[K" if _is_drawn() else "") + text, file=sys.stderr, flush=True)


def detail(text: str) -> None:
    """Prints a line on standard error, in verbose commands."""
    if _loudness is Loudness.VERBOSE:
        announce(text)


class Progress:
    """Work that is done bit by bit: a context.

    Args:
      name: of the work.
      total: the count at the end, if there is one.
      unit: of the count, a plural.
      done: the count at the start.
      shown: whether to show it, at once; by default in a terminal or notebook when it takes over a second, and in
        commands also elsewhere, as a line every 30 seconds.
    """

    def __init__(
        self, name: str, total: int | None = None, unit: str = "", *, done: int = 0, shown: bool | None = None
    ) -> None:
        self._name, self._total, self._unit, self._done = name, total, unit, done
        self._note, self._doing = "", ""
        self._since, self._first = time.monotonic(), done  # the time left follows from what was done since
        self._shown = shown
        self._painter: _Painter | None = None

    def update(self, done: int, note: str = "") -> None:
        """Sets the count, and words to stand behind it."""
        self._done, self._note = done, note

    def count(self, more: int = 1) -> None:
        """Adds to the count."""
        self._done += more

    @contextmanager
    def doing(self, step: str) -> Iterator[None]:
        """Names what is done in the block, such as compiling, in place of the count."""
        began, before = time.monotonic(), self._doing
        self._doing, self._since = step, began
        try:
            yield
        finally:
            self._doing, self._since = before, time.monotonic()
        if self._since - began > _TOLD:
            detail(f"{self._name}: {step} took {self._since - began:.1f} s")

    @property
    def fraction(self) -> float | None:
        """The part that is done, None where there is no count."""
        return None if self._total is None else self._done / max(self._total, 1)

    def __str__(self) -> str:
        """Returns the words for a display."""
        seconds = time.monotonic() - self._since
        if self._doing or self._total is None:
            return f"{self._name}{self._doing and f': {self._doing}'}, {seconds:.0f} s"
        done = self._done - self._first
        left = f", {_clock(seconds / done * (self._total - self._done))} left" if done and self.fraction != 1 else ""
        return f"{self._name} {self._done:,}/{self._total:,} {self._unit}{self._note and f', {self._note}'}{left}"

    def __enter__(self) -> "Progress":
        if self._shown is not False:
            _at_work.append(self)
            if len(_at_work) == 1:
                self._painter = _painter(self._shown)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._painter is not None:
            self._painter.end(finished=error is None)
        if self in _at_work:
            _at_work.remove(self)


def _painter(shown: bool | None) -> "_Painter | None":
    """Starts what shows the outermost work, if anything does."""
    stream = sys.stderr
    if _loudness is Loudness.QUIET or stream is None or stream.closed:
        return None
    at_once = bool(shown) or _loudness is Loudness.VERBOSE
    if stream.isatty() or "ipykernel" in sys.modules:
        return _Bar(stream, at_once)
    return _Lines(stream, at_once) if shown or _loudness is not None else None


class _Painter(threading.Thread):
    """A thread that shows what is at work; the queue is one that an interruption leaves intact."""

    def __init__(self, stream: TextIO, at_once: bool) -> None:
        super().__init__(daemon=True)
        self.drawn = False
        self._stream, self._at_once = stream, at_once
        self._ended: SimpleQueue[None] = SimpleQueue()
        self.start()

    def run(self) -> None:
        with suppress(OSError, ValueError):  # nobody reads it any more: the work goes on
            while not self._waits(self._due()):
                self._draw()

    def end(self, *, finished: bool) -> None:
        """Ends the thread, and shows the last state where one was shown before or is asked for."""
        self._ended.put(None)
        self.join()
        if self.drawn or self._at_once:
            with suppress(OSError, ValueError):
                self._close(finished)

    def _waits(self, seconds: float) -> bool:
        with suppress(Empty):
            self._ended.get(timeout=max(seconds, 0))
            return True
        return False

    def _due(self) -> float:
        """Returns the seconds to the next drawing."""
        raise NotImplementedError

    def _draw(self) -> None:
        raise NotImplementedError

    def _close(self, finished: bool) -> None:
        raise NotImplementedError


class _Bar(_Painter):
    """One line that is drawn again and again."""

    def _due(self) -> float:
        return _REDRAW if self.drawn or self._at_once else _DELAY

    def _draw(self) -> None:
        from tqdm import tqdm  # the kernels do without it

        if not self.drawn:
            self._print = tqdm.status_printer(self._stream)
            self.drawn = True
        fraction, words = _words()
        # The figures stand first, as a narrow terminal cuts off the end.
        form = "{desc}" if fraction is None else "{desc} |{bar}|"
        columns = _columns(self._stream)
        self._print(
            tqdm.format_meter(
                fraction or 0, 1, 0, ncols=columns, prefix=words, bar_format=form, ascii=not _has_blocks(self._stream)
            )
        )

    def _close(self, finished: bool) -> None:
        if finished:
            self._draw()
        self._stream.write("\n")
        self._stream.flush()


class _Lines(_Painter):
    """A line from time to time."""

    def _due(self) -> float:
        return _REDRAW if self._at_once and not self.drawn else _last_line + _LINES - time.monotonic()

    def _draw(self) -> None:
        global _last_line
        self.drawn, _last_line = True, time.monotonic()
        print(_words()[1], file=self._stream, flush=True)

    def _close(self, finished: bool) -> None:
        if finished and self._at_once:
            self._draw()


def _words() -> tuple[float | None, str]:
    """Returns how much of the outermost work is done, and words for all that is at work."""
    work = list(_at_work)
    return (work[0].fraction, "; ".join(map(str, work))) if work else (None, "")


def _is_drawn() -> bool:
    return any(isinstance(work._painter, _Bar) and work._painter.drawn for work in _at_work)


def _columns(stream: TextIO) -> int:
    with suppress(OSError, ValueError):  # a notebook has none
        return os.get_terminal_size(stream.fileno()).columns or 100
    return 100


def _has_blocks(stream: TextIO) -> bool:
    try:
        "█".encode(getattr(stream, "encoding", None) or "ascii")
    except UnicodeEncodeError:
        return False
    return True


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (f"{hours}:{minutes:02d}" if hours else f"{minutes}") + f":{seconds:02d}"
