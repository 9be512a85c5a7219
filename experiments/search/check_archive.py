"""Re-scores an archive against the certificates, by NumPy and NetworkX alone.

python -m experiments.search.check_archive CERTIFICATES ARCHIVE --size H W [--empty]

The archive is an ``.npz`` with ``grids``, integer codes ``[..., H, W]``. Each grid is measured anew. Prints, by
cyclomatic number, the certified optimum, and the best fitness and the number of the flawless networks that the archive
has. Exit code 1 says that a network contradicts a certificate, 2 that the input cannot be read.
"""

import argparse
import json
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
from numpy.typing import NDArray

__all__ = ["Score", "check", "main", "read_certificate", "rescore"]

_NORTH, _EAST, _SOUTH, _WEST = 8, 4, 2, 1


class Score(NamedTuple):
    """The fitness and the cyclomatic number of a network, and whether it is flawless and has every cell filled."""

    fitness: int
    cyclomatic: int
    flawless: bool
    filled: bool


def rescore(grid: NDArray[np.integer]) -> Score:
    """Measures a grid of codes ``[H, W]``, tile by tile and as a graph."""
    connections = np.array([code.bit_count() for code in range(16)])[grid]
    east = (grid[:, :-1] & _EAST > 0) & (grid[:, 1:] & _WEST > 0)
    south = (grid[:-1] & _SOUTH > 0) & (grid[1:] & _NORTH > 0)
    matched = np.zeros(grid.shape, int)
    for links, ends in ((east, (np.s_[:, :-1], np.s_[:, 1:])), (south, (np.s_[:-1], np.s_[1:]))):
        for end in ends:
            matched[end] += links
    outward = np.zeros(grid.shape, bool)
    for edge, side in ((np.s_[0], _NORTH), (np.s_[-1], _SOUTH), (np.s_[:, 0], _WEST), (np.s_[:, -1], _EAST)):
        outward[edge] |= grid[edge] & side > 0
    dead_ends = int(((connections == 1) | (matched < connections)).sum())

    numbers = np.arange(grid.size).reshape(grid.shape)
    graph = nx.Graph()
    graph.add_nodes_from(numbers[grid > 0].tolist())
    graph.add_edges_from(zip(numbers[:, :-1][east].tolist(), numbers[:, 1:][east].tolist(), strict=True))
    graph.add_edges_from(zip(numbers[:-1][south].tolist(), numbers[1:][south].tolist(), strict=True))
    components = nx.number_connected_components(graph)
    cyclomatic = graph.number_of_edges() - graph.number_of_nodes() + components

    crossing, turn = connections >= 3, np.isin(grid, (3, 6, 9, 12))
    crossings = int((east & crossing[:, :-1] & crossing[:, 1:]).sum() + (south & crossing[:-1] & crossing[1:]).sum())
    turns = int((turn[:, :-1] & turn[:, 1:]).sum() + (turn[:-1] & turn[1:]).sum())
    straights = sum(map(_squares, grid == _EAST + _WEST)) + sum(map(_squares, (grid == _NORTH + _SOUTH).T))
    fitness = 480 * dead_ends + 300 * max(components - 1, 0) + 150 * int(outward.sum()) + 200 * crossings + 80 * turns
    fitness += 100 * sum(1 for _ in nx.bridges(graph)) - 2 * cyclomatic - 2 * straights
    flawless = components == 1 and not (dead_ends or crossings or turns)
    return Score(fitness, cyclomatic, flawless, bool((grid > 0).all()))


def _squares(marks: NDArray[np.bool_]) -> int:
    """Sums the squares of the lengths of all runs of marks."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marks, [False]])))
    return int(((edges[1::2] - edges[::2]) ** 2).sum())


def check(
    optima: dict[int, int], grids: Iterable[NDArray[np.integer]], *, fill: bool
) -> tuple[dict[int, list[int]], list[str]]:
    """Compares networks with certificates.

    Args:
      optima: the certified fitness by feasible cyclomatic number.
      grids: of codes; those that are not flawless, or not filled where they have to be, count nothing.
      fill: whether every cell has to be filled.

    Returns:
      The fitness of all networks that count, by cyclomatic number, and a line for each that should not exist.
    """
    found: dict[int, list[int]] = {}
    faults = []
    for grid in grids:
        score = rescore(grid)
        if not score.flawless or (fill and not score.filled):
            continue
        found.setdefault(score.cyclomatic, []).append(score.fitness)
        certified = optima.get(score.cyclomatic)
        if certified is None or score.fitness < certified:
            told = "no network" if certified is None else f"{certified} at best"
            faults.append(
                f"cyclomatic number {score.cyclomatic}: certified {told}, got {score.fitness}: {grid.tolist()}"
            )
    return found, faults


def main(arguments: list[str] | None = None) -> int:
    """Runs the program; returns its exit code."""
    parser = argparse.ArgumentParser(prog="check_archive.py", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("certificates", type=Path, help="the JSON file of the certificates")
    parser.add_argument("archive", type=Path, help="an .npz with grids [..., H, W]")
    parser.add_argument("--size", type=int, nargs=2, metavar=("H", "W"), required=True, help="of the grids")
    parser.add_argument("--empty", action="store_true", help="cells may be empty: the networks of variant B")
    options = parser.parse_args(arguments)
    try:
        optima = read_certificate(options.certificates, sorted(options.size), not options.empty)
        grids = _read_grids(options.archive, tuple(options.size))
    except ValueError as error:
        print(f"check_archive.py: {error}", file=sys.stderr)
        return 2
    found, faults = check(optima, grids, fill=not options.empty)
    print("cyclomatic  certified  best  networks")
    for cyclomatic, optimum in sorted(optima.items()):
        values = found.get(cyclomatic, [])
        print(f"{cyclomatic:10}  {optimum:9}  {min(values, default='-'):>4}  {len(values):8}")
    for fault in faults:
        print(f"check_archive.py: {fault}", file=sys.stderr)
    return 1 if faults else 0


def read_certificate(file: Path, sides: list[int], fill: bool) -> dict[int, int]:
    """Returns the certified fitness by feasible cyclomatic number, of grids with these sides, the shorter one first.

    Raises:
      ValueError: if the file cannot be read or has no such certificate.
    """
    try:
        listed: list[Any] = json.loads(file.read_text(encoding="utf-8"))["certificates"]
        for entry in listed:
            if sorted((entry["height"], entry["width"])) == sides and entry["fill"] == fill:
                return {niche["cyclomatic"]: niche["optimum"] for niche in entry["niches"]}
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ValueError(f"{file}: expected certificates, got {error!r}") from None
    raise ValueError(f"{file}: expected a certificate of {sides[0]} x {sides[1]} {'A' if fill else 'B'}, got none")


def _read_grids(file: Path, shape: tuple[int, int]) -> NDArray[np.integer]:
    try:
        with np.load(file, allow_pickle=False) as content:
            grids = content["grids"]
    except (OSError, ValueError, LookupError, EOFError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise ValueError(f"{file}: expected an .npz with grids, got {error!r}") from None
    whole = np.issubdtype(grids.dtype, np.integer)
    if not whole or grids.shape[-2:] != shape or (grids.size and not 0 <= grids.min() <= grids.max() <= 15):
        kind = f"{grids.dtype} {list(grids.shape)}" + (
            f", {grids.min()} to {grids.max()}" if whole and grids.size else ""
        )
        raise ValueError(f"{file}: expected codes 0 to 15 in grids [..., {shape[0]}, {shape[1]}], got {kind}")
    return grids.reshape(-1, *shape).astype(int)


if __name__ == "__main__":
    raise SystemExit(main())
