"""Measures why MAP-Elites without strips misses optima: which moves keep a network flawless, and which would bridge.

The page that it writes says how often each move leads from one flawless network to another, how far the elites of
missed niches are from the optimum, and, where all networks can be listed, how far a search has to climb if it may refit
a window at a time.

    python -m experiments.search.landscape --out landscape-work
"""

import argparse
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numba
import numpy as np
from jax import random
from jaxtyping import Array
from numpy.typing import NDArray

from elitelanes_jax import evolve, fitness, measure, mirror, repair, rotate
from elitelanes_jax.benchmark import Task, find_task
from elitelanes_jax.network import Metrics, random_bits
from elitelanes_jax.optimizers import (
    AnnealedMapElitesConfig,
    Move,
    MoveWeights,
    lay_straight,
    mirror_block,
    random_move,
    refit_strip,
    refit_window,
    seed_keys,
    slide_lines,
    toggle_corner,
    toggle_link,
    toggle_outline,
    toggle_street,
    transplant,
    with_symmetric_copy,
)
from experiments.search.listing import flawless_networks

_RUNS, _EVALUATIONS, _DRAWS, _FIRST_SEED = 8, 1_000_000, 4_000, 100
_NO_WAY = 1 << 20
_OTHER_NICHE = 400
"""The fitness that MAP-Elites adds for each cycle more or less than its goal has."""


class Ends(NamedTuple):
    """The best elites of all runs.

    Attributes:
      grids: int8 ``[R, F, H, W]``, by run and niche.
      gap: int ``[R, F]``, their fitness above the certified optimum.
    """

    grids: NDArray[np.int8]
    gap: NDArray[np.int_]


def _is_flawless(metrics: Metrics) -> NDArray[np.bool_]:
    flaws = metrics.dead_ends + metrics.adjacent_crossings + metrics.adjacent_turns + metrics.mismatches
    return np.asarray((metrics.components == 1) & (flaws + metrics.boundary_violations == 0))


def _run(task: Task, out: Path) -> Ends:
    keys, checkpoint = seed_keys(_FIRST_SEED, _RUNS), out / task.name
    config = AnnealedMapElitesConfig(strips=False)
    found = evolve(keys, task.shape, config=config, fill=task.fill, evaluations=_EVALUATIONS, checkpoint=checkpoint)
    elites = found.elites
    usable = np.asarray(elites.valid) & _is_flawless(elites.metrics)
    niche = usable[:, None] & (np.asarray(elites.metrics.cyclomatic)[:, None] == task.cyclomatic[:, None])
    scores = np.where(niche, np.asarray(elites.fitness)[:, None], 1 << 20)
    best = scores.argmin(axis=-1)
    return Ends(np.asarray(elites.grids)[np.arange(_RUNS)[:, None], best], scores.min(axis=-1) - task.optimum)


def _moves(task: Task) -> dict[str, Move]:
    small = task.shape[0] * task.shape[1] <= 64
    mix = random_move(MoveWeights(refit=25 if small else 0), fill=task.fill)
    return {
        "the mix": mix,
        "the mix, with a symmetric copy": with_symmetric_copy(1.0, mix, diagonal=small and not task.fill),
        "`refit_window`": refit_window(empty=not task.fill),
        "`refit_strip`": refit_strip(empty=not task.fill),
        "`transplant`": transplant(),
        "`transplant`, displaced": transplant(displaced=True),
        "`lay_straight`": lay_straight(),
        "`slide_lines`": slide_lines(),
        "`mirror_block`": mirror_block(),
        "`toggle_outline`": toggle_outline(),
        "`toggle_street`": toggle_street(),
        "`toggle_corner`": toggle_corner(),
        "`toggle_link`": toggle_link(),
    }


def _yields(task: Task, move: Move, grids: NDArray[np.int8]) -> tuple[float, float]:
    """Returns how many percent of a move's draws lead to another flawless network, and to one of as many cycles."""

    @jax.jit
    @jax.vmap
    def outcome(bits: Array, grid: Array, mate: Array) -> tuple[Array, Metrics, Array]:
        child = repair(*move.apply(bits, grid, mate), fill=task.fill)
        metrics = measure(child)
        return (child != grid).any(), metrics, metrics.cyclomatic == measure(grid).cyclomatic

    many = jnp.asarray(np.repeat(grids, -(-_DRAWS // len(grids)), axis=0))
    changed, metrics, same = outcome(random_bits(random.key(0), (len(many), move.bits)), many, many[::-1])
    found = np.asarray(changed) & _is_flawless(metrics)
    return 100 * float(found.mean()), 100 * float((found & np.asarray(same)).mean())


def _images(grids: Sequence[NDArray[np.int8]]) -> NDArray[np.int8]:
    """Returns all rotations and mirror images of square grids, each once."""
    turned = [rotate(side, turns) for grid in grids for side in (grid, mirror(grid)) for turns in range(4)]
    return np.unique(np.array(turned), axis=0)


def _strips(different: NDArray[np.bool_], lines: int) -> int:
    """Counts the strips of adjacent rows, or of adjacent columns, that hold all different cells; the fewer of both."""
    counts = []
    for axis in (0, 1):
        left, count = np.flatnonzero(different.any(axis=axis)), 0
        while len(left):
            left, count = left[left >= left[0] + lines], count + 1
        counts.append(count)
    return min(counts)


def _windows(different: NDArray[np.bool_], side: int) -> int:
    """Counts square windows that hold all different cells; each is the one that holds most of those left."""
    left, count = different.copy(), 0
    while left.any():
        held = np.lib.stride_tricks.sliding_window_view(left, (side, side)).sum(axis=(2, 3))
        row, column = np.unravel_index(held.argmax(), held.shape)
        left[row : row + side, column : column + side] = False
        count += 1
    return count


def _distances(task: Task, ends: Ends) -> Iterator[list[str]]:
    """Yields a row for each niche that a run missed: how far its elites are from the nearest known optimum."""
    for index, number in enumerate(task.cyclomatic):
        missed = np.flatnonzero(ends.gap[:, index] > 0)
        if not len(missed):
            continue
        reached = ends.grids[ends.gap[:, index] == 0, index]
        optima = _images([task.witnesses[index], *reached])
        rows = []
        for elite in ends.grids[missed, index]:
            different = optima != elite
            nearest = different[different.sum(axis=(1, 2)).argmin()]
            thinnest = min(next(n for n in range(1, 99) if _strips(cells, n) == 1) for cells in different)
            smallest = min(next(n for n in range(1, 99) if _windows(cells, n) == 1) for cells in different)
            covers = _windows(nearest, 3), _windows(nearest, 4), _strips(nearest, 2), _strips(nearest, 3)
            rows.append((nearest.sum(), *covers, thinnest, smallest))
        gaps = ends.gap[missed, index]
        yield [str(number), str(len(missed)), *(_spread(column) for column in [gaps, *np.transpose(rows)])]


def _spread(values: NDArray[np.int_]) -> str:
    return f"{np.median(values):g} ({min(values)} to {max(values)})"


def _climbs(task: Task, ends: Ends) -> Iterator[list[str]]:
    """Yields a row for each kind of window: how far elites have to climb to a better network of as many cycles.

    The search may replace what is in one window at a time and stays flawless. It pays for cycles that its goal does not
    have, as MAP-Elites does.
    """
    side = task.shape[0]
    networks = flawless_networks(side)
    parts = [
        jax.vmap(lambda grid: (fitness(m := measure(grid)), m.cyclomatic))(part)
        for part in np.array_split(networks, 64)
    ]
    scores, cycles = (np.concatenate([np.asarray(part) for part in column]) for column in zip(*parts, strict=True))
    if not np.array_equal(np.bincount(cycles)[task.cyclomatic], task.networks):
        raise AssertionError("the list differs from the certified counts")
    numbers = np.random.default_rng(0).integers(2**63, size=(side * side, 16), dtype=np.uint64)
    keys = {grid.tobytes(): index for index, grid in enumerate(networks)}
    for shape in ((3, 3), (3, 4), (4, 4), (5, 5), (2, side), (3, side), (4, side)):
        groups = np.array([_groups(networks, cells, numbers) for cells in _positions(side, shape)])
        climbs, at_once, better = [], [], []
        for index, number in enumerate(task.cyclomatic):
            missed = np.array([keys[grid.tobytes()] for grid in ends.grids[ends.gap[:, index] > 0, index]], np.int64)
            if not len(missed):
                continue
            pursued = scores + _OTHER_NICHE * np.abs(cycles - number)
            climbs += _climb(np.argsort(pursued, kind="stable"), pursued, groups, missed).tolist()
            for elite in missed:
                lowest = pursued[(groups == groups[:, [elite]]).any(axis=0)].min()
                at_once.append(lowest == task.optimum[index])
                better.append(lowest < pursued[elite])
        counts = [np.sum(better), np.sum(at_once), *(np.sum(np.array(climbs) <= limit) for limit in (12, 40, 100))]
        yield [" x ".join(map(str, shape)), str(len(groups)), *map(str, counts), _spread(np.array(climbs))]


def _positions(side: int, shape: tuple[int, int]) -> Iterator[NDArray[np.int_]]:
    """Yields the cells of a window at each of its positions, upright and on its side."""
    cells = np.arange(side * side).reshape(side, side)
    for size in {shape, shape[::-1]}:
        yield from np.lib.stride_tricks.sliding_window_view(cells, size).reshape(-1, size[0] * size[1])


def _groups(networks: NDArray[np.int8], cells: NDArray[np.int_], numbers: NDArray[np.uint64]) -> NDArray[np.int32]:
    """Numbers the networks so that two have the same number if they differ in these cells alone."""
    hashed = np.zeros(len(networks), np.uint64)
    for cell in np.setdiff1d(np.arange(len(numbers)), cells):
        hashed ^= numbers[cell, networks.reshape(len(networks), -1)[:, cell]]
    return np.unique(hashed, return_inverse=True)[1].astype(np.int32)


@numba.njit
def _root(parents: NDArray[np.int_], index: int) -> int:
    while parents[index] != index:
        parents[index] = parents[parents[index]]
        index = parents[index]
    return index


@numba.njit
def _climb(
    order: NDArray[np.int_], scores: NDArray[np.int_], groups: NDArray[np.int32], elites: NDArray[np.int_]
) -> NDArray[np.int_]:
    """Returns how far each elite has to climb on the way to a network of lower score; `_NO_WAY` if it cannot.

    Networks are added from the best to the worst. When one joins the set of an elite to a better network, its score is
    the height of the way's pass.
    """
    parents, lowest = np.arange(len(order)), scores.copy()
    first, climbs = np.full(groups.shape, -1), np.full(len(elites), _NO_WAY)
    for network in order:
        joined = False
        for window in range(len(groups)):
            group = groups[window, network]
            if first[window, group] < 0:
                first[window, group] = network
                continue
            one, other = _root(parents, network), _root(parents, first[window, group])
            if one != other:
                low, high = (one, other) if lowest[one] <= lowest[other] else (other, one)
                parents[high], joined = low, True
        for index in range(len(elites) if joined else 0):
            elite = elites[index]
            if climbs[index] == _NO_WAY and lowest[_root(parents, elite)] < scores[elite]:
                climbs[index] = max(scores[network] - scores[elite], 0)
    return climbs


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def main() -> None:
    """Writes the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("landscape-work"), help="folder for runs and tables")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    with (out / "tables.md").open("w", encoding="utf-8") as page:
        for size in ("8x8B", "9x9A"):
            task = find_task(f"{size}-{_EVALUATIONS}")
            ends = _run(task, out)
            print(f"## {size}\n\n{(ends.gap == 0).sum()} of {ends.gap.size} at the optimum\n", file=page)
            found = ends.grids[(ends.gap > 0) & (ends.gap < 1 << 19)]
            heads = ["move", "certified, %", "as many cycles, %", "elites that miss, %", "as many cycles, %"]
            both = [
                (name, *_yields(task, move, task.witnesses), *_yields(task, move, found))
                for name, move in _moves(task).items()
            ]
            rows = [[name, *(f"{share:.2f}" for share in shares)] for name, *shares in both]
            print(_table(heads, rows), file=page)
            heads = ["cycles", "missed by", "gap", "cells", "3 x 3", "4 x 4", "strips of 2", "strips of 3"]
            print(
                _table([*heads, "one strip, lines", "one window, side"], _distances(task, ends)), file=page, flush=True
            )
        heads = ["window", "positions", "improves", "optimum at once", "climb <= 12", "<= 40", "<= 100", "climb"]
        print(_table(heads, _climbs(task, ends)), file=page)
        print(f"{time.perf_counter() - began:.0f} s", file=page)


if __name__ == "__main__":
    main()
