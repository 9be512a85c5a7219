"""OpenDRIVE: lanes and links by the graph of tiles; then what CARLA, ASAM's checker and SUMO read (make simulators)."""

import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from networks import approaches, ends_of, pose_at, signals_of
from simulator_maps import (
    BATCHES,
    BLOCK,
    KNOT,
    RING,
    SIDES,
    STEPS,
    all_reach_all,
    distances,
    lane_graph,
    maps,
    name,
    on_any_roads,
)

from elitelanes_jax.formats import RoadMap, read_map
from elitelanes_jax.formats.opendrive import to_opendrive
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.maps import furnish
from elitelanes_jax.network import codes

DUCKIETOWN = Streets(0.585, 0.234)


def lane_links(root, grid):
    """Lanes (road, lane) that should follow each lane, by the graph of tiles and the names of roads."""
    graph = lane_graph(grid)
    after = {}
    for row, column, into, out in graph:
        after.setdefault((row, column, into), []).append((row, column, into, out))
    junctions = {tuple(map(int, one.get("name").split("_"))) for one in root.iter("junction")}
    roads = {road.get("name"): int(road.get("id")) for road in root.iter("road")}
    assert len(roads) == len(list(root.iter("road")))
    turns = {lane: (roads[name(lane)], -1) for lane in graph if lane[:2] in junctions}

    def follow(row, column, out):
        while True:
            row, column = row + STEPS[out][0], column + STEPS[out][1]
            lanes = after[row, column, out]
            if (row, column) in junctions:
                return row, column, out, lanes
            (lane,) = lanes
            out = lane[3]

    starts, links = {}, {}
    for lane in graph:
        row, column, _, out = lane
        side = ("north", "east", "south", "west")[out]
        if (row, column) in junctions and f"{row}_{column}_{side}" in roads:
            road = roads[f"{row}_{column}_{side}"]
            end = follow(row, column, out)
            starts[row, column, out] = road, -1
            starts[end[0], end[1], (end[2] + 2) % 4] = road, 1
    for (row, column, out), lane in starts.items():
        links[lane] = {turns[other] for other in follow(row, column, out)[3]}
    for lane, road in turns.items():
        links[road] = {starts[lane[0], lane[1], lane[3]]}
    assert len(roads) == len(turns) + len(starts) / 2
    return nx.DiGraph(links), turns


@on_any_roads
def test_roads_and_their_links_are_those_of_the_tiles(grid):
    root = ET.fromstring(to_opendrive(as_map(grid)))
    expected, _ = lane_links(root, grid)
    assert all_reach_all(expected, grid)
    poses = {road.get("id"): ends_of(road) for road in root.iter("road")}
    made = set()
    for junction in root.iter("junction"):
        for connection in junction.iter("connection"):
            link = connection.find("laneLink")
            into = int(connection.get("incomingRoad")), int(link.get("from"))
            made.add((into, (int(connection.get("connectingRoad")), int(link.get("to")))))
    for road in root.iter("road"):
        if road.get("junction") == "-1":
            continue
        number = int(road.get("id"))
        before, after = road.find("link/predecessor"), road.find("link/successor")
        lane = road.find("lanes/laneSection/right/lane/link")
        into = int(before.get("elementId")), int(lane.find("predecessor").get("id"))
        out = int(after.get("elementId")), int(lane.find("successor").get("id"))
        assert (into, (number, -1)) in made
        made.add(((number, -1), out))
        # The lane starts and ends where its neighbours do, with their heading.
        shift = 1j * (float(road.find("lanes/laneOffset").get("a")) - 1.6)
        ends = poses[road.get("id")]
        for link, other, (place, heading) in zip((before, after), (into, out), ends, strict=True):
            there, angle = poses[str(other[0])][link.get("contactPoint") == "end"]
            angle += np.pi * (other[1] == 1)
            assert abs(np.exp(1j * angle) - np.exp(1j * heading)) < 1e-8
            lane_there = there - 1.6j * np.exp(1j * angle)
            lane_here = place + shift * np.exp(1j * heading)
            assert abs(lane_there - lane_here) < 1e-8, link
    assert made == set(expected.edges)


TOWN = read_map(Path(__file__).parents[2] / "docs" / "examples" / "town.json").codes
KINDS_OF_MAPS = {
    "stops": furnish(TOWN, "signs trees=3 duckies=2"),
    "lights": furnish(TOWN, "signs lights=0.5 houses=2"),
    "adjacent crossings": RoadMap(BLOCK),
    "dead ends": RoadMap(KNOT),
    "ring": RoadMap(RING),
    "one row": RoadMap(np.array([[4, 5, 5, 1]])),
}
each_map = pytest.mark.parametrize("road_map", KINDS_OF_MAPS.values(), ids=KINDS_OF_MAPS)


@each_map
@pytest.mark.parametrize("streets", [Streets(), Streets(8, 3.2, 5, "priority"), DUCKIETOWN])
def test_roads_have_what_strict_and_plain_readers_ask_for(road_map, streets):
    """py123d asks for an elevation and a lane offset, and maliput for no value without a unit. tactics2d asks for the
    speed of lanes and rules of lane changes. maliput and Scenic take roads under 0.05 m for points."""
    root = ET.fromstring(to_opendrive(as_map(road_map), streets, name="a & b"))
    assert root.find("header").get("name") == "a & b"
    for road in root.iter("road"):
        assert road.find("elevationProfile/elevation").attrib == {"s": "0", **dict.fromkeys("abcd", "0")}
        assert next(one.get("s") for one in road.iter("laneOffset")) == "0"
        assert float(road.get("length")) >= min(0.1, streets.tile_size / 64) * (1 - 1e-9) and road.get("rule") == "RHT"
        for lane in road.iter("lane"):
            assert [mark.get("laneChange") for mark in lane.iter("roadMark")] == ["none"]
            speeds = [(float(one.get("max")), one.get("unit")) for one in lane.iter("speed")]
            assert speeds == ([(streets.speed, "m/s")] if lane.get("id") != "0" else [])
    for signal in root.iter("signal"):
        assert "value" not in signal.attrib or "unit" in signal.attrib


@each_map
def test_connecting_roads_refer_to_the_signals_of_their_approach(road_map):
    """Each stop sign and light is read again on each way that its drivers may take, where its lane starts."""
    text = to_opendrive(as_map(road_map))
    root, found = ET.fromstring(text), signals_of(text)
    kinds = {one.get("id"): one.get("name") for one in root.iter("signal")}
    for road in root.iter("road"):
        references = road.findall("signals/signalReference")
        if road.get("junction") == "-1":
            assert not references
            continue
        row, column, side, _turn = road.get("name").split("_")
        approach = int(row), int(column), (SIDES.index(side) + 2) % 4
        expected = [name for name, *_ in found.get(approach, ()) if name in ("sign_stop", "trafficlight")]
        assert [kinds[one.get("id")] for one in references] == expected
        for one in references:
            assert (one.get("s"), one.get("orientation")) == ("0", "+")
            assert one.find("validity").attrib == {"fromLane": "-1", "toLane": "-1"}


@pytest.mark.parametrize("streets", [Streets(), Streets(29.7, 3.2), DUCKIETOWN])
def test_lengths_of_long_roads_add_up(streets):
    """On a road of kilometres, roadgen drops the last curve if a length and an `s` differ by 3e-9 m."""
    # A ring through all tiles: along the first row, and back down and up the columns.
    tiles = [(0, column) for column in range(24)]
    for column in reversed(range(24)):
        tiles += [(row, column) for row in (range(1, 24) if column % 2 else range(23, 0, -1))]
    grid = np.zeros((24, 24), int)
    for tile, others in zip(tiles, zip(tiles[-1:] + tiles[:-1], tiles[1:] + tiles[:1], strict=True), strict=True):
        steps = [(row - tile[0], column - tile[1]) for row, column in others]
        grid[tile] = sum(side.bit for side in codes.SIDES if (side.down, side.right) in steps)
    longest = 0.0
    for road in ET.fromstring(to_opendrive(as_map(grid), streets)).iter("road"):
        curves = road.findall("planView/geometry")
        ends = np.array([float(curve.get("s")) + float(curve.get("length")) for curve in curves])
        starts = np.array([*(float(curve.get("s")) for curve in curves[1:]), float(road.get("length"))])
        np.testing.assert_allclose(ends, starts, rtol=0, atol=1e-10)
        longest = max(longest, ends[-1])
    assert longest > 200 * streets.tile_size


def cubic(records, s):
    """The value at s of the last cubic that starts before."""
    starts = [float(one.get("s", one.get("sOffset"))) for one in records]
    start, record = [both for both in zip(starts, records, strict=True) if both[0] <= s + 1e-12][-1]
    return sum(float(record.get(name)) * (s - start) ** power for power, name in enumerate("abcd"))


@each_map
@pytest.mark.parametrize("streets", [Streets(), DUCKIETOWN])
def test_both_edges_of_lanes_are_lines(road_map, streets):
    """At a dead end too, where the inner edge leads around an island; both edges meet those of the road."""
    for road in ET.fromstring(to_opendrive(as_map(road_map), streets)).iter("road"):
        length = float(road.get("length"))
        for lane in road.findall("lanes/laneSection/right/lane"):
            edges = []
            for s in np.linspace(0, length, 9):
                piece = [one for one in road.iter("geometry") if float(one.get("s")) <= s + 1e-9][-1]
                place, heading = pose_at(piece, s - float(piece.get("s")))
                left = cubic(road.findall("lanes/laneOffset"), s)
                right = left - cubic(lane.findall("width"), s)
                edges.append([place + 1j * t * np.exp(1j * heading) for t in (left, right)])
            inner, outer = np.array(edges).T
            assert len(set(np.round(inner, 4))) > 2 and len(set(np.round(outer, 4))) > 2
            widths = abs(inner - outer)
            assert widths[[0, -1]] == pytest.approx([streets.lane] * 2) and widths.min() >= 0.95 * streets.lane - 1e-9


@pytest.mark.parametrize("kind", ["stops", "lights"])
def test_objects_and_stop_lines_are_where_the_map_has_them(kind):
    road_map, streets = KINDS_OF_MAPS[kind], Streets()
    root = ET.fromstring(to_opendrive(as_map(road_map), streets))
    found, lines = Counter(), 0
    for road in root.iter("road"):
        for one in road.iter("object"):
            s, t, turned = (float(one.get(key)) for key in ("s", "t", "hdg"))
            piece = [part for part in road.iter("geometry") if float(part.get("s")) <= s + 1e-6][-1]
            place, heading = pose_at(piece, s - float(piece.get("s")))
            place += 1j * t * np.exp(1j * heading)
            if one.get("name") == "stop_line":
                lines += 1
                assert one.find("validity").get("fromLane") == ("1" if t > 0 else "-1")
                assert min(s, float(road.get("length")) - s) < 0.2 and abs(t) == pytest.approx(1.6)
                continue
            angle = np.angle(np.exp(1j * (heading + turned)))
            found[one.get("name"), one.get("type"), *np.round([place.real, place.imag, angle], 3)] += 1
    types = {"tree": "tree", "house": "building"}
    expected = Counter()
    for thing in road_map.objects:
        if thing.height and thing.kind != "trafficlight" and not thing.kind.startswith("sign_"):
            place = [thing.x * 30, (len(TOWN) - thing.y) * 30, np.angle(np.exp(1j * thing.angle))]
            expected[thing.kind, types.get(thing.kind, "obstacle"), *np.round(place, 3)] += 1
    assert found == expected and found.total() >= 2
    assert lines == len(approaches(TOWN))


# From here on by the programs themselves: make simulators.


def check_carla(grid, text, streets):
    """CARLA's lanes lie where ours do, follow each other as ours do, and each is reached; it reads all signals."""
    carla = pytest.importorskip("carla", reason="CARLA is not here: make simulators")
    city = carla.Map("city", text)
    root = ET.fromstring(text)
    kinds = {one.get("id"): (one.get("name"), one.get("type")) for one in root.iter("signal")}
    read = Counter((one.id, one.name, one.type, one.road_id) for one in city.get_all_landmarks())
    # A landmark stands at the road of its signal, and at each connecting road that refers to it.
    expected = Counter()
    for road in root.iter("road"):
        for one in (*road.iter("signal"), *road.iter("signalReference")):
            expected[one.get("id"), *kinds[one.get("id")], int(road.get("id"))] += 1
    assert read == Counter({(str(number), *more): count for (number, *more), count in expected.items()})
    expected, turns = lane_links(root, grid)
    lengths = {int(road.get("id")): float(road.get("length")) for road in root.iter("road")}
    links = {
        (lane, (after.road_id, after.lane_id))
        for lane in expected
        for after in city.get_waypoint_xodr(*lane, lengths[lane[0]] - 1e-4 if lane[1] < 0 else 1e-4).next(1e-3)
    }
    assert links == set(expected.edges)
    assert all_reach_all(nx.DiGraph(links), grid) and all(out for _, out in nx.DiGraph(links).out_degree())
    lanes = {}
    for point in city.generate_waypoints(streets.tile_size / 4):
        place = point.transform.location
        lanes.setdefault((point.road_id, point.lane_id), []).append(place.x - 1j * place.y)  # its y is south
    assert set(lanes) == set(expected)
    ours = {road: lane for lane, road in turns.items()}
    graph = lane_graph(grid)
    here = {}
    for lane in graph:
        here.setdefault(lane[:2], []).append(lane)
    passed = set(turns)
    for lane, points in lanes.items():
        points = np.array(points)
        if lane in ours:
            # Around a dead end is an island, and turns next to an adjacent crossing start 0.05 m later.
            island = streets.lane / 40 * (ours[lane][2] == (ours[lane][3] + 2) % 4)
            assert distances(points, ours[lane], grid, streets).max() < island + 0.03
            continue
        for point in points:
            column, row = int(point.real // streets.tile_size), int(len(grid) - point.imag / streets.tile_size)
            far, nearest = min((float(distances(point, other, grid, streets)), other) for other in here[row, column])
            assert far < 0.01
            passed.add(nearest)
    assert passed == set(graph)


@pytest.mark.slow
@pytest.mark.parametrize("batch", BATCHES)
def test_carla_reads_our_lanes(batch):
    for number, road_map in enumerate(maps(batch)):
        streets = (Streets(), Streets(8, 3.2))[number % 2]
        check_carla(road_map.codes, to_opendrive(road_map, streets), streets)
