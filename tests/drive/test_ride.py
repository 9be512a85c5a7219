"""Rides to look at: trails lie on the lanes, a film has a frame for each step, the command writes whole files."""

import sys
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from types import SimpleNamespace

import cv2
import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.cli.main import main
from elitelanes_jax.drive import Camera, films, look, make_sight
from elitelanes_jax.drive.films import film, trails, write_film
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.drive.rides import load_policy, make_rides
from elitelanes_jax.formats import MapObject, RoadMap
from elitelanes_jax.lanes.curves import on_road
from elitelanes_jax.tiles.rendering import render

GRID = np.array([[6, 7, 3], [12, 13, 9]], np.int8)


@pytest.fixture(scope="module")
def rides():
    return make_rides(GRID, 1, seconds=20)


def test_rides_stay_on_the_road_and_reach_their_goals(rides):
    assert (rides.levels.shortest <= 10).all()  # what is driven in 20 seconds
    assert rides.success.all() and (rides.steps > 30).all() and rides.x.shape == (1, 601)
    column, row = np.floor(rides.x).astype(int), np.floor(rides.y).astype(int)
    assert np.asarray(on_road(GRID[row, column], rides.x - column, rides.y - row)).all()
    end = int(rides.steps[0])
    goal = [int(rides.levels.goal.row[0]), int(rides.levels.goal.column[0])]
    assert [row[0, end], column[0, end]] == goal and (rides.x[0, end:] == rides.x[0, end]).all()
    with refused("policy", "'nobody'"):
        make_rides(GRID, policy="nobody")
    with refused("count", "None"):
        make_rides(GRID, None)
    with refused("seconds", "nan"):
        make_rides(GRID, seconds=float("nan"))
    with refused("seconds", "1e+300"):
        make_rides(GRID, seconds=1e300)
    with refused("seed", "4294967296"):
        make_rides(GRID, seed=2**32)
    with refused("grid", "none", expected="lane"):
        make_rides([[2, 8]])


def test_a_ride_that_leaves_the_road_in_its_last_step_is_counted():
    long, short = (make_rides(GRID, 8, policy="random", seconds=seconds) for seconds in (2, 0.8))
    ends_there = long.off_road & (long.steps == 24)
    assert ends_there.any() and short.off_road[ends_there].all()
    np.testing.assert_array_equal(short.off_road, long.off_road & (long.steps <= 24))
    assert not (long.off_road & long.success).any()


@pytest.mark.parametrize("action", ["wheels", "twist"])
def test_a_random_driver_turns_to_both_sides(action):
    rides = make_rides(GRID, 8, policy="random", action=action, seconds=2)
    turns = np.concatenate([np.diff(rides.theta[ride, : steps + 1]) for ride, steps in enumerate(rides.steps)])
    assert (turns > 0).mean() == pytest.approx(0.5, abs=0.15) and (turns < 0).mean() == pytest.approx(0.5, abs=0.15)


# Only slow tests compile as users do. The quick programs of all other tests add no product in one instruction.
@pytest.mark.slow
@pytest.mark.parametrize("policy", ["route", "random"])
def test_a_ride_alone_has_the_bits_of_a_ride_among_others(policy):
    for seed in range(4):
        alone = make_rides(GRID, 1, policy=policy, seconds=20, seed=seed)
        first = jax.tree.map(itemgetter(slice(1)), make_rides(GRID, 5, policy=policy, seconds=20, seed=seed))
        jax.tree.map(np.testing.assert_array_equal, alone, first)


def test_a_lane_leaves_room_for_the_robot_on_the_road(drawn_tiles):
    """Rides in lanes near to the edge reach their goals in time, though their left turns are longer."""
    for seconds in (2.3, 20):
        rides = make_rides(GRID, 500, seconds=seconds, tiles=replace(drawn_tiles, lane_offset=0.24), seed=2)
        assert rides.success.all()
    with refused("tiles", "0.25", expected="at most 0.241"):
        make_rides(GRID, 1, tiles=replace(drawn_tiles, lane_offset=0.25))


def test_a_film_is_checked_at_the_call(drawn_tiles):
    """A generator would find faults with its first frame. A start fits any lane."""
    rides = make_rides(GRID, 1, seconds=2 / 30, tiles=replace(drawn_tiles, lane_offset=0.02))
    for call, subject, got, expected in (
        (lambda: film(GRID.T, drawn_tiles, rides), "rides", "rides on another one", ""),
        (lambda: film(3, drawn_tiles, rides), "source...", "3", "a map"),
        (lambda: trails(3, drawn_tiles, rides), "source...", "3", "a map"),
        (lambda: make_rides(3), "source...", "3", "a map"),
        (lambda: film(GRID, drawn_tiles, "rides"), "rides", "'rides'", ""),
        (lambda: film(GRID, drawn_tiles, rides, 1), "index", "1", ""),
        (lambda: film(GRID, 5, rides), "tiles", "5", "TileSet"),
        (lambda: trails(GRID, 5, rides), "tiles", "5", "TileSet"),
        (lambda: trails(GRID, drawn_tiles, 5), "rides", "5", ""),
    ):
        with refused(subject, got, expected):
            call()
    with refused("policy", expected="route") as caught:
        make_rides(GRID, policy="x" * 999)
    assert len(caught.value.got) == 80


@pytest.mark.slow
def test_trails_and_films_show_the_ride(rides, drawn_tiles):
    plain = trails(GRID, drawn_tiles, rides._replace(steps=np.zeros(1, int)), tile_px=16)
    drawn = trails(GRID, drawn_tiles, rides, tile_px=16)
    changed = np.argwhere((plain != drawn).any(axis=-1))
    path = np.stack([rides.y[0], rides.x[0]], axis=1) * 16
    distance = np.hypot(*(changed[:, None] + 0.5 - path).transpose(2, 0, 1)).min(axis=1)
    assert len(changed) > 20 and distance.max() < 2.5
    ringed = np.argwhere((plain != render(GRID, drawn_tiles, tile_px=16).image).any(axis=-1)) + 0.5
    ends = np.hypot(*(ringed[:, None] - path[[0, -1]]).transpose(2, 0, 1))
    assert ends.min(axis=1).max() < 5 and (ends[:, 1] < 5).sum() > 8  # a dot, and where the goal's lane is entered
    short = rides._replace(steps=np.array([3]))
    both = jax.tree.map(lambda *parts: np.concatenate(parts), rides, short)
    frames = list(film(GRID, drawn_tiles, both, 1, tile_px=16))
    assert [frame.shape for frame in frames] == [(480, 640 + 720, 3)] * 4
    assert (frames[0] != frames[3]).any()
    near = rides.x[0, 0] + 0.4 * np.cos(rides.theta[0, 0]), rides.y[0, 0] - 0.4 * np.sin(rides.theta[0, 0])
    road_map = RoadMap(GRID, objects=[MapObject("cone", *map(float, near), 0.0, 0.08)])
    (frame,) = film(road_map, drawn_tiles, rides._replace(steps=np.array([0])), tile_px=16)
    for shown in (frame[:, :640], frame[:, 640:]):
        orange = (shown[..., 0] > 150) & (shown[..., 2] < 100) & (shown[..., 1] < 150)
        assert orange.sum() > 20


@pytest.mark.parametrize("shape", [(2, 3), (1, 7), (30, 4)])
def test_the_map_beside_the_camera_fits_a_film_of_any_map(shape):
    picture = np.full((16 * shape[0], 16 * shape[1], 3), 255, np.uint8)
    plan, side = films._shrink(picture, shape)
    assert plan.shape[0] == 480 and plan.shape[1] % 2 == 0 and plan.shape[1] <= 1280
    assert plan.all(axis=-1).sum(axis=(0, 1)) == pytest.approx(side**2 * shape[0] * shape[1], rel=0.05)
    assert plan.shape[1] > 1270 or round(side * shape[0]) == 480


@pytest.mark.slow
def test_the_command_writes_a_film_and_refuses_what_is_there(tmp_path, capsys):
    (tmp_path / "city.json").write_text(f'{{"codes": {GRID.tolist()}}}')
    command = ["drive", str(tmp_path / "city.json"), "--tile-px", "16", "--seconds", "0.1", "--out"]
    assert main([*command, str(tmp_path / "ride.mp4")]) == 0
    assert "0 of 1 goals reached, 0.1 s driven" in capsys.readouterr().out
    reader = cv2.VideoCapture(str(tmp_path / "ride.mp4"))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == 4 and reader.get(cv2.CAP_PROP_FPS) == 30
    assert main([*command, str(tmp_path / "ride.gif")]) == 0
    animation = cv2.imreadanimation(str(tmp_path / "ride.gif"))[1]
    assert [frame.shape[:2] for frame in animation.frames] == [(240, 680)] * 2
    assert [*animation.durations] == [100] * 2
    assert main([*command, str(tmp_path / "ride.mp4")]) == 2
    assert "expected a new file, got an existing one" in capsys.readouterr().err
    assert {file.name for file in tmp_path.iterdir()} == {"city.json", "ride.gif", "ride.mp4"}


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
@pytest.mark.parametrize("room", [0, 1000, 20_000])
def test_a_film_that_the_disk_has_no_room_for_is_none(suffix, room, tmp_path, small_files_only):
    frames, file = np.random.default_rng(0).integers(0, 256, (12, 256, 256, 3), np.uint8), tmp_path / f"ride{suffix}"
    small_files_only(room)
    with pytest.raises(OSError, match="File too large") as raised:
        write_film(file, iter(frames))
    assert raised.value.filename == str(file)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_two_films_written_at_once_are_both_whole(suffix, tmp_path):
    file, frames = tmp_path / f"ride{suffix}", np.zeros((12, 64, 64, 3), np.uint8)

    def slow():
        yield from frames[:6]
        assert write_film(file, iter(frames[:6])) == (2 if suffix == ".gif" else 6)
        yield from frames[6:]

    count = write_film(file, slow())
    assert count == (4 if suffix == ".gif" else 12)
    reader = cv2.VideoCapture(str(file))
    assert sum(1 for _ in iter(reader.grab, False)) == count
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("name", ["12:30.mp4", "file:ride.mp4", "12:30.gif"])
def test_a_film_may_have_a_colon_in_its_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_film(Path(name), iter(np.zeros((3, 64, 64, 3), np.uint8)))
    assert [file.name for file in tmp_path.iterdir()] == [name]


POLICY = Path(__file__).parents[2] / "docs" / "examples" / "follow_lane.py"


def test_a_policy_of_ones_own_drives(rides):
    asked = []

    def stands_still(observation):
        asked.append(observation)
        return 0, 0

    still = make_rides(GRID, 2, policy=stands_still, seconds=0.2)
    assert len(asked) == 12 and (still.steps == 6).all() and not still.success.any()
    assert np.ptp(still.x, axis=1).max() == 0
    assert isinstance(asked[0].d, np.ndarray | np.float32) and asked[0].curvature.shape == (3,)
    own = make_rides(GRID, 1, policy=load_policy(POLICY), seconds=20)
    assert own.success.all()
    np.testing.assert_array_equal([own.x[0, 0], own.y[0, 0]], [rides.x[0, 0], rides.y[0, 0]])
    assert (own.x[0, own.steps[0] :] == own.x[0, -1]).all()


def test_a_policy_imports_modules_of_its_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    folder = tmp_path / "drivers"
    (folder / "package_beside").mkdir(parents=True)
    (folder / "wheels_beside.py").write_text("LEFT = 0.25\n")
    (folder / "package_beside" / "__init__.py").write_text("RIGHT = 0.5\n")
    lazy = "def act(seen):\n    from package_beside import RIGHT\n    return LEFT, RIGHT\n"
    (folder / "driver.py").write_text(f"from wheels_beside import LEFT\n\n\n{lazy}")
    (tmp_path / "link.py").symlink_to(folder / "driver.py")
    assert load_policy(tmp_path / "link.py")(None) == (0.25, 0.5)
    for name in ("wheels_beside", "package_beside"):
        del sys.modules[name]


def test_a_ride_that_has_ended_stays_there_and_reaches_no_goal(monkeypatch):
    """The first robot leaves the road and then enters its goal's tile. The second robot drives on."""
    ended, reached = np.array([[True, False], [True, True]]), np.array([[False, False], [True, False]])

    def go(keys, step, states, *_):
        info = SimpleNamespace(success=reached[step - 1], off_road=ended[step - 1] & ~reached[step - 1])
        states = states._replace(pose=states.pose._replace(x=states.pose.x + 1))
        return SimpleNamespace(observation=None, state=states, info=info, terminated=ended[step - 1])

    monkeypatch.setattr("elitelanes_jax.drive.rides._go", go)
    made = make_rides(GRID, 2, seconds=2 / 30)
    assert made.success.tolist() == [False, False] and made.steps.tolist() == [1, 2]
    assert made.off_road.tolist() == [True, True]
    np.testing.assert_allclose(np.diff(made.x, axis=1), [[1, 0], [1, 1]], atol=1e-6)


@pytest.mark.slow
def test_a_policy_with_a_camera_sees_its_picture_alone(drawn_tiles):
    asked = []

    def sees(observation):
        asked.append(observation)
        return 0.4, 0.3

    sees.camera = Camera(rows=24, columns=32)
    own = make_rides(GRID, 1, policy=sees, seconds=0.2, tiles=drawn_tiles)
    assert asked[0][:5] == (None,) * 5 and asked[0].image.shape == (24, 32, 3) and asked[0].image.dtype == np.uint8
    sight = make_sight(drawn_tiles, sees.camera, tile_px=128)
    for step, observation in enumerate(asked):
        pose = Pose(own.x[0, step], own.y[0, step], own.theta[0, step])
        close = np.isclose(observation.image, look(pose, GRID, sight).image, atol=1)
        assert close.mean() > 0.99


def test_what_is_wrong_with_a_policy_is_named(tmp_path, capsys):
    (tmp_path / "city.json").write_text(f'{{"codes": {GRID.tolist()}}}')
    for text, message in (
        ("x = 1", "policy.py: expected a function act(observation), got none"),
        ("1 / 0", "policy.py: expected a program that runs, got ZeroDivisionError: division by zero"),
        ("raise SystemExit(0)", "policy.py: expected a program that runs, got SystemExit: 0 (line 1 of"),
        ("def act(seen): exit()", "policy: expected an action, got SystemExit: None (line 1 of"),
        (
            "def act(seen): return 1",
            "policy: expected two numbers, for both wheels or for speed and turn, got shape ()",
        ),
        (
            "async def act(seen): return 0, 0",
            "turn, got a coroutine; define the function without async\n",
        ),
        ("def act(seen): return 0.5, float('nan')", "policy: expected two finite numbers, got 0.5 and nan"),
        ("def act(seen): return 0, 0\nact.camera = 3", "--policy: expected a Camera in its attribute camera, got 3"),
    ):
        (tmp_path / "policy.py").write_text(text)
        command = ["drive", str(tmp_path / "city.json"), "--policy", str(tmp_path / "policy.py"), "--seconds", "0.1"]
        assert main([*command, "--out", str(tmp_path / "ride.png"), "--rides", "1"]) == 2
        assert message in capsys.readouterr().err
    assert {file.name for file in tmp_path.iterdir()} == {"city.json", "policy.py"}
