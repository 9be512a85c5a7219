"""Maps for PufferDrive, read back by an independent reader that joins lanes by the rules of PufferDrive.

`make pufferdrive` compiles PufferDrive's own core, which then reads a thousand towns.
"""

import json
import struct
import subprocess
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.formats import RoadMap, read_map
from elitelanes_jax.formats._scene import make_scene
from elitelanes_jax.formats._traffic import AGENTS
from elitelanes_jax.formats.pufferdrive import to_pufferdrive
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import lane_polyline
from elitelanes_jax.lanes.movements import BACK, lane_graph
from elitelanes_jax.network.growth import grow_town

VEHICLE, LANE, LINE, EDGE, STOP_SIGN = 1, 4, 5, 6, 7
PROGRAM = Path(__file__).parents[2] / ".venv-pufferdrive" / "pufferdrive_check"
TOWNS, SEEDS, STEPS = 1000, 4, 5
RING = [[6, 3], [12, 9]]
EIGHT = [[6, 3, 0], [12, 15, 3], [0, 12, 9]]
DEAD_ENDS = [[2, 0], [14, 1], [8, 0]]


def random_grid(seed, side=6):
    return np.random.default_rng(seed).integers(0, 16, (side, side)).astype(np.int8)


GRIDS = [RING, EIGHT, DEAD_ENDS, *(random_grid(seed) for seed in range(6))]


class Entity(NamedTuple):
    kind: int
    number: int
    points: np.ndarray  # float32 [P, 2]
    heading: np.ndarray | None
    valid: np.ndarray | None
    width: float
    length: float
    goal: tuple[float, float]


def read_binary(content):
    """Reads entities as PufferDrive's load_map_binary does, and checks that nothing is left."""
    offset = 0

    def take(form):
        nonlocal offset
        values = struct.unpack_from(f"<{form}", content, offset)
        offset += struct.calcsize(f"<{form}")
        return values

    _, predicted = take("2i")
    assert predicted == 0
    objects, roads = take("2i")
    entities = []
    for _ in range(objects + roads):
        _, kind, number, size = take("4i")
        x, y, z = (np.array(take(f"{size}f"), np.float32) for _ in range(3))
        assert not z.any()
        heading = valid = None
        if kind == VEHICLE:
            take(f"{3 * size}f")
            heading, valid = np.array(take(f"{size}f")), np.array(take(f"{size}i"))
        width, length, _, *goal = take("6f")
        assert take("i") == (0,)
        entities.append(Entity(kind, number, np.stack([x, y], 1), heading, valid, width, length, tuple(goal[:2])))
    assert offset == len(content)
    return entities[:objects], entities[objects:]


def links_by_geometry(lanes):
    """Joins lanes whose ends are within 1 cm, with headings within 0.1 rad that do not wrap, in floats of 32 bits."""
    mean = np.mean(np.concatenate([lane.points for lane in lanes]), axis=0, dtype=np.float32)
    starts, ends = [], []
    for lane in lanes:
        points = lane.points - mean
        starts.append((points[0], points[1] - points[0]))
        ends.append((points[-1], points[-1] - points[-2]))
    links = set()
    for index, (end, last) in enumerate(ends):
        for other, (start, first) in enumerate(starts):
            turned = abs(np.arctan2(last[1], last[0]) - np.arctan2(first[1], first[0]))
            if index != other and np.linalg.norm(end - start) < 0.01 and turned < 0.1:
                links.add((index, other))
    return links


@pytest.mark.parametrize("grid", GRIDS)
def test_lanes_are_our_movements_and_join_as_they_do(grid):
    scene = make_scene(as_map(grid), Streets())
    _, roads = read_binary(to_pufferdrive(as_map(grid), "map").binary)
    graph = lane_graph(np.array(grid), turn_back=True)
    lanes = [road for road in roads if road.kind == LANE]
    assert [road.number for road in roads] == list(range(len(roads)))
    for lane, movement in zip(lanes, graph.list_movements(), strict=True):
        centre = scene.to_metres(lane_polyline(movement, 1.6 / 30))
        for point, expected in ((lane.points[0], centre[0]), (lane.points[-1], centre[-1])):
            np.testing.assert_allclose(point, [expected.real, expected.imag], atol=1e-4)
        # A half circle has 32 chords in the polyline, and 16 in PufferDrive's lane.
        shared = centre[1:-1:2] if movement.turn == BACK else centre
        distances = np.abs(lane.points[:, 0] + 1j * lane.points[:, 1] - shared[:, None])
        if movement.turn != 1:
            assert distances.min(axis=1).max() < 1e-3
        assert np.abs(np.diff(lane.points, axis=0)).max() < 2.5
    successors = graph.list_successors()
    assert links_by_geometry(lanes) == {(index, after) for index, row in enumerate(successors) for after in row}


def crosses(first, second):
    """Returns whether any segment of one polyline crosses one of another."""
    a, b = first[:-1, None], first[1:, None]
    c, d = second[None, :-1], second[None, 1:]

    def side(p, q, r):
        return (q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0]

    return bool(((side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)).any())


def outline(car, step):
    x, y = car.points[step].astype(float)
    ahead = np.exp(1j * car.heading[step])
    corners = (np.array([1, 1, -1, -1, 1]) * car.length + 1j * np.array([1, -1, -1, 1, 1]) * car.width) / 2 * ahead
    return np.stack([x + corners.real, y + corners.imag], axis=1)


@pytest.mark.parametrize("grid", GRIDS)
def test_cars_start_on_the_road_apart_from_each_other_and_follow_lanes(grid):
    cars, roads = read_binary(to_pufferdrive(as_map(grid), "map", seed=3).binary)
    edges = [road.points.astype(float) for road in roads if road.kind == EDGE]
    lanes = np.concatenate([road.points for road in roads if road.kind == LANE])
    assert 0 < len(cars) <= AGENTS
    for number, car in enumerate(cars):
        assert car.number == number and car.kind == VEHICLE and car.valid.all() and len(car.points) == 91
        assert not any(crosses(outline(car, 0), edge) for edge in edges)
        assert not any(crosses(outline(car, 0), outline(other, 0)) for other in cars[:number])
        np.testing.assert_allclose(car.goal, car.points[-1], atol=1e-4)
        steps = np.linalg.norm(np.diff(car.points, axis=0), axis=1)
        assert steps.max() < 0.834 and np.median(steps) > 0.82  # 8.33 m/s
        assert np.linalg.norm(car.points[:, None] - lanes, axis=2).min(axis=1).max() < 1.3  # half of a segment


def test_edges_lie_where_a_lane_ends_and_signs_before_crossings():
    _, roads = read_binary(to_pufferdrive(as_map(EIGHT), "map").binary)
    counts = {kind: sum(road.kind == kind for road in roads) for kind in (LANE, LINE, EDGE, STOP_SIGN)}
    # Six turns with two lanes, and a crossing with twelve; one line a turn, and one edge from each side of each tile.
    assert counts == {LANE: 24, LINE: 6, EDGE: 16, STOP_SIGN: 4}


@pytest.mark.parametrize("grid", [EIGHT, DEAD_ENDS])
def test_the_text_says_the_same_and_the_links(grid):
    made = to_pufferdrive(as_map(grid), "name")
    cars, roads = read_binary(made.binary)
    content = json.loads(made.text)
    assert content["scenario_id"] == "name"
    for entity, entry in zip(cars + roads, content["objects"] + content["roads"], strict=True):
        points = entry.get("geometry", entry.get("position"))
        np.testing.assert_allclose(entity.points, [(point["x"], point["y"]) for point in points], atol=1e-4)
    lanes = [road for road in content["roads"] if road["type"] == "lane"]
    assert [lane["exit_lanes"] for lane in lanes] == lane_graph(np.array(grid), turn_back=True).list_successors()
    for lane in lanes:
        assert all(lane["id"] in lanes[before]["exit_lanes"] for before in lane["entry_lanes"])
    assert sum(len(lane["entry_lanes"]) for lane in lanes) == sum(len(lane["exit_lanes"]) for lane in lanes)


def test_other_seeds_have_other_cars():
    town = read_map("docs/examples/town.json")
    others = read_binary(to_pufferdrive(as_map(town), "town", seed=1).binary)[0]
    cars = read_binary(to_pufferdrive(as_map(town), "town").binary)[0]
    assert any((car.points != other.points).any() for car, other in zip(cars, others, strict=True))


def test_no_car_starts_where_it_turns_back():
    cars, _ = read_binary(to_pufferdrive(as_map(DEAD_ENDS), "map").binary)
    graph = lane_graph(np.array(DEAD_ENDS), turn_back=True)
    tiles = {movement.node.tile for movement in graph.list_movements() if movement.turn != BACK}
    starts = {(int(3 - car.points[0, 1] / 30), int(car.points[0, 0] / 30)) for car in cars}
    assert starts == tiles


@pytest.mark.parametrize("grid", [[[2, 0], [8, 0]], [[0, 0], [0, 0]]])
def test_a_map_without_a_lane_is_refused(grid):
    with refused("grid", "none"):
        to_pufferdrive(RoadMap(np.array(grid, np.int8)), "map")


def grow_towns():
    """Returns different towns of 6 x 6 to 9 x 9 tiles."""
    grow = jax.jit(grow_town, static_argnums=1)
    towns = {}
    seed = 0
    while len(towns) < TOWNS:
        side = 6 + seed % 4
        town = np.asarray(grow(jax.random.fold_in(jax.random.key(37), seed), (side, side)))
        towns[side, town.tobytes()] = town
        seed += 1
    return list(towns.values())


@pytest.mark.slow
def test_pufferdrive_joins_our_lanes_and_no_car_starts_off_the_road(tmp_path):
    if not PROGRAM.exists():
        pytest.skip("PufferDrive is not here: make pufferdrive")
    cars = joined = 0
    for town in grow_towns():
        files = []
        for seed in range(SEEDS):
            files.append(tmp_path / f"{seed}.bin")
            files[-1].write_bytes(to_pufferdrive(as_map(town), "town", seed=seed).binary)
        done = subprocess.run([PROGRAM, str(STEPS), *files], check=True, capture_output=True, text=True)
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"links"')]
        successors = lane_graph(town, turn_back=True).list_successors()
        links = [[lane, after] for lane, row in enumerate(successors) for after in row]
        assert len(lines) == SEEDS
        joined += len(links)
        for line in lines:
            assert sorted(line["links"]) == links
            assert line["shrunk"] == line["full"] == [0, 0, 0]
            cars += len(line["cars"])
    print(f"{TOWNS} towns, {joined} links, {cars} cars")
    assert cars >= 100_000
