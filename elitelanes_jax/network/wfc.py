"""Wave Function Collapse in NumPy alone.

The method is that of the paper's section "Wave Function Collapse for Road Networks". Each cell has
a domain: the codes that it may still take, as the bits of a number. In each step the cell with the
smallest domain takes one of its codes at random. Codes that no longer fit are removed from the
neighbours' domains, and so on outwards. An empty domain is a contradiction: the grid starts again.

Many grids are collapsed together, with their cells end to end in one vector. Guard cells, whose
domain never changes, surround each grid, so that a neighbour is a shift and nothing passes from
grid to grid. A table with an entry for each of the 2**(K + 1) domains has the codes that a domain
allows its neighbour.
"""

from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import CROSSINGS, ROAD_ALPHABET, SIDES, check_alphabet

Border = Literal["open", "closed"]
Domains = NDArray[np.int32]


class Collapsed(NamedTuple):
    """Collapsed grids.

    Attributes:
      grid: int8 ``[n, H, W]``; zeros without success.
      success: bool ``[n]``, whether all cells took a code without a contradiction.
      attempts: int ``[n]``, the number of attempts, the successful one included.
      solvable: bool, False if the constraints alone leave a cell without any code: then no attempt
        is made. True does not guarantee a solution.
    """

    grid: NDArray[np.int8]
    success: NDArray[np.bool_]
    attempts: NDArray[np.int_]
    solvable: bool


@name_wrong_arguments
def generate_batch(
    rng: np.random.Generator,
    n: int,
    shape: tuple[int, int] = (12, 12),
    *,
    alphabet: UserValue = ROAD_ALPHABET,
    border: Border = "open",
    crossing_ban: bool = True,
    attempts: int = 10,
) -> Collapsed:
    """Collapses n grids together; each grid also depends on n.

    Args:
      rng: the source of all randomness.
      n: the number of grids.
      shape: (height, width), each at least 2.
      alphabet: the codes that cells may take.
      border: "open" lets roads leave the grid, as in the paper; "closed" does not.
      crossing_ban: whether two crossings may not be linked, as in the paper.
      attempts: the largest number of attempts at each grid. A contradiction in the last one is a
        result, not an error.

    Returns:
      A `Collapsed`. In a grid with success all connections within the grid are matched.

    Raises:
      InputError: for an argument out of its range.
    """
    if not isinstance(rng, np.random.Generator):
        raise InputError("rng", "a numpy.random.Generator", type(rng).__name__)
    if border not in ("open", "closed"):
        raise InputError("border", "'open' or 'closed'", repr(border))
    n, attempts = check_named("n", whole(1), n), check_named("attempts", whole(1), attempts)
    shape = check_shape(shape, new=True)
    constraints = check_alphabet(alphabet), border, bool(crossing_ban)
    rules, start = _rules(*constraints), _start(*constraints, shape)
    grids, success, tries = np.zeros((n, *shape), np.int8), np.zeros(n, bool), np.zeros(n, int)
    if start is None:
        return Collapsed(grids, success, tries, solvable=False)

    tries += 1
    # The unfinished grids, in the order of their cells.
    alive = np.arange(n)
    cells = np.tile(start, n)
    inside = _inside(shape)
    while alive.size:
        by_grid = cells.reshape(alive.size, -1)
        # Each grid chooses its cell with the smallest domain, and among equal domains the cell with
        # the smallest 16 random bits.
        lots = np.frombuffer(rng.bytes(2 * cells.size), np.uint16).reshape(by_grid.shape)
        cell = (rules.urgency[by_grid] | lots).argmin(axis=1)
        index = cell + np.arange(0, cells.size, start.size)
        options = rules.options[cells[index]]
        # A grid is finished if even its most urgent cell has nothing to choose.
        done = options <= 1
        if done.any():
            finished = alive[done]
            grids[finished] = rules.code[by_grid[done][:, inside]].reshape(-1, *shape)
            success[finished] = True
            alive, cells = alive[~done], by_grid[~done].reshape(-1)
            index, options = cell[~done] + np.arange(0, cells.size, start.size), options[~done]
        chosen = (rng.random(alive.size) * options).astype(int)
        # The chosen cells keep one code, and their neighbours lose the codes that do not fit.
        cells[index] = rules.option[cells[index], chosen]
        contradicted = np.unique(_propagate(rules, cells, index, shape[1] + 1) // start.size)
        if contradicted.size:
            by_grid = cells.reshape(alive.size, -1)
            # A contradicted grid starts again, unless it has had its last attempt.
            given_up = contradicted[tries[alive[contradicted]] >= attempts]
            again = np.setdiff1d(contradicted, given_up)
            tries[alive[again]] += 1
            by_grid[again] = start
            alive, cells = (
                np.delete(alive, given_up),
                np.delete(by_grid, given_up, axis=0).reshape(-1),
            )
    return Collapsed(grids, success, tries, solvable=True)


class _Rules(NamedTuple):
    """Tables by domain.

    Bit i of a domain is the alphabet's code i, the highest bit a guard cell.

    Attributes:
      guard: the domain of a guard cell.
      allowed: what is left of the domain of the neighbour to the north, east, south and west, int32
        ``[4, domains]``.
      options: the number of codes, ``[domains]``.
      urgency: the number of codes times 2**16, ``[domains]``; the largest value if there is nothing
        to choose.
      option: the domain of the first, second, ... code alone, int32 ``[domains, K]``.
      code: the code of a domain with one code, ``[domains]``.
    """

    guard: int
    allowed: Domains
    options: NDArray[np.int8]
    urgency: NDArray[np.uint32]
    option: Domains
    code: NDArray[np.int8]


@lru_cache(maxsize=8)
def _rules(alphabet: tuple[int, ...], border: Border, crossing_ban: bool) -> _Rules:
    guard = 1 << len(alphabet)
    domains = np.arange(2 * guard, dtype=np.int32)
    allowed = np.zeros((4, domains.size), np.int32)
    codes, bits = np.array(alphabet), np.arange(len(alphabet) + 1)
    crossing = np.isin(codes, CROSSINGS) & crossing_ban
    held = domains[:, None] >> bits & 1
    for direction, side in enumerate(SIDES):
        # These are the codes that a neighbour may have beside each code, and in the last row beside
        # a guard cell.
        connects, returns = (codes & side.bit > 0)[:, None], codes & side.opposite > 0
        fits = (connects == returns) & ~(connects & crossing[:, None] & crossing)
        beside_guard = ~returns | (border == "open")
        may = np.vstack([fits, beside_guard]) @ (1 << bits[:-1])
        allowed[direction] = np.bitwise_or.reduce(held * may, axis=1)
    # Guard cells are never removed, so that a contradiction does not pass to another grid.
    allowed |= guard
    held = held[:, :-1]
    options = held.sum(axis=1).astype(np.int8)
    options[guard:] = 0
    # The codes of a domain come first, in the order of the alphabet.
    order = np.argsort(1 - held, axis=1, kind="stable").astype(np.int32)
    return _Rules(
        guard=guard,
        allowed=allowed,
        options=options,
        urgency=np.where(options > 1, options.astype(np.uint32), 255) << np.uint32(16),
        option=np.int32(1) << order,
        code=np.array(alphabet, np.int8)[order[:, 0]],
    )


@lru_cache(maxsize=8)
def _inside(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Returns which cells of a framed grid are no guards.

    Guards are the rows above and below, and a cell per row.
    """
    frame = np.zeros((shape[0] + 2, shape[1] + 1), bool)
    frame[1:-1, :-1] = True
    return frame.reshape(-1)


@lru_cache(maxsize=8)
def _start(
    alphabet: tuple[int, ...], border: Border, crossing_ban: bool, shape: tuple[int, int]
) -> Domains | None:
    """Returns the domains of a framed grid before any cell is chosen, or None if one is empty."""
    rules, stride = _rules(alphabet, border, crossing_ban), shape[1] + 1
    frame = np.where(_inside(shape), rules.guard - 1, rules.guard).astype(np.int32)
    # All cells count as changed, so the padding gives the first and the last cells their
    # neighbours.
    cells = np.pad(frame, stride, constant_values=rules.guard)
    _propagate(rules, cells, np.arange(stride, cells.size - stride), stride)
    start = cells[stride:-stride]
    return start if start.all() else None


def _propagate(
    rules: _Rules, cells: Domains, changed: NDArray[np.int_], stride: int
) -> NDArray[np.int_]:
    """Removes, in place, the codes that changed cells no longer allow.

    Returns the cells with empty domains.
    """
    steps = np.array([[-stride], [1], [stride], [-1]])
    empty = [changed[:0]]
    while changed.size:
        neighbours = changed + steps
        before = cells[neighbours]
        # A cell may be the neighbour of several changed cells, which plain indexing would not
        # combine.
        np.bitwise_and.at(cells, neighbours, rules.allowed[:, cells[changed]])
        changed = np.unique(neighbours[cells[neighbours] != before])
        empty.append(changed[cells[changed] == 0])
    return np.concatenate(empty)
