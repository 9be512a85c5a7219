"""Features: whole numbers that describe a network, for niches and constraints.

A feature is a metric, or a share: a metric's part of the tiles or cells, in thousandths, rounded down.
"""

from typing import Any

import numpy as np

from elitelanes_jax._util.errors import InputError, likely, short
from elitelanes_jax.network.counts import COUNT_NAMES

__all__ = ["FEATURES", "SHARES", "SHARE_UNIT", "check_feature", "compute_features", "default_width"]

SHARES = {
    "straight_share": ("straights", ("tiles",)),
    "turn_share": ("turns", ("tiles",)),
    "crossing_share": ("crossings", ("tiles",)),
    "coverage": ("tiles", ("tiles", "empty_cells")),
}
"""Each share by name: the metric that is counted, and the metrics whose sum it is a part of."""

FEATURES = (*COUNT_NAMES, *SHARES)
"""The names of all features, in the order of `compute_features`."""

SHARE_UNIT = 1000
"""The whole number that stands for a share of 1."""


def compute_features(counts: Any) -> Any:
    """Computes all features of networks.

    Args:
      counts: int32 ``[..., M]``, metrics as `stack_counts` orders them, of NumPy or JAX.

    Returns:
      int32 ``[..., F]`` in the order of `FEATURES`, of the same library.
    """
    xp = counts.__array_namespace__()
    columns = [counts]
    for part, whole in SHARES.values():
        total = sum(counts[..., COUNT_NAMES.index(name)] for name in whole)
        share = SHARE_UNIT * counts[..., COUNT_NAMES.index(part)] // xp.maximum(total, 1)
        columns.append(share[..., None])
    return xp.concatenate(columns, axis=-1)


def check_feature(source: str, name: Any) -> str:
    """Checks the name of a feature.

    Args:
      source: the start of the message: what the name comes from.
      name: to check.

    Raises:
      InputError: if no feature has it.
    """
    if name not in FEATURES:
        raise InputError(
            f"{source}: expected a metric, or a share such as straight_share, got {short(repr(name), 40)}"
            f"{likely(name, FEATURES)} (elitelanes metrics explains all: {', '.join(FEATURES)})"
        )
    return str(name)


def default_width(name: str, bins: int, shape: tuple[int, int]) -> int:
    """Returns the width of bins that suits a feature on grids of a shape.

    Shares are cut into equal bins. Bins of the cyclomatic number are one wide at 12 x 12 and grow with the area; bins
    of other metrics cover the range that networks reach, half as many as there are cells.
    """
    area = shape[0] * shape[1]
    if name in SHARES:
        return max(1, -(-SHARE_UNIT // bins))
    if name == "cyclomatic":
        return max(1, int(np.rint(area / 144)))
    most = max(shape) * area // 2 if name == "straight_score" else area // 2
    return max(1, -(-most // bins))
