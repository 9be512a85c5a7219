"""Judges a proposal: how sure it is, by measurements that each have a limit."""

from collections.abc import Collection
from math import exp
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.photographs._views import FloorView

SURE = 0.5
"""The least score of a proposal that is cut, and of a cell whose kind is sure."""

CORNERS_GIVEN = {"out_of_square"}
"""The evidence that the user's corners replace."""

# The usual focal lengths, in widths of the picture.
_FOCAL = np.geomspace(0.45, 4, 200)
_UNLIKE = (
    "the outlined area does not look like road tiles; have the whole floor in the picture, check "
    "the size, and {corners}"
)
_UNLIKE_TILE = (
    "the outlined area does not look like one road tile; a floor of several tiles needs its size, "
    "rows and columns; for one tile, {corners}"
)
_CROPPED = (
    "the outlined tiles are no squares in space; check the size, "
    "take a photograph that is not cropped, or give the corners"
)
_MIRRORED = "the photograph is mirrored or shows left-hand traffic; do not flip it"
_UNSEEN_FLOOR = (
    "the border of the floor is not seen; photograph it from closer or on a floor of another "
    "colour, or give its exact corners"
)
_HIDDEN = (
    "the tile's border is not seen; photograph it on a floor of another colour, "
    "or give its exact corners"
)
LACKS_CORNER = "a corner of the floor has no tile, which hides the floor's corners: give them"
"""What may explain that a floor without a tile in a corner is not found."""


class _Limit(NamedTuple):
    """Where evidence gives a score of one half, and what to do if it gives less.

    Attributes:
      value: the limit.
      width: the width of the sigmoid; negative for an upper limit.
      advice: what to do; ``{corners}`` is replaced by what to do about the corners.
    """

    value: float
    width: float
    advice: str


# Measured on photographs of `experiments/perception/cutting.py`.
_LIMITS: dict[str, dict[str, _Limit]] = {
    "floor": {
        "alike": _Limit(0.5, 0.03, _UNLIKE),
        "out_of_square": _Limit(0.025, -0.004, _CROPPED),
        "edge": _Limit(
            0.42,
            0.02,
            "no tiles are seen along one side of the floor; check the size, and {corners}",
        ),
        "handed": _Limit(0.0, 0.03, _MIRRORED),
        "repeats": _Limit(
            0.87,
            0.015,
            "the tiles do not repeat in this grid; check the size, take away what stands on them, "
            "and {corners}",
        ),
        # A corner is off by up to twice its standard deviation, and rarely by more. Therefore the
        # score falls slowly: it is above 0.98 only for deviations below 0.4 %.
        "spread": _Limit(
            0.009,
            -0.0013,
            "too few lines and too little of the border are seen; photograph it from closer",
        ),
    },
    "tile": {
        "alike": _Limit(0.5, 0.03, _UNLIKE_TILE),
        "out_of_square": _Limit(0.02, -0.003, _CROPPED),
        "handed": _Limit(0.0, 0.03, _MIRRORED),
        "contrast": _Limit(4.5, 0.1, _HIDDEN),
        "spread": _Limit(0.006, -0.0006, _HIDDEN),
    },
}

# The largest spread in tiles with which the border tells the corners. With a larger one, cells or
# colours do.
_BORDER_TELLS = 0.002
# The least share of points of each side at which the border of a floor is seen. Then a floor of
# square tiles is in its place, even if its tiles differ as hand-taped tiles do.
_LEAST_BORDER_SEEN, _LARGEST_OUT_OF_SQUARE = 0.25, 0.012
_REPEATS_IF_SEEN = 0.72, 0.015
# Drawn tiles differ by this much: 1 - `repeats`. Tiles that differ more displace a fit of cells by
# more than its spread says.
_DIFFER = 0.03
# Where no border is seen at single points, corners were off by 1.5 % at a spread of 0.52 %, and by
# 1.3 % at 0.55 %. On a floor of asphalt's colour, 0.15 of the points seem to be seen by chance.
_UNSEEN = 0.2
_SPREAD_IF_UNSEEN = 0.0045, -0.0004


def out_of_square(view: FloorView) -> float:
    """Returns how far the tiles are from squares in space, 0 for squares.

    The distance combines the ratio of the sides and the angle in radians. The camera's axis is the
    photograph's middle, and its pixels are square. The focal length is unknown; the usual one that
    fits best counts.
    """
    middle = np.array([[1, 0, -(view.width - 1) / 2], [0, 1, -(view.height - 1) / 2], [0, 0, 1.0]])
    # These are a tile's sides in space, except that x and y are multiplied by the focal length.
    across, down = (middle @ view.homography)[:, :2].T
    focal = view.width * _FOCAL[:, None]
    across, down = (
        np.hstack([side[:2] / focal, np.full_like(focal, side[2])]) for side in (across, down)
    )
    lengths = np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1)
    slant = np.arcsin(np.clip((across * down).sum(axis=1) / (lengths[0] * lengths[1]), -1, 1))
    return float(np.hypot(np.log(lengths[0] / lengths[1]), slant).min())


def least_alike_edge(alike: NDArray[np.float64]) -> float:
    """Returns how alike the best tile is in the weakest outermost row or column.

    The result is 0 if this row or column has no tile.
    """
    return float(min(edge.max() for edge in (alike[0], alike[-1], alike[:, 0], alike[:, -1])))


def judge(evidence: dict[str, float], kind: str, ignored: Collection[str]) -> tuple[float, str]:
    """Returns the score of a proposal, and what to do about its weakest evidence.

    Evidence that the user's corners replace, `ignored`, does not count: a cropped photograph looks
    as if its tiles were no squares, and exact corners need no contrast.
    """
    limits = {name: limit for name, limit in _LIMITS[kind].items() if name not in ignored}
    measured = evidence
    if kind == "floor":
        evidence, limits = _weigh_border(evidence, limits)
    sures = _sures(evidence, limits)
    # In a product, each measurement alone can refuse the proposal.
    # Corners that the user gave may be wrong, and need not be asked for.
    corners = "check the corners" if {*ignored} >= CORNERS_GIVEN else "give the corners"
    # The spread of tiles that differ is enlarged. Then the reason is that they differ: more lines, or
    # more of the border, would not help.
    reason = _reason(_sures(measured, limits))
    advice = limits[reason].advice.format(corners=corners)
    return float(np.prod(list(sures.values()))), advice


def _sures(evidence: dict[str, float], limits: dict[str, _Limit]) -> dict[str, float]:
    """Returns how sure each evidence is, 0 to 1."""
    return {
        name: sigmoid((evidence[name] - limit.value) / limit.width)
        for name, limit in limits.items()
    }


def _reason(sures: dict[str, float]) -> str:
    """Returns the evidence that explains a low score, from how sure each evidence is."""
    # Nothing else counts where there are no tiles at all, except that mirrored tiles look like no
    # tiles.
    for name in ("handed", "alike"):
        if sures[name] < SURE:
            return name
    # A view that fits badly shows no squares, even if the tiles are squares.
    of_fit = {name: sure for name, sure in sures.items() if name != "out_of_square" and sure < SURE}
    return min(of_fit or sures, key=lambda name: sures[name])


def _weigh_border(
    evidence: dict[str, float], limits: dict[str, _Limit]
) -> tuple[dict[str, float], dict[str, _Limit]]:
    """Returns what the score of a floor is made of, and its limits.

    Both depend on how well the border is seen.
    """
    limits = dict(limits)
    if evidence["spread"] > _BORDER_TELLS:
        differ = max(1.0, (1 - evidence["repeats"]) / _DIFFER)
        evidence = evidence | {"spread": evidence["spread"] * differ}
    elif (
        evidence["border"] >= _LEAST_BORDER_SEEN
        and evidence["out_of_square"] <= _LARGEST_OUT_OF_SQUARE
    ):
        limits["repeats"] = _Limit(*_REPEATS_IF_SEEN, limits["repeats"].advice)
    if evidence["border"] < _UNSEEN:
        limits["spread"] = _Limit(*_SPREAD_IF_UNSEEN, _UNSEEN_FLOOR)
    return evidence, limits


def sigmoid(value: float) -> float:
    return 1 / (1 + exp(-max(-60.0, min(60.0, value))))
