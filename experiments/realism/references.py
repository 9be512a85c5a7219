"""Maps of other generators: SUMO's netgenerate, and map-utils, which makes maps for Duckietown.

Each function takes a number of maps for each size and returns as many maps. If a generator has fewer different maps of
a size, it repeats them.

netgenerate makes networks whose junctions lie on a lattice. Each network becomes a map of tiles with one straight tile
or more between two junctions. So Duckietown's rules hold: crossings are not adjacent, and parallel roads do not touch.
"""

import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from elitelanes_jax import InputError
from elitelanes_jax.formats import read_map, without_dead_ends
from elitelanes_jax.network import SIDE_TOWARDS, canonical_form
from experiments.common import require

__all__ = ["REFERENCES", "Counts", "Generator", "netgenerate_grid", "netgenerate_rand", "rasterised", "use_map_utils"]

Counts: TypeAlias = Mapping[tuple[int, int], int]
"""The number of maps by size."""

Generator: TypeAlias = Callable[[Counts], list[NDArray[np.int8]]]
"""Makes maps of sizes."""

_TILE = 30.0
_ITERATIONS = (4, 80)  # of --rand: each adds a street

# map-utils' generator has no option for a seed.
_SEEDED = """
import random, runpy, sys
_, seed, *sys.argv = sys.argv
random.seed(int(seed))
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def rasterised(
    junctions: Mapping[str, tuple[float, float]], roads: Iterable[tuple[str, str]], tile: float
) -> NDArray[np.int8]:
    """Lays tiles along the roads of a network.

    Args:
      junctions: positions by name, x to the east and y to the north, in the unit of `tile`.
      roads: pairs of names of junctions. A road may be listed in both directions.
      tile: the side of a tile.

    Returns:
      Codes ``[H, W]``.

    Raises:
      InputError: if the junctions are not on a lattice of tiles, or a road does not run along a row or column.
    """
    names = list(junctions)
    positions = np.array([junctions[name] for name in names]) / tile
    positions = (positions - [positions[:, 0].min(), positions[:, 1].max()])[:, ::-1] * (-1, 1)
    cells = np.rint(positions).astype(int)
    if not np.allclose(positions, cells, atol=1e-3):
        raise InputError(f"network: expected junctions on a lattice of {tile:g} m, got others")
    cell_of = dict(zip(names, cells, strict=True))
    codes = np.zeros(cells.max(axis=0) + 1, np.int8)
    for start, end in roads:
        here, there = cell_of[start], cell_of[end]
        if (here == there).sum() != 1:
            raise InputError(f"network: expected roads along rows and columns of tiles, got one from {here} to {there}")
        step = np.sign(there - here)
        side = SIDE_TOWARDS[step[0], step[1]]
        for tiles in range(np.abs(there - here).max()):
            row, column = here + tiles * step
            codes[row, column] |= side.bit
            codes[row + side.down, column + side.right] |= side.opposite
    return codes


def _netgenerate(*options: str) -> NDArray[np.int8]:
    """Runs netgenerate, and lays tiles along the roads."""
    require("netgenerate needs", "eclipse-sumo")
    home = import_module("sumo").SUMO_HOME
    with tempfile.TemporaryDirectory() as folder:
        command = [str(Path(home, "bin", "netgenerate")), *options, "--plain-output-prefix", "net"]
        done = subprocess.run(
            command, cwd=folder, env={**os.environ, "SUMO_HOME": home}, capture_output=True, text=True
        )
        if done.returncode:
            raise InputError(f"netgenerate: expected a network, got: {' '.join(done.stderr.split())}")
        nodes, edges = (ET.parse(Path(folder, f"net.{kind}.xml")).getroot() for kind in ("nod", "edg"))
    junctions = {node.attrib["id"]: (float(node.attrib["x"]), float(node.attrib["y"])) for node in nodes.iter("node")}
    return rasterised(junctions, [(edge.attrib["from"], edge.attrib["to"]) for edge in edges.iter("edge")], _TILE)


def _lattices(size: tuple[int, int]) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yields the lattices that fill a size: junctions by side, and tiles from one to the next, two or more."""
    sides = [[((side - 1) // step + 1, step) for step in range(2, side) if (side - 1) % step == 0] for side in size]
    for (rows, down), (columns, right) in product(*sides):
        yield (rows, columns), (down, right)


def _repeated(found: Sequence[NDArray[np.int8]], count: int) -> list[NDArray[np.int8]]:
    return [found[index % len(found)] for index in range(count)]


def netgenerate_grid(counts: Counts) -> list[NDArray[np.int8]]:
    """Makes the networks of ``netgenerate --grid`` that fill each size, with two junctions a side or more."""
    made = []
    for size, count in tqdm(counts.items(), desc="netgenerate --grid", delay=1, disable=None):
        found = [
            _netgenerate(
                "--grid",
                *("--grid.y-number", str(rows), "--grid.x-number", str(columns)),
                *("--grid.y-length", str(_TILE * down), "--grid.x-length", str(_TILE * right)),
            )
            for (rows, columns), (down, right) in _lattices(size)
        ]
        made += _repeated(found, count)
    return made


def netgenerate_rand(counts: Counts, networks: int = 200) -> list[NDArray[np.int8]]:
    """Makes networks of ``netgenerate --rand --rand.grid``, and takes those whose sizes are nearest, in tiles.

    Junctions are two tiles apart. All other options are netgenerate's defaults. Dead ends are removed, because
    Duckietown has no tile for them. netgenerate has no option for a size, so maps are taken from networks of 4 to 80
    streets that are no longer than the longest size.
    """
    found: dict[bytes, NDArray[np.int8]] = {}
    fewest, most = _ITERATIONS
    longest_side = max(max(size) for size in counts)
    spacing = ("--rand.min-distance", str(2 * _TILE), "--rand.max-distance", str(2 * _TILE))
    for seed in tqdm(range(networks), desc="netgenerate --rand", delay=1, disable=None):
        streets = str(fewest + seed % (most - fewest + 1))
        network = _netgenerate("--rand", "--rand.grid", *spacing, "--rand.iterations", streets, "--seed", str(seed))
        grid = without_dead_ends(network)
        if grid.any() and max(_extent(grid)) <= longest_side:
            found.setdefault(canonical_form(grid), grid)
    made = []
    for size, count in counts.items():
        away = [np.abs(np.subtract(sorted(_extent(grid)), sorted(size))).sum() for grid in found.values()]
        nearest = [grid for grid, gap in zip(found.values(), away, strict=True) if gap == min(away)]
        made += _repeated(nearest, count)
    return made


def _extent(grid: NDArray[np.int8]) -> tuple[int, int]:
    """Returns the sides of the smallest rectangle with all roads."""
    rows, columns = np.nonzero(grid)
    return int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1


def use_map_utils(folder: Path | None) -> Generator:
    """Returns a function that makes maps of exactly the sizes with map-utils' ``generator.py``, without a border.

    Args:
      folder: a copy of the repository duckietown/map-utils.

    Raises:
      InputError: if the folder has no such program.
    """
    if folder is None or not (folder / "generator.py").is_file():
        raise InputError(f"map-utils: expected a folder with its generator.py, got {folder or 'none'}")
    program = (folder / "generator.py").resolve()

    def make(counts: Counts) -> list[NDArray[np.int8]]:
        made: list[NDArray[np.int8]] = []
        sizes = [size for size, count in counts.items() for _ in range(count)]
        seeds = iter(range(10 * len(sizes)))
        with tempfile.TemporaryDirectory() as scratch:
            for rows, columns in tqdm(sizes, desc="map-utils", delay=1, disable=None):
                size = ("--height", str(rows), "--width", str(columns))
                for seed in seeds:  # some seeds give no map
                    command = [sys.executable, "-c", _SEEDED, str(seed), str(program), *size, "--no-border"]
                    done = subprocess.run(command, cwd=scratch, capture_output=True, text=True)
                    if not done.returncode:
                        break
                else:
                    raise InputError(f"map-utils: expected a map, got: {' '.join(done.stderr.split())[-200:]}")
                made.append(np.asarray(read_map(Path(scratch, "output.yaml")).codes))
        return made

    return make


REFERENCES: dict[str, Generator] = {
    "netgenerate-grid": netgenerate_grid,
    "netgenerate-rand": netgenerate_rand,
}
"""Generators of the package index by name."""
