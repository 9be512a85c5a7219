"""Maps for robots: nav2's and MovingAI's files, by readers of their formats' rules, and the graph of lanes in them."""

import json
import math
import subprocess
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import yaml
from conftest import grids
from hypothesis import assume, example, given, settings
from oracle import road_graph
from simulator_maps import KNOT

from elitelanes_jax import InputError, RoadMap
from elitelanes_jax.drive import lane_nodes, movements
from elitelanes_jax.drive.lanes import Movement, lane_length, lane_point, on_road
from elitelanes_jax.formats import to_movingai, to_nav2
from elitelanes_jax.formats.streets import LENGTHS, lane_graph, lane_points
from elitelanes_jax.network import wfc
from elitelanes_jax.network.movements import linked_codes

TOWN = wfc.generate_batch(np.random.default_rng(0), 1, (9, 7), border="closed").grid[0]
ANY = np.random.default_rng(1).integers(0, 16, (9, 7)).astype(np.int8)


@pytest.mark.parametrize("grid", [TOWN, ANY], ids=["town", "any"])
def test_the_graph_of_lanes_is_that_of_the_drive_room(grid):
    moves = np.argwhere(np.asarray(movements(grid)))
    graph = lane_graph(grid)
    assert np.asarray(lane_nodes(grid))[tuple(graph.nodes.T)].all()
    starts = graph.nodes[graph.edges[:, 0]]
    np.testing.assert_array_equal(np.c_[starts, graph.turns], moves)
    every = Movement(*moves.T.astype(np.int32))
    after = np.stack(every.next_node, axis=-1)
    np.testing.assert_array_equal(graph.nodes[graph.edges[:, 1]], after)
    np.testing.assert_allclose(LENGTHS[graph.turns], np.asarray(lane_length(every.turn)), rtol=1e-6)
    for share in (0, 0.3, 1):
        there = lane_point(every, share * lane_length(every.turn))
        ours = lane_points(graph, len(grid), [share])[:, 0]
        np.testing.assert_allclose(ours, np.asarray(there.x) + 1j * (len(grid) - np.asarray(there.y)), atol=1e-5)


def test_a_map_without_a_lane_is_refused():
    for write in (lane_graph, lambda codes: to_nav2(codes, "town.pgm")):
        with pytest.raises(InputError, match="expected a lane"):
            write([[4, 1], [0, 0]])
    with pytest.raises(InputError, match="expected a road"):
        to_movingai([[0, 0], [0, 0]], "town.map")


def read_pgm(content):
    """A binary PGM as its format says: magic, width, height and the largest value, then the rows from the top."""
    magic, size, largest, pixels = content.split(b"\n", 3)
    width, height = map(int, size.split())
    assert (magic, largest, len(pixels)) == (b"P5", b"255", width * height)
    return np.frombuffer(pixels, np.uint8).reshape(height, width)


def test_the_map_server_finds_what_is_free_where_the_road_is():
    """A pixel is free or occupied by the rules of nav2's map server, at the place that they give it."""
    grid, about, _ = made = to_nav2(TOWN, "town.pgm", cells=20)
    assert made == to_nav2(RoadMap(TOWN), "town.pgm", cells=20)
    pixels, rules = read_pgm(grid), yaml.safe_load(about)
    assert rules["image"] == "town.pgm" and rules["mode"] == "trinary" and rules["negate"] == 0
    height = len(TOWN)
    assert pixels.shape[0] * rules["resolution"] == pytest.approx(0.585 * height)
    occupancy = (255 - pixels / 1) / 255
    free, occupied = occupancy < rules["free_thresh"], occupancy > rules["occupied_thresh"]
    assert (free != occupied).all()
    x = rules["origin"][0] + (np.arange(pixels.shape[1]) + 0.5) * rules["resolution"]
    y = rules["origin"][1] + (pixels.shape[0] - np.arange(pixels.shape[0]) - 0.5) * rules["resolution"]
    east, south = np.meshgrid(x / 0.585, height - y / 0.585)
    codes = linked_codes(TOWN)[south.astype(int), east.astype(int)]
    np.testing.assert_array_equal(free, np.asarray(on_road(codes, east % 1, south % 1)))


@settings(max_examples=30)
@given(grids())
@example(TOWN)
@example(KNOT)
def test_the_route_server_finds_the_lanes(grid):
    """Read as nav2's route server does: nodes are points, edges lines, numbers are unique among both."""
    assume(np.asarray(movements(grid)).any())
    features = json.loads(to_nav2(grid, "town.pgm", tile_size=2).graph)["features"]
    numbers = [feature["properties"]["id"] for feature in features]
    assert len(set(numbers)) == len(numbers)
    found = nx.DiGraph()
    for feature in features:  # nodes come first
        about, geometry = feature["properties"], feature["geometry"]
        if geometry["type"] == "Point":
            assert about["frame"] == "map"
            found.add_node(about["id"], at=complex(*geometry["coordinates"]))
            continue
        assert geometry["type"] == "MultiLineString"
        (line,) = geometry["coordinates"]
        start, end = (complex(*place) for place in line)
        assert (found.nodes[about["startid"]]["at"], found.nodes[about["endid"]]["at"]) == (start, end)
        assert abs(end - start) - 1e-5 <= about["cost"] < 1.02 * abs(end - start)
        found.add_edge(about["startid"], about["endid"], cost=about["cost"])
    graph = lane_graph(grid)
    expected = nx.DiGraph()
    used = sorted(set(graph.edges.ravel().tolist()))
    expected.add_nodes_from(used)
    for (start, end), turn in zip(graph.edges.tolist(), graph.turns, strict=True):
        expected.add_edge(start, end, cost=2 * LENGTHS[turn])
    assert set(used) <= set(found)
    for start in used[:5]:
        ours = nx.single_source_dijkstra_path_length(expected, start, weight="cost")
        theirs = nx.single_source_dijkstra_path_length(found, start, weight="cost")
        assert {node: theirs.get(node) for node in used if node in ours} == pytest.approx(ours, abs=1e-3)
        assert set(theirs) & set(used) == set(ours)


def read_movingai(text):
    """Which cells of a MovingAI map can be entered."""
    kind, height, width, start, *rows = text.splitlines()
    assert (kind, start) == ("type octile", "map")
    assert height == f"height {len(rows)}" and {f"width {len(row)}" for row in rows} == {width}
    assert set("".join(rows)) <= set(".@")
    return np.array([[cell == "." for cell in row] for row in rows])


def octile_steps(free, cell):
    """The neighbours of a cell, with the straight and the diagonal steps to them; no corner is cut."""
    row, column = cell
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            beside = [(row + down, column + right), (row + down, column), (row, column + right)]
            within = all(0 <= y < free.shape[0] and 0 <= x < free.shape[1] for y, x in beside)
            if (down or right) and within and all(free[place] for place in beside):
                yield beside[0], abs(down * right)


def cells_of(free):
    """The graph of the cells that can be entered, with the lengths of steps."""
    graph = nx.Graph()
    for cell in map(tuple, np.argwhere(free).tolist()):
        graph.add_node(cell)
        for other, slanted in octile_steps(free, cell):
            graph.add_edge(cell, other, length=math.sqrt(1 + slanted))
    return graph


@pytest.mark.parametrize(("codes", "cells"), [(TOWN, 5), (TOWN, 8), (KNOT, 6)])
def test_the_lengths_of_tasks_are_those_of_shortest_paths(codes, cells):
    grid, tasks = to_movingai(codes, "town.map", cells)
    free, (version, *lines) = read_movingai(grid), tasks.splitlines()
    assert version == "version 1" and len(lines) == 100
    assert to_movingai(codes, "town.map", cells) == (grid, tasks)
    listed, graph = [], cells_of(free)
    for line in lines:
        bucket, name, width, height, *ends, length = line.split("\t")
        assert (name, int(height), int(width)) == ("town.map", *free.shape)
        x, y, goal_x, goal_y = map(int, ends)
        shortest = nx.dijkstra_path_length(graph, (y, x), (goal_y, goal_x), "length")
        assert float(length) == pytest.approx(shortest, abs=6e-9)
        assert int(bucket) == float(length) // 4
        listed.append(float(length))
    assert listed == sorted(listed)


@settings(max_examples=40)
@given(grids())
@example(TOWN)
def test_cells_are_connected_as_tiles_are(grid):
    """The roads of tiles that are not linked do not touch, not even over a corner."""
    assume(linked_codes(np.asarray(grid)).any())
    links = road_graph(np.asarray(linked_codes(np.asarray(grid))))
    for cells in (5, 6, 7):
        free = read_movingai(to_movingai(grid, "town.map", cells)[0])
        graph = cells_of(free)
        found = {(one[0] // cells, one[1] // cells, two[0] // cells, two[1] // cells) for one, two in graph.edges}
        pairs = {frozenset(((a, b), (c, d))) for a, b, c, d in found if (a, b) != (c, d)}
        assert set(map(frozenset, links.edges)) == {
            pair for pair in pairs if sum(abs(one - two) for one, two in zip(*pair, strict=True)) == 1
        }
        assert nx.number_connected_components(graph) == nx.number_connected_components(links)


@pytest.mark.slow
def test_pogema_leads_a_robot_through_the_maps(tmp_path):
    """POGEMA has an environment of its own, as it needs an older NumPy: make pogema."""
    python = Path(__file__).parents[2] / ".venv-pogema" / "bin" / "python"
    if not python.exists():
        pytest.skip("POGEMA is not installed")
    for number in range(100):
        rng = np.random.default_rng(number)
        codes = wfc.generate_batch(rng, 1, tuple(rng.integers(6, 25, 2).tolist()), border="closed").grid[0]
        for suffix, text in zip((".map", ".scen"), to_movingai(codes, f"{number}.map"), strict=True):
            (tmp_path / f"{number}{suffix}").write_text(text)
    script = Path(__file__).with_name("pogema_reads.py")
    subprocess.run([python, script, tmp_path], check=True, env={"PATH": ""}, capture_output=True)


@pytest.mark.parametrize("name", [None, "", "a\tmap", "a\nmap"])
def test_names_that_no_list_of_tasks_can_hold_are_refused(name):
    with pytest.raises(InputError, match="name: expected"):
        to_movingai(TOWN, name)
