"""Draws a sheet of photographs and of the tiles in them.

Photographs have the outlines of their tiles, and tiles have their masks.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import KIND_OF
from elitelanes_jax.photographs.proposals import SURE, Proposal
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.contact_sheet import contact_sheet, write_text

# The size of a photograph on the sheet in pixels.
_WIDTH, _HEIGHT = 640, 480
_SURE_INK, _UNSURE_INK = (235, 40, 160), (255, 140, 0)
# The points along a side of a tile's outline, which a lens bends.
_SIDE_POINTS = 13
_PAPER = (250, 249, 246)


def draw_proposal(photograph: Photograph, proposal: Proposal) -> NDArray[np.uint8]:
    """Returns the photograph, 640 x 480 pixels, with the outline and the kind of each tile.

    Unsure tiles are orange.
    """
    height, width = photograph.image.shape[:2]
    scale = min(_WIDTH / width, _HEIGHT / height)
    view = proposal.view.scaled(scale)
    small = cv2.resize(photograph.image, (view.width, view.height), interpolation=cv2.INTER_AREA)
    picture = np.full((_HEIGHT, _WIDTH, 3), _PAPER, np.uint8)
    picture[: view.height, : view.width] = small
    steps = np.linspace(0, 1, _SIDE_POINTS)
    top = np.stack([steps, np.zeros(_SIDE_POINTS)], axis=1)
    right = np.stack([np.ones(_SIDE_POINTS), steps], axis=1)
    outline = np.concatenate([top, right, 1 - top, 1 - right])
    trusted = proposal.score >= SURE
    for row, column in np.argwhere(np.array(proposal.codes) > 0).tolist():
        sure = trusted and proposal.sure[row][column] >= SURE
        ink = _SURE_INK if sure else _UNSURE_INK
        # With `shift`, OpenCV reads the last three bits of coordinates as parts of a pixel.
        pixels = np.rint(view.pixels_of(outline + np.array([column, row])) * 8).astype(np.int32)
        cv2.polylines(picture, [pixels], True, ink, 1, cv2.LINE_AA, shift=3)
        x, y = view.pixels_of(np.array([[column + 0.5, row + 0.5]]))[0]
        kind = KIND_OF[proposal.codes[row][column]] + ("" if sure else "?")
        write_text(picture, kind, (int(x) - 4 * len(kind), int(y) + 5), 0.42, ink)
    return picture


def draw_sheet(
    title: str,
    photographs: Sequence[NDArray[np.uint8]],
    proposals: Sequence[Proposal],
    tiles: NDArray[np.uint8],
) -> NDArray[np.uint8]:
    """Returns one RGB picture of photographs and tiles.

    The photographs of `draw_proposal` are above. The sheet of tiles with their masks is below them.
    """
    captions = []
    for proposal in proposals:
        fits = f"score {proposal.score:.2f}" + ("" if proposal.score >= SURE else ": refused")
        words = ", ".join(f"{name} {value:g}" for name, value in proposal.evidence.items())
        captions.append((f"{proposal.photo}: {fits}", words))
    above = contact_sheet(title, photographs, captions)
    width = max(above.shape[1], tiles.shape[1])
    padded = []
    for part in (above, tiles):
        sheet = np.full((part.shape[0], width, 3), _PAPER, np.uint8)
        sheet[:, : part.shape[1]] = part
        padded.append(sheet)
    return np.vstack(padded)
