"""Reads the kind and the direction of every tile of a floor.

They are those of the picture of a tile set that the tile's cell looks like.

Each cell is compared with all pictures of the set in all rotations, displaced by up to an eighth of
a tile, without the light: colours are relative to the ground around them. Then each cell is also
compared with those cells of the same floor whose kind is clear, because a lab's tiles look more
like each other than like those of another set. Neighbours agree about the side that they share.
This is a Markov random field on the grid; belief propagation (Pearl 1982) finds its best codes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import CONNECTIONS, SIDES, rotate_codes
from elitelanes_jax.photographs._cells import Cells, Picture, pictures_of
from elitelanes_jax.tiles.tileset import TileSet

# The correlation that counts for a cell without a tile: tiles of other sets have more.
_EMPTY = 0.42
# The correlation that a road which ends at a side costs; at the border half of it.
_DISAGREE = 0.25
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


class Kinds(NamedTuple):
    """The kinds of a floor's cells.

    Attributes:
      codes: int8 ``[H, W]``, 0 for cells without a tile.
      margins: float ``[H, W]``, by how much the code is better than any other.
      scores: float ``[H, W, 16]``, the correlation with each code's most similar picture; -1 if the
        set has none.
      handed: the mean over crossings of how much more alike they are to pictures than to mirrored
        pictures; 1 if no cell looks like a crossing.
    """

    codes: NDArray[np.int8]
    margins: NDArray[np.float64]
    scores: NDArray[np.float64]
    handed: float


def read_kinds(cells: Cells, tiles: TileSet) -> Kinds:
    """Reads the codes of a floor's cells by the pictures of a tile set."""
    pictures = pictures_of(tiles)
    scores = _score(cells, pictures)
    if cells.shape == (1, 1):
        # There is nothing to compare a single tile with.
        compared = beliefs = scores
    else:
        compared = _compare_cells(cells, scores)
        beliefs = _agree(compared)
    codes, margins = _best(beliefs)
    alone, lead = _best(compared)
    # A tile that is laid wrongly fits none of its neighbours. What it plainly shows is believed.
    is_plain = (lead >= _PLAIN) & (alone > 0)
    margins = np.where(is_plain, np.where(codes == alone, np.maximum(lead, margins), lead), margins)
    codes = np.where(is_plain, alone, codes)
    # Roads that lead to a missing tile make a tile of it, which the cell itself does not show.
    is_gone = (alone == 0) & (codes > 0)
    margins = np.where(is_gone, 0.0, margins)
    codes = np.where(is_gone & (lead >= _PLAIN), 0, codes)
    return Kinds(codes.astype(np.int8), margins, scores, _handed(cells, scores, pictures))


def _best(scores: NDArray[np.float64]) -> tuple[NDArray[np.int_], NDArray[np.float64]]:
    """Returns the best code of each cell ``[H, W]``, and its lead.

    The lead is by how much the code is better than any other.
    """
    second, first = np.moveaxis(np.sort(scores, axis=-1)[..., -2:], -1, 0)
    return scores.argmax(axis=-1), first - second


def _score(cells: Cells, pictures: list[tuple[int, Picture]]) -> NDArray[np.float64]:
    """Returns how alike each cell is to the pictures of each code, ``[H, W, 16]``."""
    scores = np.full((*cells.shape, 16), -1.0)
    # Cells of a floor may have no tile, but a single tile is there.
    if cells.shape != (1, 1):
        scores[..., 0] = _EMPTY
    for place in cells.places:
        for code, picture in pictures:
            scores[*place, code] = max(scores[*place, code], cells.likeness(place, picture))
    return scores


def _compare_cells(cells: Cells, scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns scores ``[H, W, 16]`` that also compare cells with each other.

    A score counts the cell's correlation with the cells whose kind is clear.
    """
    compared = scores.copy()
    codes, lead = _best(scores)
    is_clear = (codes > 0) & (scores.max(axis=-1) >= _CLEAR) & (lead >= _CLEARER)
    for clear in [place for place in cells.places if is_clear[place]]:
        picture = cells.picture(clear)
        shown: dict[int, Picture] = {}
        for turns in range(4):
            code = int(rotate_codes(int(codes[clear]), turns))
            shown.setdefault(code, np.ascontiguousarray(np.rot90(picture, turns)))
        for code, turned in shown.items():
            for place in cells.places:
                if place != clear:
                    alike = cells.likeness(place, turned) - _OWN_LESS
                    compared[*place, code] = max(compared[*place, code], alike)
    return compared


def _handed(
    cells: Cells, scores: NDArray[np.float64], pictures: list[tuple[int, Picture]]
) -> float:
    """Returns by how much crossings look less like mirrored crossings.

    The stop lines of mirrored crossings are on the left lane.
    """
    mirrored = [
        np.ascontiguousarray(picture[:, ::-1])
        for code, picture in pictures
        if CONNECTIONS[code] >= 3
    ]
    is_crossing = CONNECTIONS >= 3
    differences = []
    for place in cells.places:
        right = scores[*place, is_crossing].max()
        wrong = max((cells.likeness(place, picture) for picture in mirrored), default=-1.0)
        # Only cells that are clearly crossings count, mirrored or not.
        if max(right, wrong) > max(_CLEAR, scores[*place, ~is_crossing].max()):
            differences.append(right - wrong)
    return float(np.mean(differences)) if differences else 1.0


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
