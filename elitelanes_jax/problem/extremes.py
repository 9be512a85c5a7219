"""The meaning of each feature, its range, and maps with its smallest and largest value.

The range and the maps are those of 12 x 12 tiles.
"""

from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import descriptions
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.network.records import Metrics, TownFeatures, features_without_gaps
from elitelanes_jax.problem.features import (
    FEATURES,
    SHARES,
    TOWN_FEATURES,
    check_feature,
    feature_unit,
    is_share,
)

_SHAPE = (12, 12)

EXTREMES = Path(__file__).with_name("extremes.txt")
"""The file of maps that ``docs/metrics.py`` found.

Each line is a map, in rows with one hexadecimal digit per tile.
"""


def features_of(grid: Int8[np.ndarray, "H W"]) -> dict[str, float]:
    """Returns the metrics and shares of one grid ``[H, W]``, by name.

    Shares are parts of 1.
    """
    features: dict[str, float] = dict(plain_measure(grid))
    for share, (part, parts_of_whole) in SHARES.items():
        whole = sum(features[name] for name in parts_of_whole)
        features[share] = features[part] / max(1, whole)
    return {name: features[name] for name in FEATURES}


@cache
def _measured() -> list[tuple[Int8[np.ndarray, "H W"], dict[str, float]]]:
    measured = []
    for line in EXTREMES.read_text(encoding="ascii").splitlines():
        rows = [[int(code, 16) for code in row] for row in line.split()]
        grid = frozen_copy(np.array(rows, np.int8))
        measured.append((grid, features_of(grid)))
    return measured


@name_wrong_arguments
def feature_range(name: str) -> tuple[float, float]:
    """Returns the smallest and the largest value of a feature that searches found at 12 x 12.

    The maps have the constraints that `generate` has by default: one component, no dead ends and no
    empty cells. Raises `InputError` for an unknown name, and for a feature of a town, whose ends
    are not known; so does `extreme_maps`.
    """
    if check_feature("name", name) in TOWN_FEATURES:
        raise InputError(
            "name", "a metric or a share", f"{name!r}, a town feature, whose range is not known"
        )
    values = [features[name] for _, features in _measured()]
    return min(values), max(values)


def extreme_maps(name: str) -> tuple[Int8[np.ndarray, "H W"], Int8[np.ndarray, "H W"]]:
    """Returns a map with the smallest value of a feature, and one with the largest.

    The maps are int8 ``[12, 12]``, read-only.
    """
    # This call checks the name.
    feature_range(name)
    smallest, _ = min(_measured(), key=lambda measured: measured[1][name])
    largest, _ = max(_measured(), key=lambda measured: measured[1][name])
    return smallest, largest


@name_wrong_arguments
def describe_features() -> dict[str, tuple[str, str]]:
    """Returns the meaning and the range of each metric, share and town feature, by name.

    The range is the smallest and the largest value that searches found at 12 x 12. Their maps have
    one component, no dead ends and no empty cells. For a town feature, it is the kind of its
    values, and "filled" with its value if all maps without empty cells have the same.
    """
    shares = {share: f"{part} / {' + '.join(whole)}" for share, (part, whole) in SHARES.items()}
    meanings = shares | descriptions(Metrics) | descriptions(TownFeatures)
    return {name: (meanings[name], _range_text(name)) for name in (*FEATURES, *TOWN_FEATURES)}


def _range_text(name: str) -> str:
    if name in TOWN_FEATURES:
        return _town_range_text(name)
    low, high = map(value_text, feature_range(name))
    if low == high:
        return low
    return f"{low}..{high}"


def _town_range_text(name: str) -> str:
    unit = feature_unit(name)
    if is_share(name):
        kind = "0..1"
    elif unit > 1:
        kind = "a ratio"
    else:
        kind = "a number"
    filled = features_without_gaps(_SHAPE).get(name)
    if filled is None:
        return kind
    return f"{kind}; filled {value_text(filled / unit)}"


def value_text(value: float) -> str:
    """Returns the text of a metric's or share's value.

    Whole numbers are in full, and others have three digits.
    """
    if isinstance(value, float):
        return f"{value:.3g}"
    return str(value)
