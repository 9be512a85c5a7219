"""Checks of single values.

Each takes a value or its text, and returns the checked value or raises `InputError`.
"""

import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeAlias, TypeGuard, TypeVar

import numpy as np

from elitelanes_jax._util.errors import InputError, quote, shorten, show_words
from elitelanes_jax._util.types import Untyped, UserValue

T = TypeVar("T")
V = TypeVar("V")
N = TypeVar("N", bound=str)
P = ParamSpec("P")

Check: TypeAlias = Callable[[UserValue], T]
"""Takes a value or its text, and returns the checked value or raises `InputError`."""

LARGEST = 2**30
"""The largest whole number of a user, so that the difference of two fits 32 bits."""

# The suffixes of files, which the name of a folder hardly has.
_FILES = (
    ".avi", ".bin", ".bmp", ".csv", ".doc", ".gif", ".glb", ".gltf", ".gz", ".html", ".jpeg",
    ".jpg", ".json", ".log", ".map", ".md", ".mjcf", ".mp4", ".netccfg", ".npy", ".npz", ".osm",
    ".parquet", ".pdf", ".pkl", ".png", ".py", ".scen", ".svg", ".tar", ".tif", ".tiff", ".toml",
    ".txt", ".usd", ".usda", ".webp", ".xml", ".xodr", ".yaml", ".yml", ".zip",
)  # fmt: skip

_LARGEST_INT32 = 2**31 - 1


def is_whole(value: UserValue) -> TypeGuard[int]:
    """Returns whether a value is a whole number of Python or NumPy; a bool is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_real(value: UserValue) -> TypeGuard[float]:
    """Returns whether a value is a number of Python or NumPy; a bool or an array is not."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_flag(value: UserValue) -> TypeGuard[bool]:
    """Returns whether a value is True or False, of Python or NumPy.

    For example, `array.any()` is a flag of NumPy.
    """
    return isinstance(value, bool | np.bool_)


def clip_to_int32(value: Untyped) -> Untyped:
    """Returns a whole number, an array or a list of them, clipped to 32 bits.

    Anything else is returned unchanged.

    JAX drops the upper bits of a larger number of NumPy, so that 2**32 becomes 0. For one of Python
    it raises `OverflowError`.
    """
    if type(value) is list:
        return [clip_to_int32(number) for number in value]
    if isinstance(value, np.ndarray) and value.dtype.kind in "iu":
        if value.ndim:
            # NumPy refuses limits that the type of the array does not have.
            least = max(np.iinfo(value.dtype).min, -_LARGEST_INT32 - 1)
            most = min(np.iinfo(value.dtype).max, _LARGEST_INT32)
            return value.clip(least, most)
    elif not is_whole(value):
        return value
    clipped = min(max(int(value), -_LARGEST_INT32 - 1), _LARGEST_INT32)
    return value if clipped == value else clipped


def unmasked(value: V) -> V:
    """Checks that an array has no masked numbers.

    `numpy.asarray` would show the numbers that the mask hides.
    """
    if np.ma.is_masked(value):
        raise InputError("", "a number at each index", "a masked array")
    return value


def whole(least: int, most: int = _LARGEST_INT32) -> Check[int]:
    """Makes a check for a whole number from `least` to `most`."""

    def check(value: UserValue) -> int:
        number = _parse(value, int)
        # NumPy's numbers become Python's, so that JSON can hold them.
        if is_whole(number) and least <= number <= most:
            return int(number)
        limits = f", {least} to {most}"
        has_least = least > -_LARGEST_INT32
        is_outside = is_whole(number) and (number > most or (number < least and not has_least))
        # Nobody needs to know the limits of int32, unless the number is outside of them.
        if most == _LARGEST_INT32 and not is_outside:
            limits = f", {least} or more" if has_least else ""
        raise InputError("", f"a whole number{limits}", quote(value, 40))

    return check


def _parse(value: UserValue, kind: Callable[[str], int | float]) -> UserValue:
    """Returns the number that a text says, or else the value unchanged.

    Texts such as 1_000 are no numbers.
    """
    if isinstance(value, str) and value.isascii() and "_" not in value:
        with suppress(ValueError):
            return kind(value)
    return value


SEED = whole(0, 2**32 - 1)
"""Checks for a seed."""

TILE_PX = whole(16, 512)
"""Checks for the side of a tile in pixels."""

MOST_FLOOR_SIDE = 40
"""The most tiles on a side of a photographed floor."""

FLOOR_SIDE = whole(1, MOST_FLOOR_SIDE)
"""Checks for the rows or columns of a photographed floor."""


def floor_shape(value: UserValue) -> tuple[int, int]:
    """Checks for the rows and columns of a photographed floor."""
    expected = f"1 to {MOST_FLOOR_SIDE} rows and columns"
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise InputError("", expected, quote(value))
    rows, columns = value
    if not all(is_whole(side) and 1 <= side <= MOST_FLOOR_SIDE for side in value):
        raise InputError("", expected, shorten(f"{rows!r} and {columns!r}"))
    return int(rows), int(columns)


def real(
    least: float, most: float = float("inf"), *, unit: str = "a number", exclusive: bool = False
) -> Check[float]:
    """Makes a check for a finite number from `least`, or over it if `exclusive`, to `most`.

    A `least` of minus infinity is no limit.
    """
    has_most = most < float("inf")
    if exclusive and has_most:
        limit = f" over {least:g}, up to {most:g}"
    elif exclusive:
        limit = f" over {least:g}"
    elif has_most:
        limit = f", {least:g} to {most:g}"
    elif least == -float("inf"):
        limit = ""
    else:
        limit = f", {least:g} or more"

    def check(value: UserValue) -> float:
        number = _parse(value, float)
        # NumPy compares in its own type, in which the largest float of Python may be infinite.
        if isinstance(number, np.floating):
            number = float(number)
        # A whole number of Python may be finite and still too large for a float.
        largest = min(most, sys.float_info.max)
        if is_real(number) and max(least, -sys.float_info.max) <= number <= largest:
            at_limit = exclusive and number == least
            if not at_limit:
                return float(number)
        raise InputError("", f"{unit}{limit}", quote(value, 40))

    return check


def coordinates(value: UserValue) -> tuple[float, float]:
    """Checks for a latitude and a longitude in degrees, where UTM has zones of 6 degrees."""
    # North of 72 degrees UTM has other zones, and its plane ends at 84 degrees.
    if isinstance(value, tuple | list) and len(value) == 2:
        latitude, longitude = (_parse(part, float) for part in value)
        if (
            is_real(latitude)
            and is_real(longitude)
            and -80 <= latitude <= 72
            and abs(longitude) <= 180
        ):
            # UTM's zone of 180 degrees is that of -180.
            return float(latitude), -180.0 if longitude == 180 else float(longitude)
    raise InputError(
        "",
        "a latitude, -80 to 72, and a longitude, -180 to 180, in degrees",
        show_words(value, 40),
    )


def one_of(*names: N) -> Check[N]:
    """Makes a check for one of the names."""

    def check(value: UserValue) -> N:
        if not isinstance(value, str) or value not in names:
            raise InputError("", f"one of {', '.join(names)}", quote(value, 40))
        return names[names.index(value)]

    return check


def none_or(
    check: Callable[Concatenate[UserValue, P], T],
) -> Callable[Concatenate[UserValue, P], T | None]:
    """Makes a check for None, or a value that passes another check."""

    def check_unless_none(value: UserValue, *further: P.args, **named: P.kwargs) -> T | None:
        if value is None:
            return None
        return check(value, *further, **named)

    return check_unless_none


def nonblank(value: UserValue) -> str:
    """Checks for a text that is not blank."""
    if not isinstance(value, str) or not value.strip():
        raise InputError("", "a name", quote(value))
    return value


def text_name(value: UserValue) -> str:
    """Checks for a text that is not blank and that UTF-8 can hold.

    The name of a file may have bytes that are not UTF-8.
    """
    text = nonblank(value)
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError("", "a name in UTF-8", quote(text)) from None
    return text


def xml_name(value: UserValue) -> str:
    """Checks for a text that is not blank, of characters that XML 1.0 allows (section 2.2)."""
    if re.search(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", nonblank(value)):
        raise InputError("", "a name without control characters, as in XML", quote(value))
    return str(value)


def path(value: UserValue) -> Path:
    """Checks for a path."""
    # Half of a surrogate pair has no bytes. For it and for a zero byte the system would raise a
    # `ValueError`, which is no `OSError`.
    with suppress(UnicodeEncodeError):
        if b"\0" not in os.fsencode(str(value)):
            return value if isinstance(value, Path) else Path(nonblank(value))
    raise InputError("", "a path", quote(str(value)))


def is_folder(path: Path) -> bool:
    """Returns whether a path is that of a folder; False for a text that is too long for a path."""
    with suppress(OSError):
        return path.is_dir()
    return False


def path_exists(path: Path) -> bool:
    """Returns whether a path exists; False for a text that is too long for a path."""
    with suppress(OSError):
        return path.exists()
    return False


def paths(value: UserValue) -> list[Path]:
    """Checks for a path or several, at least one."""
    if isinstance(value, str | Path):
        return [path(value)]
    if not isinstance(value, Iterable):
        raise InputError("", "paths", quote(value, 40))
    checked = [path(item) for item in value]
    if not checked:
        raise InputError("", "at least one", "none")
    return checked


def items_of(value: UserValue) -> Iterator[UserValue]:
    """Returns an iterator of a list or another iterable; raises `TypeError` for anything else.

    Unpacking it into two names ends after three items, however many there are.
    """
    if not isinstance(value, Iterable):
        raise TypeError(f"{type(value).__name__} has no items")
    return iter(value)


def instance(kind: type[T]) -> Check[T]:
    """Makes a check for an object of a type."""

    def check(value: UserValue) -> T:
        if not isinstance(value, kind):
            raise InputError("", kind.__name__, quote(value))
        return value

    return check


def listed(kind: type[T]) -> Check[Sequence[T]]:
    """Makes a check for a list or tuple of objects of a type."""

    def check(values: UserValue) -> Sequence[T]:
        # The items of another collection may be gone once they are seen.
        if isinstance(values, list | tuple) and all(isinstance(value, kind) for value in values):
            return values
        raise InputError("", f"a list of {kind.__name__}", quote(values))

    return check


def function(value: UserValue) -> Callable[..., Untyped]:
    """Checks for a function."""
    if not callable(value):
        raise InputError("", "a function", quote(value))
    return value


def function_of(*arguments: str, **named: UserValue) -> Check[Callable[..., UserValue]]:
    """Makes a check that a function can be called with these arguments.

    The function takes `arguments` by position and `named` by name.
    """

    def check(value: UserValue) -> Callable[..., UserValue]:
        called = function(value)
        try:
            signature(called).bind(*arguments, **named)
        except TypeError:
            expected = list(arguments)
            for argument_name, argument in named.items():
                expected.append(f"{argument_name}={argument}")
            got = shorten(str(signature(called)))
            raise InputError("", f"a function of {', '.join(expected)}", f"one of {got}") from None
        except ValueError:
            # Some built-in functions do not say what they take.
            pass
        return called

    return check


def ends_as_file(file: Path) -> bool:
    """Returns whether a path has the suffix of a file, so that a folder is hardly meant."""
    return file.name.lower().endswith(_FILES)


def file_named(*suffixes: str) -> Check[Path]:
    """Makes a check for the path of a file to write, which has one of some suffixes.

    A pipe or a device may have any name.
    """

    def check(value: UserValue) -> Path:
        file = path(value)
        if is_folder(file):
            raise InputError("", "a file", f"a folder, {file}")
        is_special = path_exists(file) and not file.is_file()
        if file.suffix.lower() not in suffixes and not is_special:
            raise InputError("", f"a name that ends in {' or '.join(suffixes)}", file)
        return file

    return check


def folder(value: UserValue) -> Path:
    """Checks for the path of a folder to write to; an existing folder may have any name."""
    out = path(value)
    if ends_as_file(out) and not is_folder(out):
        raise InputError("", "a folder", f"the name of a file, {quote(str(out), 40)}")
    return out


def flag(value: UserValue) -> bool:
    """Checks for True or False."""
    if not is_flag(value):
        raise InputError("", "True or False", quote(value))
    return bool(value)


def check_named(
    name: str,
    check: Callable[Concatenate[V, P], T],
    value: V,
    *further: P.args,
    **named: P.kwargs,
) -> T:
    """Checks a value with the further arguments of the check.

    Returns what the check returns. The subject of an `InputError` starts with `name`.
    """
    try:
        return check(value, *further, **named)
    except InputError as error:
        if error.subject == name or error.subject.startswith((f"{name}:", f"{name} ")):
            raise
        raise error.within(name) from None


def split_settings(text: str) -> list[str]:
    """Splits a text with several settings as a shell would.

    Examples are ``crossings=6..10 bridges=0`` and ``cyclomatic:10 turns:10``.
    """
    # A space separates settings only before the name of another one, so that "a = 1" is one
    # setting.
    return re.split(r"\s+(?=\w+\s*[=:])", text.strip())


def check_unique(record: str, kind: str, names: Iterable[str]) -> list[str]:
    """Checks that no name comes twice.

    The subject of the error is `record`, which has the names. Its words call each name a `kind`.
    """
    all_names = list(names)
    counts = Counter(all_names)
    if counts:
        name, times = counts.most_common(1)[0]
        if times > 1:
            raise InputError(record, f"each {kind} once", f"{name} {times} times")
    return all_names
