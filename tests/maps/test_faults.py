"""Maps that were changed by hand: what commands say of them, and which metrics they have."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from elitelanes_jax import RoadMap, mirror, read_map, rotate
from elitelanes_jax._util import progress
from elitelanes_jax.formats import MapObject
from elitelanes_jax.formats.road_map import read_maps, refresh
from elitelanes_jax.formats.signals import _FAR, _distance, crossing_of
from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.faults import count_sign_faults, warn_of_faults
from elitelanes_jax.maps.furnishing.signs import crossings, has_free_corners
from elitelanes_jax.maps.given import parse_given
from elitelanes_jax.network import plain_measure, wfc
from elitelanes_jax.network.plain_metrics import plain_town

TOWN = np.array(
    [
        [6, 5, 7, 5, 5, 5, 3],
        [10, 0, 10, 0, 0, 0, 10],
        [14, 5, 15, 5, 7, 5, 11],
        [10, 0, 10, 0, 10, 0, 10],
        [12, 5, 13, 5, 13, 5, 9],
    ],
    np.int8,
)
SIGNED = furnish(TOWN, "signs lights=0.3 trees=2", seed=1)


def faults(road_map, capsys):
    with progress.reporting(quiet=False):
        warn_of_faults("m", road_map)
        warn_of_faults("m", road_map)
    return capsys.readouterr().err


def changed(road_map, **cells):
    """The map with other codes in some cells, such as r2c2=5."""
    codes = road_map.codes.copy()
    for name, code in cells.items():
        row, column = map(int, name[1:].split("c"))
        codes[row, column] = code
    return replace(road_map, codes=codes)


def test_whole_maps_are_not_spoken_of(capsys):
    """Whatever furnish places fits, with every choice of lights."""
    for quarter_turns in range(4):
        for codes in (rotate(TOWN, quarter_turns), mirror(rotate(TOWN, quarter_turns))):
            assert faults(furnish(codes, "all lights=0.5", seed=quarter_turns), capsys) == ""
    assert faults(furnish(TOWN, "lights=0.3"), capsys) == ""
    assert faults(RoadMap(TOWN), capsys) == faults(RoadMap(np.zeros((3, 3), np.int8)), capsys) == ""


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ({"r0c0": 4}, "roads end at 2 tiles, the first at A1 ([0, 0])"),
        ({"r0c0": 14}, "roads end at 1 tile, the first at A1 ([0, 0])"),
        ({"r2c1": 0}, "roads end at 2 tiles, the first at A3 ([2, 0]); "),
        # A crossing becomes a turn, and the road of another one goes.
        ({"r2c4": 5, "r3c4": 0, "r4c4": 5}, "10 of 44 signs do not fit the roads, furnish places signs again"),
        # A T becomes a 4-way crossing: its signs of the topology are those of a T, and its new arm has none.
        (
            {"r2c4": 15, "r1c4": 10, "r0c4": 7},
            "3 of 44 signs do not fit the roads and 2 of 8 crossings lack signs, furnish places signs again",
        ),
        # A road at the corners of crossings. Some of their signs are on that road.
        (
            {"r1c3": 6, "r1c4": 5, "r1c5": 5, "r1c6": 11, "r2c3": 13},
            "8 of 44 signs do not fit the roads, furnish places signs again; "
            "6 of 9 crossings have no room for signs, because a road is at a corner",
        ),
    ],
)
def test_what_no_longer_fits_is_said_once(capsys, cells, said):
    err = faults(changed(furnish(TOWN, "signs"), **cells), capsys)
    assert err.startswith("m: ") and said in err and err.count("\n") == 1


def test_signs_that_were_deleted_are_missed(capsys):
    """By hand in the editor, or in the file: any one sign. Other makers' maps may have no control at all."""
    for thing in SIGNED.objects:
        others = tuple(other for other in SIGNED.objects if other is not thing)
        lacks = "m: 1 of 7 crossings lacks signs, furnish places signs again\n" if "sign" in thing.kind else ""
        assert faults(replace(SIGNED, objects=others), capsys) == lacks
    topologies = tuple(thing for thing in SIGNED.objects if "intersect" in thing.kind)
    assert len(topologies) == 22 and faults(replace(SIGNED, objects=topologies), capsys) == ""


def test_crossings_that_furnish_leaves_out_are_counted(capsys):
    for number in range(30):
        codes = wfc.generate_batch(np.random.default_rng(number), 1, (7, 8), border="closed").grid[0]
        furnished = furnish(codes, "signs=possible lights=0.5", seed=number)
        has_signs = any(thing.kind.startswith("sign") for thing in furnished.objects)
        free = [tile for tile in crossings(codes) if has_free_corners(codes, tile)]
        rest = len(crossings(codes)) - len(free)
        assert has_signs == bool(free)
        assert count_sign_faults(furnished)[1:] == (0, len(free) + rest, 0, rest * has_signs, 0)


def test_street_names_that_are_missing_or_at_no_road_are_counted(capsys):
    named = furnish(TOWN, "street_names")
    assert faults(named, capsys) == ""
    for thing in named.objects:
        others = tuple(other for other in named.objects if other is not thing)
        assert faults(replace(named, objects=others), capsys) == (
            "m: 1 street lacks a name, furnish places signs again\n"
        )
    assert "; 3 of 11 signs do not fit the roads, furnish" in faults(changed(named, r0c0=0, r0c1=0, r1c0=0), capsys)


def test_a_map_without_signs_needs_none(capsys):
    assert faults(changed(RoadMap(TOWN), r2c4=15, r1c4=10, r0c4=7), capsys) == ""


def test_a_light_and_signs_beside_no_crossing_are_counted(capsys):
    things = [MapObject("trafficlight", 3, 3, 0, 0.4), MapObject("sign_stop", 3, 3, 0, 0.18)]
    loop = RoadMap([[6, 5, 3], [10, 0, 10], [12, 5, 9]], objects=things)
    assert faults(loop, capsys) == "m: 2 of 2 signs do not fit the roads, furnish places signs again\n"
    alone = RoadMap(loop.codes, objects=things[:1])
    assert faults(alone, capsys) == "m: 1 of 1 signs does not fit the roads, furnish places signs again\n"


@pytest.mark.parametrize("kind", ["sign_stop", "trafficlight"])
def test_the_crossing_of_a_sign_is_the_nearest_one_of_all(kind):
    """Though only those near it are measured."""
    arms, checked = crossings(TOWN), 0
    for x, y, turns in itertools.product(np.arange(-1, 8, 0.3), np.arange(-1, 6, 0.3), range(4)):
        sign = MapObject(kind, float(x), float(y), turns * np.pi / 2, 0.2)
        nearest = min(arms, key=lambda tile, sign=sign: _distance(sign, tile))
        expected = nearest if _distance(sign, nearest) < _FAR else None
        assert crossing_of(sign, arms) == expected
        checked += expected is not None
    assert checked > 500


def test_signs_of_other_makers_are_where_they_put_them(capsys):
    """Nearer or farther from the corner than ours, as in duckietown-world's maps."""
    moved = [
        thing._replace(x=thing.x + 0.05, y=thing.y - 0.06) if thing.kind.startswith("sign_") else thing
        for thing in SIGNED.objects
    ]
    assert faults(replace(SIGNED, objects=tuple(moved)), capsys) == ""


def test_stored_metrics_of_other_codes_are_measured_again(tmp_path, capsys):
    """So every reader has metrics that fit. What a search said of the former codes is left out."""
    whole = RoadMap(TOWN, metrics=plain_measure(TOWN), fitness=3.0, niche=[1], descriptor={"turns": 4}, seed=(0, 1))
    file = tmp_path / "map.json"
    for codes, stale in ((TOWN, False), (changed(whole, r2c2=5, r1c2=0, r0c2=5, r3c2=0, r4c2=5).codes, True)):
        values = json.loads(json.dumps({"codes": codes.tolist(), "metrics": plain_measure(TOWN)}, default=float))
        values |= {"fitness": 3.0, "niche": [1], "descriptor": {"turns": 4}, "seed": [0, 1]}
        file.write_text(json.dumps(values))
        (tmp_path / "list.json").write_text(json.dumps([values, values]))
        with progress.reporting(quiet=False):
            read = [read_map(file), read_maps(file)[0], read_maps(tmp_path / "list.json")[1], parse_given(file).maps[0]]
            read.append(parse_given([RoadMap(codes, metrics=plain_measure(TOWN))]).maps[0])
        err = capsys.readouterr().err
        for road_map in read:
            assert road_map.metrics == pytest.approx(plain_measure(codes))
        assert {road_map.fitness for road_map in read[:4]} == {None if stale else 3.0}
        assert {road_map.niche is None for road_map in read[:4]} == {stale}
        assert ("map.json: measured again, because its codes were changed: " in err) == stale
        assert "list.json: map 1: measured again" in err or not stale
        assert err.count("\n") == (4 if stale else 0)


def test_a_map_of_a_list_is_named_by_its_index(tmp_path, capsys):
    ring, ending = {"codes": [[6, 3], [12, 9]]}, {"codes": [[6, 3, 0], [12, 13, 1]]}
    listed, alone = tmp_path / "list.json", tmp_path / "map.json"
    for file, content, name in ((listed, [ring, ending], f"map 1, in {listed}"), (alone, ending, alone)):
        file.write_text(json.dumps(content))
        with progress.reporting(quiet=False):
            parse_given(file)
        assert capsys.readouterr().err.endswith(f"{name}: roads end at 1 tile, the first at C2 ([1, 2])\n")


def test_stored_town_features_of_other_codes_are_measured_again(capsys):
    """A change may leave all metrics as they were."""
    ring = np.zeros((3, 6), np.int8)
    ring[:, :3] = [[6, 5, 3], [10, 0, 10], [12, 5, 9]]
    stored = plain_measure(ring) | {name: value / 1000 for name, value in plain_town(ring).items()}
    assert refresh(RoadMap(ring, metrics=stored), "ring").metrics == pytest.approx(stored)
    wrong = stored | {"symmetry": stored["symmetry"] / 2}
    assert "symmetry" not in refresh(RoadMap(ring, metrics=wrong), "ring").metrics
    with progress.reporting(quiet=False):
        assert parse_given([RoadMap(ring, metrics=wrong)]).maps[0].metrics == pytest.approx(plain_measure(ring))
    assert "symmetry 1 instead of 0.5" in capsys.readouterr().err


def test_a_map_with_some_metrics_gets_the_others():
    (given,) = parse_given([RoadMap(TOWN, metrics={"turns": plain_measure(TOWN)["turns"], "rain": 3})]).maps
    assert given.metrics == pytest.approx(plain_measure(TOWN) | {"rain": 3})
