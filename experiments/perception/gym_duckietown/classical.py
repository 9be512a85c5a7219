"""Duckietown's classical way to see a lane: lines by their colour, and a vote of their edges for a lane pose.

After Paull et al., "Duckietown: an open, inexpensive and flexible platform for autonomy education and research", ICRA
2017: edges of white and yellow regions are projected to the ground; each piece of an edge votes for one offset and
angle; the bin with most votes is the lane pose. Positions of lines are those of gym-duckietown's photographed straight
tiles.
"""

from functools import cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

__all__ = ["find_lane", "find_lines"]

_HEIGHT, _FORWARD, _PITCH, _FIELD, _TILE = 0.108, 0.066, np.radians(19.15), np.radians(75.0), 0.585
# Tiles to the left of the lane's centre, of the right and the left edge of the right white and the yellow line.
_EDGES = {"white": (-0.299, -0.212), "yellow": (0.17, 0.211)}
_D, _PHI = np.arange(-0.25, 0.2501, 0.02), np.arange(-1.0, 1.001, 0.1)
_NEAR = 0.6  # metres ahead: beyond, pixels are too large
_PIECE = 5  # pixels


def find_lines(image: UInt8[NDArray, "h w 3"]) -> dict[str, NDArray[np.bool_]]:
    """Finds white, yellow and red pixels by fixed ranges of hue, saturation and value."""
    hue, saturation, value = np.moveaxis(cv2.cvtColor(image, cv2.COLOR_RGB2HSV), -1, 0)
    vivid = (saturation > 100) & (value > 80)
    return {
        "white": (saturation < 80) & (value > 130),
        "yellow": vivid & (hue > 20) & (hue < 40),
        "red": vivid & ((hue < 10) | (hue > 165)),
    }


@cache
def _ground(rows: int, columns: int) -> Float[NDArray, "h w 2"]:
    """Returns tiles ahead and to the left of the robot where each pixel meets the ground; NaN above the horizon."""
    focal = rows / 2 / np.tan(_FIELD / 2)
    right = (np.arange(columns) + 0.5 - columns / 2) / focal
    down = ((np.arange(rows) + 0.5 - rows / 2) / focal)[:, None]
    fall = np.sin(_PITCH) + down * np.cos(_PITCH)
    depth = np.where(fall > 0.02, _HEIGHT / np.where(fall > 0.02, fall, 1), np.nan)
    ahead = depth * (np.cos(_PITCH) - down * np.sin(_PITCH)) + _FORWARD
    return np.stack(np.broadcast_arrays(ahead, -depth * right), axis=-1) / _TILE


def find_lane(image: UInt8[NDArray, "h w 3"]) -> Float[NDArray, "2"]:
    """Returns the tiles and the radians to the left of the lane; zeros if no edge is seen."""
    ground = _ground(*image.shape[:2])
    votes = np.zeros((len(_D), len(_PHI)))
    lines = find_lines(image)
    for colour, edges in _EDGES.items():
        outlines, _ = cv2.findContours(lines[colour].astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            x, y = outline[:, 0].T
            inner = (x > 0) & (y > 0) & (x < image.shape[1] - 1) & (y < image.shape[0] - 1)
            first, second = ground[y, x][:-_PIECE], ground[y, x][_PIECE:]
            near = inner[:-_PIECE] & inner[_PIECE:] & (np.maximum(first[:, 0], second[:, 0]) < _NEAR / _TILE)
            _vote(votes, first[near], second[near], edges)
    if not votes.any():
        return np.zeros(2)
    d, phi = np.unravel_index(cv2.GaussianBlur(votes, (3, 3), 0.8).argmax(), votes.shape)
    return np.array([_D[d], _PHI[phi]])


def _vote(
    votes: Float[NDArray, "D P"],
    first: Float[NDArray, "N 2"],
    second: Float[NDArray, "N 2"],
    edges: tuple[float, float],
) -> None:
    """Adds the length of each piece of an edge to its bin. Outlines lead counter-clockwise around their pixels."""
    along = second - first
    length = np.hypot(*along.T)
    # A piece that leads ahead has the region on one side, and is its left or its right edge.
    right = along[:, 0] > 0
    along = np.where(right[:, None], along, -along)
    angle = np.arctan2(along[:, 1], along[:, 0])
    beside = (first[:, 1] * along[:, 0] - first[:, 0] * along[:, 1]) / np.maximum(length, 1e-9)
    d = np.where(right, edges[0], edges[1]) - beside
    rows, columns = np.rint((d - _D[0]) / 0.02).astype(int), np.rint((-angle - _PHI[0]) / 0.1).astype(int)
    fits = (length > 1e-3) & (rows >= 0) & (rows < len(_D)) & (columns >= 0) & (columns < len(_PHI))
    np.add.at(votes, (rows[fits], columns[fits]), length[fits])
