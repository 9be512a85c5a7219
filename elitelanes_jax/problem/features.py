"""Features: whole numbers that describe a network, for niches, constraints and weights.

A feature is a metric; or a share: a metric's part of the tiles or cells, in thousandths, rounded down; or one that is
measured only where it is asked for: an extra one, see `elitelanes_jax.problem.extras`. A row of counts has the metrics
first, then the extra features: those of the axes in their order before all others, so that axes alone tell where they
are.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, shorten, suggest
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.network.counts import COUNT_NAMES
from elitelanes_jax.network.town_features import TOWN_PARTS, TOWN_RATIOS, TownFeatures, largest_town_feature

SHARES = {
    "straight_share": ("straights", ("tiles",)),
    "turn_share": ("turns", ("tiles",)),
    "crossing_share": ("crossings", ("tiles",)),
    "coverage": ("tiles", ("tiles", "empty_cells")),
}
"""Each share by name: the metric that is counted, and the metrics whose sum it is a part of."""

FEATURES = (*COUNT_NAMES, *SHARES)
"""The names of the features that are always computed, in the order of `compute_features`."""

SHARE_UNIT = 1000
"""The whole number that stands for a share of 1."""

TOWN_FEATURES = TownFeatures._fields
"""The names of the extra features that the package has."""

# The values over which bins of a ratio are spread, in thousandths.
_USUAL = {
    "mean_block": 20_000,
    "block_spread": 1000,
    "loops_per_tile": 200,
    "mean_street": 20_000,
    "box_length": 4000,
    "adjacent_turns_per_tile": 500,
    "mean_detour": 4000,
}

LARGEST_FEATURE = 1_000_000
"""The largest value of a feature of one's own; larger ones are taken for it, negative ones for 0."""


def is_share(name: str) -> bool:
    """Tells whether a feature is a part of 1, kept in thousandths."""
    return name in SHARES or name in TOWN_PARTS


def feature_unit(name: str) -> int:
    """Returns the whole number that stands for 1 of a feature; those of one's own are whole numbers."""
    return SHARE_UNIT if is_share(name) or name in TOWN_RATIOS else 1


def largest_feature(name: str, shape: tuple[int, int]) -> int:
    """Returns an upper bound of an extra feature on grids ``(height, width)``."""
    return largest_town_feature(name, shape) if name in TOWN_FEATURES else LARGEST_FEATURE


def extra_names(*groups: Iterable[str]) -> tuple[str, ...]:
    """Returns the names that are none of `FEATURES`, in the order of the groups, each once."""
    return tuple(dict.fromkeys(name for names in groups for name in names if name not in FEATURES))


def feature_places(names: Sequence[str]) -> NDArray[np.int_]:
    """Returns the places of features in a row of `compute_features`, ints ``[N]``.

    Args:
      names: of features; the extra ones among them are the first extra ones of the row, in this order.
    """
    extras = extra_names(names)
    known = {name: place for place, name in enumerate((*FEATURES, *extras))}
    return np.array([known[name] for name in names])


def join_counts(measures: Mapping[str, AnyArray], extras: Sequence[str]) -> NDArray[np.int32]:
    """Puts metrics and extra features side by side as `compute_features` takes them, int32 ``[..., M + K]``.

    Args:
      measures: int arrays ``[...]`` of NumPy by name.
      extras: the names of K extra features.
    """
    return np.stack([measures[name] for name in (*COUNT_NAMES, *extras)], axis=-1).astype(np.int32)


def compute_features(counts: AnyArray) -> AnyArray:
    """Computes all features of networks.

    Args:
      counts: int32 ``[..., M + K]``, metrics as `stack_counts` orders them, then K extra features, of NumPy or JAX.

    Returns:
      int32 ``[..., F + K]`` in the order of `FEATURES`, then the extra ones, of the same library.
    """
    xp = counts.__array_namespace__()
    columns = [counts[..., : len(COUNT_NAMES)]]
    for part, whole in SHARES.values():
        total = sum(counts[..., COUNT_NAMES.index(name)] for name in whole)
        share = SHARE_UNIT * counts[..., COUNT_NAMES.index(part)] // xp.maximum(total, 1)
        columns.append(share[..., None])
    if counts.shape[-1] > len(COUNT_NAMES):
        columns.append(counts[..., len(COUNT_NAMES) :])
    return xp.concatenate(columns, axis=-1)


def check_feature(source: str, name: UserValue, own: Collection[str] | None = ()) -> str:
    """Checks the name of a feature.

    Args:
      source: the start of the message: what the name comes from.
      name: to check.
      own: names of features of one's own; None lets any name pass.

    Raises:
      InputError: if no feature has it.
    """
    if own is None and isinstance(name, str):
        return name
    known = (*FEATURES, *TOWN_FEATURES, *(own or ()))
    if name not in known:
        raise InputError(
            f"{source}: expected a metric, or a share such as straight_share, got {shorten(repr(name), 40)}"
            f"{suggest(name, known)} (elitelanes metrics explains all: {', '.join(known)})"
        )
    return str(name)


def default_width(name: str, bins: int, shape: tuple[int, int]) -> int:
    """Returns the width of bins that suits a feature on grids of a shape.

    Shares are cut into equal bins. Bins of the cyclomatic number are one wide at 12 x 12 and grow with the area; bins
    of other metrics cover the range that networks reach, half as many as there are cells.
    """
    area = shape[0] * shape[1]
    if is_share(name) or name in _USUAL:
        return max(1, -(-_USUAL.get(name, SHARE_UNIT) // bins))
    if name == "cyclomatic":
        return max(1, int(np.rint(area / 144)))
    most = max(shape) * area // 2 if name == "straight_score" else area // 2
    return max(1, -(-most // bins))
