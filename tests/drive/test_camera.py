"""The camera: against OpenCV's warp of the rendered map, and against points that are projected by hand."""

import time

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_programs import compilations
from driving_oracle import drawn_maps

from elitelanes_jax import render
from elitelanes_jax.drive import Camera, Pose, look, make_sight, movements, random_pose
from elitelanes_jax.drive._camera import _undistort, pack_sight, rays_of, reach_ground
from elitelanes_jax.drive._hashing import hash_normal
from elitelanes_jax.drive.lanes import lane_point
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.tiles import choose_tiles

TILE_PX = 32
frame = jax.jit(look)
undistort = jax.jit(_undistort)


@pytest.fixture(scope="module")
def scene(drawn_tiles):
    grid = drawn_maps(0, 1, (5, 6), fill=True)[0]
    chosen = choose_tiles(grid, drawn_tiles, 1)
    picture = render(grid, drawn_tiles, tile_px=TILE_PX, chosen=chosen)
    return grid, chosen, make_sight(drawn_tiles, tile_px=TILE_PX), picture


@jax.jit
def find_ground(camera):
    """Where the rays of pixels' centres meet the ground: metres ahead and to the left, infinite above the horizon."""
    rays = rays_of(camera)
    seen, depth, ahead = reach_ground(camera, rays)
    ahead, left = (jnp.where(seen, part * TILE, jnp.inf) for part in (ahead, -depth * rays.right))
    return jnp.broadcast_to(ahead, (camera.rows, camera.columns)), left


def some_poses(grid, count):
    rng = np.random.default_rng(0)
    every = np.argwhere(np.asarray(movements(grid)))
    chosen = every[rng.integers(0, len(every), count)].astype(np.int32)
    middle = jax.jit(lane_point)(Movement(*chosen.T), rng.uniform(0, 0.4, count).astype(np.float32))
    beside = rng.uniform(-0.1, 0.1, (2, count)).astype(np.float32)
    return [Pose(*one) for one in zip(middle.x + beside[0], middle.y, middle.theta + 3 * beside[1], strict=True)]


def homography(pose, camera):
    """From pixels of the camera to pixels of the map, by projecting the plane z = 0 with OpenCV's convention."""
    focal = camera.rows / 2 / np.tan(np.deg2rad(camera.field_of_view) / 2)
    intrinsic = np.array([[focal, 0, camera.columns / 2 - 0.5], [0, focal, camera.rows / 2 - 0.5], [0, 0, 1]])
    pitch, theta = np.deg2rad(camera.pitch), float(pose.theta)
    # Of x east, y north and z up.
    ahead = np.array([np.cos(theta) * np.cos(pitch), np.sin(theta) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(theta), -np.cos(theta), 0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    centre = np.array([np.cos(theta) * camera.forward, np.sin(theta) * camera.forward, camera.height])
    centre[:2] += np.array([float(pose.x), -float(pose.y)]) * TILE
    onto = intrinsic @ np.column_stack([rotation[:, 0], rotation[:, 1], -rotation @ centre])
    metres = np.array(
        [[TILE / TILE_PX, 0, 0.5 * TILE / TILE_PX], [0, -TILE / TILE_PX, -0.5 * TILE / TILE_PX], [0, 0, 1]]
    )
    return np.linalg.inv(onto @ metres)


def test_labels_and_colours_are_those_of_opencvs_warp(scene):
    grid, chosen, sight, picture = scene
    camera = Camera(rows=60, columns=80)
    same = total = seen = 0
    for pose in some_poses(grid, 12):
        view = jax.device_get(frame(pose, grid, sight._replace(camera=camera), chosen=chosen))
        matrix = homography(pose, camera)
        # A pixel in front of the camera has a positive third coordinate on the ground, one above the horizon has not.
        columns, rows = np.meshgrid(np.arange(80), np.arange(60))
        ground = matrix @ np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1)
        horizon = (ground[2] * np.linalg.det(matrix) > 0).reshape(60, 80)
        horizon = horizon if horizon[-1].all() else ~horizon
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        labels = cv2.warpPerspective(picture.labels, matrix, (80, 60), flags=flags) * horizon
        image = cv2.warpPerspective(picture.image, matrix, (80, 60), flags=flags, borderValue=camera.ground)
        image = np.where(horizon[..., None], image, np.array(camera.sky)).astype(np.uint8)
        agree = labels == view.labels
        same, total, seen = same + agree.sum(), total + agree.size, seen + len(np.unique(labels))
        grown = cv2.dilate(labels, np.ones((3, 3), np.uint8)), cv2.erode(labels, np.ones((3, 3), np.uint8))
        assert (agree | (grown[0] != grown[1])).all()
        assert (np.abs(image.astype(int) - view.image).max(axis=-1) <= 1).mean() > 0.98
    assert same / total >= 0.995
    assert seen > 30


@pytest.mark.parametrize("distortion", [None, (-0.2, 0.05), (-0.3, 0.09), (0.1, 0.1), (3.0, 0.0)])
def test_rays_meet_the_ground_where_points_project_from(distortion):
    ahead, left = np.float64(find_ground(Camera(rows=48, columns=64, distortion=distortion)))
    focal, pitch = 24 / np.tan(np.deg2rad(37.5)), np.deg2rad(19.15)
    seen = np.isfinite(ahead)
    assert distortion or (seen == (np.arange(48)[:, None] > 24 - focal * np.tan(pitch) - 0.5)).all()
    seen &= (distortion is None) | (ahead < 2)  # further away a ray hardly falls
    rows, columns = (index[seen] + 0.5 for index in np.mgrid[:48, :64])
    forward = ahead[seen] - 0.066
    down, depth = 0.108 * np.cos(pitch) - forward * np.sin(pitch), forward * np.cos(pitch) + 0.108 * np.sin(pitch)
    intrinsic = np.array([[focal, 0, 32], [0, focal, 24], [0, 0, 1.0]])
    bend = np.array([*(distortion or (0, 0)), 0, 0])
    points = np.stack([-left[seen], down, depth], axis=-1)
    projected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), intrinsic, bend)
    np.testing.assert_allclose(projected[:, 0], np.stack([columns, rows], axis=1), atol=2e-3)


@pytest.mark.parametrize("k1", [-10, -0.5, -0.2, -0.1, 0, 0.1, 10])
@pytest.mark.parametrize("k2", [-10, -0.1, 0, 0.02, 0.09, 10])
def test_distortion_is_undone_up_to_where_it_folds(k1, k2):
    far = np.concatenate([[0], np.geomspace(0.01, 20, 300)])
    found = np.float64(undistort(jnp.float32(far), jnp.zeros(301), float(k1), float(k2))[0])
    folds = [root.real for root in np.roots([5 * k2, 3 * k1, 1]) if abs(root.imag) < 1e-9 and root.real > 0]
    fold = np.sqrt(min(folds, default=np.inf))
    assert (found <= fold * (1 + 1e-5)).all()
    again = found * (1 + k1 * found**2 + k2 * found**4)
    reached = far if np.isinf(fold) else np.minimum(far, fold * (1 + k1 * fold**2 + k2 * fold**4))
    np.testing.assert_allclose(again, reached, rtol=2e-6, atol=2e-6)


def test_parts_of_the_lens_and_of_colours_may_differ_in_a_batch():
    factors, shades = jnp.array([-0.1, 0.0, 0.1]), jnp.array([0.0, 100.0, 255.0])
    made = jax.vmap(lambda factor, shade: Camera(distortion=(factor, 0.0), sky=(shade, 0, 0)))(factors, shades)
    np.testing.assert_array_equal(made.distortion[0], factors)
    np.testing.assert_array_equal(made.sky[0], shades)


def test_light_and_noise_change_colours_alone(scene):
    grid, chosen, sight, _ = scene
    (pose,) = some_poses(grid, 1)
    plain, dark, noisy = (
        jax.device_get(frame(pose, grid, sight._replace(camera=camera), key=jax.random.key(2), chosen=chosen))
        for camera in (Camera(), Camera(light=0.5), Camera(noise=5.0))
    )
    assert (plain.labels == dark.labels).all() and (plain.labels == noisy.labels).all()
    np.testing.assert_allclose(dark.image, plain.image * 0.5, atol=0.51)
    change = noisy.image.astype(float) - plain.image
    assert 4 < change[plain.image < 200].std() < 6
    red, green, _ = change[(plain.image < 200).all(axis=-1)].T
    assert abs(np.corrcoef(red, green)[0, 1]) < 0.2
    poses = Pose(*np.array([pose, pose], np.float32).T)
    frames = jax.jit(jax.vmap(look, in_axes=(0, None, None, None, 0, None)))
    both = frames(poses, grid, sight, None, jax.random.split(jax.random.key(0), 2), chosen)
    np.testing.assert_array_equal(both.labels[1], plain.labels)
    np.testing.assert_array_equal(both.image[0], plain.image)


def test_pictures_of_a_code_alternate_and_noise_depends_on_the_pose():
    """From straight above the middle of a map of one code, whose three pictures have a shade each."""
    shades = np.arange(16, dtype=np.uint8).repeat(8 * 8 * 3).reshape(16, 8, 8, 3) // 4 * 60
    camera = Camera(height=2.0, forward=0.0, pitch=90.0, rows=45, columns=45, field_of_view=60.0, noise=2.0)
    sight = pack_sight(shades, shades[..., 0], {0: [(0, 0)], 15: [(1, 0), (2, 0), (3, 0)]}, camera)
    poses = [Pose(*jnp.array([2.5, 2.5, theta])) for theta in (np.pi / 2, np.pi / 2, np.pi / 2 + 1e-4)]
    seen = jax.jit(look)
    first, again, other = (np.asarray(seen(pose, np.full((5, 5), 15), sight).image) for pose in poses)
    cells = np.rint(first[11:34:11, 11:34:11, 0] / 60)
    assert set(cells.flat) == {1, 2, 3} and np.diff(cells).all() and np.diff(cells, axis=0).all()
    assert (first == again).all() and (first != other).mean() > 0.5


def test_noise_is_nearly_normal_and_differs_between_pixels_colours_and_seeds():
    draw = jax.jit(hash_normal, static_argnums=1)
    first, second = (np.asarray(draw(jnp.uint32(seed), (3, 64, 80))) for seed in (0, 1))
    for noise in (first, second):
        assert abs(noise.mean()) < 0.02 and abs(noise.std() - 1) < 0.02
        assert abs((noise**4).mean() - 2.7) < 0.1  # of a sum of four uniform numbers; a normal one has 3
    pairs = [(first, second), (first[0], first[1]), (first[:, 1:], first[:, :-1]), (first[..., 1:], first[..., :-1])]
    for one, other in pairs:
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.05


@pytest.mark.slow
def test_a_pose_that_the_same_program_draws_costs_little(scene):
    grid, chosen, sight, _ = scene
    noisy = sight._replace(camera=Camera(noise=3.0))

    def render_each(poses):
        return jax.vmap(lambda pose: look(pose, grid, noisy, key=jax.random.key(0), chosen=chosen))(poses)[:2]

    keys = jax.random.split(jax.random.key(0), 128)
    poses = jax.jit(jax.vmap(random_pose, in_axes=(0, None)))(keys, grid)
    apart = seconds(jax.jit(render_each), poses)
    inside = seconds(jax.jit(lambda keys: render_each(jax.vmap(random_pose, in_axes=(0, None))(keys, grid))), keys)
    assert inside < 2 * apart  # ten times as long if XLA computes the pose again for each pixel


def seconds(function, *args):
    """The shortest of several calls, in seconds of the processor."""
    spent = []
    for _ in range(7):
        began = time.process_time()
        jax.block_until_ready(function(*args))
        spent.append(time.process_time() - began)
    return min(spent)


def test_a_further_view_compiles_nothing(scene):
    grid, _, sight, _ = scene
    look(Pose(1.5, 1.5, 0.0), grid, sight)
    with compilations() as compiled:
        look(Pose(2.5, 1.5, 1.0), grid, sight)
    assert not compiled


@pytest.mark.usefixtures("any_types")
def test_chosen_pictures_may_have_8_bits():
    pictures = np.zeros((260, 1, 1, 3), np.uint8)
    pictures[256] = 200
    sight = pack_sight(pictures, np.zeros((260, 1, 1), np.uint8), {0: [(0, 0)]}, Camera(rows=4, columns=4, pitch=90))
    view = look(Pose(0.5, 0.5, 0.0), [[0]], sight, chosen=np.array([[[64, 0]]], np.uint8))
    assert (view.image == 200).all()
