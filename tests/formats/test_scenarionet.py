"""Databases of ScenarioNet, read back by pickle alone. MetaDrive reads them in test_metadrive.py."""

import pickle
import pickletools
import subprocess
import sys

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.cli.main import main
from elitelanes_jax.formats import RoadMap, read_map
from elitelanes_jax.formats._scene import make_scene
from elitelanes_jax.formats._traffic import CarSides, Log
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.scenarionet import _track, _without_touching, index_scenarios, to_scenarionet
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import lane_polyline
from elitelanes_jax.lanes.movements import lane_graph

RING = [[6, 3], [12, 9]]
EIGHT = [[6, 3, 0], [12, 15, 3], [0, 12, 9]]
DEAD_ENDS = [[2, 0], [14, 1], [8, 0]]
GRIDS = [RING, EIGHT, DEAD_ENDS]


def random_grid(seed, side=6):
    return np.random.default_rng(seed).integers(0, 16, (side, side)).astype(np.int8)


def read(source, *arguments, **options):
    return pickle.loads(to_scenarionet(as_map(source), *arguments, **options))


def of_kind(scenario, kind):
    return {name: feature for name, feature in scenario["map_features"].items() if feature["type"] == kind}


@pytest.mark.parametrize("grid", [*GRIDS, *map(random_grid, range(4))])
def test_lanes_are_our_movements_with_their_links_and_outlines(grid):
    lanes = of_kind(read(grid, "map"), "LANE_SURFACE_STREET")
    scene = make_scene(as_map(grid), Streets())
    graph = lane_graph(np.array(grid), turn_back=True)
    movements, successors = graph.list_movements(), graph.list_successors()
    assert list(lanes) == [str(index) for index in range(len(movements))]
    for lane, movement, after in zip(lanes.values(), movements, successors, strict=True):
        centre = scene.to_metres(lane_polyline(movement, 1.6 / 30))
        points = lane["polyline"][:, 0] + 1j * lane["polyline"][:, 1]
        assert abs(points[0] - centre[0]) < 1e-3 and abs(points[-1] - centre[-1]) < 1e-3
        assert lane["exit_lanes"] == list(map(str, after))
        assert lane["speed_limit_kmh"] == pytest.approx(29.988)
        outline = lane["polygon"][:, 0] + 1j * lane["polygon"][:, 1]
        # Half of a lane beside its middle, or at a dead end the island's edge. Segments are up to 1.9 m long.
        aside = np.abs(outline[:, None] - points).min(axis=1)
        assert aside.max() < 2 and aside.min() > 1.4
    entries = {(before, name) for name, lane in lanes.items() for before in lane["entry_lanes"]}
    assert entries == {(name, after) for name, lane in lanes.items() for after in lane["exit_lanes"]}


def test_other_features_are_lines_edges_and_signs():
    scenario = read(EIGHT, "map")
    # One line a turn, and one edge from each side of each tile.
    assert len(of_kind(scenario, "ROAD_LINE_BROKEN_SINGLE_YELLOW")) == 6
    assert len(of_kind(scenario, "ROAD_EDGE_BOUNDARY")) == 16
    signs = of_kind(scenario, "STOP_SIGN")
    assert [len(sign["lane"]) for sign in signs.values()] == [3, 3, 3, 3]
    assert not of_kind(read(EIGHT, "map", Streets(right_of_way="priority")), "STOP_SIGN")


def outlines(track):
    """The corners of a car in each step, complex ``[T, 5]``."""
    state = track["state"]
    ahead = np.exp(1j * state["heading"].astype(float))[:, None]
    corners = np.array([1, 1, -1, -1, 1]) * state["length"][0] + 1j * np.array([1, -1, -1, 1, 1]) * state["width"][0]
    return (state["position"][:, 0] + 1j * state["position"][:, 1])[:, None] + corners / 2 * ahead


def overlap(first, second):
    """Returns whether two rectangles overlap: seen along each of their sides, they do."""
    for side in np.diff(np.concatenate([first[:3], second[:3]]))[[0, 1, 3, 4]]:
        one, other = ((corners / side).imag for corners in (first, second))
        if one.max() < other.min() or other.max() < one.min():
            return False
    return True


@pytest.mark.parametrize(("grid", "streets"), [(EIGHT, Streets()), (random_grid(1), Streets(tile_size=8))])
def test_cars_follow_logs_and_never_touch(grid, streets):
    scenario = read(grid, "map", streets, seed=3)
    tracks, length = scenario["tracks"], scenario["length"]
    assert list(tracks) == [str(number) for number in range(len(tracks))] and len(tracks) > 1
    assert scenario["metadata"]["sdc_id"] in tracks
    assert scenario["metadata"]["ts"].shape == (length,)
    for track in tracks.values():
        state = track["state"]
        assert state["valid"].all() and {len(values) for values in state.values()} == {length}
        steps = np.linalg.norm(np.diff(state["position"], axis=0), axis=1)
        assert steps.max() < 0.834
        np.testing.assert_allclose(np.linalg.norm(state["velocity"], axis=1), 8.33, rtol=1e-5)
    cars = list(map(outlines, tracks.values()))
    for number, car in enumerate(cars):
        for other in cars[:number]:
            assert not any(overlap(one, another) for one, another in zip(car, other, strict=True))


def test_a_car_that_overlaps_another_is_left_out():
    sides, rng = CarSides(4.5, 1.9, 1.6), np.random.default_rng(0)
    cars = [Log(np.zeros(1, complex), np.zeros(1, complex), np.zeros(1))]
    overlaps = 0
    for x, y, heading in rng.uniform((-7, -7, -np.pi), (7, 7, np.pi), (400, 3)):
        cars[1:] = [Log(np.array([x + 1j * y]), np.zeros(1, complex), np.array([heading]))]
        first, second = (outlines(_track("0", car, sides, 1))[0] for car in cars)
        left = len(_without_touching(cars, sides))
        overlaps += overlap(first, second)
        assert left == 1 or not overlap(first, second)
        assert left == 2 or abs(x + 1j * y) < 5.5, "circles about thirds of a car reach 2.7 m"
    assert overlaps > 50


@pytest.mark.parametrize(("streets", "lengths"), [(Streets(), {91}), (Streets(tile_size=8), {17, 41})])
def test_a_scenario_ends_before_its_car_comes_back_to_its_route(streets, lengths):
    """A car drives 75 m. A lap of a ring is 84 m or longer at 30 m a tile, and 15 m inside or 35 m outside at 8 m."""
    assert {read(RING, "map", streets, seed=seed)["length"] for seed in range(8)} == lengths
    for seed in range(8):
        route = read(RING, "map", streets, seed=seed)["tracks"]["0"]["state"]["position"][:, :2]
        gaps = np.linalg.norm(route[:, None] - route, axis=2)
        assert gaps[np.triu_indices(len(route), 10)].min() > 1.5


def test_the_same_map_gives_the_same_bytes_in_another_process():
    program = (
        "import sys\nfrom elitelanes_jax import RoadMap\n"
        "from elitelanes_jax.formats.scenarionet import to_scenarionet\n"
        "sys.stdout.buffer.write(to_scenarionet(RoadMap([[6, 3, 0], [12, 15, 3], [0, 12, 9]]), 'map'))"
    )
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout
    assert other == to_scenarionet(as_map(EIGHT), "map")
    assert other != to_scenarionet(as_map(EIGHT), "map", seed=1)


def test_pickles_name_nothing_but_arrays():
    """NumPy 1 and 2 have these two, and Python 3.4 and later read the protocol."""
    operations = list(pickletools.genops(to_scenarionet(as_map(EIGHT), "map")))
    assert operations[0][1] == 4
    texts = [argument for operation, argument, _ in operations if "UNICODE" in operation.name]
    names = {("numpy", "ndarray"), ("builtins", "bytearray")}
    assert sum(operation.name in ("GLOBAL", "STACK_GLOBAL", "INST") for operation, *_ in operations) == 2
    assert all({module, name} <= set(texts) for module, name in names)


def test_positions_can_be_moved_in_place():
    scenario = read(RING, "map")
    for feature in (scenario["tracks"]["0"]["state"]["position"], scenario["map_features"]["0"]["polygon"]):
        feature[..., :2] -= 1.0


def export(tmp_path, *options):
    maps = []
    for number, grid in enumerate(GRIDS):
        maps.append(tmp_path / "maps" / f"{number}" / "map.json")
        RoadMap(grid).save(maps[-1])
    assert main(["export", *map(str, maps), "--to", "scenarionet", "--out", str(tmp_path / "out"), *options]) == 0
    return tmp_path / "out"


def test_a_folder_of_maps_has_one_summary(tmp_path, capsys):
    folder = export(tmp_path, "--speed", "5")
    names = [f"sd_{number}.pkl" for number in range(3)]
    assert {file.name for file in folder.iterdir()} == {*names, "dataset_summary.pkl", "dataset_mapping.pkl"}
    summary = pickle.loads((folder / "dataset_summary.pkl").read_bytes())
    assert list(summary) == names
    assert pickle.loads((folder / "dataset_mapping.pkl").read_bytes()) == dict.fromkeys(names, "")
    for name, grid in zip(names, GRIDS, strict=True):
        content = (folder / name).read_bytes()
        assert content == to_scenarionet(as_map(grid), name[3:-4], Streets(speed=5))
        metadata = pickle.loads(content)["metadata"]
        assert summary[name] == metadata | {"ts": metadata["ts"].tolist()}
        assert metadata["number_summary"]["num_objects"] == len(metadata["object_summary"])


def test_a_summary_may_be_beside_its_scenarios(tmp_path):
    file = tmp_path / "towns" / "sd_ring.pkl"
    file.parent.mkdir()
    file.write_bytes(to_scenarionet(as_map(RING), "ring"))
    made = index_scenarios(tmp_path / "train", [file])
    assert pickle.loads(made["dataset_mapping.pkl"]) == {"sd_ring.pkl": "../towns"}


@pytest.mark.parametrize(
    "content",
    [b"", b"text"]
    + [
        pickle.dumps(value)
        for value in ([1], {"metadata": np.float64(1)}, {"metadata": {}}, {"metadata": []}, {"metadata": {"ts": [0.0]}})
    ],
)
def test_other_files_are_refused_and_run_no_code(content, tmp_path):
    file = tmp_path / "sd_other.pkl"
    file.write_bytes(content)
    with refused(tmp_path / "sd_other.pkl", "another file"):
        index_scenarios(tmp_path, [file])


def test_files_of_the_same_name_are_refused(tmp_path):
    file = tmp_path / "sd_ring.pkl"
    file.write_bytes(to_scenarionet(as_map(RING), "ring"))
    with refused("files", "two for sd_ring.pkl"):
        index_scenarios(tmp_path, [file, file])


def test_other_seeds_have_other_cars():
    town = read_map("docs/examples/town.json")
    assert to_scenarionet(as_map(town), "town", seed=1) != to_scenarionet(as_map(town), "town")


@pytest.mark.parametrize("grid", [[[2, 0], [8, 0]], [[0, 0], [0, 0]]])
def test_a_map_without_a_lane_is_refused(grid):
    with refused("grid", "none"):
        to_scenarionet(RoadMap(np.array(grid, np.int8)), "map")
