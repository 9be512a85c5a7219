"""Signs and lights of a map in the formats of networks: each at its crossing, for the drivers who read it."""

import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from networks import approaches, ends_of, lit, pose_at, signals_of
from simulator_maps import KNOT

from elitelanes_jax import rotate
from elitelanes_jax.formats import MapObject, RoadMap, read_map
from elitelanes_jax.formats.opendrive import to_opendrive
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.maps import furnish
from elitelanes_jax.network.codes import SIDES

BARE = read_map(Path(__file__).parents[2] / "docs" / "examples" / "town.json").codes
TOWN = furnish(BARE, "signs lights=0.4 trees=3")
TOPOLOGY = {(0, 1): "right_T", (0, 3): "left_T", (1, 3): "T", (0, 1, 3): "4_way"}  # by quarter turns clockwise


def test_each_approach_has_its_signs_and_lights():
    """Duckietown's rules place signs for the control and the topology of each approach; a light faces each."""
    streets = Streets()
    found, lights = signals_of(to_opendrive(as_map(TOWN), streets)), lit(TOWN)
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


def signs_on_roads(text):
    """Each sign with its road's middle, a pose for every metre, and its lane; signals are on their roads."""
    for road in ET.fromstring(text).iter("road"):
        pieces = road.findall("planView/geometry")
        middle = [pose_at(piece, s) for piece in pieces for s in np.arange(0, float(piece.get("length")), 1.0)]
        for signal in road.iter("signal"):
            assert 0 <= float(signal.get("s")) <= float(road.get("length"))
            place = signal.find("positionInertial")
            if place is not None:
                x, y, heading = (float(place.get(name)) for name in ("x", "y", "hdg"))
                yield signal, x + 1j * y, heading, road, middle


def test_signs_are_on_the_road_beside_them_and_street_names_on_the_road_that_they_face():
    named = furnish(BARE, "street_names")
    for signal, place, heading, road, middle in signs_on_roads(to_opendrive(named)):
        assert signal.get("name") == "sign_street_name"
        front = place - 9 * np.exp(1j * heading)
        assert min(abs(front - there) for there, _ in middle) < 11, road.get("name")
    straights = [(tuple(tile), side) for tile in np.argwhere((BARE == 5) | (BARE == 10)).tolist() for side in SIDES]
    count = 0
    for (row, column), side in straights:
        if BARE[row, column] & side.bit:
            for aside in (0.45, 0.58):  # to the right of who drives to that side, on the tile and beside it
                x, y = column + 0.5 - aside * side.down, row + 0.5 + aside * side.right
                sign = MapObject("sign_pedestrian", x, y, np.arctan2(side.down, -side.right), 0.18)
                text = to_opendrive(RoadMap(BARE, objects=[sign]))
                ((signal, place, heading, _, middle),) = signs_on_roads(text)
                far, angle = min((abs(place - there), angle) for there, angle in middle)
                angle += np.pi * (signal.find("validity").get("fromLane") == "1")
                assert far < 30 * aside + 1 and np.cos(angle - heading) > 0.99, (row, column, side.name)
                count += 1
    assert count > 20


def test_a_sign_is_at_the_road_to_the_left_of_its_reader_first():
    """South of two turns of one road, both as near and as oblique: the eastern one is left of who drives south."""
    codes = np.array([[6, 7, 3, 6, 3], [14, 13, 15, 11, 10], [12, 5, 9, 12, 9]])
    sign = MapObject("sign_parking", 3.75, 3.35, np.pi / 2, 0.18)
    ((signal, _, _, road, _),) = signs_on_roads(to_opendrive(RoadMap(codes, objects=[sign])))
    assert (road.get("name"), signal.get("orientation")) == ("1_3_south", "-")


def test_a_turned_map_has_its_signs_on_the_same_roads():
    random = np.random.default_rng(0)
    kinds = ("sign_stop", "sign_parking", "sign_street_name", "sign_no_left_turn", "sign_T_intersect")
    places = random.uniform(0, BARE.shape[::-1], (200, 2)).tolist()
    more = [MapObject(kinds[i % 5], *place, random.choice(4) * np.pi / 2, 0.18) for i, place in enumerate(places)]
    town = RoadMap(BARE, objects=[*furnish(BARE, "signs street_names").objects, *more])
    width, found = BARE.shape[1], []
    objects = [one._replace(x=one.y, y=width - one.x, angle=one.angle + np.pi / 2) for one in town.objects]
    for map_, turn in ((town, 1), (RoadMap(np.array(rotate(BARE)), objects=objects), 1j)):
        centre = 15 * (map_.codes.shape[1] + 1j * map_.codes.shape[0])
        found.append(Counter())
        for signal, place, _, road, _ in signs_on_roads(to_opendrive(map_)):
            ahead = 1 if signal.get("orientation") == "+" else -1
            end, angle = ends_of(road)[ahead == 1]
            values = (place - centre) / turn, (end - centre) / turn, ahead * np.exp(1j * angle) / turn
            found[-1][signal.get("name"), *(np.round([(v.real, v.imag) for v in values], 1).ravel() + 0.0)] += 1
    assert found[0] == found[1] and found[0].total() == len(town.objects)


@pytest.mark.parametrize("tile", [30.0, 8.43, 0.585, 333.3])
def test_signals_are_not_beyond_the_end_of_their_road(tile):
    streets = Streets(tile, tile / 10)
    for codes in (BARE, KNOT):
        for road in ET.fromstring(to_opendrive(as_map(codes), streets)).iter("road"):
            length = float(road.get("length"))
            assert all(float(signal.get("s")) in (0, length) for signal in road.iter("signal"))
