"""Errors that a user's input can cause."""

__all__ = ["InputError", "MissingPackageError", "NotEnoughMapsError", "many", "reason", "short"]


class InputError(ValueError):
    """A fault of an argument, a file or a folder: the message names it, what was expected and what came.

    The command line shows the message alone. Any other error, a plain `ValueError` too, is a fault of the program and
    keeps its traceback.
    """


class MissingPackageError(InputError):
    """A package that is needed is not installed; the message says how to install it."""


class NotEnoughMapsError(Exception):
    """A search found fewer maps than were asked for; the message says how many, and why others were rejected."""


def many(count: int, what: str) -> str:
    """Returns a count of things in words: 1 map, 2 maps."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def reason(error: OSError) -> str:
    """Returns the system's words for an error, for the end of a message."""
    return (error.strerror or str(error)).lower()


def short(text: str, most: int = 80) -> str:
    """Cuts a text to so many characters, for a message."""
    return text if len(text) <= most else text[: most - 3] + "..."
