"""Objects of a map: kept by its file, checked, and sized by their height."""

import math

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.formats import OBJECT_KINDS, MapObject, RoadMap, read_map
from elitelanes_jax.formats.dt_maps import to_dt_maps, to_duckiematrix
from elitelanes_jax.formats.duckietown import to_duckietown

GRID = np.array([[6, 12], [3, 9]], np.int8)
OBJECTS = (
    MapObject("duckie", 0.1, 0.2, 0.5, 0.08, static=False),
    MapObject("sign_stop", -0.05, 1.5, math.pi, 0.18, tag=20),
    MapObject("floor_tag", 1.0, 1.0, 0.0, 0.0, tag=300),
)


WRITTEN = 1e-5  # poses are written with six decimals


def check_same(found, expected, close=None):
    for one, other in zip(found, expected, strict=True):
        assert one[1:5] == pytest.approx(other[1:5], abs=close)
        assert (one.kind, one.tag, one.static) == (other.kind, other.tag, other.static)


def test_a_map_file_keeps_objects(tmp_path):
    """What is written is read, in every field."""
    road_map = RoadMap(GRID, objects=OBJECTS)
    road_map.save(tmp_path / "map.json")
    found = read_map(tmp_path / "map.json")
    assert found == road_map
    assert found.objects == OBJECTS
    text = (tmp_path / "map.json").read_text()
    assert text.count('"static"') == 1 and text.count('"tag"') == 2  # those that have no default


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
    ("objects", "subject", "got"),
    [
        ({"kind": "duckie"}, "objects", "{'kind': 'duckie'}"),
        ([3], "objects: object 0", "3"),
        ([{"kind": "dukie", "x": 0, "y": 0}], "objects: object 0: kind", "'dukie'"),
        ([{"kind": "helicopter", "x": 0, "y": 0}], "objects: object 0: kind", "'helicopter'"),
        ([OBJECTS[0], {"kind": "cone", "x": 3.1, "y": 0}], "objects: object 1: x", "3.1"),
        ([{"kind": "cone", "x": 10**309, "y": 0}], "objects: object 0: x", "1000000000000000000000000000000000000..."),
        ([{"kind": "cone", "x": 0}], "objects: object 0: y", "None"),
        ([{"kind": "cone", "x": 0, "y": 0, "size": 2}], "objects: object 0", "'size'"),
        ([{"kind": "cone", "x": 0, "y": 0, "angle": float("nan")}], "objects: object 0: angle", "nan"),
        ([{"kind": "cone", "x": 0, "y": 0, "height": 0}], "objects: object 0: height", "0"),
        ([{"kind": "sign_stop", "x": 0, "y": 0, "tag": 587}], "objects: object 0: tag", "587"),
        ([{"kind": "duckie", "x": 0, "y": 0, "static": "no"}], "objects: object 0: static", "'no'"),
    ],
)
def test_wrong_objects_are_named(objects, subject, got):
    """One message names the object, its field, what was expected and what came."""
    with refused(subject, got):
        RoadMap(GRID, objects=objects)


TILES = "tiles:\n- [curve_left/W, curve_left/N]\n- [curve_left/S, curve_left/E]\n- [grass, grass]\n"


def test_four_ways_to_say_where_an_object_is(tmp_path):
    """All are read as a position from the north-west corner, in tiles, and an angle from east."""
    file = tmp_path / "map.yaml"
    file.write_text(
        "tile_size: 0.5\n" + TILES + "objects:\n"
        "  a: {kind: duckie, pos: [1.5, 0.25], rotate: 90, height: 0.06, optional: true, static: False}\n"
        "  b: {kind: sign_1_way_left, pose: {~SE2Transform: {p: [0.75, 1.375], theta_deg: 450}}}\n"
        "  c: {kind: truck, height: 0.2, place: {tile: [1, 2],\n"
        "      relative: {~SE2Transform: {p: [0.05, -0.05], theta: 1.5}}}}\n"
        "  d: {kind: sign_stop, attach: {tile: [1, 2], slot: 4}, pose: {~SE2Transform: {theta_deg: 180}},\n"
        "      tag: {~TagInstance: {family: 36h11, tag_id: 31, size: 0.08}}}\n"
        "  e: {kind: sign_stop, attach: {tile: [1, 2], slot: 4}, pose: {~SE2Transform: {theta: 1.5}}}\n",
        encoding="utf-8",
    )
    expected = [
        MapObject("duckie", 1.5, 0.25, math.pi / 2, 0.06, static=False),
        MapObject("sign_oneway_left", 1.5, 0.25, math.pi / 2, 0.18),
        MapObject("truck", 1.6, 0.6, 1.5, 0.2),
        MapObject("sign_stop", 1 - 0.18, 1 + 0.07, math.pi, 0.18, tag=31),
        MapObject("sign_stop", 1 - 0.18, 1 + 0.07, 1.5, 0.18),
    ]
    check_same(read_map(file).objects, expected)


def test_objects_of_duckietown_are_written_as_they_are_read(tmp_path):
    """A traffic light is at its stand here, and at the middle of its mesh there."""
    more = MapObject("trafficlight", 0.5, 1.75, 0.75, 0.4), MapObject("other:helicopter", 0.5, 0.5, 0.0, 0.3)
    objects = (*OBJECTS, *more)
    file = tmp_path / "map.yaml"
    file.write_text(to_duckietown(GRID, objects=objects, tile_size=0.6), encoding="utf-8")
    check_same(read_map(file).objects, objects, WRITTEN)
    assert "kind: helicopter" in file.read_text(encoding="utf-8")
    assert "objects" not in to_duckietown(GRID)


@pytest.mark.parametrize("tile_size", [0.01, 0.07, 0.585, 0.61, 30])
@pytest.mark.parametrize("kind", ["sign_stop", "trafficlight"])
def test_objects_as_far_outside_as_they_may_be_are_read_where_they_are_written(kind, tile_size, tmp_path):
    """Metres are rounded to six decimals, and the division by the tile's side rounds too."""
    places = [(x, y, angle) for x in (-1, 0, 3) for y in (-1, 0, 4) for angle in (0, 1, -2, 3)]
    far = RoadMap([[6, 3], [10, 10], [12, 9]], objects=[MapObject(kind, *place, 0.18) for place in places])
    (tmp_path / "map.yaml").write_text(to_duckietown(far.codes, objects=far.objects, tile_size=tile_size))
    layers = {
        "library": to_dt_maps(far, tile_size=tile_size),
        "matrix": to_duckiematrix(far, tile_size=tile_size),
    }
    for folder, texts in layers.items():
        (tmp_path / folder).mkdir()
        for name, text in texts.items():
            (tmp_path / folder / f"{name}.yaml").write_text(text)
    for name in ("map.yaml", *layers):
        read = read_map(tmp_path / name)
        objects = [thing for thing in read.objects if thing.kind == kind]
        check_same(objects, far.objects, 2e-4)
        read.save(tmp_path / "map.json")
        assert read_map(tmp_path / "map.json") == read


@pytest.mark.parametrize(
    ("objects", "subject", "got"),
    [
        ("3", "...map.yaml: objects", "'3'"),
        ("[3]", "...map.yaml: objects: 0", "'3'"),
        ("[{kind: 'a dragon', pos: [1, 1]}]", "...map.yaml: objects: 0: kind", "'other:a dragon'"),
        ("{a: {kind: duckie}}", "...map.yaml: objects: a", "none"),
        ("[{kind: duckie, pos: [1]}]", "...map.yaml: objects: 0: pos", "['1']"),
        ("[{kind: duckie, pos: [1, x]}]", "...map.yaml: objects: 0: pos", "'x'"),
        ("[{kind: duckie, pos: [1, nan]}]", "...map.yaml: objects: 0: pos", "'nan'"),
        ("[{kind: duckie, pos: [1, 1_0]}]", "...map.yaml: objects: 0: pos", "'1_0'"),
        ("[{kind: duckie, pose: 3}]", "...map.yaml: objects: 0: ~SE2Transform", "None"),
        ("[{kind: sign_stop, attach: {tile: [1, 1], slot: 9}}]", "...map.yaml: objects: 0: slot", "9"),
        (
            "[{kind: sign_stop, attach: {tile: [1, 1], slot: 1e308}}]",
            "...map.yaml: objects: 0: slot",
            "1000000000000000010979063629440455417...",
        ),
        (
            "[{kind: floor_tag, pos: [1, 1], tag: {~TagInstance: {tag_id: 3.7}}}]",
            "...map.yaml: objects: 0: tag_id",
            "3.7",
        ),
        ("[{kind: duckie, pos: [9, 1]}]", "...map.yaml: objects: object 0: x", "9.0"),
    ],
)
def test_objects_that_cannot_be_read_are_named(tmp_path, objects, subject, got):
    """One message names the file, the object, and what was expected."""
    file = tmp_path / "map.yaml"
    file.write_text(f"tile_size: 0.5\n{TILES}objects: {objects}\n", encoding="utf-8")
    with refused(subject, got):
        read_map(file)
