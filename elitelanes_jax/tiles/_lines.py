"""Checks the roads and lines in the masks of a tile set.

They must agree with each other and with the pictures.

Lengths are parts of a tile's side. The limits leave room: of 18 tiles, drawn and photographed, the
nearest ones have stop lines on 11 % and separators on 3.1 % of a tile, all on the road and all
distinct in the picture; middles 2.2 % off; stop lines across 92 % of a lane.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import CONNECTIONS, EAST, SIDES, WEST, Side, exchange_sides
from elitelanes_jax.tiles.files import Tile
from elitelanes_jax.tiles.sides import SEPARATOR_DEPTH
from elitelanes_jax.tiles.strips import TAPE, find_strips

# The largest part of a tile's area that stop lines, red, and lane separators, yellow, cover.
_LARGEST_AREA = {"red": 0.25, "yellow": 0.15}
# The least part of a line's area on the road.
_ON_ROAD = 0.95
# The largest displacement of the road's middle and of a stop line's beginning, in tiles.
_OFF = 0.04
# The largest distance from the road's middle, in tiles, of a separator and of a stop line's end on
# the outgoing lane. People tape them up to 0.05 beside it.
_BESIDE_MIDDLE = 0.06
# The least part of a line's area that differs more from the road's colour than 95 % of the road.
_DISTINCT = 0.7
# The depth of the strip along a side, in tiles, that has its stop line, and where a separator's
# middle is measured.
_LINE_STRIP_DEPTH = 1 / 8
# The least part of the incoming lane's width that its stop line covers.
_COVERED = 0.75
# The least depth of a neighbour's tape, and the least part of a side that it is along, in tiles. One
# of four photographs has a white line of 0.0025 along a side that its road leaves by.
_STRIP_DEPTH, _STRIP_LENGTH = 0.005, 0.04
# The half width of the strip around a road's middle in which its separator is, in tiles.
_SEPARATOR_ZONE = 0.08
_NAMES = {"red": "stop lines", "yellow": "lane separators"}


class _Road(NamedTuple):
    """The road across a side, seen from inside with the side at the top.

    Attributes:
      middle: the middle of the road, in pixels from the left end of the side.
      width: the width of the road in pixels.
    """

    middle: float
    width: int


def misplaced_lines(tiles: Sequence[Tile]) -> list[tuple[str, str, str]]:
    """Returns the errors in the masks of a set: tile, mask, and what was expected and came.

    Roads lead from side to side, through the middle of each. Lines are on the road. Separators are
    in its middle; a set may have none, but not on some of its turns, straights and ends alone. Stop
    lines are across the incoming, right-hand lane at each open side of a crossing. The tiles' roads
    must reach the sides that they open, and no other.
    """
    separated = any(tile.yellow.any() for tile in tiles)
    errors = []
    for tile in tiles:
        faults = list(_faults(tile, separated))
        # If the mirror image of a crossing has no faults, all its faults have one cause, and one
        # message says so.
        if faults and CONNECTIONS[tile.code] > 2 and not list(_faults(_mirrored(tile), separated)):
            faults = [
                (
                    "image",
                    "expected a picture that is not mirrored, of traffic that keeps right, "
                    "got stop lines on the outgoing lanes",
                )
            ]
        errors += [(tile.name, *fault) for fault in faults]
    return errors


def _mirrored(tile: Tile) -> Tile:
    return tile._replace(
        code=int(exchange_sides(tile.code, EAST, WEST)),
        image=np.fliplr(tile.image),
        road=np.fliplr(tile.road),
        red=np.fliplr(tile.red),
        yellow=np.fliplr(tile.yellow),
        opaque=None if tile.opaque is None else np.fliplr(tile.opaque),
    )


def _faults(tile: Tile, separated: bool) -> Iterator[tuple[str, str]]:
    opened = [side for side in SIDES if tile.code & side.bit]
    yield from _road_faults(tile, opened)
    yield from (("image", fault) for fault in _strip_faults(tile))
    # The places of lines are checked only if the lines are on the road and not too large.
    sound = {}
    for name, most in _LARGEST_AREA.items():
        line: NDArray[np.bool_] = getattr(tile, name)
        share, on_road = line.mean(), (line & tile.road).sum() / max(line.sum(), 1)
        sound[name] = share <= most and (not share or on_road >= _ON_ROAD)
        if share > most:
            yield (
                name,
                f"expected {_NAMES[name]} on {most:.0%} of the tile at most, "
                f"got them on {share:.0%}",
            )
        elif not sound[name]:
            yield (
                name,
                f"expected {_NAMES[name]} on the road, got {on_road:.0%} of their area on it",
            )
        elif share and (distinct := _distinct(tile, line)) < _DISTINCT:
            yield (
                name,
                f"expected {_NAMES[name]} in other colours than the road, "
                f"got {distinct:.0%} of their area",
            )
    for side in opened:
        # The masks are turned until the side is at the top.
        road, red, yellow = (
            np.rot90(mask, SIDES.index(side)) for mask in (tile.road, tile.red, tile.yellow)
        )
        across = _across(road)
        crosses = CONNECTIONS[tile.code] > 2
        if sound["yellow"]:
            for fault in _separator_faults(yellow, across, required=separated and not crosses):
                yield "yellow", f"{fault} at the side {side.letter}"
        if sound["red"] and crosses:
            for fault in _stop_line_faults(red, across):
                yield "red", f"{fault} at the side {side.letter}"


def _strip_faults(tile: Tile) -> Iterator[str]:
    """Checks that a picture shows no tape of a neighbour."""
    size = len(tile.image)
    middle = np.abs((np.arange(size) + 0.5) / size - 0.5) < _SEPARATOR_ZONE
    for strip in find_strips(tile.image, tile.code, TAPE):
        is_open = bool(tile.code & strip.side.bit)
        seen = strip.depths >= max(2, round(_STRIP_DEPTH * size))
        if strip.colour == "yellow" and is_open and CONNECTIONS[tile.code] < 3:
            # A dash of the tile itself may end near the border.
            seen &= ~middle
        if seen.mean() >= _STRIP_LENGTH:
            yield (
                f"expected no {strip.colour} tape of a neighbour at the side {strip.side.letter}, "
                f"got a strip along {seen.mean():.0%} of it"
            )


def _road_faults(tile: Tile, opened: Sequence[Side]) -> Iterator[tuple[str, str]]:
    _, pieces = cv2.connectedComponents(tile.road.astype(np.uint8))
    reached = []
    for side in opened:
        row = np.rot90(pieces, SIDES.index(side))[0]
        # Sides that one piece of road joins have its label in common.
        reached.append(set(row[row > 0].tolist()))
        off = _across(np.rot90(tile.road, SIDES.index(side))).middle / len(row) - 0.5
        if abs(off) > _OFF:
            yield (
                "road",
                f"expected the road's middle in the middle of the side {side.letter}, "
                f"got it {abs(off):.0%} beside it",
            )
    if not set.intersection(*reached):
        yield "road", "expected one road that joins all sides that the tile opens, got pieces"


def _distinct(tile: Tile, line: NDArray[np.bool_]) -> float:
    """Returns the part of a line's area where the picture differs from the road."""
    bare = tile.image[tile.road & ~tile.red & ~tile.yellow]
    if not len(bare):
        return 1.0
    # At most 10,000 pixels tell the road's colour and how much it varies.
    some = bare[:: len(bare) // 10_000 + 1].astype(np.int16)
    ground = np.median(some, axis=0).astype(np.int16)
    away = np.abs(tile.image[line] - ground).max(axis=-1)
    return float((away > np.quantile(np.abs(some - ground).max(axis=-1), 0.95)).mean())


def _across(road: NDArray[np.bool_]) -> _Road:
    columns = np.flatnonzero(road[0])
    return _Road(columns.mean() + 0.5, len(columns))


def _separator_faults(yellow: NDArray[np.bool_], road: _Road, *, required: bool) -> Iterator[str]:
    size = len(yellow)
    if required and not yellow[: round(SEPARATOR_DEPTH * size)].any():
        yield "expected a lane separator that begins"
    columns = np.nonzero(yellow[: round(_LINE_STRIP_DEPTH * size)])[1]
    off = abs(columns.mean() + 0.5 - road.middle) / size if len(columns) else 0
    if off > _BESIDE_MIDDLE:
        yield (
            f"expected lane separators in the road's middle, got one {off:.0%} of a tile beside it"
        )


def _stop_line_faults(red: NDArray[np.bool_], road: _Road) -> Iterator[str]:
    """Checks the incoming lane and the outgoing lane of a side for stop lines.

    Seen from inside, the incoming lane is the left half of the side. The end of the outgoing lane
    does not count. The line of the next side begins at that end.
    """
    size = len(red)
    start, middle = round(road.middle - road.width / 2), round(road.middle)
    strip = red[: round(_LINE_STRIP_DEPTH * size)]
    lines = np.asarray(strip.any(axis=0))
    covered = lines[start:middle].mean() if middle > start else 0.0
    if covered < _COVERED:
        yield (
            "expected a stop line across the incoming, right-hand lane, "
            f"got one on {covered:.0%} of it"
        )
    elif not strip[: round(_OFF * size), start:middle].any():
        yield "expected a stop line that begins"
    over = lines[middle + round(_BESIDE_MIDDLE * size) : round(road.middle + road.width / 4)]
    if over.any():
        yield f"expected no stop line on the outgoing lane, got one on {over.mean():.0%} of it"
