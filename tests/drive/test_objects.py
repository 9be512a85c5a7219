"""Objects in the camera of the environments, by a slow renderer, and their collisions, by points along the arc."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from driving_oracle import pick
from refusals import refused
from standing_oracle import CAMERA, TOWN, draw_back_to_front, some_objects, some_poses

from elitelanes_jax import RoadMap
from elitelanes_jax.drive import Camera, LaneDrive, Pose, look, make, make_objects, make_sight
from elitelanes_jax.drive._billboards import Floor, pack_billboards
from elitelanes_jax.drive._objects import touches
from elitelanes_jax.drive._objects_seen import lie
from elitelanes_jax.drive.lanes import lane_length, lane_point
from elitelanes_jax.drive.robot import TILE, Robot, Wheels, drive
from elitelanes_jax.formats import OBJECT_KINDS, MapObject
from elitelanes_jax.tiles import load_objects
from elitelanes_jax.tiles.object_set import ObjectPictures, ObjectSet

# The pictures in a view have 64 x 64 pixels.
SIDE = 64


@pytest.fixture(scope="module")
def sight(drawn_tiles):
    camera = Camera(rows=CAMERA["rows"], columns=CAMERA["columns"], objects=12)
    return make_sight(drawn_tiles, camera, tile_px=16, objects=load_objects())


def shrink(picture):
    rows, columns = (((np.arange(SIDE) + 0.5) * side // SIDE).astype(int) for side in picture.shape[:2])
    return picture[rows[:, None], columns]


@pytest.mark.parametrize("distortion", [None, (-0.1, 0.02)])
def test_views_are_those_of_a_renderer_that_draws_back_to_front(sight, distortion):
    things = some_objects(12)
    objects = pick(make_objects([RoadMap(TOWN, objects=things)]), 0)
    sight = sight._replace(camera=sight.camera.replace(distortion=distortion))
    full = jax.jit(lambda pose: look(pose, TOWN, sight, objects))
    plain = jax.jit(lambda pose: look(pose, TOWN, sight))
    views, same, seen = load_objects().views_by_kind, [], set()
    for pose in some_poses(4):
        view, road = jax.device_get((full(Pose(*map(jnp.float32, pose))), plain(Pose(*map(jnp.float32, pose)))))
        owners, colours = draw_back_to_front(things, views, pose, CAMERA | {"distortion": distortion}, shrink)
        agree = view.instances == owners
        same.append(agree.mean())
        seen |= set(np.unique(owners))
        hidden = (owners > 0) & agree
        assert (view.labels[hidden] == 0).all() and (view.image[hidden] == colours[hidden]).mean() > 0.99
        left = (owners == 0) & agree
        assert (view.labels[left] == road.labels[left]).all() and (view.image[left] == road.image[left]).all()
    assert min(same) > 0.998 and len(seen) > 6


def test_the_nearest_objects_are_shown(sight):
    ahead = [MapObject("cone", 1.5 + 0.2 * number, 0.5, 0.0, 0.08) for number in range(1, 9)]
    behind = [MapObject("house", 1.2, 0.5, 0.0, 0.3)]
    pose = Pose(jnp.float32(1.3), jnp.float32(0.5), jnp.float32(0))
    batch = make_objects([RoadMap(TOWN, objects=behind + ahead[::-1]), RoadMap(TOWN)])
    first, second = pick(batch, 0), pick(batch, 1)
    for count in (1, 3):
        few = sight._replace(camera=sight.camera.replace(objects=count))
        shown = set(np.unique(jax.jit(look)(pose, TOWN, few, first).instances)) - {0}
        assert shown == {9 - index for index in range(count)}
    empty = jax.jit(look)(pose, TOWN, sight, second)
    assert not empty.instances.any()
    np.testing.assert_array_equal(empty.image, jax.jit(look)(pose, TOWN, sight).image)
    assert make_objects([RoadMap(TOWN)]) is None


def test_an_object_is_seen_if_its_middle_is_beside_the_picture(sight):
    house = MapObject("house", 1.3 + 0.17 / TILE, 0.5 - 0.17 / TILE, np.pi, 0.3)
    objects = pick(make_objects([RoadMap(TOWN, objects=[house])]), 0)
    pose = (1.3, 0.5, 0.0)
    view = jax.jit(look)(Pose(*map(jnp.float32, pose)), TOWN, sight, objects)
    owners, _ = draw_back_to_front([house], load_objects().views_by_kind, pose, CAMERA | {"distortion": None}, shrink)
    assert owners.any() and (view.instances == owners).mean() > 0.998


@pytest.mark.usefixtures("standard")
def test_the_nearest_objects_on_the_floor_are_those_ahead():
    """The one behind is nearer, and a view of a single object shows the one ahead."""
    things = [MapObject("floor_tag", x, 0.5, 0.0, 0.0) for x in (0.4, 0.9)]
    objects = pick(make_objects([RoadMap(TOWN, objects=things)]), 0)
    billboards = pack_billboards([{0: np.full((8, 8, 4), 255, np.uint8)}] * 2)
    floor = Floor(jnp.arange(2), *jnp.full((2, 2), 0.06))
    # A row of pixels sees the ground through the middles of both objects, 0.1 tiles from pixel to pixel.
    x, y = (jnp.array([[0.0]]), jnp.array([[0.1]])), (jnp.array([[0.5]]), jnp.array([[0.0]]))
    pose = Pose(*jnp.array([0.5, 0.5, 0.0]))
    for count, shown in ((1, {2}), (2, {1, 2})):
        instances = lie(pose, objects, floor, jnp.arange(2), billboards, x, y, jnp.arange(12), Camera(objects=count))[2]
        assert set(np.unique(instances)) - {0} == shown


@jax.jit
def part_of_the_way(start, commands, shares):
    """The poses after shares of a step of 0.1 seconds."""
    still = Wheels(jnp.float32(0), jnp.float32(0), None)
    return jax.vmap(lambda share: drive(jax.random.key(0), start, still, commands, Robot().replace(dt=0.1 * share))[0])(
        shares
    )


def test_a_disc_is_touched_where_a_point_of_the_arc_is_within_reach():
    rng = np.random.default_rng(0)
    check = jax.jit(touches)
    outcomes = []
    for number in range(120):
        commands = rng.uniform(-1, 1, 2) if number % 4 else np.repeat(rng.uniform(-1, 1), 2)
        start = Pose(*jnp.array([*rng.uniform(1, 2, 2), rng.uniform(-3.1, 3.1)], jnp.float32))
        end = jax.tree.map(lambda part: part[0], part_of_the_way(start, jnp.array(commands), np.ones(1, np.float32)))
        steps = part_of_the_way(start, jnp.array(commands), np.linspace(1e-6, 1, 200, dtype=np.float32))
        away = rng.uniform(0, 0.2, 2) * rng.choice([-1, 1], 2)
        thing = MapObject("duckie", float(start.x) + away[0], float(start.y) + away[1], 0.0, 0.08)
        objects = pick(make_objects([RoadMap(TOWN, objects=[thing])]), 0)
        least = np.hypot(steps.x - thing.x, steps.y - thing.y).min() * TILE
        reach = 0.03
        if abs(least - reach - thing.radius) > 1e-3:
            outcomes.append(bool(least < reach + thing.radius))
            assert bool(check(objects, start, end, reach)) == outcomes[-1]
    assert 5 < sum(outcomes) < len(outcomes) - 5


def test_a_robot_starts_beside_an_object_that_is_in_its_place():
    road, settings = RoadMap(TOWN), {"count": 1, "task": "lane", "start_d": 0.0}
    keys = jax.random.split(jax.random.key(0), 64)
    poses = {}
    _, params = make("LaneDrive", road, **settings)
    start = LaneDrive.reset(keys[0], params)[1].pose
    on_the_start = MapObject("cone", float(start.x), float(start.y), 0.0, 0.08)
    far = on_the_start._replace(x=-0.9, y=-0.9)
    # A tree on the second half of the lane leaves only places before the robot's own.
    movement = LaneDrive.reset(keys[0], params)[1].movement
    end = lane_point(movement, lane_length(movement.turn))
    tree = MapObject("tree", float(end.x), float(end.y), 0.0, 1.0)
    for name, thing in (("none", None), ("far", far), ("near", on_the_start), ("tree", tree)):
        _, params = make("LaneDrive", replace(road, objects=thing and (thing,)), **settings)
        poses[name] = jax.vmap(lambda key, params=params: LaneDrive.reset(key, params)[1])(keys).pose
    np.testing.assert_allclose(poses["far"], poses["none"], atol=1e-6)
    gaps = {name: np.hypot(pose.x - on_the_start.x, pose.y - on_the_start.y) * TILE for name, pose in poses.items()}
    reach = on_the_start.radius + 0.15 / 2
    touched = gaps["none"] <= reach
    assert touched[0] and not touched.all()
    assert (gaps["near"] > reach).all()
    np.testing.assert_allclose(gaps["near"][~touched], gaps["none"][~touched], atol=1e-6)
    blocked, free = (np.hypot(poses[name].x - tree.x, poses[name].y - tree.y) * TILE for name in ("none", "tree"))
    assert (blocked <= tree.radius + 0.15 / 2).any() and (free > tree.radius + 0.15 / 2).all()


@pytest.mark.parametrize("collision", ["terminate", "cost"])
def test_lane_drive_ends_or_pays_where_an_object_is_touched(collision):
    road, settings = RoadMap(TOWN), {"count": 1, "task": "route", "start_d": 0.0, "start_phi": 0.0}
    _, free = make("LaneDrive", road, **settings)
    _, start = LaneDrive.reset(jax.random.key(0), free)
    x, y, theta = (float(part) for part in start.pose)
    ahead = MapObject("cone", x + 0.35 * np.cos(theta), y - 0.35 * np.sin(theta), 0.0, 0.08)
    flat = MapObject("floor_tag", x + 0.1 * np.cos(theta), y - 0.1 * np.sin(theta), 0.0, 0.0)
    settings |= {"collision": collision, "collision_cost": 7.0}
    _, params = make("LaneDrive", replace(road, objects=(flat, ahead)), **settings)
    _, state = LaneDrive.reset(jax.random.key(0), params)
    for _ in range(30):
        before = state
        done = LaneDrive.step(jax.random.key(1), state, jnp.array([0.5, 0.5]), params)
        state = done.state
        if done.info.collision:
            break
    gap = np.hypot(float(state.pose.x) - ahead.x, float(state.pose.y) - ahead.y) * TILE
    assert done.info.collision and gap <= 0.075 + ahead.radius
    assert bool(done.terminated) == (collision == "terminate")
    other = LaneDrive.step(jax.random.key(1), before._replace(objects=None), jnp.array([0.5, 0.5]), free)
    assert other.info.collision is None
    cost = 7.0 if collision == "terminate" else 7.0 / 30
    np.testing.assert_allclose(other.reward - done.reward, cost, rtol=1e-4)
    # A touch on the goal is a success, unless it ends the episode.
    movement = state.movement
    pose = lane_point(movement, lane_length(movement.turn) - 1e-3)
    on_goal = ahead._replace(x=float(pose.x), y=float(pose.y))
    objects = pick(make_objects([replace(road, objects=(flat, on_goal))]), 0)
    state = state._replace(pose=pose, goal=movement.next_node, objects=objects)
    done = LaneDrive.step(jax.random.key(1), state, jnp.array([0.5, 0.5]), params)
    assert done.info.collision and bool(done.info.success) == (collision == "cost")


def test_faults_are_named():
    for view in (np.zeros((2, 2)), np.zeros((0, 2, 4), np.uint8)):
        cone = ObjectPictures("cone", "cone", 0.08, (0.08, 0.08), None, {0: view}, np.zeros((2, 2, 4), np.uint8))
        with refused("objects", f"{view.dtype} {view.shape}"):
            make_sight(objects=ObjectSet("own", (cone,)))
    with refused("objects", "4097", expected="at most 4096"):
        pack_billboards([{}] * 4097)
    assert set(load_objects().views_by_kind) == set(OBJECT_KINDS)
