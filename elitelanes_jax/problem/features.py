"""Features: the whole numbers that niches, ranges and weights can name.

| kind | what it is |
|---|---|
| metric | a whole number that `measure` returns for every grid, see `Metrics` |
| share | a part of the tiles or cells, in thousandths, rounded down; it follows from metrics |
| town feature | a whole number that `measure_town` returns; measured only if a search names it |
| feature of the user | what a kernel of the user returns for a grid, see `elitelanes_jax.problem.kernels` |

An array of features ``[..., F]`` has one column per feature; `feature_names` has the F names in the
same order. Shares have no column: `select_features` computes them.
"""

from collections.abc import Collection, Iterable, Sequence

import numpy as np

from elitelanes_jax._util.checks import check_named, check_unique, nonblank
from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.types import ArrayT, UserValue
from elitelanes_jax.network.records import (
    METRIC_NAMES,
    TOWN_PARTS,
    TOWN_RATIOS,
    TownFeatures,
    largest_town_feature,
)

SHARES = {
    "straight_share": ("straights", ("tiles",)),
    "turn_share": ("turns", ("tiles",)),
    "crossing_share": ("crossings", ("tiles",)),
    "coverage": ("tiles", ("tiles", "empty_cells")),
}
"""For each share, the metric that is the part and the metrics whose sum is the whole."""

FEATURES = (*METRIC_NAMES, *SHARES)
"""The names of the metrics and shares."""

SHARE_UNIT = 1000
"""The whole number that stands for a share of 1."""

TOWN_FEATURES = TownFeatures._fields
"""The names of the town features."""

# The ranges that the default bins of these ratios cover, in thousandths.
_USUAL = {
    "mean_block": 20_000,
    "block_spread": 1000,
    "loops_per_tile": 200,
    "mean_street": 20_000,
    "box_length": 4000,
    "adjacent_turns_per_tile": 500,
    "mean_detour": 4000,
}

LARGEST_FITNESS = 2**29
"""The largest size of a user's fitness, or of a weighted sum of features.

With this limit, sums with penalties fit int32 too.
"""


# Names that tables of maps give to columns beside features.
_COLUMNS = {"file", "id", "niche", "split", "height", "width", "fitness", "lanes", "trip"}


def is_share(name: str) -> bool:
    """Returns whether a feature is a part of 1, stored in thousandths."""
    return name in SHARES or name in TOWN_PARTS


def feature_unit(name: str) -> int:
    """Returns the whole number that stands for 1 of a feature; 1 for features of the user."""
    if is_share(name) or name in TOWN_RATIOS:
        return SHARE_UNIT
    return 1


def columns_for(*groups: Iterable[str]) -> tuple[str, ...]:
    """Returns the columns that contain the features in all groups.

    The metrics come first, then the other features, each once.
    """
    columns = dict.fromkeys(METRIC_NAMES)
    for names in groups:
        for name in names:
            if name not in SHARES:
                columns[name] = None
    return tuple(columns)


def with_shares(features: ArrayT, feature_names: Sequence[str]) -> tuple[ArrayT, tuple[str, ...]]:
    """Adds a column for each share that follows from the metrics.

    The features are int32 ``[..., F]`` of NumPy or JAX. Returns int32 ``[..., F + S]``, of the same
    library, and the F + S names.
    """
    # NumPy and JAX share the functions that are needed here, so one text serves both.
    xp = features.__array_namespace__()
    column = {name: index for index, name in enumerate(feature_names)}
    arrays = [features]
    names = list(feature_names)
    for share, (part, whole) in SHARES.items():
        if part not in column or not column.keys() >= set(whole):
            continue
        total = sum(features[..., column[name]] for name in whole)
        # A grid without tiles has shares of 0.
        values = SHARE_UNIT * features[..., column[part]] // xp.maximum(total, 1)
        arrays.append(values[..., None])
        names.append(share)
    return xp.concatenate(arrays, axis=-1), tuple(names)


def select_features(
    features: ArrayT, feature_names: Sequence[str], selected: Sequence[str]
) -> ArrayT:
    """Returns the columns of the selected features, int32 ``[..., D]``, of NumPy or JAX.

    Computes the columns of shares.
    """
    if not set(selected) <= set(feature_names):
        features, feature_names = with_shares(features, feature_names)
    return features[..., np.array([feature_names.index(name) for name in selected], int)]


def check_feature(source: str, name: UserValue, features: Collection[str] | None = ()) -> str:
    """Checks the name of a feature; `source` is the subject of its errors.

    `features` are the names of the user's features; None accepts any name.
    """
    if features is None and isinstance(name, str):
        return name
    known = tuple(dict.fromkeys([*FEATURES, *TOWN_FEATURES, *(features or ())]))
    # A comparison of an array with texts raises an error of NumPy.
    if not isinstance(name, str) or name not in known:
        explanation = f"elitelanes metrics explains all: {', '.join(known)}"
        raise InputError(
            source,
            "a feature such as turns or straight_share",
            quote(name, 40),
            " ".join(filter(None, (suggest(name, known), explanation))),
        )
    return name


def check_features(features: UserValue) -> tuple[str, ...]:
    """Checks the names of the user's own features, which no other feature may have."""
    if isinstance(features, str) or not isinstance(features, Iterable):
        raise InputError("features", "names", quote(features))
    listed = [check_named("features", nonblank, name) for name in features]
    names = check_unique("features", "name", listed)
    # A map also says how many tiles an inventory has left, such as turns_left.
    taken = {*FEATURES, *TOWN_FEATURES, "constant"}
    taken |= {f"{name}_left" for name in taken} | _COLUMNS
    for name in names:
        if not name.isidentifier():
            expected = "names of letters, digits and _"
            raise InputError("features", expected, quote(name, 40))
        if name in taken:
            expected = "names that no built-in feature and no column of a table has"
            raise InputError("features", expected, repr(name))
    return tuple(names)


def default_width(name: str, bins: int, shape: tuple[int, int]) -> int:
    """Returns the default width of bins of a feature on grids of a shape.

    The range of a share is divided into equal bins. Bins of the cyclomatic number have width 1 at
    12 x 12 and grow with the area. Bins of any other metric cover the range that networks reach: 0
    to half the number of cells.
    """
    area = shape[0] * shape[1]
    if is_share(name) or name in _USUAL:
        return max(1, -(-_USUAL.get(name, SHARE_UNIT) // bins))
    if name == "cyclomatic":
        # The area of 12 x 12 tiles is 144.
        return max(1, int(np.rint(area / 144)))
    most = max(shape) * area // 2 if name == "straight_score" else area // 2
    return max(1, -(-most // bins))


def largest_addend(weights: Iterable[tuple[str, int]], shape: tuple[int, int]) -> int:
    """Returns an upper bound of the size of what weighted features add to the fitness.

    Metrics are left out.
    """
    largest = 0
    has_users_features = False
    for name, weight in weights:
        if name in TOWN_FEATURES:
            largest += abs(weight) * largest_town_feature(name, shape)
        elif name not in METRIC_NAMES and name != "constant" and weight != 0:
            has_users_features = True
    # Grids with a larger sum of the user's features are refused, see `road_problem`.
    return largest + LARGEST_FITNESS if has_users_features else largest
