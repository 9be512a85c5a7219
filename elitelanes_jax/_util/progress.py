"""Progress of long work: a line that changes in a terminal or a notebook, and lines in a log.

Work opens a `Progress` and counts. A thread draws, so that the display moves while XLA compiles.
The display of the outermost work also names the work within it. Where work begins or counts, it
ends after an interruption.
"""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import TextIO

from elitelanes_jax._util.interruption import raise_if_interrupted

# Seconds between two drawings in a terminal, between two lines in a log, and before the first
# drawing in a terminal.
_REDRAW, _LINES, _DELAY = 0.2, 30.0, 1.0

# Whether the running command is quiet; None outside of commands.
_quiet: bool | None = None
# The outermost work comes first.
_running: list["Progress"] = []
# The time when the last line was printed.
_last_line = 0.0
# What the running command says of files at its end, by their names.
_at_end: dict[str, list[str]] = {}


@contextmanager
def reporting(*, quiet: bool) -> Iterator[None]:
    """Makes the block a command.

    Unless it is quiet, its progress without a terminal is a line every 30 seconds.
    """
    global _quiet, _last_line
    before, _quiet, _last_line = _quiet, quiet, time.monotonic()
    _at_end.clear()
    try:
        yield
        for name, texts in _at_end.items():
            announce(f"{name}: {'; '.join(texts)}")
    finally:
        _quiet = before


def is_quiet() -> bool:
    """Returns whether a quiet command runs."""
    return _quiet is True


def announce(text: str) -> None:
    """Prints a line on standard error, in commands that are not quiet.

    Raises `KeyboardInterrupt` after an interruption.
    """
    raise_if_interrupted()
    if _quiet is False and sys.stderr is not None:
        drawn = any(
            work.display is not None and work.display.redraws and work.display.drawn
            for work in _running
        )
        with suppress(OSError, ValueError):
            # A closed stream must not stop the work.
            print(("\r\x1b[K" if drawn else "") + text, file=sys.stderr, flush=True)


def announce_at_end(name: str, text: str) -> None:
    """Prints a line about a file, as `announce` does, when the command has succeeded.

    All texts about a file are in one line, each once. A command that fails prints its error alone.
    """
    texts = _at_end.setdefault(name, [])
    if text not in texts:
        texts.append(text)


class Progress:
    """A context that shows the progress of counted work.

    Args:
      name: the name of the work.
      total: the final count; None if it is unknown.
      unit: the unit of the count, a plural.
      done: the count at the start.
      shown: whether the work is shown, at once. By default, a terminal or notebook shows work that
        takes over a second, and a command prints a line every 30 seconds elsewhere.
    """

    def __init__(
        self,
        name: str,
        total: int | None = None,
        unit: str = "",
        *,
        done: int = 0,
        shown: bool | None = None,
    ) -> None:
        self.display: _Display | None = None
        self._name, self._total, self._unit, self._done = name, total, unit, done
        self._note, self._step = "", ""
        # The remaining time follows from what was done since.
        self._since, self._first = time.monotonic(), done
        self._shown = shown

    def update(self, done: int, note: str = "") -> None:
        """Sets the count, and a text to show after it.

        Raises `KeyboardInterrupt` after an interruption.
        """
        raise_if_interrupted()
        self._done, self._note = done, note

    def count(self, more: int = 1) -> None:
        """Adds to the count; raises `KeyboardInterrupt` after an interruption."""
        raise_if_interrupted()
        self._done += more

    @contextmanager
    def doing(self, step: str) -> Iterator[None]:
        """Shows the name of a step instead of the count while the block runs.

        Compiling is one such step.
        """
        raise_if_interrupted()
        before, self._step, self._since = self._step, step, time.monotonic()
        try:
            yield
        finally:
            self._step = before
            # The step took time and counted nothing, so the remaining time follows from later
            # counts.
            self._since, self._first = time.monotonic(), self._done
        raise_if_interrupted()

    def __str__(self) -> str:
        """Returns the text for a display."""
        seconds = time.monotonic() - self._since
        if self._step or self._total is None:
            return f"{self._name}{self._step and f': {self._step}'}, {seconds:.0f} s"
        done, rest = self._done - self._first, self._total - self._done
        left = f", {_clock(seconds / done * rest)} left" if done and rest else ""
        return (
            f"{self._name} {self._done:,}/{self._total:,} "
            f"{self._unit}{self._note and f', {self._note}'}{left}"
        )

    def __enter__(self) -> "Progress":
        raise_if_interrupted()
        if self._shown is not False:
            _running.append(self)
            # Work within other work is named by the display of the outermost one.
            if len(_running) == 1:
                self.display = _start_display(self._shown)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.display is not None:
            self.display.end(finished=error is None)
        if self in _running:
            _running.remove(self)


def _start_display(shown: bool | None) -> "_Display | None":
    stream = sys.stderr
    if _quiet or stream is None or stream.closed:
        return None
    redraws = stream.isatty() or "ipykernel" in sys.modules
    return _Display(stream, bool(shown), redraws) if redraws or shown or _quiet is False else None


class _Display(Thread):
    """A thread that draws the running work.

    It redraws one line again and again, or prints a line of a log every 30 seconds.
    """

    def __init__(self, stream: TextIO, at_once: bool, redraws: bool) -> None:
        super().__init__(daemon=True)
        self.redraws, self.drawn = redraws, False
        self._stream, self._at_once, self._width = stream, at_once, 0
        self._ended: SimpleQueue[None] = SimpleQueue()
        self.start()

    def run(self) -> None:
        with suppress(OSError, ValueError):
            # A closed stream must not stop the work.
            while True:
                with suppress(Empty):
                    self._ended.get(timeout=max(self._wait(), 0))
                    return
                self._draw()

    def end(self, *, finished: bool) -> None:
        """Ends the thread, and draws the last state.

        Draws nothing if nothing was drawn, unless the work is shown at once.
        """
        self._ended.put(None)
        self.join()
        if self.drawn or self._at_once:
            with suppress(OSError, ValueError):
                if finished and (self.redraws or self._at_once):
                    self._draw()
                if self.redraws:
                    print(file=self._stream, flush=True)

    def _wait(self) -> float:
        if self.redraws:
            return _REDRAW if self.drawn or self._at_once else _DELAY
        if self._at_once and not self.drawn:
            return _REDRAW
        return _last_line + _LINES - time.monotonic()

    def _draw(self) -> None:
        global _last_line
        text, columns = "; ".join(map(str, list(_running))), 100
        if self.redraws:
            with suppress(OSError, ValueError):
                # The stream of a notebook has no terminal.
                columns = os.get_terminal_size(self._stream.fileno()).columns or columns
            text = text[: columns - 1]
            print("\r" + text.ljust(self._width), end="", file=self._stream, flush=True)
            self._width = len(text)
        else:
            # The lines of all work in a command share one clock.
            _last_line = time.monotonic()
            print(text, file=self._stream, flush=True)
        self.drawn = True


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (f"{hours}:{minutes:02d}" if hours else f"{minutes}") + f":{seconds:02d}"
