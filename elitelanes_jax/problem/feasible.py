"""Requirements that no map can meet, found before a search: by limits of the metrics, and by going through few maps."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.network.codes import CONNECTIONS, EAST, KINDS, SIDES, WEST, exchange_sides, rotate_codes
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.problem.constraints import Range, satisfies
from elitelanes_jax.problem.features import FEATURES
from elitelanes_jax.problem.flaws import find_flaws
from elitelanes_jax.problem.limits import check_ranges, find_limits, free_links
from elitelanes_jax.problem.rules import RULES
from elitelanes_jax.problem.template import Template

# Grids are gone through one by one where they have at most so many cells altogether: 2**16 grids of 4 x 4.
_MOST_CELLS = 2**20


class Requirements(NamedTuple):
    """The maps that are wanted.

    Attributes:
      shape: (height, width) of the maps, each at least 2.
      where: ranges that they are in.
      fix: cells that they keep.
      rules: that they keep.
      filled: whether every cell has a road, given ones aside.
      alphabet: codes of their tiles, by default all with two or more connections.
      maps: how many different ones are wanted.
    """

    shape: tuple[int, int]
    where: Sequence[Range] = ()
    fix: Template | None = None
    rules: str | None = None
    filled: bool = True
    alphabet: Iterable[int] | None = None
    maps: int = 1


def check_feasible(wanted: Requirements) -> None:
    """Checks requirements against limits that hold for all maps: quick, and right whenever it refuses.

    Raises:
      InputError: for one that cannot be met; the message says the limit.
    """
    shape, where, fix, rules, filled, alphabet, maps = wanted
    missing = set() if alphabet is None else set(KINDS["turn"]) - set(alphabet)
    if missing:
        raise InputError(f"alphabet: expected the turns {KINDS['turn']}, which every map has, got no {min(missing)}")
    if fix is not None:
        _check_given(fix, rules)
    filled = filled and fix is None
    if where or fix is not None or alphabet is not None:
        certain = {name: right for name, right, _ in find_flaws(rules, filled=filled)}
        limits = find_limits(shape, certain=certain, fix=fix, alphabet=alphabet)
        check_ranges(where, limits, f"maps of {shape[0]} x {shape[1]} tiles")
    free = len(free_links(shape, fix, filled=filled)[1]) if maps.bit_length() > 1 else maps
    if maps.bit_length() > free and maps > 2**free:
        links = f"as many as {pluralize(free, 'free link')} between cells allow"
        raise InputError(f"maps: expected at most {2**free:,}, {links}, got {maps:,}")


def check_number(wanted: Requirements) -> None:
    """Checks the number of different maps where all can be gone through: of few cells, or with few free ones.

    Raises:
      InputError: if there are fewer; the message says how many there are.
    """
    shape, where, fix, rules, filled, alphabet, maps = wanted
    filled = filled and fix is None
    grids = _all_grids(shape, fix, filled=filled)
    if grids is None:
        return
    allowed = None if alphabet is None else (*alphabet, *KINDS["empty"])
    right = [(name, value) for name, value, _ in find_flaws(rules, filled=filled)]
    where = [item for item in where if item.name in FEATURES]
    found = 0
    for grid in _one_of_each_form(grids):
        metrics = plain_measure(grid, allowed)
        found += all(metrics[name] == value for name, value in right) and bool(satisfies(metrics, where))
        if found == maps:
            return
    size = f"{shape[0]} x {shape[1]} tiles"
    if not found:
        raise InputError(f"no map of {size} is as asked for: none of all {len(grids):,} grids without dead ends")
    raise InputError(
        f"maps: expected at most {found:,}, all that there are of {size} with what is asked for, but for rotation "
        f"and mirroring, got {maps:,}"
    )


def _check_given(fix: Template, rules: str | None) -> None:
    ends = np.argwhere(np.isin(fix.grid, KINDS["end"])).tolist()
    if ends:
        row, column = ends[0]
        code = int(fix.grid[row, column])
        raise InputError(f"fix: expected cells without dead ends, got code {code} at row {row}, column {column}")
    if rules is not None:
        given = plain_measure(fix.grid)
        for name in RULES[rules].forbidden:
            if given[name]:
                raise InputError(f"fix: expected cells that keep the rules of {rules}, got {name} {given[name]}")


def _all_grids(shape: tuple[int, int], fix: Template | None, *, filled: bool) -> NDArray[np.int8] | None:
    """Makes all grids without dead ends, int8 ``[M, H, W]``; None where they would be too many."""
    certain, free = free_links(shape, fix, filled=filled)
    if len(free) >= _MOST_CELLS.bit_length() or 2 ** len(free) * shape[0] * shape[1] > _MOST_CELLS:
        return None
    grids = np.zeros((2 ** len(free), *shape), np.int8)
    numbers = np.arange(len(grids))
    for place, (row, column, number) in enumerate(np.concatenate([free, certain]).tolist()):
        side = SIDES[number]
        there = (numbers >> place) & 1 if place < len(free) else np.ones_like(numbers)
        grids[:, row, column] |= (there * side.bit).astype(np.int8)
        grids[:, row + side.down, column + side.right] |= (there * side.opposite).astype(np.int8)
    connections = CONNECTIONS[grids]
    return grids[((connections >= (2 if filled else 0)) & (connections != 1)).all(axis=(1, 2))]


def _one_of_each_form(grids: NDArray[np.int8]) -> list[NDArray[np.int8]]:
    """Returns the grids that no grid before is when rotated or mirrored."""
    images = []
    for image in (grids, exchange_sides(grids, EAST, WEST)[:, :, ::-1]):
        for _ in range(4):
            images.append([(image.shape[1], grid.tobytes()) for grid in image])
            image = np.rot90(rotate_codes(image), axes=(1, 2))
    first: dict[tuple[int, bytes], NDArray[np.int8]] = {}
    for grid, form in zip(grids, map(min, zip(*images, strict=True)), strict=True):
        first.setdefault(form, grid)
    return list(first.values())
