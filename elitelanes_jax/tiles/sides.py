"""Measures where the road and its lines are at the sides of a tile."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import CONNECTIONS, SIDES
from elitelanes_jax.tiles.files import Tile
from elitelanes_jax.tiles.light import even_light

SEPARATOR_DEPTH = 1 / 5
"""The depth of the strip along a side, in tiles, in which a separator begins."""

# The depth of a separator that is measured, in tiles: on a turn it leaves the middle further
# inside.
_DASH_DEPTH = 1 / 24
# The least brightness of white tape in even light.
_WHITE_LEVEL = 130
# The largest distance between the road's edge and the white line, in tiles.
_MAX_LINE_GAP = 0.04
# The lanes' offsets that a set may have, in tiles, and the largest standard deviation of its sides.
# Measured sets have 0.18 to 0.22, and at most 0.007.
_PLAUSIBLE, _LARGEST_SPREAD = (0.14, 0.28), 0.015
# The least number of sides that tell the offset.
_LEAST_SIDES = 2


class SideLines(NamedTuple):
    """The road at one side of a tile.

    Lengths are in tiles from the side's left end, as seen from inside the tile.

    Attributes:
      side: N, E, S or W.
      road: the beginning and the end of the road.
      separator: the middle of the lane separator; None if there is none.
      white: the middles of the white lines to the left and right of the road; None where there is
        none.
      lane: tiles from the road's middle to the middle of a lane, the mean of both lanes.
    """

    side: str
    road: tuple[float, float]
    separator: float | None
    white: tuple[float | None, float | None]
    lane: float


class Lanes(NamedTuple):
    """Where the lanes of a tile set run.

    Attributes:
      offset: tiles from the road's middle to the middle of a lane, the mean of the measured sides.
      spread: the standard deviation of the sides.
      sides: the number of measured sides.
    """

    offset: float
    spread: float
    sides: int

    @property
    def is_trusted(self) -> bool:
        """Whether the sides agree on an offset that a road can have."""
        low, high = _PLAUSIBLE
        is_plausible = low <= self.offset <= high and self.spread <= _LARGEST_SPREAD
        return is_plausible and self.sides >= _LEAST_SIDES

    def __str__(self) -> str:
        return (
            f"lanes run {self.offset:.3f} tiles beside the road's middle, "
            f"with a standard deviation of {self.spread:.3f} over {self.sides} sides"
        )


def measure_sides(tile: Tile) -> list[SideLines]:
    """Measures the lines at each side that a tile opens and its road reaches."""
    bright = even_light(tile.image).min(axis=2) > _WHITE_LEVEL
    measured = []
    for turns, side in enumerate(SIDES):
        if tile.code & side.bit:
            layers = [np.rot90(layer, turns) for layer in (tile.road, tile.yellow, bright)]
            if layers[0][0].any():
                measured.append(_measure(side.letter, *layers))
    return measured


def measure_lanes(tiles: Iterable[Tile]) -> Lanes:
    """Measures where the lanes of a tile set run. Without a measured side, the offset is NaN."""
    with_separator, without = list[float](), list[float]()
    for tile in tiles:
        for side in measure_sides(tile):
            # Half the width of a separator is part of the offset. Crossings have no separators.
            # Therefore they do not tell the offset.
            if side.separator is not None:
                with_separator.append(side.lane)
            elif CONNECTIONS[tile.code] < 3:
                without.append(side.lane)
    lanes = with_separator or without or [np.nan]
    return Lanes(float(np.mean(lanes)), float(np.std(lanes)), len(with_separator or without))


def describe_lanes(tiles: Sequence[Tile], lane_offset: float) -> str:
    """Returns a table of the lines at each open side.

    The last line compares the mean place of the lanes with `lane_offset`.
    """
    rows = [
        "in tiles from the left end of each side, seen from inside: road, separator, white lines; "
        "lanes' offset"
    ]
    for tile in tiles:
        for side in measure_sides(tile):
            left, right = (_text(place) for place in side.white)
            rows.append(
                f"  {tile.name:12} {side.side}  {side.road[0]:.3f} to {side.road[1]:.3f}, "
                f"{_text(side.separator)}, "
                f"{left} and {right}; {side.lane:.3f}"
            )
    return "\n".join([*rows, f"{measure_lanes(tiles)}; lane_offset is {lane_offset:g}"])


def _text(place: float | None) -> str:
    return "none" if place is None else f"{place:.3f}"


def _measure(
    letter: str, road: NDArray[np.bool_], yellow: NDArray[np.bool_], bright: NDArray[np.bool_]
) -> SideLines:
    size = len(road)
    columns = np.flatnonzero(road[0])
    start, end = float(columns[0]) / size, float(columns[-1] + 1) / size
    half = 0.0
    rows = np.flatnonzero(yellow[: round(SEPARATOR_DEPTH * size)].any(axis=1))
    separator = None
    if len(rows):
        dash = np.flatnonzero(
            yellow[rows[0] : rows[0] + max(1, round(_DASH_DEPTH * size))].any(axis=0)
        )
        separator = float(dash[0] + dash[-1] + 1) / 2 / size
        # The first rows of a dash are narrower. Its width does not change on a turn, so all rows
        # count.
        half = float(np.median(yellow[rows].sum(axis=1))) / 2 / size
    # White lines are measured in the outermost 1/64 of the tile.
    first = np.asarray(bright[: max(1, size // 64)].any(axis=0), np.bool_)
    gaps = (
        _white_line(first[: columns[0]][::-1], size),
        _white_line(first[columns[-1] + 1 :], size),
    )
    places = (
        None if gaps[0] is None else start - gaps[0],
        None if gaps[1] is None else end + gaps[1],
    )
    # A lane reaches from the edge of the separator to the edge of the road.
    return SideLines(letter, (start, end), separator, places, ((end - start) / 2 + half) / 2)


def _white_line(beside: NDArray[np.bool_], size: int) -> float | None:
    """Returns how far from the road's edge the middle of a white line next to it is.

    The distance is in tiles. Returns None without a white line.
    """
    # The line begins at the first white pixel and ends before the next dark one.
    near = np.flatnonzero(beside[: max(1, round(_MAX_LINE_GAP * size))])
    if not len(near):
        return None
    after = np.flatnonzero(~beside[near[0] :])
    end = near[0] + after[0] if len(after) else len(beside)
    return float(near[0] + end) / 2 / size
