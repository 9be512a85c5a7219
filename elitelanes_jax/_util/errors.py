"""Errors that a user's input can cause, and words for their messages."""

from collections.abc import Iterable
from difflib import get_close_matches

from elitelanes_jax._util.types import UserValue


class InputError(ValueError):
    """A fault of an argument, a file or a folder: the message names it, what was expected and what came.

    The command line shows the message alone. Any other error, a plain `ValueError` too, is a fault of the program and
    keeps its traceback.
    """


class MissingPackageError(InputError):
    """A package that is needed is not installed; the message says how to install it."""


class NotEnoughMapsError(Exception):
    """A search found fewer maps than were asked for; the message says how many, and why others were rejected."""


class NotEnoughMemoryError(MemoryError):
    """A search needs more memory than there is; the message says how much, and what needs less."""


def likely(name: UserValue, known: Iterable[str]) -> str:
    """Returns the end of a message about an unknown name: the known one that is probably meant, if there is one."""
    text, names = str(name)[:40].lower(), list(known)
    start = text[: 5 if text.startswith("--") else 3]
    alike = get_close_matches(text, names, 1) or [one for one in names if one.startswith(start)]
    return f"; is it {alike[0]}?" if alike else ""


def many(count: int, what: str) -> str:
    """Returns a count of things in words: 1 map, 2 maps."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def reason(error: OSError) -> str:
    """Returns the system's words for an error, for the end of a message."""
    return (error.strerror or str(error)).lower()


def short(text: str, most: int = 80) -> str:
    """Cuts a text to so many characters, for a message."""
    return text if len(text) <= most else text[: most - 3] + "..."
