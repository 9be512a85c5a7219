"""What the networks of each format say, in one form: who goes first at crossings, and where lanes are.

A lane is (row, column, heading in, heading out), as in `simulator_maps.lane_graph`.
"""

import json
import pickle
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from simulator_maps import AHEAD, SIDES, lane_graph

from elitelanes_jax.formats.commonroad import to_commonroad
from elitelanes_jax.formats.lanelet2 import to_lanelet2
from elitelanes_jax.formats.opendrive import to_opendrive
from elitelanes_jax.formats.pufferdrive import to_pufferdrive
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.scenarionet import to_scenarionet
from elitelanes_jax.formats.sumo import to_sumo

QUARTERS = {1: 0, 0: 1, 3: 2, 2: 3}  # the turn of a lane by its quarter turns clockwise: right, straight, left, back
CYCLE = ["green", "yellow", "red", "redYellow"]


class Control(NamedTuple):
    """Who goes first at a crossing: the right of way, and the headings of drivers who yield to others."""

    right_of_way: str
    yielding: frozenset = frozenset()


class Format(NamedTuple):
    """A format of networks.

    `write` takes a map and streets. `controls` reads the crossings that have a control, by tile; a map is named
    because some formats number their lanes. `says` are the rights of way that the format can say. `points` reads where
    lanes are, x + y·i in metres.
    """

    write: Callable
    controls: Callable
    points: Callable
    says: tuple


def approaches(grid):
    """The turns that each approach (row, column, heading in) of each crossing has, in quarters clockwise."""
    turns = {}
    for row, column, into, out in sorted(lane_graph(grid)):
        turns.setdefault((row, column, into), set()).add((out - into) % 4)
    return {approach: tuple(sorted(some)) for approach, some in turns.items() if len(some) > 1}


def lit(town):
    """The crossings that have lights: the nearest to each."""
    crossings = {approach[:2] for approach in approaches(town.codes)}
    return {
        min(crossings, key=lambda tile: np.hypot(tile[1] + 0.5 - thing.x, tile[0] + 0.5 - thing.y))
        for thing in town.objects
        if thing.kind == "trafficlight"
    }


def pose_at(piece, s):
    x, y, heading = (float(piece.get(key)) for key in ("x", "y", "hdg"))
    arc = piece.find("arc")
    if arc is None:
        return x + 1j * y + s * np.exp(1j * heading), heading
    bend = float(arc.get("curvature"))
    turned = heading + s * bend
    return x + 1j * y + 1j / bend * (np.exp(1j * heading) - np.exp(1j * turned)), turned


def ends_of(road):
    """The poses at the start and the end of a road of OpenDRIVE; its pieces join."""
    pieces = road.findall("planView/geometry")
    start = pose = pose_at(pieces[0], 0)
    s = 0.0
    for piece in pieces:
        here = pose_at(piece, 0)
        assert abs(here[0] - pose[0]) < 1e-8 and abs(np.exp(1j * here[1]) - np.exp(1j * pose[1])) < 1e-8
        assert float(piece.get("s")) == pytest.approx(s)
        s += float(piece.get("length"))
        pose = pose_at(piece, float(piece.get("length")))
    assert float(road.get("length")) == pytest.approx(s)
    return start, pose


def approach_of(road, junctions, at_end):
    """The approach at one end of a road between junctions of OpenDRIVE."""
    start, end = ends_of(road)
    angle = end[1] if at_end else start[1] + np.pi
    link = road.find("link/successor" if at_end else "link/predecessor")
    return (*junctions[link.get("elementId")], round(1 - angle / (np.pi / 2)) % 4)


def signals_of(text):
    """Signals of OpenDRIVE by the approach at whose road they are: name, type, and place, x + y·i."""
    root, signals = ET.fromstring(text), {}
    junctions = {one.get("id"): tuple(map(int, one.get("name").split("_"))) for one in root.iter("junction")}
    for road in root.iter("road"):
        for signal in road.iter("signal"):
            ahead = signal.get("orientation") == "+"
            assert float(signal.get("s")) == pytest.approx(float(road.get("length")) if ahead else 0)
            lane = "-1" if ahead else "1"
            assert signal.find("validity").attrib == {"fromLane": lane, "toLane": lane}
            approach = approach_of(road, junctions, ahead)
            place = signal.find("positionInertial")
            if place is not None:  # who reads it drives there
                angle = (1 - approach[2]) * np.pi / 2
                assert abs(np.exp(1j * float(place.get("hdg"))) - np.exp(1j * angle)) < 1e-6
                place = float(place.get("x")) + 1j * float(place.get("y"))
            signals.setdefault(approach, []).append((signal.get("name"), signal.get("type"), place))
    return signals


def controls_of_opendrive(text, grid):
    """A sign of the map is at its road; signals that the right of way asks for are at all arms."""
    root, signals = ET.fromstring(text), signals_of(text)
    crossings = {approach[:2] for approach in approaches(grid)}
    assert {approach[:2] for approach in signals} <= crossings
    controls = {}
    for name, kind, right_of_way in (
        ("sign_stop", "206", "allway_stop"),
        ("trafficlight", "1000001", "traffic_light"),
    ):
        here = [(approach, *one) for approach, listed in signals.items() for one in listed if one[0] == name]
        assert all(code == kind for *_, code, _ in here)
        asked = {approach for approach, *_, place in here if place is None or name == "trafficlight"}
        tiles = {approach[:2] for approach in asked}
        assert asked == {approach for approach in approaches(grid) if approach[:2] in tiles}
        controls |= dict.fromkeys([approach[:2] for approach, *_ in here], Control(right_of_way))
    lights = [one.get("id") for one in root.iter("signal") if one.get("name") == "trafficlight"]
    assert sorted(one.get("signalId") for one in root.iter("control")) == sorted(lights)
    junctions = {one.get("id"): tuple(map(int, one.get("name").split("_"))) for one in root.iter("junction")}
    # Priorities name connecting roads, which are named by their tile, the side of entry and the turn.
    headings = {}
    for road in root.iter("road"):
        if road.get("junction") != "-1":
            headings[road.get("id")] = road.get("junction"), (SIDES.index(road.get("name").split("_")[2]) + 2) % 4
    for junction in root.iter("junction"):
        pairs = {(one.get("high"), one.get("low")) for one in junction.iter("priority")}
        if pairs:
            tile = junctions[junction.get("id")]
            ways = [road for road, (number, _) in headings.items() if number == junction.get("id")]
            low = {road for _, road in pairs}
            assert pairs == {(high, one) for high in ways if high not in low for one in low}
            yielding = frozenset(headings[road][1] for road in low)
            assert low == {road for road in ways if headings[road][1] in yielding}
            controls[tile] = Control("priority", yielding)
    return controls


def points_of_opendrive(text):
    return [place for road in ET.fromstring(text).iter("road") for place, _ in ends_of(road)]


def read_lanelet2(text):
    """Lanelets by name: their tags and the nodes of both bounds; rules by number; nodes as x + y·i."""
    root = ET.fromstring(text)
    tags = {part: {tag.get("k"): tag.get("v") for tag in part.findall("tag")} for part in root}
    nodes = {
        node.get("id"): complex(float(tags[node]["local_x"]), float(tags[node]["local_y"]))
        for node in root.iter("node")
    }
    ways = {way.get("id"): [nd.get("ref") for nd in way.findall("nd")] for way in root.iter("way")}
    lanelets, rules = {}, {}
    for relation in root.iter("relation"):
        members = [(member.get("role"), member.get("ref")) for member in relation.findall("member")]
        if tags[relation]["type"] == "lanelet":
            sides = dict(members)
            lanelets[tags[relation]["name"]] = relation.get("id"), ways[sides["left"]], ways[sides["right"]], members
        else:
            rules[relation.get("id")] = tags[relation]["subtype"], members
    assert len({part.get("id") for part in root}) == len(root)
    return lanelets, rules, nodes


def controls_of_lanelet2(text, grid):
    lanelets, rules, _ = read_lanelet2(text)
    names = {number: name for name, (number, *_) in lanelets.items()}
    ruled = {}  # the approaches of the lanelets that name a rule
    for name, (*_, members) in lanelets.items():
        for role, rule in members:
            if role == "regulatory_element":
                ruled.setdefault(rule, []).append(name)
    assert ruled.keys() == rules.keys()
    controls, lights = {}, {}
    for rule, (subtype, members) in rules.items():
        tile = tuple(map(int, ruled[rule][0].split("_")[:2]))
        on_tile = {name for name in lanelets if tuple(map(int, name.split("_")[:2])) == tile}
        if subtype == "traffic_light":
            (side,) = {name.split("_")[2] for name in ruled[rule]}
            assert set(ruled[rule]) == {name for name in on_tile if name.split("_")[2] == side}
            lights.setdefault(tile, set()).add(side)
            assert [role for role, _ in members] == ["refers", "ref_line"]
            continue
        assert set(ruled[rule]) == on_tile and tile not in controls
        roles = {names[ref]: role for role, ref in members if ref in names}
        assert roles.keys() == on_tile
        if subtype == "all_way_stop":
            assert set(roles.values()) == {"yield"}
            assert sum(role == "ref_line" for role, _ in members) == len(on_tile)
            controls[tile] = Control("allway_stop")
        else:
            assert subtype == "right_of_way"
            low = {(SIDES.index(name.split("_")[2]) + 2) % 4 for name, role in roles.items() if role == "yield"}
            assert all(
                (role == "yield") == ((SIDES.index(name.split("_")[2]) + 2) % 4 in low) for name, role in roles.items()
            )
            controls[tile] = Control("priority", frozenset(low))
    for tile, sides in lights.items():
        arms = {approach[2] for approach in approaches(grid) if approach[:2] == tile}
        assert {(SIDES.index(side) + 2) % 4 for side in sides} == arms and tile not in controls
        controls[tile] = Control("traffic_light")
    return controls


def points_of_lanelet2(text):
    lanelets, _, nodes = read_lanelet2(text)
    return [nodes[node] for _, left, right, _ in lanelets.values() for node in (*left, *right)]


def numbered(graph):
    """Lanes by the numbers of CommonRoad's lanelets: in ascending order of row, column, heading and turn."""
    ordered = sorted(graph, key=lambda lane: (*lane[:3], QUARTERS[(lane[3] - lane[2]) % 4]))
    return dict(enumerate(ordered, 1))


def points_of(element):
    return [complex(float(point.find("x").text), float(point.find("y").text)) for point in element.findall("point")]


def refs(element, tag):
    return {int(one.get("ref")) for one in element.findall(tag)}


def controls_of_commonroad(text, grid):
    root, lanes = ET.fromstring(text), numbered(lane_graph(grid))
    signs = {int(one.get("id")): one.find("trafficSignElement/trafficSignID").text for one in root.iter("trafficSign")}
    lights = {int(one.get("id")): [part.text for part in one.iter("color")] for one in root.iter("trafficLight")}
    (limit,) = [number for number, kind in signs.items() if kind == "274"]
    lanelets = {int(one.get("id")): one for one in root.findall("lanelet")}
    used, controls = {limit}, {}
    for intersection in root.iter("intersection"):
        kinds, ways, from_right = {}, {}, {}
        for incoming in intersection.iter("incoming"):
            after = {out for tag in ("Right", "Straight", "Left") for out in refs(incoming, f"successors{tag}")}
            ((row, column, heading),) = {lanes[number][:3] for number in after}
            ways[heading], from_right[heading] = int(incoming.get("id")), refs(incoming, "isLeftOf")
            for number in refs(incoming, "incomingLanelet"):
                lanelet = lanelets[number]
                rules = (refs(lanelet, "trafficSignRef") - {limit}) | refs(lanelet, "trafficLightRef")
                assert (lanelet.find("stopLine") is not None) == bool(rules) and len(rules) <= 1
                used |= rules
                for rule in rules:
                    kinds[heading] = signs.get(rule) or lights[rule]
        tile = row, column
        arms = {approach[2] for approach in approaches(grid) if approach[:2] == tile}
        # North meets those who drive west from its right, and so on, clockwise.
        assert from_right == {heading: {ways[way] for way in arms & {(heading - 1) % 4}} for heading in arms}
        if not kinds:
            continue
        assert kinds.keys() == arms
        words = {kind for kind in kinds.values() if isinstance(kind, str)}
        if not words:
            assert kinds == {heading: CYCLE[2:] + CYCLE[:2] if heading % 2 else CYCLE for heading in arms}
            controls[tile] = Control("traffic_light")
        elif words <= {"205", "306"}:
            low = frozenset(heading for heading, kind in kinds.items() if kind == "205")
            controls[tile] = Control("priority", low)
        else:
            (word,) = words
            controls[tile] = Control({"206": "allway_stop", "102": "right_before_left"}[word])
    assert used == {*signs, *lights}
    return controls


def points_of_commonroad(text):
    return [place for one in ET.fromstring(text).findall("lanelet") for side in one[:2] for place in points_of(side)]


def controls_of_sumo(plain, grid):
    types = {node.get("id"): node.get("type") for node in ET.fromstring(plain.nodes).iter("node")}
    crossings = {"{}_{}".format(*approach[:2]): approach[:2] for approach in approaches(grid)}
    assert {types[node] for node in types.keys() - crossings.keys()} <= {"priority"}
    return {tile: Control(types[node]) for node, tile in crossings.items()}


def points_of_sumo(plain):
    shapes = [edge.get("shape").split() for edge in ET.fromstring(plain.edges)]
    return [complex(*map(float, point.split(","))) for shape in shapes for point in shape]


def controls_of_pufferdrive(made, grid):
    roads = json.loads(made.text)["roads"]
    points = [point for road in roads if road["type"] == "stop_sign" for point in road["geometry"]]
    return controls_of_signs([complex(point["x"], point["y"]) for point in points], grid)


def controls_of_signs(signs, grid):
    """A stop sign is to the right of the lane that enters a crossing, at the border of its tile. Lanes are 3.2 m."""
    places = {}
    for row, column, into in approaches(grid):
        centre = column + 0.5 + (len(grid) - row - 0.5) * 1j
        place = 30 * (centre - AHEAD[into] / 2) - 3.2j * AHEAD[into]
        places[row, column, into] = place
    stops = set()
    for sign in signs:
        (approach,) = (approach for approach, place in places.items() if abs(place - sign) < 1e-3)
        assert approach not in stops
        stops.add(approach)
    tiles = {approach[:2] for approach in stops}
    assert stops == {approach for approach in places if approach[:2] in tiles}  # at all arms
    return dict.fromkeys(tiles, Control("allway_stop"))


def points_of_pufferdrive(made):
    roads = [road["geometry"] for road in json.loads(made.text)["roads"] if road["type"] == "lane"]
    return [complex(point["x"], point["y"]) for road in roads for point in road]


def controls_of_scenarionet(made, grid):
    features = pickle.loads(made)["map_features"]
    signs = [feature for feature in features.values() if feature["type"] == "STOP_SIGN"]
    for sign in signs:
        turns = {tuple(features[lane]["polyline"][0].tolist()) for lane in sign["lane"]}
        (start,) = turns  # A sign is for the lanes that start at one point, to its left.
        assert np.hypot(*(sign["position"] - start)[:2]) == pytest.approx(1.6, abs=1e-3)
    return controls_of_signs([complex(*sign["position"][:2].astype(float)) for sign in signs], grid)


def points_of_scenarionet(made):
    lanes = [feature for feature in pickle.loads(made)["map_features"].values() if "exit_lanes" in feature]
    return [
        complex(*point) for lane in lanes for points in (lane["polyline"], lane["polygon"]) for point in points[:, :2]
    ]


NETWORKS = {
    "opendrive": Format(
        lambda source, *streets: to_opendrive(as_map(source), *streets),
        controls_of_opendrive,
        points_of_opendrive,
        ("allway_stop", "traffic_light", "priority"),
    ),
    "lanelet2": Format(
        lambda source, *streets: to_lanelet2(as_map(source), *streets),
        controls_of_lanelet2,
        points_of_lanelet2,
        ("allway_stop", "traffic_light", "priority"),
    ),
    "commonroad": Format(
        lambda source, *streets: to_commonroad(as_map(source), *streets),
        controls_of_commonroad,
        points_of_commonroad,
        ("allway_stop", "traffic_light", "priority", "right_before_left"),
    ),
    "sumo": Format(
        lambda source, *streets: to_sumo(as_map(source), "city", *streets),
        controls_of_sumo,
        points_of_sumo,
        ("allway_stop", "traffic_light", "priority", "right_before_left"),
    ),
    "pufferdrive": Format(
        lambda source, *streets: to_pufferdrive(as_map(source), "city", *streets),
        controls_of_pufferdrive,
        points_of_pufferdrive,
        ("allway_stop",),
    ),
    "scenarionet": Format(
        lambda source, *streets: to_scenarionet(as_map(source), "city", *streets),
        controls_of_scenarionet,
        points_of_scenarionet,
        ("allway_stop",),
    ),
}
"""The formats of networks by name."""
