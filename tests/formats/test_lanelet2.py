"""Lanelet2's maps: lanelets by the graph of tiles; then what Lanelet2 itself reads and routes (make simulators)."""

import random
import xml.etree.ElementTree as ET
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from networks import read_lanelet2
from oracle import road_graph
from scipy.integrate import quad
from simulator_maps import BATCHES, BLOCK, distances, lane_graph, maps, name, on_any_roads

from elitelanes_jax._util.checks import coordinates
from elitelanes_jax.formats._earth import plane_of, to_earth
from elitelanes_jax.formats.lanelet2 import to_lanelet2
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.streets import Streets


def directed(nodes, bound, lane, grid, streets, left):
    """A bound's nodes in the direction of its lane, which begins at the side of its tile."""
    row, column, into, _ = lane
    ahead = (1j, 1, -1j, -1)[into]
    start = (column + 0.5 + (len(grid) - row - 0.5) * 1j - ahead / 2) * streets.tile_size
    start += 0 if left else -1j * ahead * streets.lane
    return bound if abs(nodes[bound[0]] - start) < 1e-5 else bound[::-1]


@on_any_roads
def test_lanelets_join_as_movements_do(grid):
    streets = Streets()
    lanelets, _, nodes = read_lanelet2(to_lanelet2(as_map(grid), streets))
    graph = lane_graph(grid)
    assert lanelets.keys() == {name(lane) for lane in graph}
    ends = {}
    for lane in graph:
        _, left, right, _ = lanelets[name(lane)]
        left = directed(nodes, left, lane, grid, streets, True)
        right = directed(nodes, right, lane, grid, streets, False)
        ends[lane] = (left[0], right[0]), (left[-1], right[-1])
        centre = [(nodes[one] + nodes[other]) / 2 for one, other in zip(left, right, strict=True)]
        island = streets.lane / 40 * (lane[2] != lane[3]) + 1e-5
        assert distances(centre, lane, grid, streets).max() < island
    joined = {(one, other) for one in graph for other in graph if ends[one][1] == ends[other][0]}
    assert joined == set(graph.edges)


def test_lights_stand_beyond_the_right_end_of_their_stop_lines():
    """The other end of a stop line is the road's middle: of its ends the one nearer to the crossing."""
    text = to_lanelet2(as_map([[6, 3, 0], [12, 15, 3], [0, 12, 9]]), Streets(right_of_way="traffic_light"))
    _, rules, nodes = read_lanelet2(text)
    ways = {way.get("id"): [nodes[nd.get("ref")] for nd in way.iter("nd")] for way in ET.fromstring(text).iter("way")}
    crossing = (1.5 + 1.5j) * Streets().tile_size
    assert len(rules) == 4
    for _, members in rules.values():
        light, stop_line = (ways[number] for _, number in members)
        middle, right = sorted(stop_line, key=lambda place: abs(place - crossing))
        for place in light:
            beside = (place - middle) / (right - middle)
            assert beside.real > 1 and abs(beside.imag) < 1e-5


def test_tags_are_those_that_autoware_asks_for():
    """Of a road, with a number for its speed; the turn on crossings; and a rule for each stop line."""
    text = to_lanelet2(as_map(BLOCK), Streets(speed=5))
    root = ET.fromstring(text)
    lanelets, rules, _ = read_lanelet2(text)
    ruled = {ref for _, members in rules.values() for _, ref in members}
    lines = [way.get("id") for way in root.iter("way") if way.find("tag[@v='stop_line']") is not None]
    assert len(lines) == 16 and set(lines) <= ruled
    arms = road_graph(BLOCK).degree
    for relation in root.iter("relation"):
        tags = {tag.get("k"): tag.get("v") for tag in relation.iter("tag")}
        if tags["type"] == "lanelet":
            assert float(tags["speed_limit"]) == 18 and tags["participant:vehicle"] == tags["one_way"] == "yes"
            row, column, _, turn = tags["name"].split("_")
            assert tags.get("turn_direction") == (turn if arms[int(row), int(column)] > 2 else None)
    assert len(lanelets) == len(lane_graph(BLOCK)) and root.find("MetaInfo").get("format_version") == "1"


@pytest.mark.parametrize("origin", [(0, 9), (48.1, 11.6), (60.39, 5.32), (-33.45, -70.66), (-80, -180)])
def test_the_origin_is_the_south_west_corner(origin):
    """Where PROJ has UTM's plane: 60.39, 5.32 is in Norway's wide zone 32."""
    (latitude,), (longitude,) = to_earth(np.zeros(1, complex), origin)
    assert (latitude, longitude % 360) == pytest.approx((origin[0], origin[1] % 360), abs=1e-11)
    meridian = {11.6: 9, 5.32: 9, -70.66: -69, 9: 9, -180: -177}[origin[1]]
    assert f"+lon_0={meridian} " in plane_of(origin)
    # One step north and one east are as long on the ellipsoid as on the plane, to the plane's scale.
    north, east = np.transpose(to_earth(np.array([1000j, 1000]), origin)) - (latitude, longitude)
    east -= 360 * np.round(east / 360)
    metres = np.radians([north, east]) * 6378137 * np.array([1, np.cos(np.radians(latitude))])
    assert np.hypot(*metres.T) == pytest.approx([1000, 1000], rel=0.01)


def test_longitudes_are_from_minus_180_to_180():
    """GeographicLib, with which Lanelet2 reads, has 180 degrees in zone 1."""
    assert coordinates((-17, 180)) == (-17, -180)
    for origin in ((-17, 179.9999), (60, -180)):
        _, longitudes = to_earth(np.array([0, 100, 100j]), origin)
        assert np.abs(longitudes).max() <= 180 and np.ptp(longitudes) > 359


def test_places_are_on_the_meridian_of_the_ellipsoid():
    """The integral of its radius of curvature, to a few micrometres at a hundred kilometres."""
    major, square = 6378137, 2 / 298.257223563 - 1 / 298.257223563**2
    for north in (1.0, 1000.0, 100_000.0):
        (latitude,), (longitude,) = to_earth(np.array([north * 1j]), (0, 9))
        length, _ = quad(
            lambda angle: major * (1 - square) / (1 - square * np.sin(angle) ** 2) ** 1.5, 0, np.radians(latitude)
        )
        assert 0.9996 * length == pytest.approx(north, abs=2e-5) and longitude == 9


# From here on by Lanelet2 itself: make simulators.


@pytest.mark.slow
@pytest.mark.parametrize("batch", BATCHES)
def test_lanelet2_routes_as_we_do(batch, tmp_path):
    lanelet2 = pytest.importorskip("lanelet2", reason="Lanelet2 is not here: make simulators")
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    file, earth = tmp_path / "city.osm", lanelet2.projection.UtmProjector(lanelet2.io.Origin(0, 9))
    for number, road_map in enumerate(maps(batch)):
        streets = (Streets(), Streets(8, 3.2))[number % 2]
        file.write_text(to_lanelet2(road_map, streets))
        city, errors = lanelet2.io.loadRobust(str(file), earth)
        assert not list(errors)
        assert max(abs(p.x - float(p.attributes["local_x"])) for p in city.pointLayer) < 2e-6
        assert max(abs(p.y - float(p.attributes["local_y"])) for p in city.pointLayer) < 2e-6
        routing = lanelet2.routing.RoutingGraph(city, rules)
        assert not list(routing.checkValidity())
        graph = lane_graph(road_map.codes)
        lanelets = {one.attributes["name"]: one for one in city.laneletLayer}
        assert set(lanelets) == {name(lane) for lane in graph}
        for lane in graph:
            after = {one.attributes["name"] for one in routing.following(lanelets[name(lane)])}
            assert after == {name(other) for other in graph[lane]}
        check_routes(routing, lanelets, graph)


def check_routes(routing, lanelets, graph, pairs=100):
    """Routes of Lanelet2 are as long as ours. It takes the length of a left bound for that of its lanelet."""
    ours = {name(lane): lane for lane in graph}
    lengths = {lane: left_length(lanelets[name(lane)]) for lane in graph}
    nx.set_edge_attributes(graph, {edge: lengths[edge[0]] for edge in graph.edges}, "weight")
    draw = random.Random(0)
    for _ in range(pairs // 10):
        start = draw.choice(sorted(graph))
        best = nx.single_source_dijkstra_path_length(graph, start)
        for goal in draw.choices(sorted(best), k=10):
            path = routing.shortestPath(lanelets[name(start)], lanelets[name(goal)], 0, False)
            lanes = [ours[one.attributes["name"]] for one in path]
            assert lanes[0] == start and lanes[-1] == goal
            assert sum(lengths[lane] for lane in lanes[:-1]) == pytest.approx(best[goal], abs=1e-3)


def left_length(lanelet):
    places = [complex(point.x, point.y) for point in lanelet.leftBound]
    return sum(abs(other - one) for one, other in pairwise(places))
