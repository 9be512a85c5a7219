"""Draws the picture of the moves in docs/moves.md.

python docs/moves.py
"""

from pathlib import Path

import jax
from matplotlib.figure import Figure

from elitelanes_jax import random_grids, repair
from elitelanes_jax.network import random_bits
from elitelanes_jax.optimizers import (
    Move,
    clear_block,
    lay_straight,
    mirror_block,
    refit_strip,
    refit_window,
    slide_lines,
    toggle_corner,
    toggle_link,
    toggle_outline,
    toggle_street,
    transplant,
    with_fill,
    with_symmetric_copy,
)
from elitelanes_jax.plots import road_map

SIDE = 7

# Each move has a seed that shows its effect well.
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
    "refit_window": (refit_window(), 1),
    "refit_strip": (refit_strip(), 1),
    "toggle_street, with_fill": (with_fill(1.0, toggle_street()), 5),
    "lay_straight, with_symmetric_copy": (with_symmetric_copy(1.0, lay_straight()), 4),
}


def main() -> None:
    grid, mate = (repair(codes, fill=True) for codes in random_grids(jax.random.key(4), 2, (SIDE, SIDE)))
    figure = Figure(figsize=(9.2, 16.8), layout="constrained")
    pairs = figure.subplots(-(-len(MOVES) // 2), 4).reshape(-1, 2)
    for unused in pairs[len(MOVES) :].flat:
        unused.set_axis_off()
    for (before, after), (name, (move, seed)) in zip(pairs, MOVES.items(), strict=False):
        varied = move.apply(random_bits(jax.random.key(seed), (move.bits,)), grid, mate)
        road_map(grid, width=0.25, lanes=False, ax=before)
        road_map(repair(*varied), width=0.25, lanes=False, marked=varied.dirty, ax=after)
        before.set_title(name, loc="left", fontsize=11)
    figure.savefig(Path(__file__).parent / "moves.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main()
