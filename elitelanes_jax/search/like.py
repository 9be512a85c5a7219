"""Options of a search for maps like example maps, whose features become ranges and axes."""

from collections.abc import Mapping, Sequence
from math import ceil, floor

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import ArrayOrRows, Plain
from elitelanes_jax.network.plain_metrics import cut_to_roads, plain_measure, plain_town
from elitelanes_jax.problem.rules import RULES
from elitelanes_jax.search.style import read_style

# The features that make maps alike: those with an axis and a range, and those with a range alone.
_SPREAD = ("loops_per_tile", "turn_share", "box_fill", "symmetry")
_HELD = ("crossing_share", "adjacent_turns_per_tile")

# The least margin of a range on either side, a part of 1 or a ratio: maps of one author differ this
# much.
_LEAST_MARGIN = {"loops_per_tile": 0.02, "crossing_share": 0.04}
_USUAL_LEAST_MARGIN = 0.1

# The features that are no part of 1, and the largest limit of their ranges.
_RATIOS = ("loops_per_tile", "adjacent_turns_per_tile")
_LARGEST_RATIO = 10.0

_BINS = 4

# For each share of the tiles, the metric that counts them.
_COUNTED = {"straight_share": "straights", "turn_share": "turns", "crossing_share": "crossings"}


def settings_like(grids: Sequence[ArrayOrRows]) -> dict[str, Plain]:
    """Returns the options of a search for maps like example maps, of any size.

    Each feature is limited to the range found in the example maps, plus a margin on either side: a
    quarter of the range, but at least a little. The niches divide these ranges. If all example maps
    keep Duckietown's rules, the search has these rules. If an example map has empty cells, maps may
    have empty cells.

    Args:
      grids: integer codes ``[H, W]``, one or more, with roads.
    """
    towns = [_cut(grid) for grid in grids]
    examples = [_features(town) for town in towns]
    keeps_rules = not any(map(_breaks_rules, examples))
    has_gaps = not all(town.all() for town in towns)

    where = {}
    axes = []
    targets = {}
    for name in _SPREAD + _HELD:
        values = [example[name] for example in examples]
        low, high = _limits(name, values)
        where[name] = low / 1000, high / 1000
        targets[name] = values
        if name in _SPREAD:
            axes.append(_axis(name, low, high))
    targets["straight_share"] = [example["straight_share"] for example in examples]
    usual = read_style("town").options
    return {
        "preset": usual["preset"],
        "rules": "duckietown" if keeps_rules else None,
        "fill": False if has_gaps and not keeps_rules else None,
        "weights": usual["weights"],
        "where": where,
        "axes": axes,
        "targets": targets,
    }


def _breaks_rules(example: Mapping[str, float]) -> bool:
    """Returns whether a map breaks Duckietown's rules."""
    return any(example[name] for name in RULES["duckietown"].forbidden)


def _cut(grid: ArrayOrRows) -> Int8[np.ndarray, "H W"]:
    """Returns the smallest box around the roads of a map."""
    roads = cut_to_roads(np.asarray(grid, np.int8))
    if not roads.any():
        raise InputError("like", "maps with roads", "one without")
    return roads


def _features(town: Int8[np.ndarray, "H W"]) -> dict[str, float]:
    """Returns the metrics, shares and town features of a map.

    Shares and town features are in units of 1.
    """
    metrics = plain_measure(town)
    features: dict[str, float] = {}
    for name, value in plain_town(town).items():
        features[name] = value / 1000
    for share, part in _COUNTED.items():
        features[share] = metrics[part] / metrics["tiles"]
    for name, value in metrics.items():
        features[name] = float(value)
    return features


def _limits(name: str, values: Sequence[float]) -> tuple[int, int]:
    """Returns the lower and the upper limit of a feature, in thousandths."""
    low, high = min(values), max(values)
    margin = max((high - low) / 4, _LEAST_MARGIN.get(name, _USUAL_LEAST_MARGIN))
    most = _LARGEST_RATIO if name in _RATIOS else 1.0
    return floor(1000 * max(low - margin, 0)), ceil(1000 * min(high + margin, most))


def _axis(name: str, first: int, last: int) -> dict[str, Plain]:
    """Returns the axis whose bins divide the range of a feature."""
    width = -(-(last - first) // _BINS)
    return {"metric": name, "bins": _BINS, "width": width, "start": first}
