"""Maps of generators that are not ours: SUMO's netgenerate, and map-utils, which makes maps for Duckietown.

Each function takes the sizes that are asked for, with a number of maps of each, and returns that many maps, those of a
size with fewer more than once.

netgenerate makes networks whose junctions lie on a lattice. Each becomes a map of tiles with a straight one at least
between two junctions: so Duckietown's rules hold, that crossings are not adjacent and roads do not lie side by side.
"""

import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.progress import Progress
from elitelanes_jax.formats import read_map, without_dead_ends
from elitelanes_jax.network import SIDE_TOWARDS, canonical_form

__all__ = ["REFERENCES", "netgenerate_grid", "netgenerate_rand", "rasterised", "use_map_utils"]

_TILE = 30.0
_ITERATIONS = (4, 80)  # of --rand: each adds a street

# map-utils' generator draws a seed of its own: with this it is the same each time.
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
      junctions: places by name, x to the east and y to the north, in the unit of `tile`.
      roads: names of junctions; a road may be there in both directions.
      tile: the side of a tile.

    Returns:
      Codes ``[H, W]``.

    Raises:
      InputError: if a junction is not in the middle of a tile, the first one being in that of its own, or a road does
        not run along a row or column of tiles.
    """
    names = list(junctions)
    places = np.array([junctions[name] for name in names]) / tile
    places -= [places[:, 0].min(), places[:, 1].max()]
    cells = np.rint(places[:, ::-1] * (-1, 1)).astype(int)
    if not np.allclose(places[:, ::-1] * (-1, 1), cells, atol=1e-3):
        raise InputError(f"network: expected junctions on a lattice of {tile:g} m, got others")
    cell_of = dict(zip(names, cells, strict=True))
    codes = np.zeros(cells.max(axis=0) + 1, np.int8)
    for start, end in roads:
        here, there = cell_of[start], cell_of[end]
        if (here == there).sum() != 1:
            raise InputError(f"network: expected roads along rows and columns of tiles, got one from {here} to {there}")
        step = np.sign(there - here)
        side = SIDE_TOWARDS[step[0], step[1]]
        for number in range(np.abs(there - here).max()):
            row, column = here + number * step
            codes[row, column] |= side.bit
            codes[row + side.down, column + side.right] |= side.opposite
    return codes


def _netgenerate(*options: str) -> NDArray[np.int8]:
    """Runs netgenerate, and lays tiles along the roads."""
    home = import_optional("sumo", "netgenerate is SUMO's", "eclipse-sumo").SUMO_HOME
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
    ways = [[((side - 1) // step + 1, step) for step in range(2, side) if (side - 1) % step == 0] for side in size]
    for (rows, down), (columns, right) in product(*ways):
        yield (rows, columns), (down, right)


def _fill(found: Sequence[NDArray[np.int8]], count: int) -> list[NDArray[np.int8]]:
    return [found[place % len(found)] for place in range(count)]


def netgenerate_grid(wanted: Mapping[tuple[int, int], int]) -> list[NDArray[np.int8]]:
    """Makes the networks of ``netgenerate --grid`` that fill each size, two junctions a side or more."""
    made = []
    with Progress("netgenerate --grid", len(wanted), "sizes") as progress:
        for size, count in wanted.items():
            found = [
                _netgenerate(
                    "--grid",
                    *("--grid.y-number", str(rows), "--grid.x-number", str(columns)),
                    *("--grid.y-length", str(_TILE * down), "--grid.x-length", str(_TILE * right)),
                )
                for (rows, columns), (down, right) in _lattices(size)
            ]
            made += _fill(found, count)
            progress.count()
    return made


def netgenerate_rand(wanted: Mapping[tuple[int, int], int], networks: int = 200) -> list[NDArray[np.int8]]:
    """Makes networks of ``netgenerate --rand --rand.grid``, and takes those whose sizes are nearest, in tiles.

    Junctions are two tiles apart, all other options netgenerate's own. Roads that lead nowhere, which Duckietown has no
    tile for, are left out. No size can be asked for: maps are taken from networks of 4 to 80 streets that are no longer
    than the longest size.
    """
    found: dict[bytes, NDArray[np.int8]] = {}
    shortest, longest = _ITERATIONS
    longest_side = max(max(size) for size in wanted)
    with Progress("netgenerate --rand", networks, "networks") as progress:
        for number in range(networks):
            spacing = (*("--rand.min-distance", str(2 * _TILE)), *("--rand.max-distance", str(2 * _TILE)))
            streets = shortest + number % (longest - shortest + 1)
            grid = without_dead_ends(
                _netgenerate(
                    *("--rand", "--rand.grid", *spacing),
                    *("--rand.iterations", str(streets), "--seed", str(number)),
                )
            )
            if grid.any() and max(_extent(grid)) <= longest_side:
                found.setdefault(canonical_form(grid), grid)
            progress.count()
    made = []
    for size, count in wanted.items():
        away = [np.abs(np.subtract(sorted(_extent(grid)), sorted(size))).sum() for grid in found.values()]
        nearest = [grid for grid, gap in zip(found.values(), away, strict=True) if gap == min(away)]
        made += _fill(nearest, count)
    return made


def _extent(grid: NDArray[np.int8]) -> tuple[int, int]:
    """Returns the sides of the smallest rectangle with all roads."""
    rows, columns = np.nonzero(grid)
    return int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1


def use_map_utils(folder: Path | None) -> Callable[[Mapping[tuple[int, int], int]], list[NDArray[np.int8]]]:
    """Returns a function that makes maps of exactly the sizes by map-utils' ``generator.py``, without a border.

    Args:
      folder: a copy of the repository duckietown/map-utils.

    Raises:
      InputError: if the folder has no such program.
    """
    if folder is None or not (folder / "generator.py").is_file():
        raise InputError(f"map-utils: expected a folder with its generator.py, got {folder or 'none'}")
    program = (folder / "generator.py").resolve()

    def make(wanted: Mapping[tuple[int, int], int]) -> list[NDArray[np.int8]]:
        made: list[NDArray[np.int8]] = []
        seeds = iter(range(10 * sum(wanted.values())))
        with Progress("map-utils", sum(wanted.values()), "maps") as progress, tempfile.TemporaryDirectory() as scratch:
            output = Path(scratch, "output.yaml")
            for (rows, columns), count in wanted.items():
                for _ in range(count):
                    size = ("--height", str(rows), "--width", str(columns))
                    for seed in seeds:  # it gives up now and then
                        command = [sys.executable, "-c", _SEEDED, str(seed), str(program), *size, "--no-border"]
                        done = subprocess.run(command, cwd=scratch, capture_output=True, text=True)
                        if not done.returncode:
                            break
                    else:
                        raise InputError(f"map-utils: expected a map, got: {' '.join(done.stderr.split())[-200:]}")
                    made.append(np.asarray(read_map(output).codes))
                    progress.count()
        return made

    return make


REFERENCES: dict[str, Callable[[Mapping[tuple[int, int], int]], list[NDArray[np.int8]]]] = {
    "netgenerate-grid": netgenerate_grid,
    "netgenerate-rand": netgenerate_rand,
}
"""Generators of the package index by name."""
