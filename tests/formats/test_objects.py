"""Objects of a map: kept by its file, checked, and sized by their height."""

import math

import numpy as np
import pytest

from elitelanes_jax import InputError
from elitelanes_jax.formats import OBJECT_KINDS, MapObject, RoadMap, read_map

GRID = np.array([[6, 12], [3, 9]], np.int8)
OBJECTS = (
    MapObject("duckie", 0.1, 0.2, 0.5, 0.08, static=False),
    MapObject("sign_stop", -0.05, 1.5, math.pi, 0.18, tag=20),
    MapObject("floor_tag", 1.0, 1.0, 0.0, 0.0, tag=300),
)


def test_a_map_file_keeps_objects(tmp_path):
    """What is written is read, in every field."""
    road_map = RoadMap(GRID, objects=OBJECTS)
    road_map.save(tmp_path / "map.json")
    found = read_map(tmp_path / "map.json")
    assert found == road_map
    assert found.objects == OBJECTS


def test_defaults_are_those_of_the_kind():
    """A kind and a position are enough."""
    (duckie,) = RoadMap(GRID, objects=[{"kind": "duckie", "x": 1, "y": 1}]).objects
    assert duckie == MapObject("duckie", 1, 1, 0, OBJECT_KINDS["duckie"].height)


def test_footprints_follow_the_height():
    """Twice as high, twice as long and wide; a disc around a rectangle goes through its corners."""
    truck = MapObject("truck", 0, 0, 0, 2 * OBJECT_KINDS["truck"].height)
    assert truck.footprint == pytest.approx((2 * 0.363, 2 * 0.157))
    assert truck.radius == pytest.approx(math.hypot(0.363, 0.157))
    assert MapObject("cone", 0, 0, 0, 0.08).radius == pytest.approx(0.025)


@pytest.mark.parametrize(
    ("objects", "words"),
    [
        ({"kind": "duckie"}, "objects: expected a list"),
        ([3], "objects: object 0: expected"),
        ([{"kind": "dukie", "x": 0, "y": 0}], "kind: expected one of .*is it duckie"),
        ([OBJECTS[0], {"kind": "cone", "x": 3.1, "y": 0}], "object 1: x: expected tiles from -1 to 3, got 3.1"),
        ([{"kind": "cone", "x": 0}], "object 0: y: .*got None"),
        ([{"kind": "cone", "x": 0, "y": 0, "size": 2}], "got 'size'"),
        ([{"kind": "cone", "x": 0, "y": 0, "angle": float("nan")}], "angle: expected radians"),
        ([{"kind": "cone", "x": 0, "y": 0, "height": 0}], "height: expected metres"),
        ([{"kind": "sign_stop", "x": 0, "y": 0, "tag": 587}], "tag: .*0 to 586, got 587"),
        ([{"kind": "duckie", "x": 0, "y": 0, "static": "no"}], "static: expected true or false"),
    ],
)
def test_wrong_objects_are_named(objects, words):
    """One message names the object, its field, what was expected and what came."""
    with pytest.raises(InputError, match=words):
        RoadMap(GRID, objects=objects)
