"""An inventory: how many tiles of each kind there are to build a map of."""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path

from elitelanes_jax._util.checks import check_unique, split_settings, whole
from elitelanes_jax._util.errors import InputError, shorten, suggest
from elitelanes_jax._util.files import read_toml
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.problem.ranges import Range

COUNTED = {"straight": "straights", "turn": "turns", "crossing3": "crossings3", "crossing4": "crossings4"}
"""The feature that counts the tiles of each kind that maps consist of."""


def parse_inventory(inventory: UserValue) -> tuple[tuple[str, int], ...]:
    """Reads the number of tiles of each kind; a kind that is not named has none.

    Args:
      inventory: texts such as ``straight=20``, one text with spaces between them, a mapping of kinds to numbers, pairs,
        or the path of a file that ends in ``.toml``, with lines such as ``straight = 20``.

    Raises:
      InputError: for anything else, a file that cannot be read, an unknown kind, or a kind given twice.
    """
    if isinstance(inventory, str | Path):
        inventory = split_settings(str(inventory))
    if isinstance(inventory, Iterable) and not isinstance(inventory, Mapping):
        inventory = list(inventory)
        if len(inventory) == 1 and str(inventory[0]).endswith(".toml"):
            inventory = read_toml(inventory[0], f"inventory: {inventory[0]}")
    if isinstance(inventory, Mapping):
        inventory = inventory.items()
    if not isinstance(inventory, Iterable):
        raise InputError(f"inventory: expected tiles such as ['straight=20'], got {shorten(repr(inventory))}")
    pairs = [_parse_pair(pair) for pair in inventory]
    check_unique("inventory", "kind", [kind for kind, _ in pairs])
    if not any(count for _, count in pairs):
        raise InputError(f"inventory: expected tiles, {', '.join(COUNTED)}, got none")
    return tuple((kind, dict(pairs).get(kind, 0)) for kind in COUNTED)


def within_inventory(where: Iterable[Range], inventory: Iterable[tuple[str, int]]) -> tuple[Range, ...]:
    """Returns ranges with the upper limits that an inventory sets: a map needs at most the tiles that there are."""
    ranges = {item.name: item for item in where}
    for kind, count in inventory:
        low, high = ranges.get(COUNTED[kind], (None, None, None))[1:]
        most = Fraction(count) if high is None else min(high, Fraction(count))
        ranges[COUNTED[kind]] = Range(COUNTED[kind], low, most)
    return tuple(ranges.values())


def _parse_pair(pair: UserValue) -> tuple[str, int]:
    try:
        kind, count = pair.partition("=")[::2] if isinstance(pair, str) else pair
    except (TypeError, ValueError):
        raise InputError(f"inventory: expected tiles such as 'straight=20', got {shorten(repr(pair))}") from None
    kind = kind.strip() if isinstance(kind, str) else kind
    if kind not in COUNTED:
        kinds = ", ".join(COUNTED)
        got = f"{shorten(repr(kind), 40)}{suggest(kind, COUNTED)}"
        raise InputError(f"inventory: expected KIND=N with one of {kinds}, or a file that ends in .toml, got {got}")
    try:
        return kind, whole(0)(count.strip() if isinstance(count, str) else count)
    except InputError as error:
        raise InputError(f"inventory {kind}: {error}") from None
