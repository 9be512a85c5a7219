"""Optima of grids that are too large for one sweep, by their two halves.

The grid is cut between two rows. The upper half only needs to know what the lower half has at the cut: the label of
each column, which linked columns hang together inside, and which links inside still could be bridges. Of all ways to
fill a half that agree in this, only the one with the highest score counts. A network is two halves that fit.

There are far more ways than can be kept, but few of them matter. The bound of `duals` first leaves a list of patterns
of columns that are linked across the cut. For each pattern the bound is computed again, and so is much lower. A way is
kept as long as it can still reach the value that a partner needs. The score that is asked for is lowered step by step,
until two halves fit.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.assignments import find_assignments, trace
from experiments.search.exact.duals import UNIT, Duals, choose_duals, edge_gains, first_duals
from experiments.search.exact.halves import Half, find_highest
from experiments.search.exact.pairs import find_best_pair
from experiments.search.exact.patterns import find_patterns

__all__ = ["Proof", "find_most_crossings", "find_optimum"]

_STEP = 8  # of the score that is asked for

# The code of each tile with the grid upside down.
_MIRRORED = np.array([code & 5 | code << 2 & 8 | code >> 2 & 2 for code in range(16)], np.int8)


class Proof(NamedTuple):
    """What is proven about the flawless networks of a cyclomatic number.

    Attributes:
      score: no network that is asked for has a higher straight score; -1 if there is none.
      grid: int8 ``[H, W]``, a network with that score; None if none was found.
      with_bridges: no network has a higher straight score, with bridges or without; -1 if there is none.
      kept: ways to fill a half that were kept, over all cells and steps.
      peak: the most after one cell.
    """

    score: int
    grid: NDArray[np.int8] | None
    with_bridges: int
    kept: int
    peak: int


def find_most_crossings(upper: Half, lower: Half) -> int:
    """Returns how many crossings no network has more of; a four-way crossing is two."""
    most = 0
    for half in (upper, lower):
        edges = find_highest(half, edge_gains(half, np.zeros((half.width, 16), np.int64), UNIT * 1000))
        most += sum(int(layer.crossings[edge]) for layer, edge in zip(half.layers, edges, strict=True))
    return most


def find_optimum(upper: Half, lower: Half, cyclomatic: int, *, bridgeless: bool = True) -> Proof:
    """Finds the highest straight score of the flawless networks of a cyclomatic number that cross the cut.

    Args:
      upper: the rows above the cut.
      lower: those below it, upside down; the same object if both are alike, which takes half the time.
      cyclomatic: 1 + x / 2 + y of x three-way and y four-way crossings.
      bridgeless: whether no link may be a bridge.
    """
    crossings = 2 * (cyclomatic - 1)
    halves = (upper,) if upper is lower else (upper, lower)
    overall = choose_duals(halves, crossings, first_duals(halves), None, 0)
    of_pattern: dict[int, Duals] = {}
    proven = with_bridges = max(-1, overall.bound)
    kept = peak = 0
    tight = True  # so far all patterns had a bound below the target
    while proven >= 0:
        target = max(0, proven + 1 - _STEP)
        best: tuple[int, NDArray[np.int8]] | None = None
        for pattern in find_patterns(halves, overall, crossings, target):
            duals = of_pattern.get(pattern, overall)
            if duals is overall or duals.bound >= target:
                of_pattern[pattern] = duals = choose_duals(halves, crossings, duals, pattern, target)
            if duals.bound < target:
                continue
            tight = False
            found = [find_assignments(one, bridgeless) for one in duals.half_bounds(halves, crossings, target)]
            sizes = [len(origin) for part in found for origin in part.origins]
            kept, peak = kept + sum(sizes), max(peak, *sizes)
            needed = duals.needed(crossings, target)
            pair = find_best_pair(upper.width, found[0], found[-1], crossings, target, needed, bridgeless)
            if pair and (best is None or pair[0] > best[0]):
                ends = trace(upper, found[0], pair[1]), _MIRRORED[trace(lower, found[-1], pair[2])[::-1]]
                best = pair[0], np.concatenate(ends)
        proven = best[0] if best else target - 1
        with_bridges = target - 1 if tight else with_bridges
        if best:
            return Proof(proven, best[1], with_bridges, kept, peak)
    return Proof(-1, None, with_bridges, kept, peak)
