"""Baselines for the kernels: the same metrics and the same search, written in the usual ways.

`networkx_fitness` uses NumPy for the tiles and NetworkX for the graph. `tarjan_fitness` is written for speed: loops
compiled by Numba, components and bridges by Tarjan's depth-first search. `cpp_fitness` is the same in C++.
`tarjan_map_elites` is the paper's whole MAP-Elites with that fitness, also compiled by Numba.
"""

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.check_archive import rescore

__all__ = ["cpp_fitness", "networkx_fitness", "tarjan_fitness", "tarjan_map_elites"]

_ROAD = np.array([3, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15], np.int8)
_VACANT = 2**31 - 1


def networkx_fitness(grids: NDArray[np.int8]) -> NDArray[np.int64]:
    """Computes the paper's fitness of grids ``[B, H, W]``, one after another."""
    return np.array([rescore(grid).fitness for grid in grids])


def cpp_fitness() -> Callable[[NDArray[np.int8]], NDArray[np.int32]] | None:
    """Compiles `tarjan.cpp`, which computes the paper's fitness of grids ``[B, H, W]``; None without a compiler."""
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    if compiler is None:
        return None
    source = Path(__file__).with_name("tarjan.cpp")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "tarjan.so"
        command = [compiler, "-O3", "-march=native", "-std=c++17", "-shared", "-fPIC", str(source), "-o", str(library)]
        subprocess.run(command, check=True)
        call = ctypes.CDLL(str(library)).fitness  # stays loaded without its file

    def fitness(grids: NDArray[np.int8]) -> NDArray[np.int32]:
        grids, result = np.ascontiguousarray(grids), np.empty(len(grids), np.int32)
        sizes = [ctypes.c_int64(size) for size in grids.shape]
        call(ctypes.c_void_p(grids.ctypes.data), ctypes.c_void_p(result.ctypes.data), *sizes)
        return result

    return fitness


@numba.njit(cache=True)
def tarjan_fitness(grids: NDArray[np.int8]) -> NDArray[np.int32]:
    """Computes the paper's fitness of grids ``[B, H, W]``, one after another."""
    result = np.empty(len(grids), np.int32)
    scratch = np.empty((5, grids.shape[1] * grids.shape[2]), np.int32)
    for index in range(len(grids)):
        result[index] = _tarjan(grids[index], scratch)[0]
    return result


@numba.njit(cache=True)
def _tarjan(grid: NDArray[np.int8], scratch: NDArray[np.int32]) -> tuple[int, int, int, int, int, int]:
    """Returns fitness, cyclomatic number, components, dead ends, adjacent crossings, adjacent turns."""
    height, width = grid.shape
    found, low, parent, side, stack = scratch
    down, right = (-1, 0, 1, 0), (0, 1, 0, -1)
    tiles = edges = dead_ends = violations = pairs = turns = straight = 0
    for row in range(height):
        for column in range(width):
            code = grid[row, column]
            found[row * width + column] = -1
            if code == 0:
                continue
            tiles += 1
            count = (code >> 3 & 1) + (code >> 2 & 1) + (code >> 1 & 1) + (code & 1)
            unmatched = outward = False
            for k in range(4):
                if code >> (3 - k) & 1:
                    y, x = row + down[k], column + right[k]
                    if y < 0 or y >= height or x < 0 or x >= width:
                        outward = True
                    elif grid[y, x] >> (3 - (k + 2 & 3)) & 1:
                        if k == 1 or k == 2:
                            edges += 1
                            other = grid[y, x]
                            others = (other >> 3 & 1) + (other >> 2 & 1) + (other >> 1 & 1) + (other & 1)
                            if count >= 3 and others >= 3:
                                pairs += 1
                    else:
                        unmatched = True
            violations += outward
            dead_ends += unmatched or outward or count == 1
            if code == 3 or code == 6 or code == 9 or code == 12:
                if column + 1 < width:
                    other = grid[row, column + 1]
                    turns += other == 3 or other == 6 or other == 9 or other == 12
                if row + 1 < height:
                    other = grid[row + 1, column]
                    turns += other == 3 or other == 6 or other == 9 or other == 12
    for row in range(height):
        run = 0
        for column in range(width):
            if grid[row, column] == 5:
                run += 1
            else:
                straight += run * run
                run = 0
        straight += run * run
    for column in range(width):
        run = 0
        for row in range(height):
            if grid[row, column] == 10:
                run += 1
            else:
                straight += run * run
                run = 0
        straight += run * run

    components = bridges = time = 0
    for start in range(height * width):
        if grid[start // width, start % width] == 0 or found[start] >= 0:
            continue
        components += 1
        top = 0
        stack[0] = start
        found[start] = low[start] = time
        time += 1
        parent[start] = -1
        side[start] = 0
        while top >= 0:
            here = stack[top]
            if side[here] < 4:
                k = side[here]
                side[here] += 1
                row, column = here // width, here % width
                if not grid[row, column] >> (3 - k) & 1:
                    continue
                y, x = row + down[k], column + right[k]
                if y < 0 or y >= height or x < 0 or x >= width or not grid[y, x] >> (3 - (k + 2 & 3)) & 1:
                    continue
                there = y * width + x
                if found[there] < 0:
                    found[there] = low[there] = time
                    time += 1
                    parent[there] = here
                    side[there] = 0
                    top += 1
                    stack[top] = there
                elif there != parent[here]:
                    low[here] = min(low[here], found[there])
            else:
                top -= 1
                above = parent[here]
                if above >= 0:
                    low[above] = min(low[above], low[here])
                    bridges += low[here] > found[above]
    cyclomatic = edges - tiles + components
    fitness = (
        480 * dead_ends
        + 300 * max(components - 1, 0)
        + 150 * violations
        + 100 * bridges
        + 200 * pairs
        + 80 * turns
        - 2 * cyclomatic
        - 2 * straight
    )
    return fitness, cyclomatic, components, dead_ends, pairs, turns


@numba.njit(cache=True)
def _settle(grid: NDArray[np.int8], row: int, column: int) -> None:
    """Matches the neighbours of a tile to it, and removes its connections that leave the grid."""
    height, width = grid.shape
    down, right = (-1, 0, 1, 0), (0, 1, 0, -1)
    for k in range(4):
        y, x = row + down[k], column + right[k]
        bit, back = 8 >> k, 8 >> (k + 2 & 3)
        if y < 0 or y >= height or x < 0 or x >= width:
            grid[row, column] &= 15 ^ bit
        elif grid[row, column] & bit:
            grid[y, x] |= back
        else:
            grid[y, x] &= 15 ^ back


@numba.njit(cache=True)
def tarjan_map_elites(seed: int, height: int, width: int, generations: int) -> NDArray[np.int32]:
    """Runs the paper's MAP-Elites: 20 parents, 40 offspring, 400 niches. Returns the archive's fitness ``[400]``."""
    np.random.seed(seed)
    parents, offspring, most = 20, 40, _VACANT
    scratch = np.empty((5, height * width), np.int32)
    grids = np.empty((parents + offspring, height, width), np.int8)
    fitness = np.empty(parents + offspring, np.int32)
    archive = np.zeros((400, height, width), np.int8)
    best = np.full(400, most, np.int32)
    for index in range(parents):
        for row in range(height):
            for column in range(width):
                grids[index, row, column] = _ROAD[np.random.randint(11)]
        for row in range(height):
            for column in range(width):
                _settle(grids[index], row, column)
        fitness[index] = _tarjan(grids[index], scratch)[0]
    order = np.argsort(fitness[:parents], kind="mergesort")
    grids[:parents] = grids[:parents][order]
    fitness[:parents] = fitness[:parents][order]
    for _ in range(generations):
        for index in range(parents, parents + offspring):
            winner = min(np.random.randint(parents), np.random.randint(parents), np.random.randint(parents))
            grid = grids[index]
            grid[:] = grids[winner]
            if np.random.random() < 0.7:
                row, column = np.random.randint(height), np.random.randint(width)
                code = grid[row, column]
                while code == grid[row, column]:
                    code = _ROAD[np.random.randint(11)]
                grid[row, column] = code
                _settle(grid, row, column)
            if np.random.random() < 0.5:
                row, column = np.random.randint(height), np.random.randint(width)
                grid[row, column] = (7, 11, 13, 14, 15)[np.random.randint(5)]
                _settle(grid, row, column)
            value, cyclomatic, components, dead_ends, pairs, turns = _tarjan(grid, scratch)
            fitness[index] = value
            niche = min(cyclomatic // 2, 24) * 16
            niche += 8 * (components > 1) + 4 * (dead_ends > 0) + 2 * (pairs > 0) + (turns > 0)
            if value < best[niche]:
                best[niche] = value
                archive[niche] = grid
        order = np.argsort(fitness, kind="mergesort")[:parents]
        grids[:parents] = grids[order]
        fitness[:parents] = fitness[order]
    return best
