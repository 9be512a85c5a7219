"""How exactly are tiles cut out of photographs, and how often is a wrong cut not refused?

    python -m experiments.perception.cutting [--only {floors,tiles,hand,seams,wrong}] [--count N] [--tiles DIR...]
        [--first N] [--out DIR]

Floors of 12 to 30 tiles, and single tiles on six kinds of floor, photographed by `synthetic_photographs.py`. The tile
sets are drawn with seeds that no parameter was chosen with. A cut is right if no corner of a tile is off by more than
1 % of a tile. The program is given the size of the floor and nothing else.

`hand` has floors whose tiles of a kind differ, as if they were taped one by one. `seams` has floors whose crossings
touch, and whose separators are up to 5 % of a tile beside the middle. A strip of a neighbour that is left in a cut tile
fails the check. `wrong` has the floors of `hand` with wrong corners, a wrong size or a mirrored photograph, and
photographs without a floor. Each should be refused, or cut right all the same.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax.network import rotate
from elitelanes_jax.photographs import Photograph, Proposal, cut_tiles, propose_tiles, write_cuts
from elitelanes_jax.tiles import TileSet, inspect_tiles, load_tiles
from experiments.common import Parser, leave, run, table, whole, write
from experiments.perception.synthetic_photographs import (
    FLOORS,
    SCENES,
    Photographed,
    draw_scene,
    draw_set,
    lay_floor,
    move_middle,
    photograph,
    tape_by_hand,
)

__all__ = ["main"]

_SHAPES = ((3, 4), (4, 4), (3, 5), (4, 5), (3, 6), (4, 6), (5, 5), (5, 6))
_HELD_BACK = (401, 402, 403, 404)  # seeds of tile sets that no parameter was chosen with
_DRAW = 2027  # seed of the photographs; parameters were chosen with photographs of another one
_RIGHT = 0.01  # tiles
_SURE = 0.5  # scores from which tiles are cut
_KINDS = {"floors": 50, "tiles": 120, "hand": 48, "seams": 10, "wrong": 24}
# All of these crossings touch.
_TOUCHING = np.array([[6, 7, 7, 3], [14, 15, 15, 11], [14, 15, 15, 11], [12, 13, 13, 9]], np.int8)
_MEMBERS = 8  # of each tile that is taped by hand: on a real floor, no two tiles are the same


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
    parser.add_argument("--only", choices=tuple(_KINDS), help="kind of photographs; default all")
    counts = ", ".join(f"{count} {kind}" for kind, count in _KINDS.items())
    parser.add_argument("--count", type=whole(1), metavar="N", help=f"photographs; default {counts}")
    parser.add_argument(
        "--tiles", type=Path, nargs="+", metavar="DIR", help="photograph these sets in turn instead of drawn ones"
    )
    parser.add_argument("--first", type=whole(0), default=0, metavar="N", help="index of the first photograph")
    out = Path("results/cutting")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    options = parser.parse_args(arguments)
    return run("cutting", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    folders = tuple(options.tiles or ())
    for kind, count in _KINDS.items():
        if options.only not in (None, kind):
            continue
        rows: list[Row] = []
        lies: list[Lie] = []
        for index in range(options.first, options.first + (options.count or count)):
            measured: list[Row] | list[Lie]
            if kind == "wrong":
                measured = list(_deceive(index, folders))
                lies.extend(measured)
            else:
                measured = [_measure(kind, index, folders)]
                rows.extend(measured)
            for row in measured:
                print(index, *(f"{name} {value}" for name, value in row._asdict().items()), sep="  ", flush=True)
        text = _summary_of_lies(lies) if kind == "wrong" else _summary(rows)
        print(text)
        write(options.out / f"{kind}.md", text)


@cache
def _set(folder: Path | None, seed: int) -> TileSet:
    return draw_set(seed) if folder is None else load_tiles(folder)


class _Laid(NamedTuple):
    """A photographed floor or tile."""

    floor: str
    codes: NDArray[np.int8]
    seen: Photographed
    rng: np.random.Generator


def _tiles_of(index: int, folders: tuple[Path, ...]) -> TileSet:
    """Returns the set of a photograph: the folders in turn, or drawn sets in turn."""
    folder = folders[index % len(folders)] if folders else None
    return _set(folder, _HELD_BACK[index % len(_HELD_BACK)])


def _lay(kind: str, index: int, folders: tuple[Path, ...]) -> _Laid:
    rng = np.random.default_rng([("floors", "tiles", "hand", "seams").index(kind), index, _DRAW])
    tiles = _tiles_of(index, folders)
    floor = list(FLOORS)[index % len(FLOORS)]
    if kind == "hand":
        floor = list(FLOORS)[index // max(len(folders), 1) % len(FLOORS)]
        tiles = tape_by_hand(tiles, rng, _MEMBERS)
    if kind == "seams":
        seen = photograph(rng, _TOUCHING, move_middle(tiles, rng), floor, fill=(0.75, 1.0))
        return _Laid(floor, _TOUCHING, seen, rng)
    if kind == "tiles":
        codes = np.array([[rng.choice(tiles.alphabet)]], np.int8)
        seen = photograph(rng, codes, tiles, floor, fill=(0.4, 0.8))
    else:
        codes = lay_floor(rng, _SHAPES[int(rng.integers(len(_SHAPES)))], tiles)
        seen = photograph(rng, codes, tiles, floor, fill=(0.65, 1.0))
    return _Laid(floor, codes, seen, rng)


def _measure(kind: str, index: int, folders: tuple[Path, ...]) -> Row:
    floor, codes, seen, _ = _lay(kind, index, folders)
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
    unsure = np.array(proposal.sure) < _SURE
    wrong = (np.array(proposal.codes) != laid) & ~unsure
    passes = not problems and len(cuts) > 0
    return Row(
        floor, error, proposal.score, int(wrong.sum()), int(unsure.sum()), codes.size, passes, len(cuts), seconds
    )


class Lie(NamedTuple):
    """The result of a photograph with wrong corners, of a wrong size, or without a floor.

    Attributes:
      lie: what is wrong.
      error: the largest error of a corner, in tiles; infinite if nothing was found or there is nothing to find.
      score: of the proposal.
      evidence: of the score.
    """

    lie: str
    error: float
    score: float
    evidence: dict[str, float]


def _deceive(index: int, folders: tuple[Path, ...]) -> Iterator[Lie]:
    """Proposes the tiles of a floor from what is wrong about it, and of photographs without a floor."""
    _, codes, seen, rng = _lay("hand", index, folders)
    rows, columns = codes.shape
    true = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)
    across = rng.choice([-1, 1], 2)
    moves = {
        "a cell to the side": across * [1, 0],
        "a cell up or down": across * [0, 1],
        "half a cell to the side": across * [0.5, 0],
        "half a cell in both directions": across * [0.5, 0.5],
        "a quarter of a cell": across * [0.25, 0],
    }
    for lie, move in moves.items():
        yield _lie(lie, seen, codes, codes.shape, seen.pixels_of(true + move))
    for lie, shape in (
        ("a column too many", (rows, columns + 1)),
        ("a row and a column too few", (rows - 1, columns - 1)),
    ):
        yield _lie(lie, seen, codes, shape, seen.pixels_of(true))
        yield _lie(f"{lie}, corners found", seen, codes, shape, None)
    for lie, turned in (("turned by 90 degrees", (columns, rows)), ("a wrong map", codes.shape)):
        laid = lay_floor(rng, codes.shape, load_tiles())
        given = laid if lie == "a wrong map" else None
        yield _lie(lie, seen, codes, turned, seen.pixels_of(true), given)
    flipped = seen._replace(image=np.ascontiguousarray(seen.image[:, ::-1]))
    yield _lie("mirrored", flipped, None, codes.shape, None)
    tiles = _tiles_of(index, folders)
    scene = SCENES[index % len(SCENES)]
    empty = seen._replace(image=draw_scene(rng, scene, tiles))
    yield _lie(scene, empty, None, (3, 4), None)
    guess = np.array([[500, 400], [1500, 400], [1500, 1150], [500, 1150]], float)
    yield _lie(f"{scene}, with corners", empty, None, (3, 4), guess)
    if scene != "one tile":
        yield _lie(f"{scene}, as a tile", empty, None, (1, 1), None)


def _lie(
    lie: str,
    seen: Photographed,
    codes: NDArray[np.int8] | None,
    shape: tuple[int, int],
    corners: NDArray[np.float64] | None,
    laid: NDArray[np.int8] | None = None,
) -> Lie:
    shot = Photograph(lie, seen.image)
    size = np.array(seen.image.shape[1::-1], float)
    corners = None if corners is None else np.clip(_clockwise(corners), 0, size)
    try:
        proposal = propose_tiles(shot, shape=shape, corners=corners, codes=laid)
    except InputError:
        return Lie(lie, np.inf, 0.0, {})
    error = np.inf if codes is None else _error(seen, proposal, codes)[0]
    return Lie(lie, error, proposal.score, proposal.evidence)


def _clockwise(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns corners ``[4, 2]`` in the clockwise order of the picture, the first one first."""
    x, y = corners.T
    area = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()
    return corners if area > 0 else corners[[0, 3, 2, 1]]


def _summary_of_lies(lies: Sequence[Lie]) -> str:
    lines = []
    for lie in dict.fromkeys(lie.lie for lie in lies):
        group = [row for row in lies if row.lie == lie]
        cut = [row for row in group if row.score >= _SURE]
        right = sum(row.error <= _RIGHT for row in cut)
        lines.append([lie, *map(str, (len(group), len(group) - len(cut), right, len(cut) - right))])
    totals = np.array([[int(cell) for cell in line[1:]] for line in lines]).sum(axis=0)
    lines.append(["all", *map(str, totals)])
    head = ["what is wrong", "photographs", "refused", "right all the same", "wrong without warning"]
    return table(head, lines, left=1)


def _error(seen: Photographed, proposal: Proposal, codes: NDArray[np.int8]) -> tuple[float, NDArray[np.int8]]:
    """Returns the largest error of a tile's corner in tiles, and the true codes as the proposal has them turned.

    A floor may be seen from any side: the direction with the smallest error counts.
    """
    rows, columns = np.shape(proposal.codes)
    best, laid = np.inf, codes
    for turns in range(4):
        turned = np.asarray(rotate(codes, turns))
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
        cut = np.array([row.score >= _SURE for row in group])
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
