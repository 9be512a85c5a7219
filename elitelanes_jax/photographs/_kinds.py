"""Reads the kind and the direction of every tile of a floor.

They are those of the picture of a tile set that the tile's cell looks like.

Each cell is compared with all pictures of the set in all rotations, displaced by up to an eighth of
a tile, without the light: colours are relative to the ground around them. Then each cell is also
compared with those cells of the same floor whose kind is clear, because a lab's tiles look more
like each other than like those of another set. Neighbours agree about the side that they share.
This is a Markov random field on the grid; belief propagation (Pearl 1982) finds its best codes.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import CONNECTIONS, SIDES, rotate_codes
from elitelanes_jax.tiles.light import ground_of
from elitelanes_jax.tiles.rendering import scale_tiles
from elitelanes_jax.tiles.tileset import TileSet

READ_PX = 32
"""The side of a tile in pixels at which kinds are read."""

MARGIN_PX = READ_PX // 8
"""The margin in pixels around a floor, in which its tiles are looked for."""

# The correlation that counts for a cell without a tile: tiles of other sets have more.
_EMPTY = 0.42
# The correlation that a road which ends at a side costs; at the border half of it.
_DISAGREE = 0.25
# The least correlation of coloured lines with those of a cell's code.
_COLOURED = 0.25
# The least contrast inside a tile that is no crossing. Tiles have 0.7 or more, bare floors at most
# 0.15. A crossing may have none, but bare cells have correlations of at most 0.36 with crossings.
_CONTRAST = 0.25
# Within this margin the tape of the neighbours is not seen.
_INSIDE_PX = MARGIN_PX + READ_PX // 8
# The rounds of belief propagation. A message gets to the next cell in each.
_ROUNDS = 12
# A cell shows its kind to the others if its code has this correlation, better than others by this
# much. Photographs of turns that were misread as ends had at most 0.44.
_CLEAR, _CLEARER = 0.5, 0.05
# A code that is better by this much is believed whatever the neighbours are.
_PLAIN = 0.25
# The difference that is taken off a correlation with another cell. Photographs of a kind have 0.75
# to 1 with each other; crossings of three and four ways have up to 0.87, straights and ends 0.69,
# others 0.53.
_OWN_LESS = 0.15
# The most pictures of each code that cells are compared with.
_MOST_PICTURES = 3
# The weight of colour beside brightness: white lines are the largest but tell kinds apart least.
_CHROMA = 2.0


class Kinds(NamedTuple):
    """The kinds of a floor's cells.

    Attributes:
      codes: int8 ``[H, W]``, 0 for cells without a tile.
      margins: float ``[H, W]``, by how much the code is better than any other; 0 if a cell may have
        no tile.
      scores: float ``[H, W, 16]``, the correlation with each code's most similar picture; -1 if the
        set has none.
      handed: the mean over crossings of how much more alike they are to pictures than to mirrored
        pictures; 1 if no cell looks like a crossing.
    """

    codes: NDArray[np.int8]
    margins: NDArray[np.float64]
    scores: NDArray[np.float64]
    handed: float


def read_kinds(flat: NDArray[np.uint8], rows: int, columns: int, tiles: TileSet) -> Kinds:
    """Reads the codes of a floor.

    Args:
      flat: uint8, RGB, the floor from above, a tile `READ_PX` pixels wide, with a margin of
        `MARGIN_PX` around it.
      rows: the number of rows of tiles.
      columns: the number of columns of tiles.
      tiles: whose pictures the cells are compared with.
    """
    scores = _correlate(flat, rows, columns, tiles)
    if rows * columns == 1:
        # There is nothing to compare a single tile with.
        compared = beliefs = scores
    else:
        compared = _compare_cells(flat, scores)
        beliefs = _agree(compared)
    codes, margins = _best(beliefs)
    # Roads that lead to a missing tile make a tile of it. Only what the cell shows can tell.
    is_gone = _shows_no_tile(flat, compared) & (codes > 0)
    if is_gone.any():
        compared = np.where(is_gone[..., None], 0.0, compared)
        codes, margins = _best(_agree(compared))
    # A tile that is laid wrongly fits none of its neighbours.
    alone, lead = _best(compared)
    is_plain = (lead >= _PLAIN) & (alone > 0)
    margins = np.where(is_plain & (codes != alone), 0, margins)
    codes = np.where(is_plain, alone, codes)
    margins = np.where(is_plain, np.maximum(lead, margins), margins)
    bare = is_gone | _lacks_colour(flat, codes, tiles)
    codes, margins = np.where(bare, 0, codes), np.where(bare, 0.0, margins)
    return Kinds(codes.astype(np.int8), margins, scores, _handed(flat, scores, tiles))


def _best(scores: NDArray[np.float64]) -> tuple[NDArray[np.int_], NDArray[np.float64]]:
    """Returns the best code of each cell ``[H, W]``, and its lead.

    The lead is by how much the code is better than any other.
    """
    second, first = np.moveaxis(np.sort(scores, axis=-1)[..., -2:], -1, 0)
    return scores.argmax(axis=-1), first - second


def _correlate(
    flat: NDArray[np.uint8], rows: int, columns: int, tiles: TileSet
) -> NDArray[np.float64]:
    templates = _templates(tiles)
    floor = _without_light(flat)
    scores = np.full((rows, columns, 16), -1.0)
    # Cells of a floor may have no tile, but a single tile is there.
    if rows * columns > 1:
        scores[..., 0] = _EMPTY
    for row, column in np.ndindex(rows, columns):
        cell = _cell(floor, row, column)
        for code, template in templates:
            alike = _most_alike(cell, template)
            scores[row, column, code] = max(scores[row, column, code], alike)
    return scores


def _compare_cells(flat: NDArray[np.uint8], scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns scores ``[H, W, 16]`` that also compare cells with each other.

    A score counts the cell's correlation with the cells whose kind is clear.
    """
    floor, compared = _without_light(flat), scores.copy()
    rows, columns = scores.shape[:2]
    codes, lead = _best(scores)
    is_clear = (codes > 0) & (scores.max(axis=-1) >= _CLEAR) & (lead >= _CLEARER)
    places = list(np.ndindex(rows, columns))
    for row, column in np.argwhere(is_clear).tolist():
        top, left = row * READ_PX + MARGIN_PX, column * READ_PX + MARGIN_PX
        picture = floor[top : top + READ_PX, left : left + READ_PX]
        shown: dict[int, NDArray[np.float32]] = {}
        for turns in range(4):
            code = int(rotate_codes(int(codes[row, column]), turns))
            shown.setdefault(code, np.ascontiguousarray(np.rot90(picture, turns)))
        for code, template in shown.items():
            for place in places:
                if place != (row, column):
                    alike = _most_alike(_cell(floor, *place), template) - _OWN_LESS
                    compared[*place, code] = max(compared[*place, code], alike)
    return compared


def _cell(floor: NDArray[np.float32], row: int, column: int) -> NDArray[np.float32]:
    """Returns a cell of a floor with the margin around it."""
    side = READ_PX + 2 * MARGIN_PX
    top, left = row * READ_PX, column * READ_PX
    return floor[top : top + side, left : left + side]


def _most_alike(cell: NDArray[np.float32], template: NDArray[np.float32]) -> float:
    """Returns the largest correlation of a template with a part of a cell."""
    return float(cv2.matchTemplate(cell, template, cv2.TM_CCOEFF_NORMED).max())


def _templates(tiles: TileSet) -> list[tuple[int, NDArray[np.float32]]]:
    """Returns codes and pictures without light."""
    pictures = scale_tiles(tiles, READ_PX)["image"]
    return [
        (code, _without_light(pictures[4 * drawn.tile + drawn.quarter_turns]))
        for code, draws in tiles.rotations.items()
        for drawn in draws[:: -(-len(draws) // _MOST_PICTURES)]
        if code
    ]


def _handed(flat: NDArray[np.uint8], scores: NDArray[np.float64], tiles: TileSet) -> float:
    """Returns by how much crossings look less like mirrored crossings.

    The stop lines of mirrored crossings are on the left lane.
    """
    floor = _without_light(flat)
    mirrored = [
        np.ascontiguousarray(template[:, ::-1])
        for code, template in _templates(tiles)
        if CONNECTIONS[code] >= 3
    ]
    is_crossing = CONNECTIONS >= 3
    differences = []
    for row, column in np.ndindex(*scores.shape[:2]):
        cell = _cell(floor, row, column)
        right = scores[row, column, is_crossing].max()
        wrong = max((_most_alike(cell, template) for template in mirrored), default=-1.0)
        # Only cells that are clearly crossings count, mirrored or not.
        if max(right, wrong) > max(_CLEAR, scores[row, column, ~is_crossing].max()):
            differences.append(right - wrong)
    return float(np.mean(differences)) if differences else 1.0


def _lacks_colour(
    flat: NDArray[np.uint8], codes: NDArray[np.int_], tiles: TileSet
) -> NDArray[np.bool_]:
    """Finds cells ``[H, W]`` without the coloured lines of their code, where most cells have them.

    The edges of a bright floor in cells without a tile look like white lines, but nothing in such a
    cell is coloured.
    """
    pictures, floor = scale_tiles(tiles, READ_PX)["image"], _without_light(flat)[..., 1:]
    alike = np.ones(codes.shape)
    # Neighbours of a cell without a tile may ask for a dead end there, which few sets have.
    has_picture = (codes > 0) & np.isin(codes, list(tiles.rotations))
    for row, column in np.argwhere(has_picture).tolist():
        cell = _cell(floor, row, column)
        correlations = []
        for drawn in tiles.rotations[int(codes[row, column])][:_MOST_PICTURES]:
            template = _without_light(pictures[4 * drawn.tile + drawn.quarter_turns])[..., 1:]
            for channel in range(2):
                part = np.ascontiguousarray(cell[..., channel])
                lines = np.ascontiguousarray(template[..., channel])
                correlations.append(_most_alike(part, lines))
        alike[row, column] = max(correlations)
    if codes.size == 1 or np.median(alike[has_picture] if has_picture.any() else 0) < 2 * _COLOURED:
        return np.zeros(codes.shape, np.bool_)
    return np.asarray(alike < _COLOURED, np.bool_)


def _shows_no_tile(flat: NDArray[np.uint8], scores: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Finds the cells ``[H, W]`` of a floor that show no tile.

    These have no lines inside, and do not look like a crossing.
    """
    floor = _without_light(flat)
    contrasts = np.zeros(scores.shape[:2])
    for row, column in np.ndindex(*contrasts.shape):
        cell = _cell(floor, row, column)
        inside = cell[_INSIDE_PX:-_INSIDE_PX, _INSIDE_PX:-_INSIDE_PX].reshape(-1, 3)
        # Lines are the brightest part of a cell, and the ground is its median.
        bright, middle = np.percentile(inside, (96, 50), axis=0)
        contrasts[row, column] = (bright - middle).max()
    crossing = scores[..., CONNECTIONS >= 3].max(axis=-1)
    is_bare = (contrasts < _CONTRAST) & (crossing < _EMPTY)
    return np.asarray(is_bare & (contrasts.size > 1), np.bool_)


def _without_light(flat: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Returns how bright, red and yellow each pixel is beside the ground around it.

    The result is float32 ``[H, W, 3]``.
    """
    relative = (flat.astype(np.float32) + 4) / ground_of(flat, READ_PX)[..., None]
    red, green, blue = np.moveaxis(relative, -1, 0)
    bright = np.clip(np.maximum(np.maximum(red, green), blue), 0, 3)
    # Red exceeds both other channels in red tape. Red and green exceed blue in yellow tape.
    parts = [
        bright,
        _CHROMA * np.clip(red - np.maximum(green, blue), 0, 2),
        _CHROMA * np.clip(np.minimum(red, green) - blue, 0, 2),
    ]
    return np.asarray(cv2.GaussianBlur(np.stack(parts, axis=-1), (0, 0), 1), np.float32)


def _agree(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the score of the best floor with each code in each cell, ``[H, W, 16]``.

    Max-sum messages between neighbours compute it.
    """
    rows, columns = scores.shape[:2]
    codes = np.arange(16)
    # The messages to each cell, from its neighbour on each side.
    messages = np.zeros((4, rows, columns, 16))
    outside = [-_DISAGREE / 2 * ((codes & side.bit) > 0) for side in SIDES]
    for _ in range(_ROUNDS):
        total = scores + messages.sum(axis=0)
        sent = np.empty_like(messages)
        for index, side in enumerate(SIDES):
            back = (index + 2) % 4
            # A cell sends its neighbour its best score for an open and for a closed side, without
            # what it has from this neighbour.
            belief = total - messages[index]
            is_open = (codes & side.bit) > 0
            opened = belief[..., is_open].max(axis=-1)
            closed = belief[..., ~is_open].max(axis=-1)
            # A road that ends at a side costs the same, whichever of the two cells it is in.
            if_open = np.maximum(opened, closed - _DISAGREE)
            if_closed = np.maximum(closed, opened - _DISAGREE)
            # Only differences between codes count. Therefore the best message is 0.
            best = np.maximum(if_open, if_closed)
            faces = (codes & side.opposite) > 0
            message = np.where(faces, (if_open - best)[..., None], (if_closed - best)[..., None])
            # The message goes to the neighbour on this side. Cells at the border get what the
            # outside sends instead.
            moved = np.roll(message, (side.down, side.right), (0, 1))
            edge = [slice(None), slice(None)]
            edge[0 if side.down else 1] = (
                slice(0, 1) if side.down + side.right > 0 else slice(-1, None)
            )
            moved[tuple(edge)] = outside[back]
            sent[back] = moved
        messages = sent
    return scores + messages.sum(axis=0)
