"""Finds constraints that no map satisfies before a search, by bounds of the metrics or by trying all small maps."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.network.codes import CONNECTIONS, EAST, KINDS, SIDES, WEST, exchange_sides, rotate_codes
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.problem.bounds import check_ranges, find_bounds, free_links
from elitelanes_jax.problem.features import FEATURES
from elitelanes_jax.problem.fixed_cells import FixedCells
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.problem.ranges import Range, satisfies
from elitelanes_jax.problem.rules import RULES, map_constraints

# All grids are tried if they have at most this many cells in total: 2**16 grids of 4 x 4.
_MOST_CELLS = 2**20


def check_feasible(
    shape: tuple[int, int],
    where: Sequence[Range] = (),
    *,
    fix: FixedCells | None = None,
    rules: str | None = None,
    filled: bool = True,
    alphabet: Iterable[int] | None = None,
    maps: int = 1,
    exhaustive: bool = False,
) -> None:
    """Checks in milliseconds whether enough different maps can satisfy all constraints. Some contradictions are missed.

    `filled` says whether every free cell has a road, `maps` how many different maps are needed, and `exhaustive`
    whether to try all maps too, if the grid is small or has few free cells. The `InputError` for too few maps states
    the bound or the count.
    """
    missing = set() if alphabet is None else set(KINDS["turn"]) - set(alphabet)
    if missing:
        raise InputError(f"alphabet: expected the turns {KINDS['turn']}, which every map has, got no {min(missing)}")
    if fix is not None:
        _check_fixed(fix, rules)
    filled = filled and fix is None
    constraints = map_constraints(rules, filled=filled)
    if where or fix is not None or alphabet is not None:
        certain = {name: value for name, value, _ in constraints}
        bounds = find_bounds(shape, certain=certain, fix=fix, alphabet=alphabet)
        check_ranges(where, bounds, f"maps of {shape[0]} x {shape[1]} tiles")
    free = len(free_links(shape, fix, filled=filled)[1]) if maps.bit_length() > 1 else maps
    if maps.bit_length() > free and maps > 2**free:
        links = f"as many as {pluralize(free, 'free link')} between cells allow"
        if fix is not None:
            raise InputError(f"fix: expected free cells for {maps:,} maps, got {pluralize(2**free, 'map')}, {links}")
        raise InputError(f"maps: expected at most {2**free:,}, {links}, got {maps:,}")

    grids = _all_grids(shape, fix, filled=filled) if exhaustive else None
    if grids is None:
        return
    allowed = None if alphabet is None else (*alphabet, *KINDS["empty"])
    where = [item for item in where if item.name in (*FEATURES, *COUNTED.values())]
    found = 0
    for grid in _one_of_each_form(grids):
        metrics = plain_measure(grid, allowed)
        metrics |= {name: int(np.isin(grid, KINDS[kind]).sum()) for kind, name in COUNTED.items()}
        found += all(metrics[name] == value for name, value, _ in constraints) and bool(satisfies(metrics, where))
        if found == maps:
            return
    size = f"{shape[0]} x {shape[1]} tiles"
    if not found:
        raise InputError(
            f"no map of {size} satisfies all constraints: none of the {len(grids):,} grids without dead ends does"
        )
    raise InputError(
        f"maps: expected at most {found:,}, the number of maps of {size} that satisfy all constraints and are not "
        f"rotations or mirror images of each other, got {maps:,}"
    )


def _check_fixed(fix: FixedCells, rules: str | None) -> None:
    ends = np.argwhere(np.isin(fix.grid, KINDS["end"])).tolist()
    if ends:
        row, column = ends[0]
        code = int(fix.grid[row, column])
        raise InputError(f"fix: expected cells without dead ends, got code {code} at row {row}, column {column}")
    if rules is not None:
        metrics = plain_measure(fix.grid)
        for name in RULES[rules].forbidden:
            if metrics[name]:
                raise InputError(f"fix: expected cells that keep the rules of {rules}, got {name} {metrics[name]}")


def _all_grids(shape: tuple[int, int], fix: FixedCells | None, *, filled: bool) -> Int8[np.ndarray, "M H W"] | None:
    """Returns all grids without dead ends; None if there are too many."""
    certain, free = free_links(shape, fix, filled=filled)
    if len(free) >= _MOST_CELLS.bit_length() or 2 ** len(free) * shape[0] * shape[1] > _MOST_CELLS:
        return None
    grids = np.zeros((2 ** len(free), *shape), np.int8)
    indices = np.arange(len(grids))
    for bit, (row, column, side_index) in enumerate(np.concatenate([free, certain]).tolist()):
        side = SIDES[side_index]
        linked = (indices >> bit) & 1 if bit < len(free) else np.ones_like(indices)
        grids[:, row, column] |= (linked * side.bit).astype(np.int8)
        grids[:, row + side.down, column + side.right] |= (linked * side.opposite).astype(np.int8)
    connections = CONNECTIONS[grids]
    return grids[((connections >= (2 if filled else 0)) & (connections != 1)).all(axis=(1, 2))]


def _one_of_each_form(grids: Int8[np.ndarray, "M H W"]) -> list[Int8[np.ndarray, "H W"]]:
    """Returns the grids that are not rotations or mirror images of earlier ones."""
    images = []
    for image in (grids, exchange_sides(grids, EAST, WEST)[:, :, ::-1]):
        for _ in range(4):
            images.append([(image.shape[1], grid.tobytes()) for grid in image])
            image = np.rot90(rotate_codes(image), axes=(1, 2))
    first: dict[tuple[int, bytes], Int8[np.ndarray, "H W"]] = {}
    for grid, form in zip(grids, map(min, zip(*images, strict=True)), strict=True):
        first.setdefault(form, grid)
    return list(first.values())
