"""Reads the kind and the direction of every tile of a floor.

A cell has the kind and the direction of the picture of a tile set that it looks like.

Each cell is compared with all pictures of the set in all rotations, displaced by up to an eighth of
a tile, without the light: colours are relative to the ground around them. Then each cell is also
compared with the cells of the same floor whose kind is clear. A lab's tiles look more like each
other than like the tiles of another set. Neighbours agree about the side that they share. This is a
Markov random field on the grid; belief propagation (Pearl 1982) finds its best codes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import CONNECTIONS, SIDES, rotate_codes
from elitelanes_jax.photographs._cells import Cells, CodedPicture, pictures_of
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

    def alike(self, codes: NDArray[np.int8]) -> NDArray[np.float64]:
        """Returns the correlation of each cell with its code of ``[H, W]``."""
        return np.take_along_axis(self.scores, codes[..., None].astype(int), -1)[..., 0]


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


def _score(cells: Cells, pictures: Sequence[CodedPicture]) -> NDArray[np.float64]:
    """Returns how alike each cell is to the pictures of each code, ``[H, W, 16]``."""
    scores = np.full((*cells.shape, 16), -1.0)
    # Cells of a floor may have no tile, but a single tile is there.
    if cells.shape != (1, 1):
        scores[..., 0] = _EMPTY
    alike = cells.likeness([picture for _, picture in pictures])
    return _with_best(scores, pictures, alike)


def _with_best(
    scores: NDArray[np.float64], pictures: Sequence[CodedPicture], alike: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns the larger of each score and of how alike the cell is to P pictures of its code."""
    best = scores.copy()
    for index, (code, _) in enumerate(pictures):
        best[..., code] = np.maximum(best[..., code], alike[..., index])
    return best


def _compare_cells(cells: Cells, scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns scores ``[H, W, 16]`` that also compare cells with each other.

    A score counts the cell's correlation with the cells whose kind is clear.
    """
    codes, lead = _best(scores)
    is_clear = (codes > 0) & (scores.max(axis=-1) >= _CLEAR) & (lead >= _CLEARER)
    shown: list[CodedPicture] = []
    places: list[list[int]] = []
    for row, column in np.argwhere(is_clear).tolist():
        picture = cells.picture(row, column)
        turned = {
            int(rotate_codes(int(codes[row, column]), turns)): np.rot90(picture, turns)
            for turns in reversed(range(4))
        }
        shown += [(code, np.ascontiguousarray(image)) for code, image in turned.items()]
        places += [[row, column]] * len(turned)
    alike = cells.likeness([picture for _, picture in shown]) - _OWN_LESS
    # A cell is not compared with itself.
    for index, (row, column) in enumerate(places):
        alike[row, column, index] = -1.0
    return _with_best(scores, shown, alike)


def _handed(cells: Cells, scores: NDArray[np.float64], pictures: Sequence[CodedPicture]) -> float:
    """Returns by how much crossings look less like mirrored crossings.

    The stop lines of mirrored crossings are on the left lane.
    """
    mirrored = [
        np.ascontiguousarray(picture[:, ::-1])
        for code, picture in pictures
        if CONNECTIONS[code] >= 3
    ]
    is_crossing = CONNECTIONS >= 3
    right, other = scores[..., is_crossing].max(axis=-1), scores[..., ~is_crossing].max(axis=-1)
    wrong = cells.likeness(mirrored).max(axis=-1, initial=-1.0)
    # Only cells that are clearly crossings count, mirrored or not.
    is_clear = np.maximum(right, wrong) > np.maximum(_CLEAR, other)
    return float((right - wrong)[is_clear].mean()) if is_clear.any() else 1.0


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
