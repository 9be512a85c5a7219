"""One table for the networks of all formats: each property holds for each format."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from networks import NETWORKS, Control, approaches, lit
from refusals import refused
from simulator_maps import BLOCK, KNOT, RING

from elitelanes_jax import RoadMap, rotate
from elitelanes_jax.formats import MapObject, read_map
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.maps import furnish

TOWN = read_map(Path(__file__).parents[2] / "docs" / "examples" / "town.json").codes
SIGNED = furnish(TOWN, "signs lights=0.4 trees=3")
STOPS = [one for one in furnish(TOWN, "signs").objects if one.kind == "sign_stop"]
DEAD_ENDS = np.array([[2, 0, 0], [14, 5, 1], [8, 0, 0]], np.int8)
EIGHT = np.array([[6, 3, 0], [12, 15, 3], [0, 12, 9]], np.int8)
GRIDS = {"ring": RING, "dead ends": DEAD_ENDS, "adjacent crossings": BLOCK, "loops": EIGHT, "knot": KNOT, "town": TOWN}
RIGHTS = ("allway_stop", "traffic_light", "priority", "right_before_left")

all_formats = pytest.mark.parametrize("to", NETWORKS)
all_grids = pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)


def control_of(tile, grid, right_of_way):
    """The control of a crossing: at three arms the road that goes straight on goes first, at four nobody does."""
    if right_of_way != "priority":
        return Control(right_of_way)
    arms = {heading: turns for (*crossing, heading), turns in approaches(grid).items() if tuple(crossing) == tile}
    low = frozenset(heading for heading, turns in arms.items() if 0 not in turns)
    return Control("priority", low) if low else None


def same(controls, expected, to):
    """SUMO says of a crossing with priority only that; other formats say nothing where nobody goes first."""
    if to == "sumo":
        controls = {tile: control.right_of_way for tile, control in controls.items()}
        return controls == {tile: control.right_of_way if control else "priority" for tile, control in expected.items()}
    says = NETWORKS[to].says
    return controls == {
        tile: control for tile, control in expected.items() if control is not None and control.right_of_way in says
    }


@all_formats
@all_grids
def test_same_bytes_in_every_form_of_a_map(to, grid):
    write = NETWORKS[to].write
    streets = Streets(np.int64(30), np.float64(3.2), 8.33)
    assert write(grid.tolist(), streets) == write(grid) == write(np.asarray(grid, np.int64)) == write(RoadMap(grid))


@all_formats
@pytest.mark.parametrize(
    "grid", [DEAD_ENDS, BLOCK, KNOT, TOWN], ids=["dead ends", "adjacent crossings", "knot", "town"]
)
def test_a_turned_map_has_a_turned_network(to, grid):
    """Counter-clockwise: x, y become the width - y, x. A ring is left out, because roads start at its first tile."""
    turned = np.array(rotate(grid))
    places = np.array(NETWORKS[to].points(NETWORKS[to].write(grid)))
    back = (np.array(NETWORKS[to].points(NETWORKS[to].write(turned))) - 30 * len(grid)) / 1j
    before, after = (Counter(map(complex, np.round(some + (1e-9 + 1e-9j), 3))) for some in (places, back))
    far = [place for place in (before - after) if np.abs(back - place).min() > 2e-3]
    assert not far and len(places) == len(back)


@all_formats
@all_grids
@pytest.mark.parametrize("right_of_way", RIGHTS)
def test_crossings_have_the_right_of_way_of_the_streets(to, grid, right_of_way):
    made = NETWORKS[to].write(grid, Streets(right_of_way=right_of_way))
    tiles = {approach[:2] for approach in approaches(grid)}
    expected = {tile: control_of(tile, grid, right_of_way) for tile in tiles}
    assert same(NETWORKS[to].controls(made, grid), expected, to)


@all_formats
def test_crossings_follow_their_signs_and_lights(to):
    """Whatever the streets say, and in whatever order the objects are: lights overrule signs."""
    lights, tiles = lit(SIGNED), {approach[:2] for approach in approaches(TOWN)}
    assert 1 < len(lights) < len(tiles)
    expected = {tile: Control("traffic_light" if tile in lights else "allway_stop") for tile in tiles}
    for objects in (SIGNED.objects, (*SIGNED.objects, *STOPS), (*STOPS, *SIGNED.objects)):
        for right_of_way in ("allway_stop", "priority"):
            made = NETWORKS[to].write(RoadMap(TOWN, objects=objects), Streets(right_of_way=right_of_way))
            assert same(NETWORKS[to].controls(made, TOWN), expected, to)


@all_formats
@pytest.mark.parametrize("right_of_way", ["traffic_light", "priority"])
def test_one_stop_sign_makes_an_all_way_stop(to, right_of_way):
    sign = MapObject("sign_stop", 0.8, 1.2, 0.0, 0.18)  # for who drives west at the crossing of row 1, column 1
    made = NETWORKS[to].write(RoadMap(KNOT, objects=[sign]), Streets(right_of_way=right_of_way))
    assert same(NETWORKS[to].controls(made, KNOT), {(1, 1): Control("allway_stop")}, to)


@all_formats
@pytest.mark.parametrize(
    ("codes", "subject", "got", "expected"),
    [
        ([[4, 4], [0, 0]], "grid", "none", "road"),
        ([[0, 0], [0, 0]], "grid", "none", "road"),
        ([[4, 16], [0, 0]], "grid", "16 at B1 ([0, 1])", ""),
        ([KNOT, KNOT], "map", "2", "one map"),
    ],
)
def test_bad_maps_are_refused(to, codes, subject, got, expected):
    with refused(subject, got, expected):
        NETWORKS[to].write(codes, Streets())


@pytest.mark.parametrize(
    ("measures", "subject", "got"),
    [
        ({"tile_size": 0}, "tile_size", "0"),
        ({"tile_size": 1001}, "tile_size", "1001"),
        ({"lane": 15}, "lane", "15 m"),
        ({"tile_size": 6.4}, "tile_size", "6.4 m"),
        ({"speed": float("nan")}, "speed", "nan"),
        ({"right_of_way": "left"}, "right_of_way", "'left'"),
    ],
)
def test_bad_measures_are_refused_for_all_formats(measures, subject, got):
    with refused(subject, got):
        Streets(**measures)
