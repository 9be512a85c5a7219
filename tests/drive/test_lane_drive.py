"""LaneDrive: the robot's arcs against small steps, the lane's figures against `lane_pose`, and the expert's routes."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from driving_oracle import drawn_maps, pick, polyline_errors
from refusals import refused

from elitelanes_jax.drive import (
    LaneDrive,
    LaneDriveParams,
    Pose,
    RoadNav,
    auto_reset,
    lane_pose,
    make_levels,
    make_objects,
    pure_pursuit,
)
from elitelanes_jax.drive.lanes import lane_point
from elitelanes_jax.drive.robot import TILE, Robot, drive, still, to_wheels
from elitelanes_jax.formats import MapObject, RoadMap, without_dead_ends

SHAPE, COUNT = (4, 5), 16
TOWN = np.array([[6, 5, 7, 3], [10, 0, 10, 10], [14, 5, 15, 11], [12, 5, 13, 9]], np.int8)


@pytest.fixture(scope="module")
def params():
    return LaneDriveParams(make_levels(jax.random.key(2), drawn_maps(1, COUNT, SHAPE, fill=True)), limit=3000)


def test_the_robot_drives_the_arc_of_its_wheels():
    robot = Robot(trim=0.1)
    start = Pose(jnp.float32(2), jnp.float32(3), jnp.float32(3.0))
    move = jax.jit(partial(drive, robot=robot))
    for command in ((1, 1), (0.2, 0.9), (1, -1), (-0.5, -0.4), (0, 0), (np.nan, np.inf), (7, -9)):
        there, wheels = move(jax.random.key(0), start, still(robot), jnp.array(command, jnp.float32))
        left, right = np.clip(np.nan_to_num(command), -1, 1) * 1.2 * (0.9, 1.1)
        x, y, theta, parts = 2.0, 3.0, 3.0, 10_000
        for _ in range(parts):
            step = (left + right) / 2 / 30 / parts / TILE
            theta += (right - left) / 0.102 / 30 / parts / 2
            x, y = x + step * np.cos(theta), y - step * np.sin(theta)
            theta += (right - left) / 0.102 / 30 / parts / 2
        turned = np.angle(np.exp(1j * (theta - float(there.theta))))
        np.testing.assert_allclose([there.x, there.y, turned], [x, y, 0], atol=1e-5)
        assert wheels.speed == pytest.approx((left + right) / 2, abs=1e-5)


@pytest.mark.slow
def test_steps_have_the_gradients_of_finite_differences(params):
    _, start = LaneDrive.reset(jax.random.key(0), params)

    @jax.jit
    def loss(actions):
        state = start
        for action in actions:
            state = LaneDrive.step(jax.random.key(1), state, action, params).state
        return (state.pose.x - 1) ** 2 + (state.pose.y - 1.3) ** 2 + state.pose.theta

    actions, small = jnp.full((2, 2), 0.3), 0.02
    differences = [
        (loss(actions.at[place].add(small)) - loss(actions.at[place].add(-small))) / (2 * small)
        for place in np.ndindex(actions.shape)
    ]
    gradients = jax.jit(jax.grad(loss))(actions)
    assert (jnp.abs(gradients) > 0.1).all()
    np.testing.assert_allclose(gradients.ravel(), differences, atol=1e-3)


# Only slow tests compile as users do. The quick programs of all other tests add no product in one instruction.
@pytest.mark.slow
@pytest.mark.parametrize("action", ["wheels", "twist"])
def test_a_rollout_has_the_same_bits_alone_and_in_a_batch(params, action):
    params, step = params.replace(action=action, limit=20), auto_reset(LaneDrive).step

    def roll(key, actions):
        def go(state, action):
            done = step(key, state, action, params)
            return done.state, done

        return jax.lax.scan(go, LaneDrive.reset(key, params)[1], actions)

    keys = jax.random.split(jax.random.key(3), COUNT)
    actions = np.random.default_rng(0).uniform(0, 1, (COUNT, 40, 2)).astype(np.float32)
    together = jax.jit(jax.vmap(roll))(keys, actions)
    for number in range(0, COUNT, 5):
        alone = jax.jit(roll)(keys[number], actions[number])
        jax.tree.map(np.testing.assert_array_equal, alone, pick(together, number))


def test_a_late_command_takes_effect_later_and_noise_is_drawn():
    robot = Robot(latency=1.5)
    pose, wheels = Pose(*jnp.zeros(3)), still(robot)
    speeds = []
    for _ in range(4):
        pose, wheels = drive(jax.random.key(0), pose, wheels, jnp.ones(2), robot)
        speeds.append(float(wheels.speed))
    np.testing.assert_allclose(speeds, [0, 0.6, 1.2, 1.2], atol=1e-6)
    noisy = jax.jit(jax.vmap(partial(drive, robot=Robot(noise=0.1)), in_axes=(0, None, None, None)))
    keys = jax.random.split(jax.random.key(1), 4000)
    _, wheels = noisy(keys, Pose(*jnp.zeros(3)), still(Robot()), jnp.array([0.5, 0.5]))
    # The mean of two independent wheels.
    assert np.mean(wheels.speed) == pytest.approx(0.6, abs=0.01)
    assert np.std(wheels.speed) == pytest.approx(0.12 / np.sqrt(2), rel=0.05)
    # The state of the wheels keeps commands if and only if the robot has a latency.
    with refused("robot", "a latency", expected="no latency"):
        drive(jax.random.key(0), pose, still(Robot()), jnp.ones(2), robot)
    curved = to_wheels(1.2, 8.0, Robot())
    assert curved.max() == 1 and (curved[1] - curved[0]) / curved.sum() == pytest.approx(0.408 / 1.2)


@partial(jax.jit, static_argnames="steps")
def ride(params, key, steps):
    """Rides of the expert on all levels: the transitions of all steps, stacked."""
    count = params.levels.grid.shape[0]
    keys = jax.random.split(key, count)
    _, state = jax.vmap(LaneDrive.reset_to_level, in_axes=(0, 0, None))(keys, params.levels, params)

    def go(state, key):
        action = jax.vmap(lambda one: pure_pursuit(one, params))(state)
        done = jax.vmap(LaneDrive.step, in_axes=(0, 0, 0, None))(jax.random.split(key, count), state, action, params)
        return done.state, done._replace(state=(done.state.pose, done.state.movement, done.state.s), observation=None)

    return jax.lax.scan(go, state, jax.random.split(key, steps))[1]


def test_a_step_alone_has_the_bits_of_a_step_in_a_batch(params):
    params = LaneDriveParams(params.levels, task="lane")
    reset = jax.jit(jax.vmap(LaneDrive.reset, in_axes=(0, None)))
    step = jax.jit(jax.vmap(LaneDrive.step, in_axes=(0, 0, 0, None)))
    rng = np.random.default_rng(0)
    _, states = reset(jax.random.split(jax.random.key(0), COUNT), params)
    for number in range(4):
        keys = jax.random.split(jax.random.key(number), COUNT)
        actions = rng.uniform(-1, 1, (COUNT, 2)).astype(np.float32)
        together = step(keys, states, actions, params)
        for index in range(COUNT):
            alone = LaneDrive.step(keys[index], pick(states, index), actions[index], params)
            jax.tree.map(np.testing.assert_array_equal, alone, pick(together, index))
        states = together.state


def check_rides(params, rides):
    """Every ride reaches its goal by a shortest way and stays in its lane."""
    done, info = rides.terminated, rides.info
    last = done.argmax(axis=0), np.arange(done.shape[1])
    driving = np.arange(len(done))[:, None] <= last[0]
    assert done.any(axis=0).all() and info.success[last].all()
    assert (info.own_lane | ~driving).all() and not (info.off_road & driving).any()
    assert (info.tiles[last] == params.levels.shortest).all() and (info.spl[last] == 1).all()


@pytest.fixture(scope="module")
def rides(params):
    return jax.device_get(ride(params, jax.random.key(3), 700))


def test_the_expert_reaches_every_goal_by_a_shortest_way_in_its_lane(params, rides):
    check_rides(params, rides)


def test_the_figures_of_the_lane_are_those_of_lane_pose(params, rides):
    at = slice(5, 100, 19)
    pose, movement, s = jax.tree.map(lambda part: part[at], rides.state)
    locate = jax.jit(jax.vmap(jax.vmap(lane_pose), in_axes=(None, 0, 0)))
    found = locate(params.levels.grid, pose, movement)
    going = ~np.cumsum(rides.terminated, axis=0).astype(bool)[at]
    assert going.sum() > 30
    for ours, theirs in ((rides.reached.d[at], found.d), (rides.reached.phi[at], found.phi), (s, found.s)):
        np.testing.assert_allclose(ours[going], np.asarray(theirs)[going], atol=1e-5)
    np.testing.assert_array_equal(rides.info.own_lane[at][going], np.asarray(found.own_lane)[going])
    ahead = rides.reached.curvature[at][going][:, 0]
    np.testing.assert_allclose(ahead, np.array([-1 / 0.3, 0, 1 / 0.7])[movement.turn[going]], rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("action", ["wheels", "twist"])
def test_the_expert_acts_the_same_compiled_or_not_and_in_a_batch(params, action):
    params, keys = params.replace(action=action), jax.random.split(jax.random.key(4), 100)
    _, states = jax.jit(jax.vmap(LaneDrive.reset, (0, None)))(keys, params)
    batch = jax.jit(jax.vmap(pure_pursuit, (0, None)))(states, params)
    for act in (pure_pursuit, jax.jit(pure_pursuit)):
        np.testing.assert_array_equal(np.stack([act(pick(states, index), params) for index in range(100)]), batch)


def test_the_expert_drives_a_slow_robot_the_same_by_either_action(params):
    """Its top speed is less than the expert's speed."""
    slow = params.replace(robot=Robot(top_speed=0.1))
    _, states = jax.vmap(LaneDrive.reset, (0, None))(jax.random.split(jax.random.key(4), 20), slow)
    wheels, twist = (
        jax.vmap(LaneDrive.step, (0, 0, 0, None))(
            jax.random.split(jax.random.key(5), 20), states, jax.vmap(pure_pursuit, (0, None))(states, asked), asked
        ).state
        for asked in (slow, slow.replace(action="twist"))
    )
    np.testing.assert_allclose(wheels.wheels.turn, twist.wheels.turn, atol=1e-5)
    np.testing.assert_allclose(wheels.wheels.speed, twist.wheels.speed, atol=1e-6)
    assert np.abs(wheels.wheels.turn).max() > 0.1


@pytest.mark.usefixtures("standard")
def test_lanes_are_where_the_tile_set_has_them():
    """Starts are on the oracle's polylines, the expert stays on them, and `d` is measured from them."""
    levels = make_levels(jax.random.key(0), [TOWN], 8)
    params = LaneDriveParams(levels, start_d=0.0, start_phi=0.0, task="lane", lane_offset=0.24)

    def ride(key):
        _, state = LaneDrive.reset(key, params)

        def step(state, key):
            done = LaneDrive.step(key, state, pure_pursuit(state, params), params)
            return done.state, (done.state, done.info.own_lane)

        return state, jax.lax.scan(step, state, jax.random.split(key, 40))[1]

    starts, (states, own_lane) = jax.jit(jax.vmap(ride))(jax.random.split(jax.random.key(1), 8))
    for index in range(8):
        row, column, heading, turn = (int(part[index]) for part in starts.movement)
        point = np.array([[starts.pose.x[index] - column, starts.pose.y[index] - row]])
        d, phi, _ = polyline_errors(point, starts.pose.theta[index : index + 1], heading, turn, 0.24)
        assert abs(d[0]) < 1e-4 and abs(phi[0]) < 1e-3
    found = jax.vmap(jax.vmap(lambda pose, movement: lane_pose(TOWN, pose, movement, lane_offset=0.24)))(
        states.pose, states.movement
    )
    np.testing.assert_allclose(states.d, found.d, atol=1e-5)
    np.testing.assert_array_equal(own_lane, found.own_lane)
    assert np.abs(states.d).max() < 0.02
    with refused("start_d", "0.15"):
        LaneDriveParams(levels, start_d=0.15, lane_offset=0.1)
    with refused("lane_offset", "0.5"):
        LaneDriveParams(levels, lane_offset=0.5)
    with refused("lane_offset", "0.26", expected="at most 0.251"):
        LaneDriveParams(levels, lane_offset=0.26)


@pytest.mark.parametrize(
    "action", [[2**40, -(2**70)], np.array([2**40, -(2**40)]), [1e300, -np.inf], np.array([1e300, -2.0])]
)
@pytest.mark.usefixtures("any_types")
def test_an_action_of_more_than_32_bits_is_clipped(params, action):
    """2**40 was once an error in a list, and 0 in an array."""
    _, state = LaneDrive.reset(jax.random.key(0), params)
    expected = LaneDrive.step(jax.random.key(0), state, jnp.array([1.0, -1.0]), params)
    for transition in (
        LaneDrive.step(jax.random.key(0), state, action, params),
        LaneDrive.step(jax.random.key(0), state, action=action, params=params),
    ):
        jax.tree.map(np.testing.assert_array_equal, transition, expected)


def test_messages_show_what_came_and_no_tracer(params):
    _, state = LaneDrive.reset(jax.random.key(0), params)
    for call, subject, got, expected in (
        (lambda: LaneDrive.step(jax.random.key(0), 5, [0, 0], params), "state", "5", "LaneDriveState"),
        (lambda: LaneDrive.step(jax.random.key(0), state, [0, 0], 5), "params", "5", ""),
        (lambda: LaneDrive.reset(jax.random.key(0), 5), "params", "5", ""),
        (lambda: LaneDrive.observe(5, params), "state", "5", "LaneDriveState"),
        (lambda: RoadNav.step(jax.random.key(0), 5, 0, params), "state", "5", "RoadNavState"),
        (lambda: RoadNav.observe(state, 5), "state", "LaneDriveState(...", "RoadNavState"),
    ):
        with refused(subject, got, expected):
            call()


@pytest.fixture(scope="module")
def short():
    """The parameters of a road of three tiles, the state in the middle one, and that before its goal is reached."""
    params = LaneDriveParams(make_levels(jax.random.key(0), [[[4, 5, 1]]]), start_d=0.0, start_phi=0.0)
    _, state = LaneDrive.reset(jax.random.key(0), params)
    return params, state, *drive_on(params, state)


def drive_on(params, state):
    """Drives straight on: the state before the last step of the episode, and that step."""
    terminated = False
    while not terminated:
        before, done = state, LaneDrive.step(jax.random.key(1), state, jnp.array([0.5, 0.5]), params)
        state, terminated = done.state, done.terminated
    return before, done


def test_the_road_is_left_with_either_side_of_the_robot(short):
    """On a straight road, 0.222 m from its middle to the white line on either side."""
    params, state, *_ = short
    for edge, inwards in ((-0.222 + 0.075, 0.005), (0.222 - 0.075, -0.005)):
        for d, left in ((edge / TILE + 0.2 + inwards, False), (edge / TILE + 0.2 - inwards, True)):
            beside = state._replace(pose=lane_point(state.movement, 0.5, d))
            assert LaneDrive.step(jax.random.key(1), beside, jnp.zeros(2), params).info.off_road == left


def test_a_dead_end_that_is_no_goal_ends_the_episode_where_it_is_entered(short):
    params, state, _, done = short
    assert done.info.success and not done.info.off_road
    _, done = drive_on(params, state._replace(goal=state.goal._replace(column=2 - state.goal.column)))
    assert done.info.off_road and not done.info.success and 0.5 < abs(float(done.state.pose.x) - 1.5) < 0.54


def test_a_goal_that_is_reached_with_a_collision_is_none(short):
    """The object is touched in the step that enters the goal's tile, and not before."""
    params, _, before, done = short
    x, y, theta = (float(part) for part in done.state.pose)
    reach = (0.075 + MapObject("duckie", 0, 0, 0, 0.08).radius) / TILE - 0.005
    thing = MapObject("duckie", x + reach * np.cos(theta), y, 0.0, 0.08)
    objects = pick(make_objects([RoadMap([[4, 5, 1]], objects=[thing])]), 0)
    done = LaneDrive.step(jax.random.key(1), before._replace(objects=objects), jnp.array([0.5, 0.5]), params)
    assert done.info.collision and done.terminated and not done.info.success


@pytest.mark.slow
def test_straight_on_for_ever_ends_off_the_road(params):
    step = jax.jit(LaneDrive.step)
    _, state = jax.jit(LaneDrive.reset)(jax.random.key(0), params)
    total = 0.0
    for _ in range(300):
        done = step(jax.random.key(1), state, jnp.array([0.5, 0.5]), params)
        state, total = done.state, total + float(done.reward)
        if done.terminated:
            break
    assert done.terminated and done.info.off_road and not done.info.success and not done.truncated
    assert total < 0 and done.reward < -9


@pytest.mark.slow
def test_turns_of_a_lane_are_drawn_and_lead_round_for_ever(params):
    follow = LaneDriveParams(params.levels, task="lane", action="twist", limit=250)
    done = jax.device_get(ride(follow, jax.random.key(5), 250))
    assert not done.terminated.any() and done.truncated[-1].all() and not done.truncated[:-1].any()
    assert done.info.own_lane.all()
    assert len(np.unique(done.state[1].turn)) == 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["drawn", "without dead ends"])
def test_the_expert_drives_a_thousand_routes_on_a_thousand_maps(kind):
    maps = drawn_maps(7, 1000, (8, 8), fill=kind == "drawn")
    if kind != "drawn":
        maps = np.stack([without_dead_ends(grid) for grid in maps])
    params = LaneDriveParams(make_levels(jax.random.key(8), maps))
    check_rides(params, jax.device_get(ride(params, jax.random.key(9), 1200)))


@pytest.mark.parametrize(("faces", "speed", "sign"), [(0, 0.5, 1), (0, -0.5, -1), (np.pi, 0.5, -1), (np.pi, -0.5, 0)])
def test_only_a_robot_that_faces_along_its_lane_makes_progress(faces, speed, sign):
    """Else a driver can learn to turn round on the spot and to drive in reverse."""
    free = {"offset_cost": 0.0, "heading_cost": 0.0, "oncoming_cost": 0.0, "leaving_cost": 0.0}
    params = LaneDriveParams(make_levels(jax.random.key(2), [TOWN], 1), action="twist", start_d=0, start_phi=0, **free)
    _, state = LaneDrive.reset(jax.random.key(3), params)
    turned = state._replace(pose=state.pose._replace(theta=state.pose.theta + jnp.float32(faces)))
    done = LaneDrive.step(jax.random.key(0), turned, jnp.array([speed, 0.0]), params)
    tiles = 0.5 * float(params.robot.top_speed) * float(params.robot.dt) / TILE
    assert bool(done.info.own_lane)
    assert float(done.reward) == pytest.approx(sign * tiles, rel=1e-3)
