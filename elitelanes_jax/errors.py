"""The error that stands for a user's mistake."""

__all__ = ["InputError"]


class InputError(ValueError):
    """An argument, a file or a folder is not as it should be: the message names it, what was expected and what came.

    The command line shows the message alone. Any other error, a plain `ValueError` too, is a fault of the program and
    keeps its traceback.
    """
