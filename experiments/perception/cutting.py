"""How exactly are tiles cut out of photographs, and how often is a wrong cut not refused?

    python -m experiments.perception.cutting [--only {floors,tiles}] [--count N] [--tiles DIR] [--first N] [--out DIR]

Floors of 12 to 30 tiles, and single tiles on six kinds of floor, photographed by `synthetic_photographs.py`. The tile
sets are drawn with seeds that no parameter was chosen with. A cut is right if no corner of a tile is off by more than
1 % of a tile. The program is given the size of the floor and nothing else.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax.tiles import (
    SURE,
    Photograph,
    Proposal,
    TileSet,
    cut_tiles,
    inspect_tiles,
    load_tiles,
    propose_tiles,
    turn_floor,
    write_cuts,
)
from experiments.common import Parser, leave, run, table, whole, write
from experiments.perception.synthetic_photographs import FLOORS, Photographed, draw_set, lay_floor, photograph

__all__ = ["main"]

_SHAPES = ((3, 4), (4, 4), (3, 5), (4, 5), (3, 6), (4, 6), (5, 5), (5, 6))
_HELD_BACK = (401, 402, 403, 404)  # seeds of tile sets that no parameter was chosen with
_DRAW = 2027  # seed of the photographs; parameters were chosen with photographs of another one
_RIGHT = 0.01  # tiles


class Row(NamedTuple):
    """The result of one photograph.

    Attributes:
      floor: under the tiles.
      error: the largest error of a corner, in tiles; infinite if nothing was found.
      score: of the proposal.
      wrong: cells that were read wrongly and not marked as unsure.
      unsure: cells marked as unsure.
      cells: of the floor.
      passes: whether the cut set passes the check.
      tiles: cut.
      seconds: that finding, cutting, masks and writing took.
    """

    floor: str
    error: float
    score: float
    wrong: int
    unsure: int
    cells: int
    passes: bool
    tiles: int
    seconds: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("cutting", __doc__)
    parser.add_argument("--only", choices=("floors", "tiles"), help="kind of photographs; default both")
    parser.add_argument("--count", type=whole(1), metavar="N", help="photographs; default 50 floors, 120 tiles")
    parser.add_argument("--tiles", type=Path, metavar="DIR", help="photograph this set instead of drawn ones")
    parser.add_argument("--first", type=whole(0), default=0, metavar="N", help="index of the first photograph")
    out = Path("results/cutting")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    options = parser.parse_args(arguments)
    return run("cutting", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    for kind, count in (("floors", 50), ("tiles", 120)):
        if options.only in (None, kind):
            rows = []
            for index in range(options.first, options.first + (options.count or count)):
                rows.append(_measure(kind, index, options.tiles))
                print(index, *(f"{name} {value}" for name, value in rows[-1]._asdict().items()), sep="  ", flush=True)
            text = _summary(rows)
            print(text)
            write(options.out / f"{kind}.md", text)


@cache
def _set(folder: Path | None, seed: int) -> TileSet:
    return draw_set(seed) if folder is None else load_tiles(folder)


def _measure(kind: str, index: int, folder: Path | None) -> Row:
    rng = np.random.default_rng([("floors", "tiles").index(kind), index, _DRAW])
    tiles = _set(folder, _HELD_BACK[index % len(_HELD_BACK)])
    floor = list(FLOORS)[index % len(FLOORS)]
    if kind == "floors":
        codes = lay_floor(rng, _SHAPES[int(rng.integers(len(_SHAPES)))], tiles)
        seen = photograph(rng, codes, tiles, floor, fill=(0.65, 1.0))
    else:
        codes = np.array([[rng.choice(tiles.alphabet)]], np.int8)
        seen = photograph(rng, codes, tiles, floor, fill=(0.4, 0.8))
    start = time.perf_counter()
    shot = Photograph(f"{kind}-{index}", seen.image)
    try:
        proposal = propose_tiles(shot, shape=codes.shape)
    except InputError:
        return Row(floor, np.inf, 0.0, 0, 0, codes.size, False, 0, time.perf_counter() - start)
    with tempfile.TemporaryDirectory() as out:
        cuts = cut_tiles(shot, proposal)
        write_cuts(out, cuts)
        seconds = time.perf_counter() - start
        problems = [line for line in inspect_tiles(out, lines=True)[1] if "of every kind a map needs" not in line]
    error, laid = _error(seen, proposal, codes)
    unsure = np.array(proposal.sure) < SURE
    wrong = (np.array(proposal.codes) != laid) & ~unsure
    passes = not problems and len(cuts) > 0
    return Row(
        floor, error, proposal.score, int(wrong.sum()), int(unsure.sum()), codes.size, passes, len(cuts), seconds
    )


def _error(seen: Photographed, proposal: Proposal, codes: NDArray[np.int8]) -> tuple[float, NDArray[np.int8]]:
    """Returns the largest error of a tile's corner in tiles, and the true codes as the proposal has them turned.

    A floor may be seen from any side: the direction with the smallest error counts.
    """
    rows, columns = np.shape(proposal.codes)
    best, laid = np.inf, codes
    for turns in range(4):
        turned = turn_floor(codes, turns)
        if turned.shape != (rows, columns):
            continue
        around = np.pad(turned, 1) > 0
        corners = np.argwhere(around[:-1, :-1] | around[1:, :-1] | around[:-1, 1:] | around[1:, 1:])[:, ::-1]
        x, y = corners.T.astype(float)
        height, width = turned.shape
        for _ in range(turns):  # turned back: clockwise
            x, y, height, width = height - y, x, width, height
        found = seen.tiles_of(proposal.view.pixels_of(corners.astype(float)))
        error = float(np.linalg.norm(found - np.stack([x, y], axis=1), axis=1).max())
        if error < best:
            best, laid = error, turned
    return best, laid


def _summary(rows: Sequence[Row]) -> str:
    groups = [(floor, [row for row in rows if row.floor == floor]) for floor in FLOORS]
    lines = []
    for name, group in [*groups, ("all", list(rows))]:
        if not group:
            continue
        error = np.array([row.error for row in group])
        cut = np.array([row.score >= SURE for row in group])
        right = error <= _RIGHT
        read = sum(row.cells - row.unsure for row, is_cut in zip(group, cut, strict=True) if is_cut)
        wrong = sum(row.wrong for row, is_cut in zip(group, cut, strict=True) if is_cut)
        cells = sum(row.cells for row, is_cut in zip(group, cut, strict=True) if is_cut)
        passing = [row.passes for row, is_cut in zip(group, cut, strict=True) if is_cut]
        lines.append(
            [
                name,
                str(len(group)),
                f"{(cut & right).mean():.1%}",
                f"{(~cut).mean():.1%}",
                str(int((cut & ~right).sum())),
                f"{np.median(error[cut]) if cut.any() else np.nan:.2%}",
                f"{np.mean(passing) if passing else np.nan:.1%}",
                f"{(read - wrong) / max(cells, 1):.2%}",
                str(wrong),
                f"{np.median([row.seconds for row in group]):.1f}",
            ]
        )
    head = ["floor", "photographs", "right", "refused", "wrong without warning", "error, median", "pass the check"]
    return table([*head, "tiles read right", "read wrong without warning", "seconds, median"], lines, left=1)


if __name__ == "__main__":
    leave(main())
