"""What duckietown-world makes of maps, in an environment of its own, and what it should make of them."""

import json
import subprocess
from collections import Counter
from itertools import permutations
from pathlib import Path

import pytest

from elitelanes_jax.lanes.links import linked_tiles, walk_roads
from elitelanes_jax.network.codes import CONNECTIONS
from elitelanes_jax.network.metrics import measure

OWN_ENVIRONMENT = Path(__file__).parents[2] / ".venv-duckietown" / "bin" / "python"
PROGRAMS = Path(__file__).parent / "duckietown_world"


def lanes_on_tiles(grid):
    """All ways across a tile, by the borders where they begin and end.

    A border is that between two tiles, in the direction of travel.
    """
    return Counter(
        (*one, *tile, *tile, *other)
        for tile, linked in linked_tiles(grid).items()
        for one, other in permutations(linked, 2)
    )


def lanes(grid):
    """What duckietown-world should make of a grid: its lanes between crossings and across them, by their ends."""
    links = linked_tiles(grid)
    crossings = {tile for tile in links if CONNECTIONS[grid[tile]] >= 3}
    expected = Counter({ends: 1 for ends in lanes_on_tiles(grid) if ends[2:4] in crossings})
    for path in walk_roads(links, crossings | {tile for tile in links if len(links[tile]) < 2}):
        if {path[0], path[-1]} <= crossings and len(path) > 2:
            for way in (path, path[::-1]):
                expected[(*way[0], *way[1], *way[-2], *way[-1])] += 1
    return expected


def say_by_duckietown_world(program, *arguments):
    if not OWN_ENVIRONMENT.exists():
        pytest.skip("duckietown-world is not here: make duckietown")
    done = subprocess.run([OWN_ENVIRONMENT, PROGRAMS / program, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def read_by_duckietown_world(files):
    read = say_by_duckietown_world("lanes.py", *files)
    assert len(read) == len(files)
    return read


def check_lanes(grid, graph):
    metrics = measure(grid)
    sides = int(CONNECTIONS[grid][CONNECTIONS[grid] >= 3].sum())
    assert "nodes" in graph, graph
    assert graph["nodes"] == 2 * sides - metrics.adjacent_crossings
    assert Counter((*start, *end) for start, end in graph["lanes"]) == lanes(grid)
    assert Counter((*start, *end) for start, end in graph["on_tiles"]) == lanes_on_tiles(grid)
