"""The errors that stand for what a user asked."""

__all__ = ["InputError", "MissingPackageError", "NotEnoughMapsError", "reason", "short"]


class InputError(ValueError):
    """An argument, a file or a folder is not as it should be: the message names it, what was expected and what came.

    The command line shows the message alone. Any other error, a plain `ValueError` too, is a fault of the program and
    keeps its traceback.
    """


class MissingPackageError(InputError):
    """A package that is needed for what was asked is not installed; the message says how to."""


class NotEnoughMapsError(Exception):
    """Searches yield fewer maps than were asked for; the message says how many, and what became of the rest."""


def reason(error: OSError) -> str:
    """What the system says of an error, to stand at the end of a message."""
    return (error.strerror or str(error)).lower()


def short(text: str, most: int = 80) -> str:
    """What a file holds, cut to so many characters, to stand in a message."""
    return text if len(text) <= most else text[: most - 3] + "..."
