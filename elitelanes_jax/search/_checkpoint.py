"""Checkpoints of a search: its result so far, in a folder."""

import time
from pathlib import Path

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import remove_parts, write_json
from elitelanes_jax._util.folders import compare_settings
from elitelanes_jax._util.types import Plain
from elitelanes_jax.search.result import Result

_RESULT, _SETTINGS = "result.npz", "search.json"

# The time between two checkpoints is at least 20 times the time that it takes to write one.
_TIMES_WRITING = 20

# A search that is interrupted earlier, in seconds, leaves no checkpoint, because it can soon be
# repeated.
_SECONDS_TO_KEEP = 10


class Checkpoint:
    """The folder of one search.

    Args:
      folder: the locked folder of the search.
      identity: all that the search depends on except its budget, plain values for JSON.
      every: seconds between two checkpoints; 0 to write at every occasion.
    """

    def __init__(self, folder: Path, identity: dict[str, Plain], every: float) -> None:
        self.folder = folder
        self._identity, self._every = identity, every
        self._began = self._due = float("inf")

    def load(self) -> Result | None:
        """Returns the result so far, or None.

        Raises `InputError` for another search's result, or a damaged file.
        """
        # A kill leaves the part of a file that was written. The folder is locked, so no other
        # process writes it now.
        for file in (_RESULT, _SETTINGS):
            remove_parts(self.folder / file)
        if not self.kept:
            return None
        hint = "use another folder, or delete this one to start anew"
        compare_settings(self.folder, self.folder / _SETTINGS, self._identity, hint)
        try:
            return Result.load(self.folder / _RESULT)
        except InputError as error:
            raise error.advise(hint) from None

    @property
    def kept(self) -> bool:
        return (self.folder / _RESULT).exists()

    @property
    def keeps_interrupted(self) -> bool:
        """Whether to write a checkpoint of an interrupted search."""
        return self.kept or time.monotonic() - self._began >= _SECONDS_TO_KEEP

    def is_due(self) -> bool:
        """Returns whether it is time to write.

        The first call starts the timer, so compile time does not count.
        """
        now = time.monotonic()
        if self._began > now:
            self._began, self._due = now, now + self._every
        return now >= self._due

    def save(self, result: Result) -> None:
        """Writes the result so far. A kill leaves the result before."""
        started_writing = time.monotonic()
        # The settings come first, because a result without settings could be that of any search.
        if not self.kept:
            write_json(self.folder / _SETTINGS, self._identity)
        result.save(self.folder / _RESULT)
        written = time.monotonic()
        pause = 0.0
        if self._every:
            pause = max(self._every, _TIMES_WRITING * (written - started_writing))
        self._due = written + pause
