"""Measures an archive and compares it with the certificates, with NumPy and NetworkX alone.

    python -m experiments.search.check_archive CERTIFICATES ARCHIVE --size H W [--empty]

The archive is an ``.npz`` with ``grids``, integer codes ``[..., H, W]``. For each cyclomatic number, the program prints
the certified optimum, and the best fitness and the number of the archive's flawless networks. Exit code 1 means that a
network contradicts a certificate, 2 that the input cannot be read.
"""

import argparse
import json
import sys
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import networkx as nx
import numpy as np
from numpy.typing import NDArray

__all__ = ["Score", "check", "main", "read_certificate", "rescore"]

_NORTH, _EAST, _SOUTH, _WEST = 8, 4, 2, 1


class Score(NamedTuple):
    """The fitness and the cyclomatic number of a network, whether it is flawless, and whether every cell is filled."""

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

    nodes = np.arange(grid.size).reshape(grid.shape)
    graph = nx.Graph()
    graph.add_nodes_from(nodes[grid > 0].tolist())
    graph.add_edges_from(zip(nodes[:, :-1][east].tolist(), nodes[:, 1:][east].tolist(), strict=True))
    graph.add_edges_from(zip(nodes[:-1][south].tolist(), nodes[1:][south].tolist(), strict=True))
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
    optima: Mapping[int, int], grids: Iterable[NDArray[np.integer]], *, fill: bool
) -> tuple[dict[int, list[int]], list[str]]:
    """Compares networks with certificates.

    Args:
      optima: the certified fitness by feasible cyclomatic number.
      grids: of codes. A grid that is not flawless does not count, nor one with an empty cell if `fill` is set.
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
            expected = "no network" if certified is None else f"{certified} at best"
            faults.append(
                f"cyclomatic number {score.cyclomatic}: certified {expected}, got {score.fitness}: {grid.tolist()}"
            )
    return found, faults


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="check_archive", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("certificates", type=Path, help="the JSON file of the certificates")
    parser.add_argument("archive", type=Path, help="an .npz with grids [..., H, W]")
    parser.add_argument("--size", type=int, nargs=2, metavar=("H", "W"), required=True, help="of the grids")
    parser.add_argument("--empty", action="store_true", help="cells may be empty: the networks of variant B")
    options = parser.parse_args(arguments)
    try:
        optima = read_certificate(options.certificates, sorted(options.size), not options.empty)
        grids = _read_grids(options.archive, tuple(options.size))
    except ValueError as error:
        print(f"check_archive: {error}", file=sys.stderr)
        return 2
    found, faults = check(optima, grids, fill=not options.empty)
    print("cyclomatic  certified  best  networks")
    for cyclomatic, optimum in sorted(optima.items()):
        values = found.get(cyclomatic, [])
        print(f"{cyclomatic:10}  {optimum:9}  {min(values, default='-'):>4}  {len(values):8}")
    for fault in faults:
        print(f"check_archive: {fault}", file=sys.stderr)
    return 1 if faults else 0


def read_certificate(file: Path, sides: Sequence[int], fill: bool) -> dict[int, int]:
    """Returns the certified fitness of a size by feasible cyclomatic number.

    Args:
      file: the certificates.
      sides: the shorter side first.
      fill: whether every cell is filled.

    Raises:
      ValueError: if the file cannot be read or has no such certificate.
    """
    try:
        for entry in json.loads(file.read_text(encoding="utf-8"))["certificates"]:
            if sorted((entry["height"], entry["width"])) == list(sides) and entry["fill"] == fill:
                return {niche["cyclomatic"]: niche["optimum"] for niche in entry["niches"]}
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ValueError(f"{file}: expected certificates, got {error!r}") from None
    raise ValueError(f"{file}: expected a certificate of {sides[0]} x {sides[1]} {'A' if fill else 'B'}, got none")


def _read_grids(file: Path, shape: tuple[int, int]) -> NDArray[np.int_]:
    try:
        with np.load(file, allow_pickle=False) as content:
            grids = content["grids"]
    except (OSError, ValueError, LookupError, EOFError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise ValueError(f"{file}: expected an .npz with grids, got {error!r}") from None
    integers = np.issubdtype(grids.dtype, np.integer)
    if not integers or grids.shape[-2:] != shape or (grids.size and not 0 <= grids.min() <= grids.max() <= 15):
        got = f"{grids.dtype} {list(grids.shape)}"
        got += f", {grids.min()} to {grids.max()}" if integers and grids.size else ""
        raise ValueError(f"{file}: expected codes 0 to 15 in grids [..., {shape[0]}, {shape[1]}], got {got}")
    return grids.reshape(-1, *shape).astype(int)


if __name__ == "__main__":
    raise SystemExit(main())
