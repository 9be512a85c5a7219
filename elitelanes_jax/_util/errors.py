"""Errors and warnings that a user's input can cause, and words for their messages."""

import re
import reprlib
import sys
import warnings
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Self

from elitelanes_jax._util.types import UserValue


class InputError(ValueError):
    """A wrong argument, file or folder: what it is, what was expected, and what came.

    The message is "subject: expected this, got that; hint". The command line prints the message
    alone. Any other error, also a plain `ValueError`, is a bug with a traceback.

    Attributes:
      subject: the name of the argument, option, file or folder, or "" if only a caller knows it.
        A place within a file has the file's name before it: "map.yaml: tiles".
      expected: what the subject should be. If this is "", the message has only what came.
      got: what came, or "" if the message has only what was expected.
      hint: what the user may do, or "".
    """

    def __init__(
        self, subject: object, expected: object, got: object = "", hint: object = ""
    ) -> None:
        # Exceptions are sent to other processes by their arguments, so these are plain texts.
        super().__init__(*(_on_one_line(str(part)) for part in (subject, expected, got, hint)))

    @property
    def subject(self) -> str:
        return str(self.args[0])

    @property
    def expected(self) -> str:
        return str(self.args[1])

    @property
    def got(self) -> str:
        return str(self.args[2])

    @property
    def hint(self) -> str:
        return str(self.args[3])

    def __str__(self) -> str:
        expected = f"expected {self.expected}" if self.expected else ""
        got = f"got {self.got}" if self.expected and self.got else self.got
        statement = ", ".join(filter(None, (expected, got)))
        message = ": ".join(filter(None, (self.subject, statement)))
        return "; ".join(filter(None, (message, self.hint)))

    def replace(self, **parts: object) -> Self:
        """Returns the error with another subject, expectation or hint, or with other words."""
        return type(self)(
            *(
                parts.get(name, getattr(self, name))
                for name in ("subject", "expected", "got", "hint")
            )
        )

    def within(self, place: object) -> Self:
        """Returns the error with a file or option before its subject."""
        return self.replace(subject=": ".join(filter(None, (str(place), self.subject))))

    def advise(self, hint: str) -> Self:
        """Returns the error with a further hint."""
        return self.replace(hint="; ".join(filter(None, (self.hint, hint))))


def _on_one_line(text: str) -> str:
    """Returns a text whose arrays are on one line.

    An array in a message has several lines, whose later ones begin with spaces or a bracket. Other
    line breaks stay.
    """
    return re.sub(r"\n\s+|\n(?=\[)", " ", text)


class MissingPackageError(InputError):
    """A required package is not installed; the message says how to install it."""


class NotEnoughMapsError(Exception):
    """A search found fewer maps than requested.

    The message says how many, and why the search rejected others.
    """


class NotEnoughMemoryError(MemoryError):
    """A search needs more memory than is free; the message says how much, and what needs less."""


def warn_user(message: str) -> None:
    """Warns at the line of the user's code that called the package."""
    prefix_of_ours = f"{__package__.split('.')[0]}."
    # The first frame outside of the package is the user's. Level 1 is this function's own frame.
    frame = sys._getframe()
    level = 1
    # Code that `exec` runs may have no `__name__`.
    while frame.f_globals.get("__name__", "").startswith(prefix_of_ours):
        if frame.f_back is None:
            break
        frame = frame.f_back
        level += 1
    warnings.warn(message, stacklevel=level)


def suggest(name: UserValue, known: Iterable[str]) -> str:
    """Returns the known name that an unknown name probably means.

    The result is a hint, or "" if no known name is similar.
    """
    # Dashes that all options begin with would make any two of them alike: --floor and --force.
    names_by_word = {candidate.lstrip("-"): candidate for candidate in known}
    # The name may be any value. The first letters of a long one are enough.
    word = str(name)[:40].lower().lstrip("-")
    if not word:
        # Every name begins with nothing.
        return ""
    similar = get_close_matches(word, names_by_word, 1, cutoff=0.7)
    # A short form, such as cycl for cyclomatic, is not similar, but begins with the same letters.
    if not similar:
        similar = [other for other in names_by_word if other.startswith(word[:3])]
    if not similar:
        return ""
    return f"is it {names_by_word[similar[0]]}?"


def pluralize(count: int, noun: str) -> str:
    """Returns a count with its noun: 1 map, 2 maps."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def list_some(names: Sequence[str], most: int) -> str:
    """Returns the first `most` names as words, with the number of names that are left out."""
    words = ", ".join(names[:most])
    if len(names) <= most:
        return words
    return f"{words} and {len(names) - most} more"


def reason(error: OSError) -> str:
    """Returns the system's words for an error, as the end of a message."""
    return (error.strerror or str(error)).lower()


def shorten(text: str, limit: int = 80) -> str:
    """Cuts a text to a number of characters, on one line: arrays have several."""
    if "\n" in text:
        text = " ".join(line.strip() for line in text.splitlines())
    if len(text) <= limit:
        return text
    return text[: limit - 3] + "..."


def quote(value: UserValue, limit: int = 80) -> str:
    """Returns a user's value as a message shows it: its `repr`, shortened."""
    return shorten(repr(value), limit)


def show_words(value: UserValue, limit: int = 80) -> str:
    """Returns the words of an option as the user wrote them; for another value, its `repr`."""
    if isinstance(value, list) and all(isinstance(word, str) for word in value):
        return shorten(" ".join(value), limit)
    return quote(value, limit)


def yaml_fault(error: Exception) -> str:
    """Returns where a YAML text has a fault, and which one, from an error of PyYAML."""
    mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
    if mark is None or not problem:
        # PyYAML calls a text that is no file by this name.
        words = " ".join(str(error).split()).replace(
            ' in "<unicode string>", position', " at position"
        )
        return shorten(words, 200)
    start, context = getattr(error, "context_mark", None), getattr(error, "context", None)
    fault = f"a fault at line {mark.line + 1}, column {mark.column + 1}"
    if context and start is not None and (start.line, start.column) != (mark.line, mark.column):
        fault += f", {context} from line {start.line + 1}, column {start.column + 1}"
    return shorten(f"{fault}: {problem}", 200)


def brief(value: UserValue, limit: int = 80) -> str:
    """Returns the first entries of a large value as a message shows them, shortened."""
    # YAML's aliases may unfold to a text longer than the memory. `reprlib` reads only the first
    # entries of each list and table.
    return shorten(reprlib.repr(value), limit)
