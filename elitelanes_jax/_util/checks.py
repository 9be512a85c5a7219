"""Checks of single values: each takes a value, or its text, and returns it as it should be, or raises `InputError`."""

import re
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np

from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import UserValue

Check = Callable[[UserValue], UserValue]
"""From a value or a text to the value as it should be; raises `InputError`."""

LARGEST = 2**30
"""The largest whole number a user may give: the difference of two fits 32 bits."""

_FILES: tuple[str, ...] = (".csv", ".gif", ".graphml", ".gz", ".html", ".jpeg", ".jpg", ".json", ".log", ".md")
_FILES += (".npy", ".npz", ".pdf", ".png", ".py", ".svg", ".tar", ".toml", ".txt", ".xml", ".xodr", ".yaml", ".yml")
_FILES += (".zip",)

_LARGEST_INT32 = 2**31 - 1


def is_whole(value: UserValue) -> bool:
    """Tells whether a value is a whole number of Python or NumPy; a bool is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_real(value: UserValue) -> bool:
    """Tells whether a value is a number of Python or NumPy, whole or not; a bool or an array is not."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def whole(least: int, most: int = _LARGEST_INT32) -> Check:
    """Makes a check: a whole number within limits."""
    open_limit = f"{least} or more" if most == _LARGEST_INT32 else f"{least} to {most}"

    def check(value: UserValue) -> int:
        number = value
        if isinstance(value, str) and value.isascii() and "_" not in value:
            with suppress(ValueError):
                number = int(value)
        if not is_whole(number) or not least <= number <= most:
            limit = f"{least} to {most}" if is_whole(number) and number > most else open_limit
            raise InputError(f"expected a whole number, {limit}, got {shorten(repr(value), 40)}")
        return int(number)

    return check


def real(least: float, most: float = float("inf"), *, unit: str = "a number", exclusive: bool = False) -> Check:
    """Makes a check: a finite number within limits, the lower one included unless `exclusive`."""
    limit = (
        f", {least:g} to {most:g}"
        if most < float("inf")
        else f" over {least:g}"
        if exclusive
        else f", {least:g} or more"
    )

    def check(value: UserValue) -> float:
        number = value
        if isinstance(value, str) and "_" not in value:
            with suppress(ValueError):
                number = float(value)
        within = is_real(number) and least <= number <= most and abs(number) < float("inf")
        if not within or (exclusive and number == least):
            raise InputError(f"expected {unit}{limit}, got {shorten(repr(value), 40)}")
        return float(number)

    return check


def one_of(*names: str) -> Check:
    """Makes a check: one of the given names."""

    def check(value: UserValue) -> str:
        if not isinstance(value, str) or value not in names:
            raise InputError(f"expected one of {', '.join(names)}, got {shorten(repr(value), 40)}")
        return value

    return check


def none_or(check: Callable[..., UserValue]) -> Callable[..., UserValue]:
    """Makes a check: None, or a value that another check lets pass."""
    return lambda value, *beside: None if value is None else check(value, *beside)


def name(value: UserValue) -> str:
    """Checks for a text that is not blank."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"expected a name, got {shorten(repr(value))}")
    return value


def path(value: UserValue) -> Path:
    """Checks for a path."""
    return value if isinstance(value, Path) else Path(name(value))


def paths(value: UserValue) -> list[Path]:
    """Checks for a path or several, at least one."""
    listed = [value] if isinstance(value, str | Path) else value
    if not isinstance(listed, Iterable):
        raise InputError(f"expected paths, got {shorten(repr(value), 40)}")
    if not (found := [path(one) for one in listed]):
        raise InputError("expected at least one, got none")
    return found


def ends_as_file(place: Path) -> bool:
    """Tells whether a path ends as that of a file does, so that hardly a folder is meant."""
    return place.name.lower().endswith(_FILES)


def folder(value: UserValue) -> Path:
    """Checks for the path of a folder to write to; one that is there may have any name."""
    place = path(value)
    if ends_as_file(place) and not place.is_dir():
        raise InputError(f"expected a folder, got the name of a file, {shorten(repr(str(place)), 40)}")
    return place


def flag(value: UserValue) -> bool:
    """Checks for True or False."""
    if not isinstance(value, bool):
        raise InputError(f"expected True or False, got {value!r}")
    return value


def switch(value: UserValue) -> bool:
    """Checks for True or False, or the words on or off."""
    if isinstance(value, bool):
        return value
    if value not in ("on", "off"):
        raise InputError(f"expected on or off, got {shorten(repr(value), 40)}")
    return bool(value == "on")


def check_named(name: str, check: Callable[..., UserValue], value: UserValue, *beside: UserValue) -> UserValue:
    """Checks a value, with what the check takes beside it; the error's message starts with its name."""
    try:
        return check(value, *beside)
    except InputError as error:
        words = str(error)
        raise InputError(words if words.startswith((f"{name}:", f"{name} ")) else f"{name}: {words}") from None


def split_settings(text: str) -> list[str]:
    """Splits a text such as ``crossings=6..10 bridges=0`` or ``cyclomatic:10 turns:10`` as a shell would."""
    return re.split(r"\s+(?=\w+\s*[=:])", text.strip())


def check_unique(record: str, kind: str, names: Iterable[str]) -> list[str]:
    """Checks that no name comes twice.

    Args:
      record: the name of what they are names in, for the message.
      kind: of things they name.
      names: to check.

    Raises:
      InputError: if one does.
    """
    listed = list(names)
    name, times = max(Counter(listed).items(), key=lambda item: item[1], default=("", 0))
    if times > 1:
        raise InputError(f"{record}: expected each {kind} once, got {name} {times} times")
    return listed
