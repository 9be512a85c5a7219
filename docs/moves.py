"""Draws the picture of the moves in docs/moves.md.

python docs/moves.py
"""

from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import random_grids, repair
from elitelanes_jax.draws import random_words
from elitelanes_jax.moves import (
    clear_block,
    lay_straight,
    mirror_block,
    slide_lines,
    toggle_corner,
    toggle_link,
    toggle_outline,
    toggle_street,
    transplant,
)
from elitelanes_jax.variation import Move

SIDE, PX, GAP, TITLE = 7, 30, 26, 34
GROUND, CHANGED, ROAD, INK = (250, 249, 246), (255, 226, 160), (60, 66, 82), (40, 40, 44)

# A seed for each, with which it is easily seen what the move does.
MOVES: dict[str, tuple[Move, int]] = {
    "toggle_link": (toggle_link(), 3),
    "toggle_corner": (toggle_corner(), 3),
    "toggle_outline": (toggle_outline(), 1),
    "toggle_street": (toggle_street(), 5),
    "lay_straight": (lay_straight(), 12),
    "clear_block": (clear_block(), 4),
    "mirror_block": (mirror_block(), 2),
    "slide_lines": (slide_lines(), 6),
    "transplant": (transplant(), 5),
    "transplant, displaced": (transplant(displaced=True), 7),
}


def main() -> None:
    grid, mate = (repair(codes, fill=True) for codes in random_grids(jax.random.key(4), 2, (SIDE, SIDE)))
    panels = []
    for name, (move, seed) in MOVES.items():
        varied = move.apply(random_words(jax.random.key(seed), (move.words,)), grid, mate)
        panel = np.hstack([draw(grid), draw(repair(*varied), varied.dirty)])
        panels.append(titled(name, panel))
    rows = [np.hstack(panels[start : start + 2]) for start in range(0, len(panels), 2)]
    cv2.imwrite(str(Path(__file__).parent / "moves.png"), np.vstack(rows)[..., ::-1])


def draw(grid: jax.Array, dirty: jax.Array | None = None) -> NDArray[np.uint8]:
    """The roads of a network as lines, the changed tiles in colour."""
    size = SIDE * PX
    sheet = np.full((size + GAP, size + GAP, 3), GROUND, np.uint8)
    changed = np.zeros(grid.shape, bool) if dirty is None else np.asarray(dirty)
    codes = np.asarray(jnp.asarray(grid))
    for row, column in np.argwhere(changed):
        corner = (GAP // 2 + column * PX, GAP // 2 + row * PX)
        cv2.rectangle(sheet, corner, (corner[0] + PX - 1, corner[1] + PX - 1), CHANGED, -1)
    for row, column in np.ndindex(codes.shape):
        middle = (GAP // 2 + column * PX + PX // 2, GAP // 2 + row * PX + PX // 2)
        for side, right, down in ((8, 0, -1), (4, 1, 0), (2, 0, 1), (1, -1, 0)):
            if codes[row, column] & side:
                end = (middle[0] + right * PX // 2, middle[1] + down * PX // 2)
                cv2.line(sheet, middle, end, ROAD, 7, cv2.LINE_AA)
    return sheet


def titled(name: str, panel: NDArray[np.uint8]) -> NDArray[np.uint8]:
    head = np.full((TITLE, panel.shape[1], 3), GROUND, np.uint8)
    cv2.putText(head, name, (GAP // 2, TITLE - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.6, INK, 1, cv2.LINE_AA)
    return np.vstack([head, panel])


if __name__ == "__main__":
    main()
