"""Measures where the border of a floor is, by edges of colours at single points of its sides."""

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from elitelanes_jax.photographs._borders import Border, Sides, profiles
from elitelanes_jax.photographs._views import FloorView

Field = NDArray[np.float32]

# The width around the floor, in tiles, that the border's colours are read from.
_MARGIN = 0.4
# The least change of colour at an edge, as a multiple of that in the floor's texture.
_CLEAR = 4.0
# The width of the ring outside of the search, in tiles, in which the floor's colour is measured.
# Light differs further away.
_RING = 0.16
# The distance from the floor's colour, in standard deviations, above which a colour is another one.
_AWAY = 4.0
# The distance between two places across the border, in tiles.
_STEP = 1 / 160


def edge_border(image: NDArray[np.uint8], view: FloorView, sides: Sides, reach: float) -> Border:
    """Returns where the border of sides is seen, within a reach of where a view has it."""
    # The steps go from outside to inside.
    steps = np.arange(_MARGIN, -reach - 0.06, -_STEP)
    points, outwards, colours = profiles(image, view, sides, steps, 1, 1 / _STEP)
    rows = cv2.cvtColor(colours.reshape(-1, len(steps), 3), cv2.COLOR_RGB2LAB)
    lab = rows.reshape(colours.shape).astype(np.float32)
    return Border(points, outwards, _first_edges(lab, steps, reach))


def _first_edges(colours: Field, steps: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Returns how far outside the border is at each point ``[S, A]``.

    The distance is in tiles, or NaN where no border is seen. Going inwards, the border is the first
    strong edge where the colour stops to be the ground's for a while.

    Args:
      colours: Lab ``[S, A, T, 3]``, from outside to inside.
      steps: the distance outside of each of the T places.
      reach: the reach of the search in tiles, outside and inside.
    """
    # The colours are averaged over three places across the border.
    blurred = cv2.blur(colours.reshape(-1, *colours.shape[2:]), (3, 1))
    colours = np.asarray(blurred, np.float32).reshape(colours.shape)
    nearest = max(reach, 0.08) + 0.02
    in_ring = (steps > nearest) & (steps < nearest + _RING)
    ring = colours[:, :, in_ring]
    near = sliding_window_view(
        np.pad(ring, ((0, 0), (2, 2), (0, 0), (0, 0)), mode="edge"), 5, axis=1
    )
    # These are the colours of five neighbouring points.
    near = near.swapaxes(3, 4).reshape(*ring.shape[:2], -1, 3)
    ground = np.median(near, axis=2, keepdims=True)
    noise = np.maximum(1.48 * np.median(np.abs(near - ground), axis=2, keepdims=True), 2.0)
    away = np.sqrt((((colours - ground) / noise) ** 2).sum(axis=-1))
    inner = np.flatnonzero((steps <= reach) & (steps >= -reach - 0.05))
    length = max(2, round(0.03 / _STEP))
    # The tile begins where most colours within 0.03 tiles are another one than the floor's.
    lasting = sliding_window_view(away[..., inner] > _AWAY, length, axis=2).mean(axis=-1) > 0.85
    first = inner[0] + np.argmax(lasting, axis=2)
    seen = lasting.any(axis=2) & (first > inner[0])
    # The strength of an edge is the change of colour from the place before to the one after.
    edge = np.linalg.norm(colours[:, :, 2:] - colours[:, :, :-2], axis=-1)
    edge = np.pad(edge, ((0, 0), (0, 0), (1, 1)))
    window = np.clip(first[..., None] + np.arange(-3, length + 1), 1, len(steps) - 2)
    strength = np.take_along_axis(edge, window, 2)
    # The border is at a peak of the strength near this beginning.
    peak = (strength >= np.take_along_axis(edge, window - 1, 2)) & (
        strength >= np.take_along_axis(edge, window + 1, 2)
    )
    # Behind a narrow strip of asphalt, white tape is a stronger edge than the border. It alone is
    # brighter inside.
    rise = np.pad(colours[:, :, 2:, 0] - colours[:, :, :-2, 0], ((0, 0), (0, 0), (1, 1)))
    darkens = np.where(np.take_along_axis(rise, window, 2) < 0.5 * strength, strength, 0).max(
        axis=2, keepdims=True
    )
    texture = np.median(edge[:, :, in_ring], axis=2, keepdims=True)
    largest = strength.max(axis=2, keepdims=True)
    is_clear = darkens >= np.maximum(_CLEAR * texture, 0.15 * largest)
    # A peak has at least half the strength of the strongest edge that darkens. If that does not
    # stand out from the floor's texture, the strongest edge of all counts instead.
    peak &= strength >= 0.5 * np.where(is_clear, darkens, largest)
    # The first strong peak counts. A parabola through three strengths places it between the steps.
    at = np.take_along_axis(window, np.argmax(peak, axis=2)[..., None], 2)
    left, here, right = (np.take_along_axis(edge, at + shift, 2)[..., 0] for shift in (-1, 0, 1))
    bow = np.maximum(2 * here - left - right, 1e-3)
    place = steps[at[..., 0]] - np.clip((right - left) / (2 * bow), -1, 1) * _STEP
    return np.where(seen & peak.any(axis=2), place, np.nan)
