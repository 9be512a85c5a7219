"""Networks for SUMO: the plain XML against the graph of tiles, and what SUMO makes of it."""

import math
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import pairwise
from operator import eq
from pathlib import Path

import jax
import networkx as nx
import numpy as np
import pytest
from hypothesis import example
from odd_names import ODD_NAMES, REFUSED
from oracle import road_graph
from refusals import refused
from simulator_maps import KNOT, RING, all_reach_all, on_any_roads
from sumo_drive import convert, drive, elements, points, read, run

from elitelanes_jax import evolve
from elitelanes_jax.formats import to_sumo_trips
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.formats.sumo import to_sumo
from elitelanes_jax.lanes.movements import movements_of
from elitelanes_jax.maps import PackSpec, pack
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.wfc import generate_batch

CITY = generate_batch(np.random.default_rng(0), 1, (9, 12), border="closed").grid[0]
TO_SCALE = Streets(tile_size=8.43, right_of_way="right_before_left")


def plain_xml(codes, *streets):
    return to_sumo(as_map(codes), "city", *streets)


def opposites(edges):
    """For each edge the one that has the same shape the other way round."""
    by_shape = {tuple(edge["shape"]): name for name, edge in edges.items()}
    assert len(by_shape) == len(edges)
    return {name: by_shape[tuple(edge["shape"][::-1])] for name, edge in edges.items()}


@on_any_roads
@example(CITY)
def test_roads_are_the_links_in_both_directions(grid):
    graph = road_graph(grid)
    graph = graph.subgraph([tile for tile in graph if graph.degree(tile)])
    plain = plain_xml(grid, Streets(tile_size=10))
    nodes, edges, _ = read(plain)
    stops = {node["id"] for node in elements(plain.nodes) if node["type"] == "allway_stop"}
    assert stops == {f"{row}_{column}" for row, column in graph if graph.degree((row, column)) > 2}

    # Each tile that is no node joins two links to one.
    assert len(edges) == 2 * (graph.number_of_edges() - (len(graph) - len(nodes)))
    met = {tile for tile in graph if graph.degree(tile) != 2 or int(grid[tile]).bit_count() > 2}
    extra = 0
    for road in nx.connected_components(graph.subgraph(set(graph) - met)):
        ends = {end for tile in road for end in graph[tile]} - road
        extra += 2 - len(ends) if len(road) > 1 else 0  # none on a road, one on a loop, two on a ring
    assert len(nodes) == len(met) + extra

    height, width = grid.shape
    length = 0.0
    for edge in edges.values():
        shape = edge["shape"]
        assert edge["from"] != edge["to"]
        assert shape[0] == nodes[edge["from"]] and shape[-1] == nodes[edge["to"]]
        assert all(0 < point.real < 10 * width and 0 < point.imag < 10 * height for point in shape)
        length += sum(abs(b - a) for a, b in pairwise(shape))
    opposite = opposites(edges)
    assert all(edges[opposite[name]]["from"] == edge["to"] for name, edge in edges.items())
    turn = 10 * 16 * math.sin(math.pi / 64)  # a quarter circle of 16 chords
    bends = sum(graph.degree(tile) == 2 and not any(map(eq, *graph[tile])) for tile in graph)
    assert length == pytest.approx(2 * (5 * sum(dict(graph.degree).values()) - bends * (10 - turn)), abs=0.05)


@on_any_roads
@example(CITY)
def test_traffic_may_go_on_everywhere_and_back_at_dead_ends(grid):
    _, edges, connections = read(plain_xml(grid))
    opposite = opposites(edges)
    expected = set()
    for name, edge in edges.items():
        onward = {other for other in edges if edges[other]["from"] == edge["to"]} - {opposite[name]}
        expected |= {(name, other) for other in onward or {opposite[name]}}
    assert len(connections) == len(expected) and set(connections) == expected
    assert all_reach_all(nx.DiGraph(connections), grid)


def test_a_ring_is_two_roads_around_a_circle():
    nodes, edges, connections = read(plain_xml(RING, Streets(tile_size=20)))
    assert list(nodes) == ["0_0", "1_1"]
    assert list(edges) == ["0_0_east", "0_0_south", "1_1_north", "1_1_west"]
    assert ("0_0_east", "1_1_west") in connections and len(connections) == 4
    for edge in edges.values():
        np.testing.assert_allclose(np.abs(np.array(edge["shape"]) - (20 + 20j)), 10, atol=1e-3)
        assert len(edge["shape"]) == 33


def test_north_is_up_and_crossings_are_junctions():
    plain = plain_xml(KNOT, Streets(10, 2, 5, "traffic_light"))
    nodes = {node["id"]: node for node in elements(plain.nodes)}
    assert list(nodes) == ["0_0", "1_1", "1_2", "2_1"]
    assert nodes["1_1"] == {"id": "1_1", "x": "15.0000", "y": "15.0000", "type": "traffic_light", "radius": "2.5000"}
    assert nodes["2_1"] == {"id": "2_1", "x": "15.0000", "y": "5.0000", "type": "priority", "radius": "2.5000"}
    edge = next(edge for edge in elements(plain.edges) if edge["id"] == "2_1_north")
    assert edge["shape"] == "15.0000,5.0000 15.0000,15.0000"
    assert (edge["width"], edge["speed"], edge["numLanes"]) == ("2", "5", "1")
    assert plain == plain_xml(KNOT.tolist(), Streets(10, 2, 5, "traffic_light"))
    tight = elements(plain_xml(KNOT, TO_SCALE).nodes)
    assert all(3.2 + float(node["radius"]) < 8.43 / 2 for node in tight)


@on_any_roads
@example(CITY)
def test_trips_lead_over_the_edges_that_enter_their_tiles(grid):
    """The tile of a node is on its edge, and the edge comes to it with the node's heading."""
    grid = np.asarray(grid)
    plain, moves = plain_xml(grid, Streets(tile_size=10)), np.stack(movements_of(grid), axis=1)
    nodes = [tuple(node) for node in moves[:, :3].tolist()]
    trips = ET.fromstring(to_sumo_trips(grid, [(node, node) for node in nodes]))
    edges, height = read(plain)[1], len(grid)
    assert trips.tag == "routes" and [trip.get("depart") for trip in trips] == [str(n) for n in range(len(nodes))]
    for (row, column, heading), trip in zip(nodes, trips, strict=True):
        assert trip.get("from") == trip.get("to")
        side = SIDES[heading]
        border = 10 * (column + 0.5 - side.right / 2 + (height - row - 0.5 + side.down / 2) * 1j)
        ahead = side.right - side.down * 1j
        shape = edges[trip.get("from")]["shape"]
        passed = [
            abs((border - a) / (b - a) - ((border - a) / (b - a)).real) < 1e-4
            and -1e-6 < ((border - a) / (b - a)).real < 1 + 1e-6
            and ((b - a) / ahead).real > 0
            for a, b in pairwise(shape)
        ]
        assert any(passed)


def test_trips_off_the_roads_are_refused():
    for heading in (0, 4, -1):
        with refused("trips", f"B2 ([1, 1]) with the heading {heading}"):
            to_sumo_trips(RING, [((0, 1, 1), (1, 1, heading))])


# From here on SUMO itself, in an environment of its own: make sumo.


def keeps_right(net, opposite):
    """Whether each lane lies to the right of the one that goes the other way."""
    lanes = {edge.get("id"): points(edge.find("lane").get("shape")) for edge in net.iter("edge") if edge.get("from")}
    for name, lane in lanes.items():
        across = lane[0] - lanes[opposite[name]][-1]
        if (across * (lane[1] - lane[0]).conjugate()).imag >= 0:
            return False
    return lanes.keys() == opposite.keys()


def harmful(warnings):
    """The warnings but for the one that does no harm.

    Cars that turn left towards each other may be in each other's way; the network then makes one of them wait. So it is
    on crossings of Duckietown's proportions; and on some of others, where OpenDRIVE has smoother curves.
    """
    return [warning for warning in warnings if "Intersecting left turns at junction" not in warning]


def maps_of(source):
    if source == "wfc":
        return generate_batch(np.random.default_rng(0), 80, (12, 12), border="closed").grid
    rules = {"rules": "duckietown"} if source == "duckietown" else {"fill": True}
    keys = jax.random.split(jax.random.key(0), 4)
    elites = evolve(keys, preset="tuned", evaluations=20_000, **rules).elites
    some = np.asarray(elites.valid & (elites.metrics.edges > 0))
    found = np.unique(np.asarray(elites.grids)[some], axis=0)
    return found[np.linspace(0, len(found) - 1, 60).astype(int)]


@pytest.mark.slow
@pytest.mark.parametrize("source", ["wfc", "evolved", "duckietown"])
def test_two_hundred_maps_convert_and_all_vehicles_arrive(source, tmp_path):
    run("netconvert", "--version")
    maps = maps_of(source)
    assert len(np.unique(maps, axis=0)) == len(maps) == {"wfc": 80, "evolved": 60, "duckietown": 60}[source]
    assert (maps == 0).any() == (source == "duckietown")
    net = tmp_path / "city.net.xml"
    for seed, grid in enumerate(maps):
        _, edges, connections = read(plain_xml(grid))
        assert convert(net, grid) == []
        built = ET.parse(net)
        made = [(pair.get("from"), pair.get("to")) for pair in built.iter("connection")]
        assert sorted(pair for pair in made if pair[0][0] != ":") == sorted(connections)
        assert keeps_right(built, opposites(edges))
        assert drive(net, connections, tmp_path, seed) == (20, "")


@pytest.mark.slow
def test_to_scale_cars_as_long_as_duckiebots_arrive(tmp_path):
    run("netconvert", "--version")
    net = tmp_path / "city.net.xml"
    shorter = '<vType id="DEFAULT_VEHTYPE" length="2.6" minGap="1"/>'
    for seed, grid in enumerate(maps_of("duckietown")):
        assert harmful(convert(net, grid, streets=TO_SCALE)) == []
        connections = read(plain_xml(grid))[2]  # of 60 towns, one jams with 20 cars: streets are that short
        assert drive(net, connections, tmp_path, seed, vehicles=10, kind=shorter, crossings=False) == (10, "")


@pytest.mark.slow
@pytest.mark.parametrize("right_of_way", ["allway_stop", "priority", "right_before_left", "traffic_light"])
@pytest.mark.parametrize("grid", [KNOT, RING], ids=["knot", "ring"])
def test_loops_dead_ends_and_rings_are_driven(grid, right_of_way, tmp_path):
    run("netconvert", "--version")
    net = tmp_path / "city.net.xml"
    assert convert(net, grid, streets=Streets(right_of_way=right_of_way)) == []
    assert (f'type="{right_of_way}"' in net.read_text()) == (grid is KNOT or right_of_way == "priority")
    assert drive(net, read(plain_xml(grid))[2], tmp_path, 0) == (20, "")


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted({*ODD_NAMES} - REFUSED["sumo"]))
def test_netconvert_finds_files_of_odd_names(kind, tmp_path):
    run("netconvert", "--version")
    net = tmp_path / f"{ODD_NAMES[kind]}.net.xml"
    convert(net, KNOT)  # netconvert warns of "100%" on its command line, and reads it
    assert net.is_file()


@pytest.mark.slow
def test_trips_of_a_pack_are_driven(tmp_path):
    """SUMO finds a way for each trip, and all cars arrive."""
    run("netconvert", "--version")
    pack(PackSpec(to=("sumo",), split=(1, 0, 0), trips=50), [CITY, KNOT], tmp_path / "pack")
    for settings in sorted((tmp_path / "pack" / "sumo").rglob("*.netccfg")):
        assert not harmful(run("netconvert", "-c", settings).splitlines())
        trips, arrived = (settings.with_suffix(suffix) for suffix in (".rou.xml", ".out"))
        said = run("sumo", "-n", settings.with_suffix(".net.xml"), "-r", trips, "--tripinfo-output", arrived)
        assert not said and len(ET.parse(arrived).findall("tripinfo")) == 50


@pytest.mark.slow
def test_the_page_works(tmp_path, monkeypatch):
    run("netconvert", "--version")
    page = (Path(__file__).parents[2] / "docs" / "simulators.md").read_text().partition("## SUMO\n")[2]
    program, commands = (re.search(rf"```{kind}\n(.*?)```", page, re.DOTALL)[1] for kind in ("python", "sh"))
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "simulators.md", "exec"), {})
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    subprocess.run(["sh", "-e", "-c", commands], env={**os.environ, "PATH": path}, check=True)
    arrived = ET.parse("city.tripinfo.xml").findall("tripinfo")
    assert len(arrived) == len(ET.parse("city.rou.xml").findall("vehicle")) > 150
