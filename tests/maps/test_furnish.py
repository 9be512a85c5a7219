"""Furnished maps: signs by Duckietown's rules, objects where they fit, the same for the same seed."""

import itertools
import json
import math
import re
import shutil
from collections import Counter
from itertools import pairwise
from pathlib import Path

import check_objects
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import InputError, RoadMap, read_map
from elitelanes_jax._util import progress
from elitelanes_jax._util.checks import check_named
from elitelanes_jax.cli.main import main
from elitelanes_jax.drive import Camera
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.tags import STREET_NAMES
from elitelanes_jax.maps import faults as map_faults
from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.furnishing.placing import placed_kinds
from elitelanes_jax.maps.furnishing.space import Space, make_object
from elitelanes_jax.maps.furnishing.spec import FurnishSpec, parse_furnish
from elitelanes_jax.tiles.tileset import default_tiles

# A 4-way crossing amid T crossings of all four directions, with straight tiles between.
TOWN = np.array(
    [
        [6, 5, 7, 5, 3],
        [10, 0, 10, 0, 10],
        [14, 5, 15, 5, 11],
        [10, 0, 10, 0, 10],
        [12, 5, 13, 5, 9],
    ],
    np.int8,
)


def faults(road_map):
    return check_objects.check(to_duckietown(road_map.codes, objects=road_map.objects))


@pytest.mark.parametrize(
    "spec", ["signs", "all", "all signs street_names lights=1", "signs street_names lights=0.5 trees=0.9 houses=0.5"]
)
def test_no_rule_is_broken(spec):
    """As a checker finds that reads the file alone."""
    for seed in range(5):
        assert faults(furnish(TOWN, spec, seed=seed)) == []


@pytest.mark.parametrize(
    "spec", ["all street_names=possible", "signs", "signs lights=1", "lights=0.5 buses=1 lane_duckies=1", "trees=0"]
)
@pytest.mark.parametrize("crossings", [True, False])
def test_the_kinds_that_are_placed_are_known_before(spec, crossings):
    """On this town, each kind that may be placed is placed for some seed."""
    codes = TOWN if crossings else np.array([[6, 5, 3, 0], [12, 5, 9, 0]], np.int8)
    expected = placed_kinds(parse_furnish(spec), set(codes.flat))
    placed = set()
    for seed in range(20):
        placed |= {thing.kind for thing in furnish(codes, spec, seed=seed).objects}
    assert placed <= expected
    if crossings and "all" not in spec:
        assert placed == expected


EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


def test_the_checker_finds_what_is_wrong():
    """Each change of a furnished map breaks a rule."""
    town = furnish(TOWN, "signs street_names lights=0.3 trees=3", seed=1)
    kinds = [thing.kind for thing in town.objects]
    stop, tree, light = kinds.index("sign_stop"), kinds.index("tree"), kinds.index("trafficlight")
    corner, straight = (kinds.index("sign_street_name") + place for place in (0, 1))
    for place, change in (
        (stop, {"tag": 2}),
        (stop, {"angle": town.objects[stop].angle + 1.6}),
        (stop, {"kind": "sign_t_light_ahead"}),
        (stop, {"x": town.objects[stop].x - 1}),
        (tree, {"x": 2.5, "y": 1.5}),
        (tree, {"x": town.objects[stop].x, "y": town.objects[stop].y}),
        (light, {"angle": town.objects[light].angle + 1}),
        (corner, {"tag": 20}),
        (corner, {"x": 4.7, "y": 0.3}),
        (corner, {"angle": 0.0}),
        (corner, {"kind": "tree"}),
        (straight, {"angle": town.objects[straight].angle + math.pi}),
    ):
        objects = list(town.objects)
        objects[place] = objects[place]._replace(**change)
        assert faults(RoadMap(TOWN, objects=objects)), change
    for place in (0, corner, straight):
        assert faults(RoadMap(TOWN, objects=town.objects[:place] + town.objects[place + 1 :]))


def test_signs_of_a_crossing_are_where_the_manual_has_them():
    """From the south of the 4-way crossing: the topology at the far right corner, the stop sign at the far left one."""
    facing_south = {
        (thing.kind, round(thing.x, 2), round(thing.y, 2))
        for thing in furnish(TOWN, "signs").objects
        if abs(thing.angle + math.pi / 2) < 1e-9 and 1 < thing.x < 4 and 1 < thing.y < 4
    }
    assert ("sign_4_way_intersect", 3.08, 1.92) in facing_south
    assert ("sign_stop", 1.8, 1.92) in facing_south


@pytest.mark.parametrize("distance", [0.3, 0.45, 0.6])
def test_both_signs_are_in_the_picture(distance):
    """All of their boards, some tiles before the stop line. Signs of all crossings have this position from it."""
    camera = Camera()
    pitch, focal = math.radians(camera.pitch), 1 / math.tan(math.radians(camera.field_of_view / 2))
    x, y = 2.7, 3 + distance  # in the right lane, to the north
    for sign_x, sign_y in ((3.08, 1.92), (1.8, 1.92)):
        ahead = (y - sign_y) * 0.585 - camera.forward
        for side, up in itertools.product((-0.036, 0.036), (0.036, 0.18)):
            drop = camera.height - up
            depth = ahead * math.cos(pitch) + drop * math.sin(pitch)
            assert abs(((sign_x - x) * 0.585 + side) / depth * focal) < 4 / 3
            assert abs((drop * math.cos(pitch) - ahead * math.sin(pitch)) / depth * focal) < 1


RING = np.zeros((4, 8), np.int8)
RING[[0, -1]], RING[:, [0, -1]] = 5, 10
RING[0, 0], RING[0, -1], RING[-1, 0], RING[-1, -1] = 6, 3, 12, 9
RING[[0, -1], 3], RING[1:-1, 3] = (7, 13), 10


def test_the_signs_of_a_road_have_one_street_name():
    """Two turns and a straight road make three roads; each has its own name."""
    signs = furnish(RING, "street_names").objects
    names = [STREET_NAMES[sign.tag] for sign in signs]
    sides = ["west" if sign.x < 2 else "middle" if sign.x < 4.2 else "east" for sign in signs]
    assert Counter(sides) == {"west": 2, "east": 2, "middle": 1}
    assert len(set(zip(sides, names, strict=True))) == len(set(names)) == 3
    assert len({sign.tag for sign in signs}) == 5
    tags = Counter(STREET_NAMES.values())
    for name, count in Counter(names).items():
        assert tags[name] == min(number for number in tags.values() if number >= count), "no longer name than it needs"
    assert faults(furnish(RING, "signs street_names")) == []


def test_street_names_without_room_are_refused_or_left_out():
    """Between three rows of roads there is no free side."""
    grid = np.array([[6, 5, 5, 3], [14, 5, 5, 11], [12, 5, 5, 9]], np.int8)
    with refused("street_names", "none at the road from B2 ([1, 1])"):
        furnish(grid, "street_names")
    assert len(furnish(grid, "street_names=possible").objects) == 4
    grid = np.array([[6, 3] * 32, [12, 9] * 32] * 2, np.int8)  # 64 rings of four turns
    with refused("unique_tags", "more", expected="at most"):
        furnish(grid, "street_names unique_tags")
    assert len(furnish(grid, "street_names").objects) == 256


def test_tags_of_own_objects_are_in_use():
    town, own = EXAMPLES / "town.json", {"kind": "sign_stop", "x": 1.5, "y": 1.5, "tag": 1}
    assert 1 in {one.tag for one in furnish(town, "signs").objects}
    spec = FurnishSpec(signs="all", objects=[own], unique_tags=True)
    found = [one.tag for one in furnish(town, spec).objects]
    assert len(set(found)) == len(found) > 9
    with refused("unique_tags", "1 twice"):
        furnish(town, FurnishSpec(objects=[own, own | {"x": 2.5}], unique_tags=True))


OWN = [{"kind": "bus", "x": 1.5, "y": 1.5, "angle": 0.5}, {"kind": "sign_stop", "x": 3.2, "y": 1.4, "tag": 33}]


def test_objects_of_ones_own_are_kept_as_they_are(tmp_path):
    """From a file of TOML, or a map file; other objects keep clear of them."""
    file, other = tmp_path / "my own.toml", tmp_path / "map.json"
    tables = [
        "[[objects]]\n" + "".join(f"{name} = {json.dumps(value)}\n" for name, value in one.items()) for one in OWN
    ]
    file.write_text("".join(tables), encoding="utf-8")
    own = RoadMap(TOWN, objects=OWN)
    own.save(other)
    town = furnish(TOWN, [str(file), "signs", "trees=0.9"])
    assert town.objects[:2] == own.objects
    assert faults(RoadMap(TOWN, objects=(town.objects[0], *town.objects[2:]))) == []
    assert furnish(TOWN, f"signs {other} trees=0.9") == town == furnish(TOWN, ["signs", "trees=0.9", other.as_posix()])
    assert furnish(TOWN, {"objects": OWN}).objects == own.objects == furnish(TOWN, other).objects
    with refused("objects: object 1: x", "3.2"):
        furnish(TOWN[:, :2], {"objects": OWN})
    with refused("objects", "one", expected="sign_stop at x 1.8, y 1.92"):
        furnish(TOWN, {"objects": [{"kind": "cone", "x": 1.8, "y": 1.9}], "signs": "all"})


def test_a_second_map_is_no_file_of_objects(tmp_path, capsys):
    """The command furnishes one map; a map without objects among its words was meant to be furnished too."""
    first, second, out = (tmp_path / name for name in ("a.json", "b.json", "out.json"))
    for file in (first, second):
        RoadMap(TOWN).save(file)
    assert main(["furnish", str(first), str(second), "signs", "--out", str(out)]) == 2
    assert capsys.readouterr().err == (
        f"elitelanes: furnish: {second}: expected objects to place, got a map without any (a call furnishes one map)\n"
    )
    assert not out.exists()


def test_the_same_seed_gives_the_same_objects():
    """Whatever else the map has; another seed gives others."""
    town = furnish(TOWN, "all", seed=4)
    assert furnish(RoadMap(TOWN, fitness=1.0), "all", seed=4).objects == town.objects
    assert furnish(town, "all", seed=4) == town
    assert furnish(TOWN, "all", seed=5) != town
    assert furnish(TOWN, FurnishSpec(trees=3), seed=4) == furnish(TOWN, {"trees": 3}, seed=4)


def test_amounts_are_counts_or_shares():
    """Whole numbers are exact; shares are of the cells without road."""
    found = Counter(thing.kind for thing in furnish(TOWN, "duckies=6 trees=0.5 lane_robots=2 lane_duckies=3").objects)
    assert found == {"duckie": 9, "tree": 2, "duckiebot": 2}
    lit = Counter(thing.kind for thing in furnish(TOWN, "lights=0.75 trees=0.45").objects)
    assert lit == {"trafficlight": 4, "tree": 2}, "the nearest whole numbers of 3.75 and 1.8"
    with refused("furnish: lights", "'all'"):
        furnish(TOWN, "lights=all")
    with refused("trees", "1, of which 0 fit"):
        furnish(np.full((2, 2), 15), "trees=1")
    walking = furnish(TOWN, "crossing_duckies=3").objects
    assert [thing.static for thing in walking] == [False] * 3


AMOUNTS = [name for name, value in vars(FurnishSpec()).items() if value == 0 and name not in ("lights", "unique_tags")]


def test_numbers_of_objects_outside_lanes_need_cells_without_road():
    numbers = FurnishSpec(**dict.fromkeys(AMOUNTS, 3)).numbers_beside_roads
    assert numbers == {name: 3 for name in AMOUNTS if not name.startswith("lane_")}
    assert not FurnishSpec(**dict.fromkeys(AMOUNTS, 0.9)).numbers_beside_roads


@pytest.mark.parametrize("name", AMOUNTS)
def test_more_objects_than_the_area_holds_are_refused_before_they_are_placed(name):
    """Placing 100,000 on a small map would take half an hour. The limit is above any number that fits."""
    for codes in ([[5]], [[5, 0]], [[0]], [[6, 3], [12, 9]]):
        try:
            furnish(np.array(codes), f"{name}=100000")
        except InputError as error:
            message = str(error)
        if "at most" not in message:  # no spot
            assert "of which 0 fit" in message
            continue
        most = int(re.search(r"of which at most (\d+) fit", message)[1])
        assert most < 1700
        with refused(name, f"{most}, of which ... fit"):
            furnish(np.array(codes), f"{name}={most}")


def test_placing_many_objects_shows_how_many_are_placed(monkeypatch, capsys):
    """100,000 duckies take minutes on 64 x 64 tiles."""
    monkeypatch.setattr(progress, "_LINES", 0.05)
    with progress.reporting(quiet=False):
        furnish(np.zeros((16, 16), int), "duckies=3000")
    first, *_ = capsys.readouterr().err.splitlines()
    assert re.match(r"placing duckies [\d,]+/3,000 objects, 0:0\d left$", first)


def test_each_amount_has_places_of_its_own():
    """Though cones and duckies are drawn on the same spots."""
    places = [[(one.x, one.y) for one in furnish(TOWN, what).objects] for what in ("cones=4", "duckies=4")]
    assert not set(places[0]) & set(places[1])


def test_objects_beside_a_road_look_at_it():
    """They are at most 0.3 tiles from it, and 0.4 tiles ahead of them is road."""
    things = furnish(TOWN, "barriers=6 crossing_duckies=6").objects
    assert len({round(thing.angle % math.tau, 3) for thing in things}) == 4
    for thing in things:
        assert not TOWN[math.floor(thing.y), math.floor(thing.x)]
        row, column = thing.y - 0.4 * math.sin(thing.angle), thing.x + 0.4 * math.cos(thing.angle)
        assert TOWN[math.floor(row), math.floor(column)]


@pytest.mark.parametrize("lane_offset", [0.2, 0.23])
@pytest.mark.parametrize(("code", "across"), [(5, math.sin), (10, math.cos)])
def test_only_asked_for_objects_are_in_lanes(code, across, lane_offset):
    """Objects in lanes are on straight tiles, in the middle of the right-hand lane, along the road."""
    town = furnish(TOWN, "lane_robots=6 lane_duckies=4", seed=2, lane_offset=lane_offset)
    things = [thing for thing in town.objects if TOWN[math.floor(thing.y)][math.floor(thing.x)] == code]
    for thing in things:
        assert abs(across(thing.angle)) < 1e-5
        offset = (thing.x % 1 - 0.5) * math.sin(thing.angle) + (thing.y % 1 - 0.5) * math.cos(thing.angle)
        assert abs(offset - lane_offset) < 1e-5  # to the right
    assert len({round(thing.angle, 3) for thing in things}) == 2
    assert all(TOWN[math.floor(thing.y)][math.floor(thing.x)] in (5, 10) for thing in town.objects)


def test_the_command_places_objects_in_the_lanes_of_its_tiles(tmp_path):
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    with (tmp_path / "tiles" / "tileset.toml").open("a") as file:
        file.write("lane_offset = 0.24\n")
    RoadMap(TOWN).save(tmp_path / "map.json")
    command = ["furnish", str(tmp_path / "map.json"), "lane_robots=6", "--tiles", str(tmp_path / "tiles")]
    assert main([*command, "--out", str(tmp_path / "out.json")]) == 0
    assert read_map(tmp_path / "out.json").objects == furnish(TOWN, "lane_robots=6", lane_offset=0.24).objects


def test_tags_are_reused_far_away_or_refused():
    """No number twice while there are unused ones; later the farthest."""
    grid = np.kron(np.ones((9, 9), np.int8), np.array([[15, 5], [10, 0]], np.int8))[:-1, :-1]
    grid[0], grid[-1] = np.tile([7, 5], 9)[:-1], np.tile([13, 5], 9)[:-1]
    grid[:, 0], grid[:, -1] = np.tile([14, 10], 9)[:-1], np.tile([11, 10], 9)[:-1]
    grid[0, 0], grid[0, -1], grid[-1, 0], grid[-1, -1] = 6, 3, 12, 9
    town = furnish(grid, "signs")
    assert faults(town) == []
    places = {}
    for thing in town.objects:
        places.setdefault((thing.kind, thing.tag), []).append((thing.x, thing.y))
    apart = [math.dist(*pair) for group in places.values() for pair in pairwise(group)]
    assert len([tag for kind, tag in places if kind == "sign_stop"]) == 55
    assert min(apart) > 2
    with refused("unique_tags", "more", expected="at most 55"):
        furnish(grid, "signs unique_tags")


def test_objects_keep_clear_of_those_in_the_next_cell():
    space = Space(np.zeros((1, 2), np.int8))
    left, near, far = (make_object("cone", 1 + x, 0.5, 0.0) for x in (-0.045, 0.045, 0.055))
    space.add(left)
    assert not space.is_clear(near) and space.is_clear(far)


def test_crossings_without_room_are_refused_or_left_out():
    """A road at the corner of a crossing leaves no room for signs."""
    full = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    with refused("signs", "one at B1 ([0, 1])"):
        furnish(full, "signs")
    assert furnish(full, "signs=possible").objects == ()


@pytest.mark.parametrize("words", ["signs signs=possible", "signs=possible signs", ["signs=possible", "signs"]])
def test_settings_override_words_in_any_order(words):
    full = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)  # has no room for all signs
    assert furnish(full, words).objects == ()
    with refused("furnish", "signs twice"):
        furnish(full, "signs=all signs=possible")


def test_crossings_without_room_for_signs_are_counted(monkeypatch):
    lines = []
    monkeypatch.setattr(map_faults, "announce", lines.append)
    full = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    alone = np.array([[0, 2, 0], [4, 15, 1], [0, 8, 0]], np.int8)
    words = ("signs=possible", "trees=2", "lights=1", "all lights=0.5")
    possible, none, lights, both = (check_named("furnish", parse_furnish, text) for text in words)
    map_faults.announce_without_room([RoadMap(alone)], possible)
    map_faults.announce_without_room([RoadMap(full)], none)
    map_faults.announce_without_room([RoadMap(full)], None)
    assert not lines
    map_faults.announce_without_room([RoadMap(full), RoadMap(alone)], possible)
    assert lines == ["5 of 6 crossings have no room for signs, because a road is at a corner"]
    for spec in (lights, both):
        map_faults.announce_without_room([RoadMap(full)], spec)
    assert ["for lights," in lines[1], "for signs and lights," in lines[2]] == [True, True]
