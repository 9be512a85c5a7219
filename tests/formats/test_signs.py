"""Signs and lights of a map in the formats of networks: each at its crossing, for the drivers who read it."""

import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from simulator_maps import KNOT, lane_graph
from test_opendrive import ends_of

from elitelanes_jax.formats import MapObject, RoadMap, Streets, read_map, to_commonroad, to_lanelet2, to_opendrive
from elitelanes_jax.formats.sumo import to_sumo
from elitelanes_jax.maps import furnish

BARE = read_map(Path(__file__).parents[2] / "docs" / "examples" / "town.json").codes
TOWN = furnish(BARE, "signs lights=0.4 trees=3")
TOPOLOGY = {(0, 1): "right_T", (0, 3): "left_T", (1, 3): "T", (0, 1, 3): "4_way"}  # by quarter turns clockwise


def approaches(grid):
    """The turns that each approach (row, column, heading in) of each crossing has."""
    found = {}
    for row, column, into, out in sorted(lane_graph(grid)):
        found.setdefault((row, column, into), set()).add((out - into) % 4)
    return {approach: tuple(sorted(turns)) for approach, turns in found.items() if len(turns) > 1}


def lit(town):
    """The crossings that have lights: the nearest to each."""
    crossings = {approach[:2] for approach in approaches(town.codes)}
    return {
        min(crossings, key=lambda tile: np.hypot(tile[1] + 0.5 - thing.x, tile[0] + 0.5 - thing.y))
        for thing in town.objects
        if thing.kind == "trafficlight"
    }


def signals_of(text):
    """Signals by the approach at whose road they are: attributes, and the place and heading, x + y·i and radians."""
    root, found = ET.fromstring(text), {}
    junctions = {one.get("id"): tuple(map(int, one.get("name").split("_"))) for one in root.iter("junction")}
    for road in root.iter("road"):
        start, end = ends_of(road) if road.get("junction") == "-1" else (None, None)
        for signal in road.iter("signal"):
            ahead = signal.get("orientation") == "+"
            assert float(signal.get("s")) == pytest.approx(float(road.get("length")) if ahead else 0)
            lane = "-1" if ahead else "1"
            assert signal.find("validity").attrib == {"fromLane": lane, "toLane": lane}
            angle = end[1] if ahead else start[1] + np.pi
            tile = junctions[road.find("link/successor" if ahead else "link/predecessor").get("elementId")]
            place = signal.find("positionInertial")
            if place is not None:  # who reads it drives there
                assert abs(np.exp(1j * float(place.get("hdg"))) - np.exp(1j * angle)) < 1e-6
                place = float(place.get("x")) + 1j * float(place.get("y"))
            into = round(1 - angle / (np.pi / 2)) % 4
            found.setdefault((*tile, into), []).append((signal.get("name"), signal.get("type"), place))
    return found


def test_each_approach_has_its_signs_and_lights():
    """Duckietown's rules place signs for the control and the topology of each approach; a light faces each."""
    streets = Streets()
    found, lights = signals_of(to_opendrive(TOWN, streets)), lit(TOWN)
    assert len(lights) > 1
    types = {"sign_stop": "206", "sign_t_light_ahead": "131", "trafficlight": "1000001"}
    for approach, turns in approaches(BARE).items():
        control = {"sign_t_light_ahead", "trafficlight"} if approach[:2] in lights else {"sign_stop"}
        names = [name for name, _, _ in found[approach]]
        assert sorted(names) == sorted({f"sign_{TOPOLOGY[turns]}_intersect"} | control)
        assert all(kind == types.get(name, "-1") for name, kind, _ in found[approach])
    signs = [thing for thing in TOWN.objects if thing.kind.startswith("sign")]
    ours = Counter((thing.kind, round(thing.x * 30, 3), round((len(BARE) - thing.y) * 30, 3)) for thing in signs)
    theirs = [one for listed in found.values() for one in listed if one[0] != "trafficlight"]
    assert Counter((name, round(place.real, 3), round(place.imag, 3)) for name, _, place in theirs) == ours
    assert found.keys() == approaches(BARE).keys()


def test_crossings_follow_their_signs_and_lights_in_all_networks():
    lights, arms = lit(TOWN), Counter(approach[:2] for approach in approaches(BARE))
    nodes = {one.get("id"): one.get("type") for one in ET.fromstring(to_sumo(TOWN, "town").nodes)}
    kinds = {tile: nodes[f"{tile[0]}_{tile[1]}"] for tile in arms}
    assert kinds == {tile: "traffic_light" if tile in lights else "allway_stop" for tile in arms}
    count = sum(arms[tile] for tile in lights)
    lanelet2 = ET.fromstring(to_lanelet2(TOWN))
    rules = Counter(tag.get("v") for tag in lanelet2.iterfind("relation/tag[@k='subtype']"))
    assert (rules["traffic_light"], rules["all_way_stop"]) == (count, len(arms) - len(lights))
    commonroad = ET.fromstring(to_commonroad(TOWN))
    stops = [one for one in commonroad.iter("trafficSignID") if one.text == "206"]
    assert (len(list(commonroad.iter("trafficLight"))), len(stops)) == (count, sum(arms.values()) - count)
    controlled = [one.get("signalId") for one in ET.fromstring(to_opendrive(TOWN)).iter("control")]
    faces = [one.get("id") for one in ET.fromstring(to_opendrive(TOWN)).iter("signal") if one.get("dynamic") == "yes"]
    assert sorted(controlled) == sorted(faces) and len(faces) == count


def test_crossings_without_signs_follow_the_right_of_way():
    """One stop sign makes an all-way stop of its crossing; signs far from crossings change none."""
    sign = MapObject("sign_stop", 0.8, 1.2, 0.0, 0.18)  # for who drives west at the crossing of row 1, column 1
    town = RoadMap(KNOT, objects=[sign, sign._replace(kind="sign_parking", x=2.9)])
    for how in ("traffic_light", "priority"):
        found = signals_of(to_opendrive(town, Streets(right_of_way=how)))
        assert {name for listed in found.values() for name, _, _ in listed} == {"sign_stop", "sign_parking"}
        places = {listed: place for listed, _, place in found[1, 1, 3]}
        assert places == {"sign_stop": pytest.approx(24 + 54j), "sign_parking": pytest.approx(87 + 54j)}
    far = RoadMap(np.pad(KNOT, 3), objects=[sign])
    names = [name for listed in signals_of(to_opendrive(far)).values() for name, _, _ in listed]
    assert names == ["sign_stop"] * 5
