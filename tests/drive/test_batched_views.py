"""Views in JAX: against the dataset's camera, and against a slow oracle of what varies."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import views_oracle
from driving_oracle import drawn_maps

from elitelanes_jax import InputError, RoadMap, read_map, render
from elitelanes_jax.dataset import _robot_views, _transforms
from elitelanes_jax.dataset._variation import vary_motion
from elitelanes_jax.drive import Camera, Pose, Variation, lane_pose, make_scenes, stream_views, views
from elitelanes_jax.drive import _variation as varying
from elitelanes_jax.drive import _views as drawing
from elitelanes_jax.drive.robot import TILE, Robot
from elitelanes_jax.formats import MapObject
from elitelanes_jax.formats.objects import NEAR
from elitelanes_jax.lanes.movements import movements_of
from elitelanes_jax.maps import furnish
from elitelanes_jax.network.bits import seed_key
from elitelanes_jax.tiles import load_objects
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.pasting import paste_objects

pytestmark = pytest.mark.usefixtures("standard")  # `views` allows promotions itself

TILE_PX = 64
TOWN = Path(__file__).parents[2] / "docs/examples/town.json"
CAMERA, BARE, NOISY = Camera(rows=30, columns=40), Variation(), Variation(noise=8)


@pytest.fixture(scope="module")
def grids():
    return [drawn_maps(0, 1, (5, 6), fill=True)[0], np.array([[6, 7, 3], [12, 13, 9]], np.int8)]


@pytest.fixture(scope="module")
def scenes(grids):
    return make_scenes(grids, tile_px=TILE_PX)


@pytest.fixture(scope="module")
def furnished():
    return furnish(read_map(TOWN), "all", seed=1)


@pytest.fixture(scope="module")
def crowded(furnished):
    return make_scenes(furnished, tile_px=TILE_PX)


@jax.jit
def plan_views(keys, scenes, camera, variation):
    def plan(key):
        return drawing._plan_view(key, scenes, camera, variation, samples=2)

    return jax.vmap(plan)(keys)


def plans_of(key, scenes, count, camera=CAMERA, variation=BARE):
    """The numbers of a batch's views."""
    keys = jax.vmap(partial(jax.random.fold_in, key))(jnp.arange(count))
    return jax.device_get(plan_views(keys, scenes, *jax.tree.map(jnp.float32, (camera, variation))))


def viewpoint_of(plan, camera):
    """The dataset's viewpoint of a planned view."""
    pose = {name: float(part) for name, part in zip(Pose._fields, plan.pose, strict=True)}
    drawn = {name: float(getattr(plan.camera, name)) for name in ("height", "forward", "pitch", "field_of_view")}
    scale = np.diag([1 / TILE_PX, 1 / TILE_PX, 1])
    to_robot = _robot_views._to_robot(pose["x"], pose["y"], pose["theta"]) @ scale
    onto_ground = np.array([[1, 0, -camera.forward], [0, 1, 0], [0, 0, 0], [0, 0, 1]])
    size = camera.rows, camera.columns
    matrix = _robot_views.camera_matrix(drawn, size) @ onto_ground @ to_robot
    lines = 0.0 if plan.lines is None else float(plan.lines) / 2**20 * np.sin(2 * np.pi * 0.09)
    sky = tuple(int(part) for part in np.ravel(plan.camera.sky))
    return _robot_views.Viewpoint(matrix, size, sky, TILE_PX, lines, {"pose": pose, "camera": drawn})


@pytest.mark.parametrize("columns", [1, 3, 4])
def test_the_middle_of_a_picture_is_straight_ahead(columns):
    pose, camera = Pose(*jnp.array([0.5, 0.25, 0.0])), Camera(rows=3, columns=columns)
    rows = drawing._meet_ground(pose, camera, 4, 1, smaller=False)
    beside = 0.5 * (columns % 2 == 0) * rows.y_step
    np.testing.assert_allclose((rows.y - beside)[rows.seen], 1.25 * 2**20, atol=1)


@pytest.mark.parametrize("pitch", [-90, 90])
def test_a_wobble_tilts_no_camera_beyond_straight_up_and_down(scenes, pitch):
    plans = plans_of(jax.random.key(2), scenes, 8, Camera(pitch=pitch), Variation(wobble=0.5))
    pitches = np.abs(plans.camera.pitch)
    assert (pitches == 90).any() and (pitches < 90).any() and pitches.max() == 90


def test_a_single_column_is_the_middle_one_of_three(scenes):
    one, three = (
        views(jax.random.key(5), scenes, 8, camera=Camera(rows=30, columns=columns), samples=1) for columns in (1, 3)
    )
    for narrow, wide in ((one.images, three.images), (one.labels, three.labels)):
        np.testing.assert_array_equal(narrow[:, :, 0], wide[:, :, 1])


@pytest.mark.parametrize("lines", [pytest.param(None, marks=pytest.mark.slow), 0.07])
def test_views_are_those_of_the_datasets_camera(grids, scenes, drawn_tiles, lines):
    camera, variation = Camera(rows=60, columns=80), Variation(lines=lines)
    seen = jax.device_get(views(jax.random.key(1), scenes, 12, camera=camera, variation=variation))
    plans = plans_of(jax.random.key(1), scenes, 12, camera, variation)
    same, difference = [], []
    for index in range(12):
        plan = jax.tree.map(lambda part, index=index: part[index], plans)
        grid = grids[plan.map]
        cells = plan.cells.reshape(scenes.maps.codes.shape[1:])[1 : grid.shape[0] + 1, 1 : grid.shape[1] + 1]
        chosen = np.stack(np.divmod(cells, 4), axis=-1)
        picture = render(grid, drawn_tiles, tile_px=TILE_PX, chosen=chosen)
        viewpoint = viewpoint_of(plan, camera)
        same.append(_robot_views.see_labels(picture.labels, viewpoint) == seen.labels[index])
        expected = _robot_views.see(picture.image, viewpoint, GROUND)
        difference.append(np.abs(expected.astype(int) - seen.images[index]))
    assert len(np.unique(seen.maps)) == 2
    assert np.mean(same) > 0.9995
    assert np.mean(difference) < 1.5 and np.mean(np.max(difference, axis=-1) <= 16) > 0.95


@pytest.mark.parametrize(
    "variation",
    [Variation.varied(), pytest.param(Variation.varied().replace(gamma=None, motion=None), marks=pytest.mark.slow)],
)
def test_pictures_are_those_of_the_slow_oracle(crowded, variation):
    key, count = jax.random.key(3), 2
    seen = jax.device_get(views(key, crowded, count, camera=CAMERA, variation=variation))
    plans = plans_of(key, crowded, count, variation=variation)
    bare = [jax.jit(partial(layers_of, crowded))(jax.tree.map(lambda part, i=i: part[i], plans)) for i in range(count)]
    for index, (road, paved, sky) in enumerate(jax.device_get(bare)):
        look = jax.tree.map(lambda part, index=index: part[index], plans.look)
        expected = views_oracle.photograph(np.stack(road, axis=-1), paved, sky, look)
        difference = np.abs(expected.astype(int) - seen.images[index])
        assert difference.max() <= 1 and (difference > 0).mean() < 0.01


def layers_of(scenes, plan):
    """Roads and objects, their share, and the share of the sky, without variation."""
    sums = drawing._sum_samples(plan, scenes, 2, drawing._stand(plan, scenes, 2, plan.samples))
    red_blue, green_paved, above = sums
    road = [part / 4 for part in (red_blue & 0xFFFF, green_paved & 0xFFFF, red_blue >> 16)]
    return road, (green_paved >> 16) / (4 * 64), above / 4


@pytest.mark.slow
@pytest.mark.parametrize("batch", [4, 1])
def test_a_view_depends_on_the_key_and_its_index_alone(scenes, batch):
    key = jax.random.key(5)
    draw = partial(views, scenes=scenes, camera=CAMERA, variation=Variation.varied())
    many = jax.device_get(draw(key, batch=7))
    part = jax.device_get(jax.jit(partial(draw, batch=batch))(key))
    jax.tree.map(lambda few, all_: np.testing.assert_array_equal(few, all_[:batch]), part, many)
    assert len(np.unique(many.poses.x)) == 7
    other = jax.device_get(draw(jax.random.key(6), batch=7))
    assert (other.images != many.images).mean() > 0.5


@pytest.mark.slow
def test_all_at_once_draws_what_is_drawn_one_by_one(crowded):
    plans = plans_of(jax.random.key(5), crowded, 2, variation=Variation.varied())
    each, at_once = (jax.jit(partial(way, crowded))(plans) for way in (drawing._draw_each, drawing._draw_all))
    np.testing.assert_array_equal(each[1], at_once[1])
    colours = [np.asarray(words).view(np.uint8).astype(int) for words, _ in (each, at_once)]
    assert np.abs(colours[0] - colours[1]).max() <= 1


def test_lanes_are_those_of_lane_pose_and_within_the_ranges(grids, scenes):
    variation = Variation(offset=0.05, heading=10)
    seen = jax.device_get(views(jax.random.key(2), scenes, 64, camera=CAMERA, variation=variation, samples=1))
    for index, number in enumerate(seen.maps[:24]):
        pose = Pose(*(part[index] for part in seen.poses))
        lane = lane_pose(grids[number], pose)
        np.testing.assert_allclose(seen.lanes[index, :2], (lane.d, lane.phi), atol=1e-5)
    assert 0.04 < np.abs(seen.lanes[:, 0]).max() < 0.0501
    # On a crossing another lane may be nearer than the one on which the pose was drawn.
    assert 0.03 < np.median(np.abs(seen.lanes[:, 1])) < 0.15
    assert 20 < seen.maps.sum() < 44


def test_lanes_and_poses_are_those_of_the_tile_sets_own_lane_offset(grids, drawn_tiles):
    scenes = make_scenes(grids, replace(drawn_tiles, lane_offset=0.15), tile_px=16)
    plans = plans_of(jax.random.key(2), scenes, 48, variation=Variation(offset=0))
    curvatures = set()
    for index, number in enumerate(plans.map):
        pose = Pose(*(part[index] for part in plans.pose))
        lane = lane_pose(grids[number], pose, lane_offset=0.15)
        nearest = _robot_views._nearest(movements_of(grids[number]), *map(float, pose), 0.15)
        expected = lane.d, lane.phi, nearest["curvature"]
        np.testing.assert_allclose(plans.lane[index], expected, atol=1e-5)
        np.testing.assert_allclose(plans.lane[index], [*nearest.values()], atol=1e-5)
        curvatures.add(round(nearest["curvature"], 4))
    # On a crossing another lane may be nearer than the one on which the pose was drawn.
    assert (np.abs(plans.lane[:, 0]) < 1e-5).mean() > 0.8
    assert curvatures == {0.0, round(-1 / 0.35, 4), round(1 / 0.65, 4)}


@pytest.mark.slow
def test_objects_hide_labels_and_no_robot_touches_them(furnished, crowded):
    seen = jax.device_get(views(jax.random.key(2), crowded, 48, camera=CAMERA))
    assert (seen.labels[seen.instances > 0] == 0).all()
    assert seen.instances.max() <= len(furnished.objects) and (seen.instances > 0).mean() > 0.002
    for thing in furnished.objects:
        away = np.hypot(thing.x - seen.poses.x, thing.y - seen.poses.y) * TILE
        assert not thing.height or (away > thing.radius + Robot().width / 2 - 1e-5).all()


def test_a_pose_is_drawn_anew_until_it_touches_no_object():
    """Most tiles of the ring have a bus, so that often a second pose touches one too."""
    ring = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)
    buses = [MapObject("bus", x, y, 0.0, 0.12) for x, y in ((1.5, 0.5), (2.5, 0.5), (2.5, 1.5), (2.5, 2.5), (1.5, 2.5))]
    poses = plans_of(jax.random.key(0), make_scenes(RoadMap(ring, objects=buses), tile_px=16), 32).pose
    for bus in buses:
        away = np.hypot(bus.x - poses.x, bus.y - poses.y) * TILE
        assert (away > bus.radius + Robot().width / 2 - 1e-5).all()


@pytest.mark.slow
def test_objects_have_the_masks_and_the_pictures_that_datasets_have(drawn_tiles):
    grid, objects, camera = np.array([[6, 7, 3], [12, 13, 9]], np.int8), load_objects(), Camera(rows=60, columns=80)
    oblong = [one if one.height else replace(one, footprint=(0.12, 0.05)) for one in objects.pictures]
    objects = replace(objects, pictures=tuple(oblong))
    spots = [(0.15, 0.2), (0.8, 0.75), (1.5, 0.05), (1.1, 0.9), (2.8, 0.2), (2.2, 0.8), (1.8, 1.9)]
    lying = [(0.5, 0.3), (0.3, 1.0), (1.5, 1.5), (1.5, 0.45), (2.7, 1.0), (2.6, 1.6)]
    things = [MapObject("duckie", x, y, 2 * x, 0.09) for x, y in spots]
    things += [MapObject("sign_stop", 1.95, 0.02, 2.0, 0.2, tag) for tag in (24, 25)]
    things += [MapObject("floor_tag", x, y, 2 * x - 3 * y, 0.0, 300 + number) for number, (x, y) in enumerate(lying)]
    scenes = make_scenes(RoadMap(grid, objects=things), tile_px=TILE_PX, objects=objects)
    seen = jax.device_get(views(jax.random.key(4), scenes, 16, camera=camera))
    plans = plans_of(jax.random.key(4), scenes, 16, camera)
    choices, first = [objects.choices(thing) for thing in things], np.asarray(scenes.maps.choices)[0, :, 0]
    same, difference, other, shown = [], [], [], set()
    for index in range(16):
        plan = jax.tree.map(lambda part, index=index: part[index], plans)
        chosen = np.stack(np.divmod(plan.cells.reshape(4, 5)[1:-1, 1:-1], 4), axis=-1)
        ground = render(grid, drawn_tiles, tile_px=TILE_PX, chosen=chosen).image
        viewpoint, images = viewpoint_of(plan, camera), []
        for shift in (0, 1):
            pictures = [one[(plan.pictures[i] - first[i] + shift) % len(one)] for i, one in enumerate(choices)]
            layers = {"image": _robot_views.see(ground, viewpoint, GROUND)}
            placed, order, _ = _robot_views.place_objects(things, pictures, viewpoint, TILE_PX)
            owners, _ = paste_objects(layers, placed, order, NEAR)
            images.append(np.abs(layers["image"].astype(int) - seen.images[index]))
            if not shift:
                same.append(owners == seen.instances[index])
                inside = (owners > 0) & same[-1]
        is_duckie = inside & (seen.instances[index] <= len(spots))
        for image, differences in zip(images, (difference, other), strict=True):
            differences.append(image[is_duckie])
        shown |= set(np.unique(seen.instances[index]).tolist())
        assert (seen.labels[index][inside] == 0).all()
    assert np.mean(same) > 0.99
    assert np.mean(np.concatenate(difference)) < 0.8 * np.mean(np.concatenate(other))
    assert {len(set(column)) for column in plans.pictures.T} <= {1, 3, 4}
    assert set((plans.pictures - first)[:, 0]) == {0, 1, 2, 3}
    assert shown > set(range(10, 16)) and len(shown) > 12


@pytest.mark.slow
def test_ranges_may_differ_between_the_pictures_of_a_batch(scenes):
    still = {"offset": 0, "heading": 0, "wobble": 0}
    ranges = Variation(noise=np.array([0, 64], np.float32), **still)
    camera = Camera(rows=30, columns=40, sky=(np.array([9.0, 200.0]), 0, 0))
    plain = jax.device_get(views(jax.random.key(1), scenes, 2, camera=camera, variation=Variation(noise=0, **still)))
    noisy = jax.device_get(views(jax.random.key(1), scenes, 2, camera=camera, variation=ranges))
    assert (plain.images[:, 0, 0, 0] == (9, 200)).all()
    changed = (plain.images != noisy.images).mean(axis=(1, 2, 3))
    assert changed[0] == 0 and changed[1] > 0.5


def test_the_ranges_and_horizons_are_those_of_datasets():
    for name, value in Variation.varied().values().items():
        if hasattr(_transforms.VARIED, name):
            assert value == getattr(_transforms.VARIED, name)
        elif hasattr(_transforms.Viewpoints(), name):
            assert (value or 0) == getattr(_transforms.Viewpoints(), name)
        else:
            assert (name, value) == ("horizon", 1)
    assert (np.array(_robot_views._HORIZONS) == varying.HORIZONS).all()


@pytest.mark.parametrize("numbers", [(0.7, 0.2), (1.0, 0.75), (0.1, 0.5)])
def test_streaks_of_motion_are_those_of_datasets(numbers):
    class Numbers:
        def uniform(self, low, high):
            return low + (high - low) * draws.pop(0)

    draws, point = list(numbers), np.zeros((5, 5, 3), np.uint8)
    point[2, 2] = 255
    expected = vary_motion(Numbers(), point, 2.9)[..., 0]
    given = {"motion": jnp.float32(numbers), "blur": jnp.zeros(1)}
    kernel = varying._draw_kernel(given, Variation(motion=2.9))
    np.testing.assert_allclose(255 * kernel, expected, atol=0.51)


def test_a_stream_yields_the_batches_of_its_seed(scenes):
    draw = partial(stream_views, 7, scenes, 4, camera=CAMERA, variation=NOISY)
    stream = draw()
    first, second = next(stream), next(stream)
    key = jax.random.fold_in(seed_key(7), 1)
    expected = views(key, scenes, 4, camera=CAMERA, variation=NOISY)
    jax.tree.map(np.testing.assert_array_equal, second, expected)
    jax.tree.map(np.testing.assert_array_equal, second, next(draw(first=1)))
    assert (np.asarray(first.images) != np.asarray(second.images)).any()
    assert np.asarray(first.images).ctypes.data == first.images.unsafe_buffer_pointer()
    assert np.from_dlpack(first.images).ctypes.data == first.images.unsafe_buffer_pointer()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"batch": 0}, "batch: expected a whole number, 1 or more, got 0"),
        ({"samples": 5}, "samples: expected a whole number, 1 to 4, got 5"),
        ({"scenes": 3}, "scenes: expected Scenes, got 3"),
        ({"key": 3}, "key: expected a jax.random.key, got 3"),
        ({"camera": Camera(distortion=(0.1, 0))}, r"camera: expected no distortion, .*, got \(0.1, 0.0\)"),
        (
            {"camera": Camera(sky=np.zeros(2))},
            r"sky: expected a tuple of red, green and blue, got array\(\[0., 0.\]\)",
        ),
        ({"variation": None}, "variation: expected Variation, got None"),
        ({"variation": Variation(noise=np.zeros(3))}, r"noise: expected a number or an array \[2\], got shape \(3,\)"),
    ],
)
def test_bad_arguments_are_named(scenes, arguments, message):
    with pytest.raises(InputError, match=f"^{message}$"):
        views(**{"key": jax.random.key(0), "scenes": scenes, "batch": 2} | arguments)
    if "key" not in arguments:
        with pytest.raises(InputError, match=f"^{message}$"):
            stream_views(**{"seed": 0, "scenes": scenes, "batch": 2} | arguments)


def test_scenes_are_made_where_transfers_are_forbidden():
    with jax.transfer_guard("disallow"):
        scenes = make_scenes([[[6, 3], [12, 9]]], tile_px=16)
    assert scenes.maps.codes.shape == (1, 4, 4)


@pytest.mark.parametrize(
    ("maps", "options", "message"),
    [
        ([], {}, "maps: expected one or more, got none"),
        ([[[6, 3], [12, 9]], [[0, 0], [0, 0]]], {}, r"maps\[1\]: expected a map with a lane, got .*"),
        ([[[6, 3], [12, 9]]], {"tile_px": 96}, "tile_px: expected 16, 32, 64, 128, 256 or 512, got 96"),
        ([[[6, 3], [12, 9]]], {"tiles": "folder"}, "tiles: expected TileSet, got 'folder'"),
    ],
)
@pytest.mark.usefixtures("any_types")
def test_bad_scenes_are_named(maps, options, message):
    with pytest.raises(InputError, match=f"^{message}$"):
        make_scenes(maps, **options)
    with pytest.raises(InputError, match="^noise: expected a number, 0 to 64, got 65$"):
        Variation(noise=65)
