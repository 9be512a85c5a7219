"""Options of a search for maps like example maps, whose features become ranges and axes."""

from collections.abc import Sequence
from math import ceil, floor

import numpy as np

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import AnyArray, Plain
from elitelanes_jax.network.plain_metrics import cut_to_roads, plain_measure, plain_town
from elitelanes_jax.problem.rules import RULES
from elitelanes_jax.search.style import read_style

# The features that make maps alike: those with an axis and a range, and those with a range alone.
_SPREAD = ("loops_per_tile", "turn_share", "box_fill", "symmetry")
_HELD = ("crossing_share", "adjacent_turns_per_tile")
# The least margin of a range on either side, a part of 1 or a ratio: maps of one author differ this much.
_LEAST = {"loops_per_tile": 0.02, "crossing_share": 0.04}
_USUAL_LEAST, _BINS = 0.1, 4


def settings_like(grids: Sequence[AnyArray]) -> dict[str, Plain]:
    """Returns the options of a search for maps like example maps, of any size.

    Each feature is limited to the range found in the example maps, plus a margin on either side: a quarter of the
    range, but at least a little. The niches divide these ranges. If all example maps keep Duckietown's rules, the
    search has these rules. If an example map has empty cells, maps may have empty cells.

    Args:
      grids: integer codes ``[H, W]``, one or more, with roads.
    """
    rows, gaps = [], False
    for grid in grids:
        cut = cut_to_roads(np.asarray(grid, np.int8))
        if not cut.any():
            raise InputError("like: expected maps with roads, got one without")
        metrics, gaps = plain_measure(cut), gaps or not cut.all()
        shares = {name: metrics[of] / metrics["tiles"] for name, of in _COUNTED.items()}
        rows.append({name: value / 1000 for name, value in plain_town(cut).items()} | shares | metrics)
    where, axes = {}, []
    for name in (*_SPREAD, *_HELD):
        values = [float(row[name]) for row in rows]
        low, high = min(values), max(values)
        margin = max((high - low) / 4, _LEAST.get(name, _USUAL_LEAST))
        most = 10.0 if name in ("loops_per_tile", "adjacent_turns_per_tile") else 1.0
        first, last = floor(1000 * max(low - margin, 0)), ceil(1000 * min(high + margin, most))
        where[name] = (first / 1000, last / 1000)
        if name in _SPREAD:
            axes.append({"metric": name, "bins": _BINS, "width": -(-(last - first) // _BINS), "start": first})
    town = read_style("town").options
    kept = all(not row[name] for row in rows for name in RULES["duckietown"].forbidden)
    targets = {name: [float(row[name]) for row in rows] for name in (*_SPREAD, *_HELD, "straight_share")}
    return {
        "preset": town["preset"],
        "rules": "duckietown" if kept else None,
        "fill": False if gaps and not kept else None,
        "weights": town["weights"],
        "where": where,
        "axes": axes,
        "targets": targets,
    }


_COUNTED = {"straight_share": "straights", "turn_share": "turns", "crossing_share": "crossings"}
