"""The Duckiematrix' folder of layers: there and back; then by Duckietown's own reader (make duckietown-sdk)."""

import json
import subprocess
from math import pi
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import grids
from hypothesis import given, settings
from refusals import refused
from test_map_objects import WRITTEN, check_same

from elitelanes_jax import RoadMap, read_map
from elitelanes_jax.drive.lanes import lane_point
from elitelanes_jax.formats import MapObject, without_dead_ends
from elitelanes_jax.formats.dt_maps import to_duckiematrix
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.lanes.curves import lane_curves
from elitelanes_jax.lanes.movements import Movement, lane_graph
from elitelanes_jax.network.codes import ROAD_ALPHABET, SIDES

OWN_ENVIRONMENT = Path(__file__).parents[2] / ".venv-duckietown-sdk" / "bin" / "python"
PROGRAM = Path(__file__).parent / "duckietown_sdk" / "lane_positions.py"
PAGE = Path(__file__).parents[2] / "docs" / "simulators.md"
ROBOT = MapObject("duckiebot", 0.5, 0.5, 0.0, 0.12)
# The open sides of each kind at yaw 0, in the Duckiematrix' map loop_0. North is 0, and sides go clockwise.
OPEN = {"straight": (0, 2), "curve": (0, 3), "3way": (0, 1, 3), "4way": (0, 1, 2, 3)}
TILE = 0.585
SHARES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])


def code_of(kind, yaw):
    quarters = round(yaw / (pi / 2))
    return sum(SIDES[(side - quarters) % 4].bit for side in OPEN.get(kind, ()))


def write(folder, road_map):
    folder.mkdir(exist_ok=True)
    for name, text in to_duckiematrix(as_map(road_map)).items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder


@settings(max_examples=30, deadline=None)
@given(grid=grids())
def test_tiles_are_turned_as_in_the_duckiematrix(grid):
    codes = without_dead_ends(grid)
    texts = to_duckiematrix(RoadMap(codes, objects=[ROBOT]))
    frames = yaml.safe_load(texts["frames"])["frames"]
    read = np.zeros_like(codes)
    for name, tile in yaml.safe_load(texts["tiles"])["tiles"].items():
        frame = frames[name]
        i, j = map(int, name.split("_")[2:])
        assert (frame["unit"], frame["pose"]["x"], frame["pose"]["y"]) == ("tiles", i, j)
        read[len(codes) - 1 - j, i] = code_of(tile["type"], frame["pose"]["yaw"])
    np.testing.assert_array_equal(read, codes)


def test_all_tiles_are_read_back(tmp_path):
    """Also where both ways of turning tiles leave loose ends."""
    row = np.array([[*ROAD_ALPHABET, 0]], np.int8)
    objects = [ROBOT, MapObject("tree", 2.5, 0.1, 1.0, 0.25), MapObject("other:vehicle", 3.5, 0.5, 0.0, 0.1)]
    found = read_map(write(tmp_path, RoadMap(row, objects=objects)))
    np.testing.assert_array_equal(found.codes, row)
    check_same(found.objects, objects, WRITTEN)


def test_a_map_without_robots_gets_one_in_its_first_lane(tmp_path):
    tree = MapObject("tree", 1.0, 1.0, 0.0, 0.25)
    found = read_map(write(tmp_path, RoadMap([[6, 3], [12, 9]], objects=[tree])))
    lane = lane_point(lane_graph(found.codes).list_movements()[0], np.float32(0.5 * 0.3 * pi / 2))
    robot = MapObject("duckiebot", float(lane.x), float(lane.y), float(lane.theta), 0.12)
    check_same(found.objects, [robot, tree], 1e-5)
    assert "map_0/vehicle_0" in (tmp_path / "vehicles.yaml").read_text()


def test_robots_are_vehicles_from_0_on(tmp_path):
    robots = [MapObject("duckiebot", 0.5, 0.5 + index, 0.0, 0.12) for index in range(2)]
    texts = to_duckiematrix(RoadMap([[6, 3], [12, 9]], objects=[MapObject("duckie", 1, 1, 0, 0.08), *robots]))
    assert list(yaml.safe_load(texts["vehicles"])["vehicles"]) == ["map_0/vehicle_0", "map_0/vehicle_1"]


def test_maps_without_lanes_are_refused():
    with refused("grid", "none", expected="lane"):
        to_duckiematrix(as_map([[0, 0], [0, 0]]))


# From here on by Duckietown's own reader: make duckietown-sdk.


def ask(questions, tmp_path):
    if not OWN_ENVIRONMENT.exists():
        pytest.skip("duckietown-sdk is not here: make duckietown-sdk")
    file = tmp_path / "questions.json"
    file.write_text(json.dumps(questions))
    done = subprocess.run([OWN_ENVIRONMENT, PROGRAM, file], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_the_interpreter_reads_the_tiles(tmp_path):
    """Of the town of the pages, and of 50 random grids."""
    draw = np.random.default_rng(0)
    grids_read = [read_map(PAGE.parent / "examples" / "town.json").codes]
    grids_read += [without_dead_ends(draw.integers(0, 16, (9, 12))) for _ in range(50)]
    questions = []
    for number, grid in enumerate(grids_read):
        folder = write(tmp_path / str(number), RoadMap(grid, objects=[ROBOT]))
        questions.append({"folder": str(folder), "shift": 0, "poses": []})
    for grid, answer in zip(grids_read, ask(questions, tmp_path), strict=True):
        assert answer["size"] == TILE
        read = np.full_like(grid, -1)
        for i, j, kind, yaw, has_lane in answer["tiles"]:
            cell = len(grid) - 1 - j, i
            read[cell] = code_of(kind, yaw)
            assert has_lane == (grid[cell] not in (0, 15))
        np.testing.assert_array_equal(read, grid)


def poses_in_lanes(code):
    """Poses in the middle of the lanes of a tile at row 1, column 1, of a map of three rows: x and y north, and yaw."""
    sides = [side for side in range(4) if code & SIDES[side].bit]
    poses = []
    for entry in sides:
        for exit_side in sides:
            if entry == exit_side:
                continue
            heading = (entry + 2) % 4
            turn = {3: 2, 0: 1, 1: 0}[(exit_side - heading) % 4]
            (curve,) = lane_curves(Movement(1, 1, heading, turn))
            yaws = pi / 2 - heading * pi / 2 + curve.curvature * curve.length * SHARES
            for (x, y), yaw in zip(curve.points(SHARES), yaws, strict=True):
                poses.append((x * TILE, (3 - y) * TILE, yaw))
    return poses


@pytest.mark.slow
def test_the_table_of_lane_positions(tmp_path):
    """Each row of the page: how many poses in the middle of our lanes its calculator finds there."""
    tiles = [(kind, quarters) for kind in OPEN for quarters in range(1 if kind == "4way" else 4)]
    questions, lines = [], []
    for kind, quarters in tiles:
        code = code_of(kind, quarters * pi / 2)
        grid = np.zeros((3, 3), np.int8)
        grid[1, 1] = code
        folder = str(write(tmp_path / f"{kind}-{quarters}", RoadMap(grid, objects=[ROBOT])))
        poses = poses_in_lanes(code)
        as_environment = [(x, y, 0.0, yaw) for x, y, yaw in poses]
        exchanged = [(x, 0.0, y, yaw) for x, y, yaw in poses]
        for listed, shift in ((as_environment, 0), (exchanged, 0), (exchanged, 0.5)):
            questions.append({"folder": folder, "shift": shift, "poses": listed})
    answers = [answer["lanes"] for answer in ask(questions, tmp_path)]
    for (kind, quarters), *of_tile in zip(tiles, answers[::3], answers[1::3], answers[2::3], strict=True):
        asked, exchanged, shifted = ([lane for lane in lanes if lane is not None] for lanes in of_tile)
        # Its tangents are not of length 1, so no angle is right.
        assert all(abs(angle) > 0.2 for _, angle in (*asked, *exchanged, *shifted))
        yaw = "any" if kind == "4way" else 90 * quarters
        cells = kind, yaw, len(of_tile[0]), len(asked), len(exchanged), count_near(exchanged), count_near(shifted)
        lines.append(f"| {' | '.join(map(str, cells))} |")
    print("\n".join(lines))
    assert "\n".join(lines) in PAGE.read_text(encoding="utf-8")


def count_near(lanes):
    """Returns how many lanes are within 3 cm."""
    return sum(abs(distance) < 0.03 for distance, _ in lanes)
