"""Measures where the border of tiles is seen in a photograph.

The colours near the border tell the ground of the tiles from the floor around them.

On a floor that is nearly as dark as asphalt, no edge is seen at most points of a side. So each side
is first the line that separates the colours inside from those outside best: all pixels near the
side count, as in a region-based active contour (Chan and Vese 2001). Then it is the line at which
colours change most on the average along a part of the side.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.photographs._views import FloorView, Points, flatten

Sides = list[tuple[tuple[float, float], tuple[int, int]]]
"""The middle of each side of a tile in tiles, x and y, and the direction out of the tile."""

ALONG = 24
"""Points along a side of a tile at which the border is measured."""

MOST_CONTRAST = 6.0
"""The contrast of a side whose colours all tell the tile from the floor."""

# The largest distance between the border by colours, which a shadow under the tile shifts, and the
# sharpest edge, in tiles.
_SHARP_REACH = 0.015
# The points of a side over which the sharpest edge is averaged.
_PART = 8
# The distance beyond the reach, in tiles, from which the colours of the floor and of the tile are
# taken.
_RING = 0.18
# The distance between two places across a side, in tiles.
_STEP = 1 / 320
# The places along a side for each point.
_FINE = 4
# The logarithm of the density of tape, and of all else on a tile that is not asphalt.
_TAPE_DENSITY = -3.0
# The largest logarithm of a ratio of likelihoods that one pixel counts for.
_MOST_LIKELY = MOST_CONTRAST / 2
# The width on both sides of a border, in tiles, whose colours are compared.
_BESIDE = 0.04
# The distance on both sides of a border, in tiles, within which colours are no sample of the
# floor's or the tile's.
_BESIDE_REACH = 0.05
# The least standard deviation of a floor's colours, in logarithms.
_GRAIN = 0.01
# How much brighter than the tile's darkest quarter the sample of asphalt may be, in logarithms.
_ASPHALT_RANGE = 0.35
# A tenth of the sample of a density is left out, and this factor makes its covariance larger again.
# For normal colours 1.23 would do so.
_TRIMMED_FACTOR = 1.3
# How far beyond the reach of the sharpest edge the sample of the floor begins, in tiles.
_FLOOR_GAP = 0.02
# The change of colours at a step is over three steps.
_CHANGE_STEPS = 3
# The grey levels that are added to colours before their logarithm is taken, because noise is as
# large in dark pixels.
_DARK = 8


class Border(NamedTuple):
    """How far outside of the sides of tiles the border is seen, at A points of each of S sides.

    Attributes:
      points: float ``[S, A, 2]``, points on the outer sides, x and y in tiles.
      outwards: float ``[S, 1, 2]``, the directions out of the tiles, of length 1.
      offsets: float ``[S, A]``, the offset of the border at each point, in tiles outwards; NaN
        where no border is seen.
    """

    points: Points
    outwards: Points
    offsets: NDArray[np.float64]


def outer_sides(codes: NDArray[np.int8]) -> Sides:
    """Returns the middle of each side of a tile that has no neighbour.

    With each middle comes the direction out of the tile.
    """
    around, sides = np.pad(codes, 1), []
    for row, column in np.argwhere(codes > 0).tolist():
        for side in SIDES:
            if not around[row + 1 + side.down, column + 1 + side.right]:
                middle = column + 0.5 + side.right / 2, row + 0.5 + side.down / 2
                sides.append((middle, (side.right, side.down)))
    return sides


def contrasts(image: NDArray[np.uint8], view: FloorView, sides: Sides) -> NDArray[np.float64]:
    """Returns how well the colours beside each side tell the tile from the floor, ``[S]``.

    At each point of a side, the likelihood of the colours just inside is compared with that of the
    colours just outside. The result is the median along the side: `MOST_CONTRAST` if all colours
    tell the tile from the floor, and 0 if none does or the colours on both sides are the same.
    """
    _, _, steps, likely = _likely_profiles(image, view, sides, _BESIDE_REACH)
    inside, outside = (steps < 0) & (steps > -_BESIDE), (steps > 0) & (steps < _BESIDE)
    differences = likely[..., inside].mean(axis=-1) - likely[..., outside].mean(axis=-1)
    return np.median(differences, axis=1)


def profiles(
    image: NDArray[np.uint8],
    view: FloorView,
    sides: Sides,
    steps: NDArray[np.float64],
    fine: int,
    tile_px: float,
) -> tuple[Points, Points, NDArray[np.uint8]]:
    """Returns the colours across the sides of tiles.

    S sides have A points each, and a point has `fine` places along the side, F in all for a side.

    Args:
      image: the photograph.
      view: where the tiles are in it.
      sides: the sides.
      steps: float ``[T]``, the distances outwards at which colours are read, in tiles.
      fine: the places of a point.
      tile_px: the pixels of a tile to which the photograph is reduced, see `flatten`.

    Returns:
      The points on the sides ``[S, A, 2]``; the directions out ``[S, 1, 2]``; and the colours
      ``[S, F, T, 3]``, RGB.
    """
    # Shapes [S, 1, 2].
    middles, outwards = (np.array(part, float)[:, None] for part in zip(*sides, strict=True))
    count = fine * ALONG
    # A direction out of the tile with swapped coordinates points along the side.
    along = (np.arange(count) + 0.5)[None, :, None] / count - 0.5
    # Shape [S, F, 2].
    places = middles + along * outwards[..., ::-1]
    # Shape [S, F, T, 2].
    across = places[:, :, None] + steps[:, None] * outwards[:, :, None]
    # `flatten` takes places in rows and columns.
    rows = flatten(image, view, across.reshape(-1, len(steps), 2), tile_px)
    points = places.reshape(len(sides), ALONG, fine, 2).mean(axis=2)
    return points, outwards, rows.reshape(len(sides), count, len(steps), 3)


def _fine_profiles(
    image: NDArray[np.uint8], view: FloorView, sides: Sides, steps: NDArray[np.float64]
) -> tuple[Points, Points, NDArray[np.float64]]:
    """Returns what `profiles` does with `_FINE` places a point, and logarithms of the colours."""
    points, outwards, colours = profiles(image, view, sides, steps, _FINE, 1 / _STEP)
    return points, outwards, np.log(colours.astype(float) + _DARK)


def colour_border(image: NDArray[np.uint8], view: FloorView, sides: Sides, reach: float) -> Border:
    """Returns where the colours of sides separate.

    The border is searched for within `reach` tiles of where the view has it.
    """
    points, outwards, steps, likely = _likely_profiles(image, view, sides, reach)
    return Border(points, outwards, np.stack([_separate(side, steps, reach) for side in likely]))


def _likely_profiles(
    image: NDArray[np.uint8], view: FloorView, sides: Sides, reach: float
) -> tuple[Points, Points, NDArray[np.float64], NDArray[np.float64]]:
    """Returns where the colours across the sides are likelier the tiles' than the floor's.

    Returns points and directions as `profiles` does, the T distances outwards of colours, from
    outside to inside, and the likelihoods ``[S, A, T]``, see `_likelihoods`.
    """
    steps = np.arange(reach + _RING, -reach - _RING, -2 * _STEP)
    points, outwards, fine = _fine_profiles(image, view, sides, steps)
    # The colours of a point are the mean of its places.
    colours = fine.reshape(len(sides), ALONG, _FINE, len(steps), 3).mean(axis=2)
    likely = np.stack([_likelihoods(side, steps, reach) for side in colours])
    return points, outwards, steps, likely


def _likelihoods(
    colours: NDArray[np.float64], steps: NDArray[np.float64], reach: float
) -> NDArray[np.float64]:
    """Returns how much likelier each colour of a side is the tile's than the floor's.

    Args:
      colours: ``[A, T, 3]``, across the side at A points.
      steps: the distances outwards ``[T]``.
      reach: colours farther outside are the floor's, and colours farther inside are the tile's.

    Returns:
      The logarithm of the ratio of the likelihoods, ``[A, T]``, at most `_MOST_LIKELY` both ways.
    """
    floor = colours[:, steps > reach].reshape(-1, 3)
    tile = colours[:, steps < -reach].reshape(-1, 3)
    brightness = tile.max(axis=1)
    # Tape is brighter than asphalt, so the sample of asphalt has the tile's darkest colours.
    asphalt = tile[brightness < np.percentile(brightness, 25) + _ASPHALT_RANGE]
    # A pixel of the tile is asphalt, or anything else with the same small density at all colours.
    inside = np.logaddexp(_log_density(colours, asphalt), _TAPE_DENSITY)
    return np.clip(inside - _log_density(colours, floor), -_MOST_LIKELY, _MOST_LIKELY)


def _log_density(colours: NDArray[np.float64], sample: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the logarithm of the normal density of a sample at some colours.

    The sample is ``[N, 3]``, and the colours are ``[..., 3]``.
    """
    mean = np.median(sample, axis=0)
    # Specks in the sample would widen the density. Therefore its farthest tenth is left out.
    distance = np.abs(sample - mean).sum(axis=1)
    core = sample[distance <= np.percentile(distance, 90)]
    covariance = np.cov(core.T) * _TRIMMED_FACTOR + np.eye(3) * _GRAIN**2
    away = colours - mean
    square = np.einsum("...i,ij,...j->...", away, np.linalg.inv(covariance), away)
    return np.asarray(-0.5 * square - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1])


def _separate(
    likely: NDArray[np.float64], steps: NDArray[np.float64], reach: float
) -> NDArray[np.float64]:
    """Returns where the border of a side is at each of its points.

    First the straight line that separates the side best is searched for. A border need not be
    straight, so each point may then leave this line by a few steps.

    Args:
      likely: ``[A, T]``, how much likelier each colour is the tile's than the floor's.
      steps: the distances outwards ``[T]``, from outside to inside.
      reach: the largest distance of the border.

    Returns:
      The offsets outwards ``[A]``; NaN where nothing separates near the line.
    """
    # The I steps at which the border may be.
    inner = np.flatnonzero(np.abs(steps) <= reach)
    # The gain of a border is the sum of the likelihoods inside of it, at the steps after it. This is
    # the sum of all, which is the same for every border and is left out, less the sum before it.
    gain = -np.cumsum(likely, axis=1)[:, inner - 1]
    line = _best_line(gain)
    # Each point counts the gains of its neighbours, since those of a single point are noisy.
    smooth = cv2.GaussianBlur(gain, (1, 5), 0, borderType=cv2.BORDER_REPLICATE)
    width = max(2, round(0.01 / _STEP))
    window = np.clip(line[:, None] + np.arange(-width, width + 1), 0, len(inner) - 1)
    best = np.take_along_axis(smooth, window, 1).argmax(axis=1)
    border = window[np.arange(len(likely)), best]
    # A maximum at the end of the window is no border, since a larger one may be beyond it.
    is_maximum = (best > 0) & (best < 2 * width)
    # At the reach it is one: a side that is off by more moves by the reach, and is looked for again.
    is_at_reach = (border == 0) | (border == len(inner) - 1)
    return np.where(is_maximum | is_at_reach, steps[inner[border]] + _STEP, np.nan)


def _best_line(gain: NDArray[np.float64]) -> NDArray[np.int_]:
    """Returns the straight line of the largest gain, its step at each point ``[A]``.

    `gain` is that of a border at each point and each inner step, ``[A, I]``.
    """
    points = np.arange(len(gain))
    share = (points + 0.5) / len(points)
    # Lines lead from every second place at one end of the side to every second place at the other
    # end: shape [E, E, A].
    ends = np.arange(0, gain.shape[1], 2)
    lines = np.rint(ends[:, None, None] * (1 - share) + ends[:, None] * share).astype(int)
    best = np.argmax(gain[points, lines].sum(axis=-1))
    first, last = np.unravel_index(int(best), lines.shape[:2])
    return lines[first, last]


def sharpest_border(image: NDArray[np.uint8], view: FloorView, sides: Sides) -> Border:
    """Returns where colours change most near the sides of a view.

    The change is the mean along a third of a side.
    """
    points, outwards, steps, contrasting = _contrasting_profiles(image, view, sides)
    part = (1, _FINE * _PART + 1)
    offsets = []
    for colours in contrasting:
        # The mean along the side is taken first, because no edge is seen at single points of a dark
        # floor.
        mean = cv2.blur(colours, part, borderType=cv2.BORDER_REPLICATE)[_FINE // 2 :: _FINE]
        offsets.append(_sharpest(mean, steps))
    return Border(points, outwards, np.array(offsets))


def shadow_width(image: NDArray[np.uint8], view: FloorView, sides: Sides, reach: float) -> float:
    """Returns how far outside of the sharpest edge the border by colours is.

    The distance is in tiles, and is the mean of all sides. A shadow under the tiles moves the
    border by colours outwards. NaN if no change of colours is the largest nearby.
    """
    _, _, steps, contrasting = _contrasting_profiles(image, view, sides)
    # One edge for all sides averages over the noise of single points.
    edge = _sharpest(contrasting.mean(axis=(0, 1))[None], steps)[0]
    offsets = colour_border(image, view, sides, reach).offsets
    seen = np.isfinite(offsets)
    return float(offsets[seen].mean() - edge) if seen.any() else np.nan


def _contrasting_profiles(
    image: NDArray[np.uint8], view: FloorView, sides: Sides
) -> tuple[Points, Points, NDArray[np.float64], NDArray[np.float64]]:
    """Returns the colours across the sides, by how rare they are on the floor.

    Returns points, directions, steps, and colours ``[S, F, T, 3]`` in standard deviations of the
    floor's colours.
    """
    # Inside, the steps end where the change at the reach still has all its steps.
    end = -_SHARP_REACH - (_CHANGE_STEPS + 1.5) * _STEP
    steps = np.arange(_SHARP_REACH + _RING, end, -_STEP)
    points, outwards, colours = _fine_profiles(image, view, sides, steps)
    for side in range(len(sides)):
        floor = colours[side][:, steps > _SHARP_REACH + _FLOOR_GAP].reshape(-1, 3)
        # After this product the floor's colours are uncorrelated and vary by about 1. A difference
        # then counts by how rare it is on the floor.
        covariance = np.cov(floor.T) + np.eye(3) * _GRAIN**2
        colours[side] = colours[side] @ np.linalg.cholesky(np.linalg.inv(covariance))
    return points, outwards, steps, colours


def _sharpest(colours: NDArray[np.float64], steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the offset outwards of the largest change in each row of colours ``[A, T, 3]``.

    The offset is NaN if the largest change is at the reach.
    """
    inner = np.flatnonzero(np.abs(steps - _STEP / 2) <= _SHARP_REACH)
    difference = colours[:, _CHANGE_STEPS:] - colours[:, :-_CHANGE_STEPS]
    # The three steps of the change between a step and the next one begin one step before it.
    change = np.pad(np.linalg.norm(difference, axis=2), ((0, 0), (1, _CHANGE_STEPS - 1)))
    best = inner[change[:, inner].argmax(axis=1)]
    index = np.arange(len(colours))
    left, here, right = (change[index, best + shift] for shift in (-1, 0, 1))
    # A parabola through three changes places the largest one between the steps.
    bow = np.maximum(2 * here - left - right, 1e-6)
    place = steps[best] - _STEP / 2 - np.clip((right - left) / (2 * bow), -1, 1) * _STEP
    return np.where((best > inner[0]) & (best < inner[-1]), place, np.nan)
