"""The maps that simulators are checked with, and what their lanes should be, by the graph of tiles."""

import os
from functools import cache
from itertools import permutations
from pathlib import Path

import jax
import networkx as nx
import numpy as np
import pytest
from conftest import ALL_SHAPES, grids
from hypothesis import example, given
from oracle import road_graph

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats import RoadMap, read_map
from elitelanes_jax.maps import furnish
from elitelanes_jax.network.bits import random_grids
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.network.growth import grow_town
from elitelanes_jax.network.repairing import repair
from elitelanes_jax.network.wfc import generate_batch

STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1))  # rows and columns, by heading
SIDES = ("north", "east", "south", "west")
TURNS = {1: "right", 0: "straight", 3: "left", 2: "back"}  # by quarter turns clockwise
AHEAD = np.array([1j, 1, -1j, -1])  # x east, y north

_SIZES = (4, 6, 9, 12, 16, 20, 24)
_grow = jax.jit(grow_town, static_argnums=1)

# Those of duckietown-world, where make duckietown has installed it.
_PEOPLES = Path(__file__).parents[2].glob(".venv-duckietown/**/gd1/maps/*.yaml")

KNOT = np.array([[6, 3, 0], [12, 15, 1], [0, 8, 0]], np.int8)  # a road back to its own crossing, and two dead ends
RING = np.array([[6, 3], [12, 9]], np.int8)
BLOCK = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)  # crossings next to crossings
BATCHES = ["people", *range(40)]
KEPT = Path(__file__).parents[2] / "results" / "maps-of-networks.npz"


def on_any_roads(test):
    """Runs a test on all sorts of grids that have a road."""
    for grid in (KNOT, RING, BLOCK):
        test = example(grid)(test)
    return given(grids(ALL_SHAPES).filter(lambda grid: road_graph(grid).number_of_edges()))(test)


def maps(batch):
    """The maps of a batch's number, or those that people made."""
    return (peoples_maps() if batch == "people" else maps_of(batch)) or pytest.skip("people's maps: make duckietown")


@cache
def maps_of(batch, number=25):
    """Some of a thousand maps of three sources: WFC, half of them with dead ends; repaired noise; grown towns.

    Half of the maps of each source and size have signs and lights, at crossings with room for them.
    """
    if not KEPT.exists():
        KEPT.parent.mkdir(exist_ok=True)
        part = KEPT.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(part, **{str(seed): draw(seed) for seed in range(1000)})
        part.replace(KEPT)
    with np.load(KEPT) as kept:
        seeds = range(batch * number, (batch + 1) * number)
        spec = "signs=possible lights=0.3"
        return [furnish(kept[str(seed)], spec) if seed // 21 % 2 else RoadMap(kept[str(seed)]) for seed in seeds]


def draw(seed):
    side = _SIZES[seed // 3 % len(_SIZES)]
    key = jax.random.fold_in(jax.random.key(36), seed)
    if seed % 3 == 0:
        codes = range(16) if seed % 2 else ROAD_ALPHABET
        return generate_batch(np.random.default_rng(seed), 1, (side, side), alphabet=codes, border="closed").grid[0]
    if seed % 3 == 1:
        return np.asarray(repair(random_grids(key, 1, (side, side))[0], fill=True))
    return np.asarray(_grow(key, (side, side)))


@cache
def peoples_maps():
    """Maps that people made, with their dead ends and objects, of all files that have lanes."""
    found = []
    for file in sorted(_PEOPLES):
        try:
            road_map = read_map(file)
        except InputError:
            continue
        if road_graph(road_map.codes).number_of_edges():
            found.append(road_map)
    return found


def lane_graph(grid):
    """Lanes as nodes (row, column, heading in, heading out), and what follows each; back only at dead ends."""
    tiles = road_graph(grid)
    heading = {step: index for index, step in enumerate(STEPS)}
    lanes = set()
    for row, column in tiles:
        sides = [heading[other[0] - row, other[1] - column] for other in tiles[row, column]]
        pairs = permutations(sides, 2) if len(sides) > 1 else [(side, side) for side in sides]
        lanes |= {(row, column, (one + 2) % 4, other) for one, other in pairs}
    entries = {}
    for lane in lanes:
        entries.setdefault(lane[:3], []).append(lane)
    graph = nx.DiGraph()
    graph.add_nodes_from(sorted(lanes))
    for row, column, into, out in sorted(lanes):
        down, right = STEPS[out]
        graph.add_edges_from(((row, column, into, out), other) for other in entries[row + down, column + right, out])
    return graph


def name(lane):
    row, column, into, out = lane
    return f"{row}_{column}_{SIDES[(into + 2) % 4]}_{TURNS[(out - into) % 4]}"


def distances(points, lane, grid, streets):
    """Metres from points (x + y·i) to a lane's centre, which continues beyond its tile as a line or a circle."""
    row, column, into, out = lane
    tile = streets.tile_size
    centre = (column + 0.5 + (len(grid) - row - 0.5) * 1j) * tile
    ahead = AHEAD[into]
    turn = TURNS[(out - into) % 4]
    local = (np.asarray(points) - centre) / ahead  # real: ahead; imaginary: to the left
    if turn == "straight":
        return abs(local.imag + streets.lane / 2)
    if turn == "back":
        straight = abs(abs(local.imag) - streets.lane / 2)
        return np.where(local.real < 0, straight, abs(abs(local) - streets.lane / 2))
    left = 1 if turn == "left" else -1
    return abs(abs(local - (-1 + left * 1j) * tile / 2) - (tile + left * streets.lane) / 2)


def all_reach_all(graph, grid):
    """Whether each lane is reached from each other one on its roads; on a ring, from those of its direction."""
    tiles = road_graph(grid)
    parts = [tiles.subgraph(part) for part in nx.connected_components(tiles) if len(part) > 1]
    directions = sum(2 if all(part.degree(tile) == 2 for tile in part) else 1 for part in parts)
    return nx.number_strongly_connected_components(graph) == directions
