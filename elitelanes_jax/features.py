"""Features: what a network can be described or asked for by, whole numbers all.

A feature is a metric, or a share: a metric's part of the tiles or cells, in thousandths, rounded down.
"""

from difflib import get_close_matches
from typing import Any

import jax.numpy as jnp
import numpy as np
from chex import Array

from elitelanes_jax.errors import InputError
from elitelanes_jax.metrics import COUNTED

__all__ = ["FEATURES", "SHARES", "WHOLE", "check_feature", "features_of", "usual_width"]

SHARES = {
    "straight_share": ("straights", ("tiles",)),
    "turn_share": ("turns", ("tiles",)),
    "crossing_share": ("crossings", ("tiles",)),
    "coverage": ("tiles", ("tiles", "empty_cells")),
}
"""Each share by name: the metric that is counted, and those that together make the whole."""

FEATURES = (*COUNTED, *SHARES)
"""The names of all features, in the order of `features_of`."""

WHOLE = 1000
"""What a share of 1 is."""


def features_of(counts: Array) -> Array:
    """All features, int32 ``[..., F]`` in the order of `FEATURES`, of `counts_of` metrics ``[..., M]``."""
    columns = [counts]
    for part, whole in SHARES.values():
        total = sum(counts[..., COUNTED.index(name)] for name in whole)
        share = WHOLE * counts[..., COUNTED.index(part)] // jnp.maximum(total, 1)
        columns.append(share[..., None])
    return jnp.concatenate(columns, axis=-1)


def check_feature(where: str, name: Any) -> str:
    """The name.

    Raises:
      InputError: if no feature has it; `where` says what was being read.
    """
    if name not in FEATURES:
        near = get_close_matches(str(name), FEATURES, 1)
        hint = f"; is it {near[0]}?" if near else ""
        raise InputError(f"{where}: expected a metric, or a share such as straight_share, got {name!r}{hint}")
    return name


def usual_width(name: str, bins: int, shape: tuple[int, int]) -> int:
    """The width of bins that suits a feature on grids of a shape.

    Shares are cut into equal bins. The cyclomatic number is kept apart unit by unit at 12 x 12, in proportion to the
    area beyond; other metrics by what can be met, half as many as there are cells.
    """
    area = shape[0] * shape[1]
    if name in SHARES:
        return max(1, -(-WHOLE // bins))
    if name == "cyclomatic":
        return max(1, int(np.rint(area / 144)))
    most = max(shape) * area // 2 if name == "straight_score" else area // 2
    return max(1, -(-most // bins))
