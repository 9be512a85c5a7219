"""Views from a robot: the lanes' own figures, the camera of the environments, and datasets to the same bytes."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drive.driving_oracle import polyline_errors
from given_maps import random_maps
from pages import blocks

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.dataset._robot_views import draw_viewpoint, find_rays, place_objects, see, see_labels
from elitelanes_jax.dataset._samples import draw_sample
from elitelanes_jax.dataset._tiled_maps import TiledMap, can_tile, see_tiled_labels
from elitelanes_jax.dataset._transforms import Viewpoints
from elitelanes_jax.dataset.make import make_dataset
from elitelanes_jax.dataset.spec import DatasetSpec
from elitelanes_jax.drive import Camera, look, make_sight
from elitelanes_jax.drive._objects import make_objects, touches
from elitelanes_jax.drive.lanes import Pose, lane_curvature, lane_errors, lane_pose
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.lanes.curves import LANE_OFFSET
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.maps.furnishing.placing import furnish
from elitelanes_jax.tiles.object_set import load_objects
from elitelanes_jax.tiles.rendering import choose_tiles, render, show_paved

TOWN = np.array([[6, 5, 7, 3], [10, 0, 10, 10], [14, 5, 15, 11], [12, 5, 13, 9]], np.int8)
SMALL = Viewpoints(rows=48, columns=64)
PX = 64


def viewpoints(count, settings=SMALL, codes=TOWN, lane_offset=LANE_OFFSET):
    seeds = map(np.random.default_rng, range(count))
    return [draw_viewpoint(rng, settings, codes, PX, lane_offset=lane_offset) for rng in seeds]


def test_offset_heading_and_curvature_are_those_of_the_lane():
    drawn = viewpoints(300)
    abouts = [viewpoint.about for viewpoint in drawn]
    pose = Pose(*(jnp.array([about["pose"][name] for about in abouts], jnp.float32) for name in Pose._fields))
    names = Movement._fields
    movement = Movement(*(jnp.array([about["movement"][name] for about in abouts]) for name in names))
    d, phi, _ = lane_errors(pose, movement)
    np.testing.assert_allclose(d, [about["d"] for about in abouts], atol=1e-5)
    np.testing.assert_allclose(phi, [about["phi"] for about in abouts], atol=1e-5)
    np.testing.assert_allclose(lane_curvature(movement.turn), [about["curvature"] for about in abouts], rtol=1e-6)
    where = jax.vmap(lambda pose, movement: lane_pose(TOWN, pose, movement))(pose, movement)
    assert where.found.all() and where.own_lane.all()
    assert np.abs(d).max() < 0.1001 and np.abs(phi).max() < np.radians(30.01)
    near = jax.vmap(lambda pose: lane_pose(TOWN, pose))(pose)
    for name, values in (("d", near.d), ("phi", near.phi), ("curvature", lane_curvature(near.movement.turn))):
        np.testing.assert_allclose(values, [about["nearest"][name] for about in abouts], atol=1e-5)
    others = [about["nearest"]["d"] != pytest.approx(about["d"]) for about in abouts]
    assert 0.1 < np.mean(others) < 0.5
    turns, counts = np.unique(movement.turn, return_counts=True)
    assert turns.tolist() == [0, 1, 2] and counts.min() > 50


def test_poses_are_on_the_lanes_of_the_set():
    """`d` and `phi` against the oracle's polylines with another offset; the tile set hands it to the sample."""
    for viewpoint in viewpoints(40, lane_offset=0.21):
        about = viewpoint.about
        x, y, theta = (about["pose"][name] for name in ("x", "y", "theta"))
        row, column, heading, turn = about["movement"].values()
        d, phi, _ = polyline_errors(np.array([[x - column, y - row]]), np.array([theta]), heading, turn, 0.21)
        assert (d, phi) == (pytest.approx(about["d"], abs=1e-4), pytest.approx(about["phi"], abs=1e-3))
        assert about["curvature"] == pytest.approx([-1 / 0.29, 0, 1 / 0.71][turn])
        nearest = lane_pose(TOWN, Pose(*np.float32([x, y, theta])), lane_offset=0.21)
        assert about["nearest"]["d"] == pytest.approx(float(nearest.d), abs=1e-5)


def test_a_sample_follows_the_lanes_of_its_tiles(drawn_tiles):
    tiles = replace(drawn_tiles, lane_offset=0.21)
    here, there = (draw_sample(RoadMap(TOWN), one, 0, camera=SMALL).record for one in (drawn_tiles, tiles))
    assert here["d"] == there["d"] and here["movement"] == there["movement"]
    apart = np.hypot(here["pose"]["x"] - there["pose"]["x"], here["pose"]["y"] - there["pose"]["y"])
    assert 0.009 < apart < 0.02


def test_labels_and_pictures_are_those_of_the_environments_camera(drawn_tiles):
    chosen = choose_tiles(TOWN, drawn_tiles, 3)
    picture = render(TOWN, drawn_tiles, tile_px=PX, chosen=chosen)
    sight = make_sight(drawn_tiles, tile_px=PX)
    looking = jax.jit(lambda pose, camera: look(pose, TOWN, sight._replace(camera=camera), chosen=chosen))
    ground = tuple(drawn_tiles.pictures[-1].image[0, 0].tolist())
    same, away = [], []
    for viewpoint in viewpoints(30):
        seen = dict(viewpoint.about["camera"])
        sky, forward = tuple(map(float, seen.pop("sky"))), seen.pop("forward")
        camera = Camera(**{name: jnp.float32(value) for name, value in seen.items()}, forward=forward, sky=sky)
        pose = Pose(*(jnp.float32(part) for part in viewpoint.about["pose"].values()))
        view = looking(pose, camera)
        labels = see_labels(picture.labels, viewpoint)
        same.append((labels == np.asarray(view.labels)).mean())
        away.append(np.abs(see(picture.image, viewpoint, ground).astype(int) - np.asarray(view.image)).mean())
    assert np.mean(same) >= 0.995
    assert np.mean(away) < 6  # one averages, the other takes the nearest pixel


@pytest.mark.parametrize("tile_px", [32, 96])
def test_the_tiles_that_are_seen_give_the_view_of_the_whole_map(tile_px, drawn_tiles):
    """Near and far, upright and from above, and with lines that are shifted."""
    assert can_tile(drawn_tiles, tile_px) and not can_tile(drawn_tiles, tile_px + 8)
    assert not can_tile(replace(drawn_tiles, blend=True), tile_px)
    rng = np.random.default_rng(tile_px)
    for number in range(24):
        settings = Viewpoints(
            **{"rows": 20 + int(rng.integers(60)), "columns": 20 + int(rng.integers(60)), "heading": 180},
            **{"pitch": rng.uniform(0, 90), "height": (0.05, 0.2, 4)[number % 3], "lines": 0.07 * (number % 2)},
        )
        viewpoint = draw_viewpoint(rng, settings, TOWN, tile_px)
        chosen = choose_tiles(TOWN, drawn_tiles, number)
        whole = render(TOWN, drawn_tiles, tile_px=tile_px, chosen=chosen)
        paved = show_paved(drawn_tiles, chosen, tile_px).astype(np.uint8)
        tiled = TiledMap(drawn_tiles, tile_px, chosen[..., 0] * 4 + chosen[..., 1])
        np.testing.assert_array_equal(tiled.see(viewpoint, (9, 8, 7)), see(whole.image, viewpoint, (9, 8, 7)))
        seen = see_tiled_labels(tiled, find_rays(viewpoint, 1))
        np.testing.assert_array_equal(seen.labels, see_labels(whole.labels, viewpoint))
        np.testing.assert_array_equal(seen.paved, see_labels(paved, viewpoint))


def rays_by_hand(viewpoint, finer):
    """Each ray from the inverse of the viewpoint's matrix, without shifted lines."""
    rows, columns = (side * finer for side in viewpoint.size)
    u, v = (np.arange(columns) + 0.5) / finer, ((np.arange(rows) + 0.5) / finer)[:, None]
    x, y, inverse_depth = (part[0] * u + part[1] * v + part[2] for part in np.linalg.inv(viewpoint.matrix))
    near = inverse_depth > 1e-6
    depth = 1 / np.where(near, inverse_depth, 1)
    x, y = (np.clip(np.where(near, part * depth, -1e6), -1e6, 1e6).astype(np.float32) for part in (x, y))
    return x, y, near


@pytest.mark.parametrize("pitch", [0, 20, 89])
def test_rays_that_meet_the_ground_are_those_of_the_matrix(pitch):
    for viewpoint in viewpoints(8, SMALL.replace(pitch=pitch, wobble=0.3)):
        rays, (x, y, near) = find_rays(viewpoint, 2), rays_by_hand(viewpoint, 2)
        np.testing.assert_array_equal(rays.x, x[rays.sky :])
        np.testing.assert_array_equal(rays.y, y[rays.sky :])
        assert near[rays.sky :].all() and not near[: rays.sky].any()


def test_a_place_of_the_map_is_where_its_pixel_is(drawn_tiles):
    """The matrix against a marked pixel of the map, warped as labels are."""
    settings = Viewpoints(rows=240, columns=320)
    for viewpoint in viewpoints(12, settings):
        pose = viewpoint.about["pose"]
        ahead, left = 0.45, 0.1
        x = (pose["x"] + ahead * np.cos(pose["theta"]) - left * np.sin(pose["theta"])) * PX
        y = (pose["y"] - ahead * np.sin(pose["theta"]) - left * np.cos(pose["theta"])) * PX
        if not (0 <= x < 4 * PX and 0 <= y < 4 * PX):
            continue
        marked = np.zeros((4 * PX, 4 * PX), np.uint8)
        marked[int(y), int(x)] = 1
        found = np.argwhere(see_labels(marked, viewpoint))
        (across, down), *_ = cv2.perspectiveTransform(np.array([[[int(x) + 0.5, int(y) + 0.5]]]), viewpoint.matrix)[0]
        assert len(found)
        assert np.abs(found.mean(axis=0) + 0.5 - (down, across)).max() < 1.5


def make(out, workers=1, **more):
    camera, split = ["rows=24", "columns=32"], (0.5, 0.25, 0.25)
    spec = DatasetSpec(maps_from=random_maps(4), views=2, split=split, camera=camera, tile_px=32, **more)
    return make_dataset(spec, out, workers=workers)


@pytest.mark.parametrize("camera", [True, False])
@pytest.mark.parametrize("layout", ["imagefolder", "coco"])
def test_the_card_loads_arrays(layout, camera, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if camera:
        make(tmp_path / "one", format=layout)
    else:
        spec = DatasetSpec(maps_from=[TOWN], views=4, split=(1, 0, 0), tile_px=16, transforms="none", format=layout)
        make_dataset(spec, tmp_path / "one", workers=1)
    card = (tmp_path / "one" / "README.md").read_text()
    assert "gym-duckietown" not in card  # it says nothing of networks that learned from other pictures
    (program,) = [text for _, text in blocks(card, "python") if "rows" in text][-1:]
    assert len([line for line in program.splitlines() if line]) <= 9
    found = {}
    exec(program.replace("DIR", "one"), found)
    size, targets = ((24, 32), (2,)) if camera else ((64, 64), (4, 4))
    assert capsys.readouterr().out == f"4 {(*size, 3)} {size} {targets}\n"
    assert all(set(np.unique(labels)) <= {0, 1, 2, 3} for labels in found["labels"])
    if camera:
        assert [one.tolist() for one in found["poses"]] == [
            [row["nearest"]["d"], row["nearest"]["phi"]] for row in found["rows"]
        ]
        assert "less than a quarter turn away from the robot's direction" in " ".join(card.split())
        for row in found["rows"]:
            assert abs(row["nearest"]["phi"]) < np.pi / 2
            assert {"d", "phi", "curvature", "nearest", "pose", "movement", "camera", "transform"} <= set(row)
            assert row["pixels"] == [24, 32]
        assert len({tuple(row["pose"].values()) for row in found["rows"]}) == 4


def test_of_two_tags_on_one_spot_the_last_one_is_in_front():
    """As in pictures from above, and behind all that stands."""
    grid = np.array([[6, 3], [12, 9]], np.int8)
    things = [MapObject(kind, 1.0, 1.0, 0.0, height) for kind, height in (("floor_tag", 0.0), ("cone", 0.08)) * 2]
    for seed in range(20):
        viewpoint = draw_viewpoint(np.random.default_rng(seed), Viewpoints(), grid, 64)
        _, order, _ = place_objects(things, load_objects().choose(things), viewpoint, 64)
        assert order in ([0, 2], [0, 2, 1, 3])


def test_a_map_without_lanes_has_no_view():
    with pytest.raises(InputError, match="expected lanes for the camera"):
        draw_viewpoint(np.random.default_rng(0), SMALL, np.array([[4, 1], [0, 0]], np.int8), PX)


def test_a_camera_looks_straight_down_at_most():
    steep = replace(SMALL, pitch=80, field_of_view=170, wobble=0.5)
    cameras = [viewpoint.about["camera"] for viewpoint in viewpoints(20, steep)]
    assert max(camera["pitch"] for camera in cameras) == 90
    assert max(camera["field_of_view"] for camera in cameras) == 175


def test_the_robot_touches_no_object():
    """As `LaneDrive` finds. Poses that touch no object are those of the map without objects, to the bit."""
    things = (*furnish(TOWN, "lane_robots=4 lane_duckies=4").objects, MapObject("floor_tag", 1.5, 0.7, 0.0, 0.0))
    objects = jax.tree.map(lambda part: part[0], make_objects([RoadMap(TOWN, objects=things)]))
    touching = jax.jit(lambda pose: touches(objects, pose, pose, 0.075))
    moved = 0
    for number, plain in enumerate(viewpoints(200)):
        drawn = draw_viewpoint(np.random.default_rng(number), SMALL, TOWN, PX, things)
        assert not touching(Pose(**drawn.about["pose"]))
        if touching(Pose(**plain.about["pose"])):
            moved += 1
            assert drawn.about["camera"] == plain.about["camera"]
        else:
            assert drawn.about == plain.about
            np.testing.assert_array_equal(drawn.matrix, plain.matrix)
    assert 10 < moved < 190


def test_a_map_full_of_objects_has_views():
    full = [MapObject("building", column + 0.5, row + 0.5, 0.0, 1.0) for row in range(4) for column in range(4)]
    drawn = draw_viewpoint(np.random.default_rng(0), SMALL, TOWN, PX, full)
    assert drawn.about["pose"] != viewpoints(1)[0].about["pose"]


def test_the_index_of_a_sample_is_a_number(drawn_tiles):
    """A text was written to the metadata as it was."""
    one, other = (draw_sample(RoadMap(TOWN), drawn_tiles, index, tile_px=16).record for index in ("3", 3))
    assert one == other and one["number"] == 3
