"""Lanes: against polylines of ten thousand points, against the drawn roads, and what must hold of any map."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from driving_oracle import BITS, POINTS, drawn_maps, links, pick, polyline, polyline_errors, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from oracle import OPPOSITE
from refusals import refused

from elitelanes_jax import render
from elitelanes_jax.drive import Pose, lane_pose, movements, random_pose
from elitelanes_jax.drive.lanes import lane_errors, lane_length, lane_point
from elitelanes_jax.lanes.curves import LANE_OFFSET, on_road
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import MOVEMENTS, Movement

SHAPE = (6, 7)
TILE_PX = 64
EVERY = [(heading, turn) for heading in range(4) for turn in range(3)]


@pytest.fixture(scope="module")
def grid():
    return drawn_maps(5, 1, SHAPE, fill=True)[0]


@pytest.fixture(scope="module")
def locate():
    return jax.jit(jax.vmap(lane_pose, in_axes=(None, 0)))


def random_poses(count, seed=0, shape=SHAPE):
    rng = np.random.default_rng(seed)
    height, width = shape
    return Pose(*rng.uniform([[0], [0], [-np.pi]], [[width], [height], [np.pi]], (3, count)).astype(np.float32))


any_grids = hnp.arrays(np.int8, (3, 4), elements=st.integers(0, 15))
find_movements = jax.jit(movements)
clean = jax.jit(linked_codes)


@settings(max_examples=60)
@given(any_grids)
def test_movements_are_those_of_links(grid):
    found = np.asarray(find_movements(grid))
    cleaned = np.asarray(clean(grid))
    for row, column in np.ndindex(grid.shape):
        open_sides = links(grid, row, column)
        assert sum(open_sides) == cleaned[row, column]
        for heading, turn in EVERY:
            expected = OPPOSITE[BITS[heading]] in open_sides and BITS[turned(heading, turn)] in open_sides
            assert found[row, column, heading, turn] == expected


def agree(grid, poses, found, lane_offset=LANE_OFFSET):
    """Compares with the polylines; returns the share of poses that were compared."""
    tiles = np.floor(poses.y).astype(int), np.floor(poses.x).astype(int)
    points = np.stack([poses.x - tiles[1], poses.y - tiles[0]], axis=1).astype(float)
    allowed = np.asarray(movements(grid))[tiles].reshape(-1, 12)
    errors = np.stack(
        [polyline_errors(points, poses.theta, *one, lane_offset) for one in EVERY], axis=-1
    )  # [3, poses, 12]
    rank = np.abs(errors[0]) + 100 * (np.cos(errors[1]) <= 0) + 1e6 * ~allowed
    best = rank.argmin(axis=1)
    ranks = np.sort(rank, axis=1)
    # Where two lanes are as near, or one points a quarter turn away, rounding decides between them.
    plain = (ranks[:, 1] - ranks[:, 0] > 1e-3) & (np.abs(np.cos(errors[1])).min(axis=1) > 1e-3)
    exists = allowed.any(axis=1)
    np.testing.assert_array_equal(found.found, exists)
    same = plain & exists
    chosen = np.array(EVERY)[best]
    np.testing.assert_array_equal(found.movement.heading[same], chosen[same, 0])
    np.testing.assert_array_equal(found.movement.turn[same], chosen[same, 1])
    d, phi, s = errors[:, np.arange(len(best)), best]
    assert np.abs(found.d - d)[same].max() < 1e-4
    assert np.abs(np.angle(np.exp(1j * (found.phi - phi))))[same].max() < 1e-3
    # Outside of its middle the foot of a point is anywhere on an arc.
    assert np.abs(found.s - s)[same & (np.abs(d) < 0.2)].max() < 1e-3
    road = np.asarray(found.on_road)
    edge = np.abs(np.abs(d) - lane_offset) < 1e-3
    np.testing.assert_array_equal(found.own_lane[same & ~edge], (road & (np.abs(d) <= lane_offset))[same & ~edge])
    np.testing.assert_array_equal(found.oncoming[same & ~edge], (road & (d > lane_offset))[same & ~edge])
    return same.mean()


def test_lane_poses_are_those_of_polylines(grid, locate):
    poses = random_poses(1000)
    assert agree(grid, poses, jax.device_get(locate(grid, poses))) > 0.9


def test_lane_poses_of_a_set_with_other_lanes_are_those_of_polylines(grid):
    poses = random_poses(1000)
    found = jax.jit(jax.vmap(lambda pose: lane_pose(grid, pose, lane_offset=0.21)))(poses)
    assert agree(grid, poses, jax.device_get(found), 0.21) > 0.9
    drawn = random_pose(jax.random.key(1), grid, offset=0.0, heading=0.0, lane_offset=0.21)
    there = lane_pose(grid, drawn, lane_offset=0.21)
    np.testing.assert_allclose([there.d, there.phi], 0, atol=1e-5)
    assert abs(lane_pose(grid, drawn, there.movement).d) == pytest.approx(0.01, abs=1e-5)


@pytest.mark.parametrize("wrong", [0, 0.5, -0.2, float("nan"), 1])
def test_a_lane_beside_the_road_is_refused(grid, wrong):
    with refused("lane_offset", repr(wrong), expected="number"):
        lane_pose(grid, Pose(0.5, 0.5, 0.0), lane_offset=wrong)


@pytest.mark.parametrize(
    ("movement", "exists"),
    [
        ((0, 1, 3, 1), True),
        ((0, 1, 3, 3), False),  # a turn back
        ((0, 1, 3, -1), False),
        ((0, 1, 7, 1), False),
        ((0, 1, -1, 1), False),
        ((2, 1, 3, 1), False),
    ],
)
def test_a_movement_with_a_field_out_of_range_does_not_exist(movement, exists):
    """The nearest movement of the table was once used instead."""
    town = np.array([[6, 7, 3], [12, 13, 9]])
    pose = lane_pose(town, Pose(1.5, 0.25, 3.0), Movement(*movement))
    assert pose.on_road and pose.found == pose.own_lane == exists and (pose.d != 0) == exists


@pytest.mark.slow
def test_a_hundred_thousand_lane_poses_are_those_of_polylines(locate):
    compared = []
    for number, grid in enumerate(drawn_maps(6, 100, SHAPE)):
        poses = random_poses(1000, number)
        compared.append(agree(grid, poses, jax.device_get(locate(grid, poses))))
    assert np.mean(compared) > 0.8  # some tiles have no movement


@pytest.mark.parametrize("lane_offset", [0.2, 0.21])
def test_points_on_a_lane_are_its_polyline_and_have_no_errors(lane_offset):
    points = jax.jit(partial(lane_point, lane_offset=lane_offset))
    errors_of = jax.jit(partial(lane_errors, lane_offset=lane_offset))
    end_of = jax.jit(lambda one: one.next_node)
    for heading, turn in EVERY:
        length = float(lane_length(turn, lane_offset))
        some = np.arange(0, POINTS, 99)
        s = (some * (length / (POINTS - 1))).astype(np.float32)
        one = Movement(3, 5, heading, turn)
        pose = points(one, s)
        expected = polyline(heading, turn, lane_offset)[some]
        np.testing.assert_allclose(np.stack([pose.x - 5, pose.y - 3], axis=1), expected, atol=1e-6)
        errors = np.stack(errors_of(pose, one))
        np.testing.assert_allclose(errors, np.stack([0 * s, 0 * s, s]), atol=3e-6)
        # It ends where the lane of the next tile begins.
        end, onward = points(one, length), points(Movement(*end_of(one), 1), 0.0)
        np.testing.assert_allclose(np.stack(end), np.stack(onward), atol=1e-6)


def test_a_given_movement_is_measured_by_also_from_outside_its_tile(grid):
    (row, column, heading, turn), *_ = np.argwhere(np.asarray(movements(grid)))
    start = lane_point(Movement(row, column, heading, turn), -0.1)
    found = lane_pose(grid, start, Movement(row, column, heading, turn))
    assert found.found
    np.testing.assert_allclose([found.d, found.phi, found.s], [0, 0, -0.1], atol=1e-5)
    # Numbers of more than 32 bits would lose their upper bits, which are all that this row has.
    large = Movement(np.int64(row + 2**32), column, heading, turn)
    for nowhere in (Movement(-1, 0, 0, 0), Movement(*SHAPE, 0, 0), large, large._replace(row=2**40)):
        lost = lane_pose(grid, start, nowhere)
        assert not lost.found and lost.d == lost.phi == lost.s == 0 and not lost.own_lane


def test_random_poses_are_on_lanes(grid):
    """Without an offset: on the centre of a movement that there is; all movements come."""
    keys = jax.random.split(jax.random.key(0), 2000)
    poses = jax.jit(jax.vmap(lambda key: random_pose(key, grid, offset=0.0, heading=0.0)))(keys)
    found = jax.jit(jax.vmap(lane_pose, in_axes=(None, 0)))(grid, poses)
    assert found.found.all() and np.abs(found.d).max() < 1e-4
    drawn = set(zip(*(np.asarray(part).tolist() for part in found.movement), strict=True))
    assert drawn == set(map(tuple, np.argwhere(np.asarray(movements(grid))).tolist()))


# Only slow tests compile as users do.
@pytest.mark.slow
def test_a_random_pose_has_the_same_bits_compiled_or_not_and_in_a_batch(grid):
    keys = jax.random.split(jax.random.key(1), 100)
    compiled = jax.jit(lambda key: random_pose(key, grid))
    batch = jax.device_get(jax.jit(jax.vmap(lambda key: random_pose(key, grid)))(keys))
    for draw in (partial(random_pose, grid=grid), compiled):
        np.testing.assert_array_equal(np.stack([draw(key) for key in keys], axis=1), np.stack(batch))


def test_off_the_grid_there_is_no_road(grid, locate):
    poses = Pose(*np.array([[-0.5, 2, 0], [3, -7, 1], [7.01, 2, 2], [1, 6.5, 3], [1e9, -1e9, 0]], np.float32).T)
    found = locate(grid, poses)
    for far in (2**40, np.int64(2**40), np.array(2**40)):
        assert not lane_pose(grid, Pose(far, 2, 0)).found
    assert not found.on_road.any() and not found.found.any()
    assert np.isfinite(np.stack([found.d, found.phi, found.s])).all()


def test_the_road_is_the_drawn_one(drawn_tiles):
    """But for its edge: the drawn tiles are 60 cm wide, the lanes are as wide as on tiles of 58.5 cm."""
    margin = 3
    offsets = np.indices((2 * margin + 1,) * 2).reshape(2, -1) - margin
    inner = (np.arange(TILE_PX) + 0.5) / TILE_PX
    compared = 0
    for code in drawn_tiles.alphabet:
        grid = np.full((2, 2), code, np.int8)
        road = render(grid, drawn_tiles, tile_px=TILE_PX).road[:TILE_PX, :TILE_PX] > 0
        around = np.stack([np.roll(road, shift, axis=(0, 1)) for shift in offsets.T])[:, margin:-margin, margin:-margin]
        ours = np.asarray(on_road(code, *np.meshgrid(inner, inner)))[margin:-margin, margin:-margin]
        settled = around.all(axis=0) | ~around.any(axis=0)
        np.testing.assert_array_equal(ours[settled], road[margin:-margin, margin:-margin][settled])
        compared += settled.mean() / len(drawn_tiles.alphabet)
    assert compared > 0.7
    assert not np.asarray(on_road(0, 0.5, 0.5))


def test_compiled_or_not_and_many_at_once_it_is_the_same(grid, locate):
    poses = random_poses(64, 3)
    found = locate(grid, poses)
    for number in range(0, 64, 8):
        one = lane_pose(grid, pick(poses, number))
        for alone, batched in zip(jax.tree.leaves(one), jax.tree.leaves(pick(found, number)), strict=True):
            np.testing.assert_allclose(alone, batched, atol=1e-6)


def test_a_pose_of_64_bits_has_figures_of_32(grid):
    jax.config.update("jax_enable_x64", True)
    try:
        found = lane_pose(grid, Pose(*np.float64([1.5, 0.25, 3])))
        assert found.d.dtype == found.phi.dtype == found.s.dtype == np.float32
    finally:
        jax.config.update("jax_enable_x64", False)


@pytest.mark.usefixtures("any_types")
def test_a_wrong_grid_is_refused():
    pose = Pose(0.5, 0.5, 0.0)
    with refused("grid", "16 at A1 ([0, 0])"):
        lane_pose(np.full((3, 3), 16), pose)
    with refused("grid", "none", expected="lane"):
        random_pose(jax.random.key(0), [[4, 1], [0, 0]])
    assert not MOVEMENTS[[0, 1, 2, 4, 8]].any()
    assert jnp.asarray(MOVEMENTS[15]).all()
