"""Optima of grids that are too large for one sweep, by their two halves.

The grid is cut between two rows. Of a half the other one only needs to know what it has at the cut: the label of each
column, which linked columns hang together inside, and which links inside still could be bridges. Of all ways to fill a
half that agree in this only the one of the highest score counts. A network is two halves that fit.

There are far more halves than can be kept, but few that matter. The bound of `half_worths` first leaves a list of
patterns, of columns that are linked across the cut. For each of these it is made anew, and so is much lower. A half is
kept as long as it can still become high enough for a partner, by the sweep of `half_sweep`. The score that is asked
for is lowered step by step, until two halves fit.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.half_fillings import fill, trace
from experiments.search.exact.half_pairs import find_best_pair
from experiments.search.exact.half_patterns import find_patterns
from experiments.search.exact.half_sweep import UNIT, Half, find_highest
from experiments.search.exact.half_worths import Worths, choose_worths, first_worths

__all__ = ["Proof", "find_most_crossings", "find_optimum"]

_STEP = 8  # of the score that is asked for

# The code of each tile with the grid upside down.
_MIRRORED = np.array([code & 5 | code << 2 & 8 | code >> 2 & 2 for code in range(16)], np.int8)


class Proof(NamedTuple):
    """What is proven of the flawless networks of a cyclomatic number.

    Attributes:
      score: no network that is asked for has a higher straight score; -1 if there is none.
      grid: int8 ``[H, W]``, a network with that score; None if none was found.
      with_bridges: no network has a higher straight score, with bridges or without; -1 if there is none.
      kept: ways to fill a half that were kept, over all lines and steps.
      peak: the most on one line.
    """

    score: int
    grid: NDArray[np.int8] | None
    with_bridges: int
    kept: int
    peak: int


def find_most_crossings(upper: Half, lower: Half) -> int:
    """Returns how many crossings no network has more of; a four-way crossing is two."""
    price = UNIT * 1000
    free = [np.zeros((half.width, 16), np.int64) for half in (upper, lower)]
    return sum(find_highest(half, worth, price)[2] for half, worth in zip((upper, lower), free, strict=True))


def find_optimum(
    upper: Half, lower: Half, cyclomatic: int, *, bridgeless: bool = True, most: int = 20_000_000
) -> Proof:
    """Finds the highest straight score of the flawless networks of a cyclomatic number that cross the cut.

    Args:
      upper: the rows above the cut.
      lower: those below it, upside down; the same object if both are alike, which takes half the time.
      cyclomatic: 1 + x / 2 + y of x three-way and y four-way crossings.
      bridgeless: whether no link may be a bridge.
      most: ways to fill a half to keep on a line; with more the search ends with what is proven so far.
    """
    crossings = 2 * (cyclomatic - 1)
    halves = (upper,) if upper is lower else (upper, lower)
    overall = choose_worths(halves, crossings, first_worths(halves), None, 0)
    known: dict[int, Worths] = {}
    proven = with_bridges = max(-1, overall.bound)
    kept = peak = 0
    tight = True  # so far all patterns had a bound below the target
    while proven >= 0:
        target = max(0, proven + 1 - _STEP)
        best: tuple[int, NDArray[np.int8]] | None = None
        patterns = find_patterns(halves, overall, crossings, target, most)
        if patterns is None:
            return Proof(proven, None, with_bridges, kept, peak)
        for pattern in patterns:
            worths = known.get(pattern, overall)
            if worths is overall or worths.bound >= target:
                known[pattern] = worths = choose_worths(halves, crossings, worths, pattern, target)
            if worths.bound < target:
                continue
            tight = False
            filled = fill(halves, worths, crossings, target, most, bridgeless)
            if filled is None:
                return Proof(proven, None, with_bridges, kept, peak)
            sizes = [len(origin) for fillings in filled for origin in fillings.origins]
            kept, peak = kept + sum(sizes), max(peak, *sizes)
            least = worths.least(crossings, target)
            found = find_best_pair(upper.width, filled[0], filled[-1], crossings, target, least, bridgeless)
            if found and (best is None or found[0] > best[0]):
                ends = trace(upper, filled[0], found[1]), _MIRRORED[trace(lower, filled[-1], found[2])[::-1]]
                best = found[0], np.concatenate(ends)
        proven = best[0] if best else target - 1
        with_bridges = target - 1 if tight else with_bridges
        if best:
            return Proof(proven, best[1], with_bridges, kept, peak)
    return Proof(-1, None, with_bridges, kept, peak)
