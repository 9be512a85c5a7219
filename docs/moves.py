"""Draws the picture of the moves in docs/moves.md.

python docs/moves.py
"""

from pathlib import Path

import jax
from matplotlib.figure import Figure

from elitelanes_jax import random_grids, repair
from elitelanes_jax.optimizers import (
    Move,
    make_move,
    refit_strip,
    with_fill,
    with_symmetric_copy,
)
from elitelanes_jax.plots import road_map

SIDE = 7

# Each move has a seed that shows its effect well.
MOVES: dict[str, tuple[Move, int]] = {
    "link": (make_move("link"), 3),
    "corner": (make_move("corner"), 3),
    "outline": (make_move("outline"), 1),
    "street": (make_move("street"), 5),
    "straight": (make_move("straight"), 12),
    "clear": (make_move("clear"), 4),
    "mirror": (make_move("mirror"), 2),
    "slide": (make_move("slide"), 6),
    "transplant": (make_move("transplant"), 5),
    "displaced": (make_move("displaced"), 7),
    "refit": (make_move("refit"), 1),
    "refit_strip": (refit_strip(), 1),
    "street, with_fill": (with_fill(1.0, make_move("street")), 5),
    "straight, with_symmetric_copy": (with_symmetric_copy(1.0, make_move("straight")), 4),
}


def main() -> None:
    grid, mate = (repair(codes, fill=True) for codes in random_grids(jax.random.key(4), 2, (SIDE, SIDE)))
    figure = Figure(figsize=(9.2, 16.8), layout="constrained")
    pairs = figure.subplots(-(-len(MOVES) // 2), 4).reshape(-1, 2)
    for unused in pairs[len(MOVES) :].flat:
        unused.set_axis_off()
    for (before, after), (name, (move, seed)) in zip(pairs, MOVES.items(), strict=False):
        varied = move.apply(jax.random.bits(jax.random.key(seed), (move.bits,), "uint32"), grid, mate)
        road_map(grid, width=0.25, lanes=False, ax=before)
        road_map(repair(*varied), width=0.25, lanes=False, marked=varied.dirty, ax=after)
        before.set_title(name, loc="left", fontsize=11)
    figure.savefig(Path(__file__).parent / "moves.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main()
