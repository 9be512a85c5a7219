"""Views in JAX: against slow oracles of the ground, and of what varies."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import views_oracle
from driving_oracle import drawn_maps
from ground_oracle import matrix_of, points_of, see, see_labels
from refusals import refused
from standing_oracle import draw_back_to_front

from elitelanes_jax import RoadMap, read_map, render
from elitelanes_jax.dataset import _transforms
from elitelanes_jax.dataset._variation import vary_motion
from elitelanes_jax.drive import Camera, Pose, Variation, lane_pose, make_scenes, stream_views, views
from elitelanes_jax.drive import _variation as varying
from elitelanes_jax.drive import view_drawing as drawing
from elitelanes_jax.drive._ground import meet_ground, take_points
from elitelanes_jax.drive._view_plans import plan_views
from elitelanes_jax.drive.camera_options import LaneCamera
from elitelanes_jax.drive.lanes import lane_errors
from elitelanes_jax.drive.robot import TILE, Robot
from elitelanes_jax.formats import MapObject
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.maps import furnish
from elitelanes_jax.network.bits import seed_key
from elitelanes_jax.tiles import load_objects
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.object_set import lay_flat
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


planned = jax.jit(partial(plan_views, samples=2))


def plans_of(key, scenes, count, camera=CAMERA, variation=BARE):
    """The numbers of a batch's views."""
    return jax.device_get(planned(key, jnp.arange(count), scenes, camera, variation))


def ground_of(plan, finer):
    """Where points of a planned view's pixels meet the ground, in pixels of the map."""
    camera = plan.camera
    drawn = {name: float(getattr(camera, name)) for name in ("height", "forward", "pitch", "field_of_view")}
    lines = 0.0 if plan.lines is None else float(plan.lines) / 2**20
    pose, size = tuple(map(float, plan.pose)), (camera.rows, camera.columns)
    points = points_of(pose, drawn, size, TILE_PX, finer, lines, camera.distortion)
    return points, matrix_of(pose, drawn, size, TILE_PX), drawn


@pytest.mark.parametrize("columns", [1, 3, 4])
def test_the_middle_of_a_picture_is_straight_ahead(columns):
    pose, camera = Pose(*jnp.array([0.5, 0.25, 0.0])), Camera(rows=3, columns=columns)
    rows = meet_ground(pose, camera, (16, 8, 4, 2, 1), 1, smaller=False)
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


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, marks=pytest.mark.slow),
        {"lines": 0.07},
        pytest.param({"distortion": (-0.2, 0.03)}, marks=pytest.mark.slow),
    ],
)
def test_views_are_those_of_the_rendered_map(grids, scenes, drawn_tiles, options):
    camera, variation = (
        Camera(rows=60, columns=80, distortion=options.get("distortion")),
        Variation(lines=options.get("lines")),
    )
    seen = jax.device_get(views(jax.random.key(1), scenes, 12, camera=camera, variation=variation))
    plans = plans_of(jax.random.key(1), scenes, 12, camera, variation)
    same, difference = [], []
    for index in range(12):
        plan = jax.tree.map(lambda part, index=index: part[index], plans)
        grid = grids[plan.map]
        cells = plan.cells.reshape(scenes.maps.codes.shape[1:])[1 : grid.shape[0] + 1, 1 : grid.shape[1] + 1]
        picture = render(grid, drawn_tiles, tile_px=TILE_PX, chosen=np.stack(np.divmod(cells, 4), axis=-1))
        same.append(see_labels(picture.labels, ground_of(plan, 1)[0])[0] == seen.labels[index])
        expected = see(picture.image, ground_of(plan, 4)[0], 4, GROUND, camera.sky)
        difference.append(np.abs(expected - seen.images[index]))
    assert len(np.unique(seen.maps)) == 2
    assert np.mean(same) > 0.999
    assert np.mean(difference) < 1.6 and np.mean(np.max(difference, axis=-1) <= 16) > 0.95


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
    centre, _ = take_points(plan.centres, plan.lines, plan.camera.columns)
    sums = drawing._sum_samples(plan, scenes, 2, drawing._find_objects(plan, scenes, 2, plan.samples), centre, None)
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
    draw = partial(drawing._draw_view, crowded)
    each, at_once = (jax.jit(way)(plans) for way in (partial(jax.lax.map, draw), jax.vmap(draw)))
    np.testing.assert_array_equal(each.instances, at_once.instances)
    colours = [np.asarray(drawn.words).view(np.uint8).astype(int) for drawn in (each, at_once)]
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
        np.testing.assert_allclose(plans.lane[index, :2], (lane.d, lane.phi), atol=1e-5)
        own = Movement(*(part[index] for part in plans.movement))
        errors = lane_errors(pose, own, 0.15)
        np.testing.assert_allclose(plans.errors[index, :2], errors[:2], atol=1e-5)
        curvatures |= {round(float(curvature), 4) for curvature in (plans.lane[index, 2], plans.errors[index, 2])}
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
def test_objects_have_the_masks_and_the_pictures_of_slow_renderers(drawn_tiles):
    grid, objects, camera = np.array([[6, 7, 3], [12, 13, 9]], np.int8), load_objects(), Camera(rows=60, columns=80)
    oblong = [one if one.height else replace(one, footprint=(0.12, 0.05)) for one in objects.pictures]
    objects = replace(objects, pictures=tuple(oblong))
    spots = [(0.15, 0.2), (0.8, 0.75), (1.5, 0.05), (1.1, 0.9), (2.8, 0.2), (2.2, 0.8), (1.8, 1.9)]
    lying = [(0.5, 0.3), (0.3, 1.0), (1.5, 1.5), (1.5, 0.45), (2.7, 1.0), (2.6, 1.6)]
    things = [MapObject("duckie", x, y, 2 * x, 0.09) for x, y in spots]
    things += [MapObject("sign_stop", 1.95, 0.02, 2.0, 0.2, tag) for tag in (24, 25)]
    standing = len(things)
    things += [MapObject("floor_tag", x, y, 2 * x - 3 * y, 0.0, 300 + number) for number, (x, y) in enumerate(lying)]
    scenes = make_scenes(RoadMap(grid, objects=things), tile_px=TILE_PX, objects=objects)
    seen = jax.device_get(views(jax.random.key(4), scenes, 16, camera=camera))
    plans = plans_of(jax.random.key(4), scenes, 16, camera)
    choices, first = [objects.choices(thing) for thing in things], np.asarray(scenes.maps.choices)[0, :, 0]
    same, colours, shown = [], [], set()
    for index in range(16):
        plan = jax.tree.map(lambda part, index=index: part[index], plans)
        _, matrix, drawn = ground_of(plan, 1)
        pictures = [choice[plan.pictures[i] - first[i]] for i, choice in enumerate(choices)]
        layer = {"image": np.zeros((60, 80, 3), np.uint8)}
        flat = [lay_flat(things[i], pictures[i], TILE_PX) for i in range(standing, len(things))]
        flat = [item._replace(matrix=matrix @ item.matrix) for item in flat]
        lies, _ = paste_objects(layer, flat, range(standing, len(things)), 0.02)
        upright = [thing._replace(kind=i) for i, thing in enumerate(things[:standing])]
        stands, painted = draw_back_to_front(
            upright, {i: one.views for i, one in enumerate(pictures)}, plan.pose, drawn | {"rows": 60, "columns": 80}
        )
        owners = np.where(stands, stands, lies)
        same.append(owners == seen.instances[index])
        inside = (stands > 0) & (stands <= len(spots)) & same[-1]
        colours.append(np.abs(painted[inside].astype(int) - seen.images[index][inside]).mean(axis=-1))
        shown |= set(np.unique(seen.instances[index]).tolist())
        assert (seen.labels[index][owners > 0][same[-1][owners > 0]] == 0).all()
    assert np.mean(same) > 0.99
    assert np.median(np.concatenate(colours)) < 25  # a mean of four points against one
    assert {len(set(column)) for column in plans.pictures.T} <= {1, 3, 4}
    assert set((plans.pictures - first)[:, 0]) == {0, 1, 2, 3}
    assert shown > set(range(10, 16)) and len(shown) > 12


def test_any_number_of_objects_is_shown_from_back_to_front():
    """Twenty cones in a row: with room for eight, the nearest ones; without a limit, all, the same in groups."""
    grid = np.array([[0, 0, 0], [6, 5, 3], [12, 5, 9]], np.int8)
    cones = [MapObject("cone", 0.05 + 0.1 * number, 0.5, 0.0, 0.4) for number in range(20)]
    scenes = make_scenes(RoadMap(grid, objects=cones), tile_px=16)
    drawn = {
        count: jax.device_get(views(jax.random.key(1), scenes, 12, camera=CAMERA.replace(objects=count)))
        for count in (8, 20, None)
    }
    np.testing.assert_array_equal(drawn[20].instances, drawn[None].instances)
    np.testing.assert_array_equal(drawn[20].images, drawn[None].images)
    seen = drawn[None].instances
    limited = drawn[8].instances
    assert max(len(np.unique(view)) for view in seen) > 9
    np.testing.assert_array_equal(seen[limited > 0], limited[limited > 0])


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


def test_the_ranges_are_those_of_datasets():
    for name, value in Variation.varied().values().items():
        if hasattr(_transforms.VARIED, name):
            assert value == getattr(_transforms.VARIED, name)
        elif hasattr(LaneCamera(), name):
            assert value == getattr(LaneCamera(), name)
        else:
            assert (name, value) in (("horizon", 1), ("haze", None))


def test_the_haze_falls_from_the_upper_edge_to_the_horizon(scenes):
    camera = Camera(rows=60, columns=8, sky=(128.0, 128.0, 128.0))
    plain, hazy = (
        jax.device_get(views(jax.random.key(3), scenes, 8, camera=camera, variation=Variation(haze=haze, wobble=0)))
        for haze in (None, 60)
    )
    change = hazy.images.astype(int) - plain.images
    sky = (plain.images == 128).all(axis=(2, 3)).sum(axis=1)
    assert (sky == sky[0]).all() and sky[0] > 8
    assert (change[:, sky[0] + 1 :] == 0).all()
    column = change[:, : sky[0], 0]
    assert (np.abs(column).max(axis=(0, 1)) > 20).all() and np.abs(column).max() <= 60
    assert (np.diff(np.abs(column), axis=1) <= 1).all() and (np.abs(column[:, -1]) <= 5).all()


@pytest.mark.parametrize("numbers", [(0.7, 0.2), (1.0, 0.75), (0.1, 0.5)])
def test_streaks_of_motion_are_those_of_datasets(numbers):
    class Numbers:
        def uniform(self, low, high):
            return low + (high - low) * draws.pop(0)

    draws, point = list(numbers), np.zeros((5, 5, 3), np.uint8)
    point[2, 2] = 255
    expected = vary_motion(Numbers(), point, 2.9)[..., 0]
    kernel = varying._draw_kernel(jnp.float32(numbers), jnp.float32(0), Variation(motion=2.9))
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
    ("arguments", "subject", "got"),
    [
        ({"batch": 0}, "batch", "0"),
        ({"samples": 5}, "samples", "5"),
        ({"scenes": 3}, "scenes", "3"),
        ({"key": 3}, "key", "3"),
        (
            {"camera": Camera(sky=np.zeros(2))},
            "sky",
            "array([0., 0.])",
        ),
        ({"variation": None}, "variation", "None"),
        ({"variation": Variation(noise=np.zeros(3))}, "noise", "shape (3,)"),
    ],
)
def test_bad_arguments_are_named(scenes, arguments, subject, got):
    with refused(subject, got):
        views(**{"key": jax.random.key(0), "scenes": scenes, "batch": 2} | arguments)
    if "key" not in arguments:
        with refused(subject, got):
            stream_views(**{"seed": 0, "scenes": scenes, "batch": 2} | arguments)


def test_scenes_are_made_where_transfers_are_forbidden():
    with jax.transfer_guard("disallow"):
        scenes = make_scenes([[[6, 3], [12, 9]]], tile_px=16)
    assert scenes.maps.codes.shape == (1, 4, 4)


@pytest.mark.parametrize(
    ("maps", "options", "subject", "got", "expected"),
    [
        ([], {}, "maps", "none", "one or more"),
        ([[[6, 3], [12, 9]], [[0, 0], [0, 0]]], {}, "maps[1]", "one without any movement", ""),
        ([[[6, 3], [12, 9]]], {"tile_px": 8}, "tile_px", "8", ""),
        ([[[6, 3], [12, 9]]], {"tiles": "folder"}, "tiles", "'folder'", "TileSet"),
    ],
)
@pytest.mark.usefixtures("any_types")
def test_bad_scenes_are_named(maps, options, subject, got, expected):
    with refused(subject, got, expected):
        make_scenes(maps, **options)
    with refused("noise", "65"):
        Variation(noise=65)
