"""Checkpoints of a search: its result so far, in a folder that one process at a time has."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.folders import compare_settings, locked
from elitelanes_jax._util.types import Plain
from elitelanes_jax.search.result import Result

_RESULT, _SETTINGS = "result.npz", "search.json"

# Writing takes one part in so many of the time, at most.
_SELDOM = 20

# The seconds of a search that an interruption keeps: to start it again costs no more.
_WORTH_KEEPING = 10


class Checkpoint:
    """The folder of one search.

    Args:
      folder: locked, see `open_checkpoint`.
      identity: all that the search depends on but its budget, plain values for JSON.
      every: seconds from one writing to the next, 0 to write whenever it is asked.
    """

    def __init__(self, folder: Path, identity: dict[str, Plain], every: float) -> None:
        self.folder = folder
        self._identity, self._every = identity, every
        self._began = self._due = float("inf")

    def load(self) -> Result | None:
        """Returns the result so far; None where nothing is kept.

        Raises:
          InputError: for the result of another search, or a damaged file.
        """
        if not self.kept:
            return None
        hint = "use another folder, or delete this one to start anew"
        compare_settings(self.folder, self.folder / _SETTINGS, self._identity, hint)
        return Result.load(self.folder / _RESULT)

    @property
    def kept(self) -> bool:
        """Whether there is a result."""
        return (self.folder / _RESULT).exists()

    @property
    def worth_keeping(self) -> bool:
        """Whether an interrupted search is to be written."""
        return self.kept or time.monotonic() - self._began >= _WORTH_KEEPING

    @property
    def due(self) -> bool:
        """Whether it is time to write; the first question starts the clock, as compiling is no search."""
        now = time.monotonic()
        if self._began > now:
            self._began, self._due = now, now + self._every
        return now >= self._due

    def save(self, result: Result) -> None:
        """Writes the result so far; a kill meanwhile leaves the one before."""
        began = time.monotonic()
        if not self.kept:
            write_json(self.folder / _SETTINGS, self._identity)
        result.save(self.folder / _RESULT)
        now = time.monotonic()
        self._due = now + (max(self._every, _SELDOM * (now - began)) if self._every else 0)


@contextmanager
def open_checkpoint(folder: str | Path, identity: dict[str, Plain], every: float) -> Iterator[Checkpoint]:
    """Opens the folder of a search, which is made where it is missing; see `Checkpoint` for the arguments.

    Raises:
      InputError: if another process has it, or it cannot be written to.
    """
    folder = Path(folder)
    with locked(folder, folder):
        yield Checkpoint(folder, identity, every)
