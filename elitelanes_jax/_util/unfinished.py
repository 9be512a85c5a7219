"""Work for a folder that is kept beside it until the folder is there, so that a run that was killed goes on."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from elitelanes_jax._util.atomic_io import remove
from elitelanes_jax._util.locks import locked

_KEPT = "search"


def is_kept(folder: str | Path) -> bool:
    """Tells whether there is work for a folder that the next run goes on from."""
    return (_place(folder) / _KEPT).is_dir()


@contextmanager
def kept_work(folder: str | Path) -> Iterator[Path | None]:
    """Provides a hidden folder beside a given one, for work that the next run goes on from.

    When the block ends, it is removed; if it ends with an error, the work stays. One process at a time has it.

    Args:
      folder: to be made within the block.

    Yields:
      The hidden folder, which the block makes; None where no folder can be made.

    Raises:
      InputError: if another process has it.
    """
    place = _place(folder)
    missing = [parent for parent in place.parents if not parent.exists()]
    kept, mine = place / _KEPT, not place.exists()
    try:
        with suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
        if not place.is_dir():
            yield None
            return
        with locked(place, folder):
            mine = True
            yield kept
            remove(kept)
    finally:
        with suppress(OSError):  # something is in them, or another run has them now
            if mine and not kept.exists():
                place.rmdir()
                for parent in missing:  # the deepest first
                    parent.rmdir()


def _place(folder: str | Path) -> Path:
    folder = Path(os.path.realpath(folder))
    return folder.parent / f".{folder.name}-search"
