"""An inventory: how many tiles of each kind there are to build a map of."""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path

from elitelanes_jax._util.checks import check_named, check_unique, items_of, split_settings, whole
from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.files import read_toml
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.problem.ranges import Range

COUNTED = {
    "straight": "straights",
    "turn": "turns",
    "crossing3": "crossings3",
    "crossing4": "crossings4",
}
"""The feature that counts the tiles of each kind that maps consist of."""


def parse_numbers(
    option: str, known: Iterable[str], numbers: UserValue, *, least: int
) -> tuple[tuple[str, int], ...]:
    """Reads whole numbers by name, from texts such as ``bridges=300``, a mapping or pairs.

    Raises `InputError` for anything else, a name that is not `known`, a number less than `least`,
    or a name that comes twice.
    """
    names = list(known)
    expected = f"NAME=N with one of {', '.join(names)}"
    if isinstance(numbers, str):
        numbers = split_settings(numbers)
    if isinstance(numbers, Mapping):
        numbers = numbers.items()
    if not isinstance(numbers, Iterable):
        raise InputError(option, expected, quote(numbers))
    check = whole(least)
    checked: list[tuple[str, int]] = []
    for pair in numbers:
        try:
            name, number = _split_pair(pair)
        except (TypeError, ValueError):
            # The value cannot be unpacked, or has not two parts, or one of them is missing.
            raise InputError(option, expected, quote(pair)) from None
        if isinstance(name, str):
            name = name.strip()
        if not isinstance(name, str) or name not in names:
            raise InputError(option, expected, quote(name, 40), suggest(name, names))
        checked.append((name, check_named(f"{option} {name}", check, number)))
    check_unique(option, "name", [name for name, _ in checked])
    return tuple(checked)


def _split_pair(pair: UserValue) -> tuple[UserValue, UserValue]:
    """Splits a pair, or a text such as ``bridges=300``, into a name and a number.

    Neither part is checked. Raises `ValueError` for a text that lacks one.
    """
    if isinstance(pair, str):
        name, _, number = pair.partition("=")
        if not name.strip() or not number.strip():
            raise ValueError(pair)
        return name, number
    first, second = items_of(pair)
    return first, second


def parse_inventory(inventory: UserValue) -> tuple[tuple[str, int], ...]:
    """Reads the number of tiles of each kind, as `parse_numbers` does.

    A kind that is not named has no tile. The inventory may also be the path of a file that ends in
    ``.toml``, with lines such as ``straight = 20``.
    """
    if isinstance(inventory, str | Path):
        inventory = split_settings(str(inventory))
    # A path has no settings to split, so it is one part. The command line also gives a list.
    parts = inventory if isinstance(inventory, list | tuple) else []
    if len(parts) == 1 and str(parts[0]).endswith(".toml"):
        inventory = read_toml(parts[0], f"inventory: {parts[0]}")
    counts = dict(parse_numbers("inventory", COUNTED, inventory, least=0))
    if not any(counts.values()):
        raise InputError("inventory", f"tiles, {', '.join(COUNTED)}", "none")
    return tuple((kind, counts.get(kind, 0)) for kind in COUNTED)


def within_inventory(
    where: Iterable[Range], inventory: Iterable[tuple[str, int]]
) -> tuple[Range, ...]:
    """Returns ranges with the upper limits that an inventory sets.

    A map needs at most the tiles that there are.
    """
    ranges = {item.name: item for item in where}
    for kind, count in inventory:
        feature = COUNTED[kind]
        high = Fraction(count)
        earlier = ranges.get(feature, Range(feature, None, None))
        # The user may ask for fewer tiles than there are.
        if earlier.high is not None:
            high = min(earlier.high, high)
        ranges[feature] = Range(feature, earlier.low, high)
    return tuple(ranges.values())
