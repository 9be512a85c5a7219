"""Finds the corners of tiles in a photograph: guesses to start from, to be fitted later.

Guesses are made of four masks: what differs from the colours at the photograph's border (GrabCut,
Rother et al. 2004), bright tape, another hue than the border's, and the dark part. Each is the
quadrangle around the largest piece.
"""

from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.photographs._views import Points

# The longer side of the photograph in which outlines are looked for, in pixels.
_SEARCH_PX = 400
# The most edges of an outline that may be sides of the quadrangle.
_MOST_EDGES = 12
# The least difference of two guesses, in pixels of the small photograph.
_SAME = 6
# The most quadrangles of a mask that are guesses if a corner of the floor has no tile.
_IF_LACKING = 5
# The least part of a photograph that tiles cover.
_LEAST = 0.03


def find_corners(image: NDArray[np.uint8], *, lacks_corner: bool = False) -> list[Points]:
    """Returns guesses of the corners of the tiles in a photograph.

    If a corner of the floor has no tile, the smallest quadrangle cuts across the gap. Then larger
    quadrangles are guesses too.

    Args:
      image: uint8 ``[H, W, 3]``, RGB.
      lacks_corner: whether a corner of the floor is known to have no tile.

    Returns:
      Guesses of float ``[4, 2]`` in pixels, clockwise, the top left corner first.
    """
    scale = _SEARCH_PX / max(image.shape[:2])
    size = max(16, round(image.shape[1] * scale)), max(16, round(image.shape[0] * scale))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    stretch = np.array([image.shape[1], image.shape[0]]) / size
    quads: list[Points] = []
    for mask in (_unlike_border(small), _tape(small), _other_colour(small), _dark(small)):
        for quad in _quadrangles(mask)[: _IF_LACKING if lacks_corner else 1]:
            if all(np.abs(quad - other).max() > _SAME for other in quads):
                quads.append(quad)
    return [(quad + 0.5) * stretch - 0.5 for quad in quads]


def _unlike_border(small: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Separates what differs from the photograph's border, whose light is a plane."""
    height, width = small.shape[:2]
    lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB).astype(np.float32).reshape(-1, 3)
    y, x = np.mgrid[0:height, 0:width]
    # A plane for each channel fits the light of the photograph's border.
    plane = np.stack([np.ones(lab.shape[0]), x.ravel() / width, y.ravel() / height], axis=1)
    rim = max(3, min(height, width) // 40)
    edge = np.ones((height, width), bool)
    edge[rim:-rim, rim:-rim] = False
    light, *_ = np.linalg.lstsq(plane[edge.ravel()], lab[edge.ravel()], rcond=None)
    away = np.linalg.norm(lab - plane @ light, axis=1).reshape(height, width)
    # What is farther from the plane than nearly all of the border is likely to be a tile.
    likely = away > np.percentile(away[edge], 97) + 6
    labels = np.where(likely, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[edge] = cv2.GC_BGD
    if likely[~edge].any() and not likely[~edge].all():
        # OpenCV's clusters start at random.
        cv2.setRNGSeed(0)
        cv2.grabCut(
            small,
            labels,
            (0, 0, 0, 0),
            np.zeros((1, 65)),
            np.zeros((1, 65)),
            4,
            cv2.GC_INIT_WITH_MASK,
        )
    return np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)


def _dark(small: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Separates the darker part of the photograph, without its light."""
    value = small.max(axis=2).astype(np.float32) + 4
    # The light is the brightest value nearby, smoothed.
    light = cv2.GaussianBlur(cv2.dilate(value, np.ones((25, 25), np.uint8)), (0, 0), 60)
    relative = np.clip(value / light * 200, 0, 255).astype(np.uint8)
    return np.asarray(
        cv2.threshold(relative, 0, 1, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)[1], np.uint8
    )


def _tape(small: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Separates thin lines that are brighter than what is around them."""
    value = small.max(axis=2).astype(np.float32) + 4
    # The opening removes lines that are narrower than 9 pixels.
    ground = cv2.morphologyEx(value, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    return (value > 1.4 * cv2.GaussianBlur(ground, (0, 0), 3)).astype(np.uint8)


def _other_colour(small: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Separates what has another hue than the photograph's border, in light and shadow.

    An example is grey asphalt on a floor.
    """
    logs = np.log(cv2.GaussianBlur(small, (0, 0), 2).astype(np.float32) + 4)
    # Quotients of channels are the same in light and shadow.
    hue = logs[..., [0, 2]] - logs[..., [1]]
    rim = max(3, min(small.shape[:2]) // 20)
    edge = np.concatenate(
        [part.reshape(-1, 2) for part in (hue[:rim], hue[-rim:], hue[:, :rim], hue[:, -rim:])]
    )
    away = np.linalg.norm(hue - np.median(edge, axis=0), axis=-1)
    # The hue of asphalt differs little from the floor's, and that of red and yellow tape differs
    # much. Therefore large differences are clipped before a threshold is chosen.
    scaled = np.clip(away / np.clip(np.percentile(away, 90), 0.06, 0.5) * 255, 0, 255).astype(
        np.uint8
    )
    return np.asarray(cv2.threshold(scaled, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1], np.uint8)


def _quadrangles(mask: NDArray[np.uint8]) -> list[Points]:
    """Returns the corners of quadrangles around the largest piece of a mask, the smallest first."""
    # Gaps are closed and holes filled. Then specks and thin strips are removed.
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((17, 17), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(np.zeros_like(closed), outlines, -1, 1, cv2.FILLED)
    opened = cv2.morphologyEx(filled, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    outlines, _ = cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return []
    hull = cv2.convexHull(max(outlines, key=cv2.contourArea))
    if cv2.contourArea(hull) < _LEAST * mask.size:
        return []
    # The sides of the quadrangle are on the longest edges of the hull, in their order around it.
    edges = cv2.approxPolyDP(hull, 0.006 * cv2.arcLength(hull, True), True)[:, 0].astype(np.float64)
    ends = np.roll(edges, -1, axis=0)
    longest = np.sort(np.argsort(-np.linalg.norm(ends - edges, axis=1))[:_MOST_EDGES])
    one = np.ones((len(longest), 1))
    # In homogeneous coordinates, the cross product of two points is their line, and that of two
    # lines is their point.
    lines = np.cross(np.hstack([edges[longest], one]), np.hstack([ends[longest], one]))
    around_hull: list[tuple[float, Points]] = []
    for chosen in combinations(range(len(longest)), 4):
        meet = np.cross(lines[list(chosen)], lines[[*chosen[1:], chosen[0]]])
        # Parallel edges do not meet.
        if (np.abs(meet[:, 2]) < 1e-9).any():
            continue
        quad = (meet[:, :2] / meet[:, 2:]).astype(np.float32)
        area = cv2.contourArea(quad)
        # The whole hull has to be inside, except for 3 pixels.
        around = all(
            cv2.pointPolygonTest(quad, tuple(map(float, point)), True) > -3 for point in edges
        )
        if around and cv2.isContourConvex(quad):
            around_hull.append((area, _first_at_top_left(quad.astype(np.float64))))
    return [quad for _, quad in sorted(around_hull, key=lambda found: found[0])]


def _first_at_top_left(corners: Points) -> Points:
    """Returns corners in clockwise order as seen.

    The first corner is the one nearest to the picture's top left.
    """
    x, y = corners.T
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0:
        corners = corners[::-1]
    return np.roll(corners, -int(corners.sum(axis=1).argmin()), axis=0)
