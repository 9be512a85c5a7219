"""Views from a robot: the lanes' own figures, a slow renderer of the ground, and datasets to the same bytes."""

import os
import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drive.driving_oracle import polyline_errors
from given_maps import random_maps
from ground_oracle import matrix_of, points_of, see, see_labels
from pages import blocks
from refusals import refused

from elitelanes_jax.dataset import _views_from_robots as robots
from elitelanes_jax.dataset import make as dataset_make
from elitelanes_jax.dataset._samples import SampleSettings
from elitelanes_jax.dataset._sampling import draw_sample, make_drawer
from elitelanes_jax.dataset._transforms import VARIED, Transforms
from elitelanes_jax.dataset.make import make_dataset
from elitelanes_jax.dataset.spec import DatasetSpec
from elitelanes_jax.drive._camera import rays_of
from elitelanes_jax.drive._objects import make_objects, touches
from elitelanes_jax.drive.camera_options import LaneCamera, sees_ground
from elitelanes_jax.drive.lanes import Pose, lane_curvature, lane_errors, lane_pose
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.maps.furnishing.placing import furnish
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.object_set import load_objects
from elitelanes_jax.tiles.packed import Pictures
from elitelanes_jax.tiles.rendering import render
from elitelanes_jax.tiles.tileset import own_tiles

TOWN = np.array([[6, 5, 7, 3], [10, 0, 10, 10], [14, 5, 15, 11], [12, 5, 13, 9]], np.int8)
SMALL = LaneCamera(rows=48, columns=64)
TINY = LaneCamera(rows=16, columns=16)
PX = 64


def draw(count, camera=TINY, codes=TOWN, tiles=None, objects=(), object_set=None, tile_px=16, transforms=Transforms()):
    """Draws samples of one map, in batches, as a dataset does."""
    road_map = RoadMap(codes, objects=objects)
    settings = SampleSettings(Pictures(tiles or own_tiles(), object_set), 0, tile_px, transforms, camera)
    drawer, samples = make_drawer(settings, [road_map]), []
    for first in range(0, count, drawer.at_once):
        indices = range(first, min(count, first + drawer.at_once))
        samples += drawer.draw([road_map] * len(indices), indices)
    return samples


def records(*arguments, **options):
    return [sample.record for sample in draw(*arguments, **options)]


def test_offset_heading_and_curvature_are_those_of_the_lane():
    abouts = records(300)
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
    others = [about["nearest"]["d"] != pytest.approx(about["d"], abs=1e-6) for about in abouts]
    assert 0.1 < np.mean(others) < 0.5
    turns, counts = np.unique(movement.turn, return_counts=True)
    assert turns.tolist() == [0, 1, 2] and counts.min() > 50


def test_poses_are_on_the_lanes_of_the_set(drawn_tiles):
    """`d` and `phi` against the oracle's polylines with another offset; the tile set hands it to the sample."""
    tiles = replace(drawn_tiles, lane_offset=0.21)
    for about in records(32, tiles=tiles):
        x, y, theta = (about["pose"][name] for name in ("x", "y", "theta"))
        row, column, heading, turn = about["movement"].values()
        d, phi, _ = polyline_errors(np.array([[x - column, y - row]]), np.array([theta]), heading, turn, 0.21)
        assert (d, phi) == (pytest.approx(about["d"], abs=1e-4), pytest.approx(about["phi"], abs=1e-3))
        assert about["curvature"] == pytest.approx([-1 / 0.29, 0, 1 / 0.71][turn])
        nearest = lane_pose(TOWN, Pose(*np.float32([x, y, theta])), lane_offset=0.21)
        assert about["nearest"]["d"] == pytest.approx(float(nearest.d), abs=1e-5)
    here, there = (records(1, tiles=one)[0] for one in (drawn_tiles, tiles))
    assert here["d"] == there["d"] and here["movement"] == there["movement"]
    apart = np.hypot(here["pose"]["x"] - there["pose"]["x"], here["pose"]["y"] - there["pose"]["y"])
    assert 0.009 < apart < 0.02


def seen_by_hand(record, tiles, camera, finer):
    """The picture and the labels of a record, by the slow renderer."""
    names = [tile.name for tile in tiles.pictures]
    chosen = np.stack([[[names.index(name) for name in row] for row in record["tiles"]], record["quarter_turns"]], -1)
    picture = render(np.array(record["codes"]), tiles, tile_px=PX, chosen=chosen)
    drawn, size = record["camera"], tuple(record["pixels"])
    place = tuple(record["pose"].values()), drawn, size, PX
    distortion = drawn.get("distortion")
    labels, _ = see_labels(picture.labels, points_of(*place, 1, drawn["lines"], distortion))
    # The sky is left out, whose colours vary from row to row.
    points = points_of(*place, finer, drawn["lines"], distortion)
    return see(picture.image, points, finer, GROUND, (-1000, -1000, -1000)), labels


@pytest.mark.parametrize(
    ("options", "blend"),
    [({}, False), ({"lines": 0.07}, True), ({"distortion": (-0.2, 0.03)}, False), ({"pitch": 60, "height": 0.4}, True)],
)
def test_pictures_and_labels_are_those_of_the_rendered_map(options, blend, drawn_tiles):
    """Near and far, upright and from above, with shifted lines, a lens, and photographs that are blended."""
    tiles = drawn_tiles
    if blend:
        tiles = replace(tiles, blend=True, tiles=tuple(map(darkened, range(99), tiles.tiles)))
    camera = replace(SMALL, **options)
    same, away = [], []
    for sample in draw(12, camera, tiles=tiles, tile_px=PX):
        image, labels = seen_by_hand(sample.record, tiles, camera, 6)
        same.append(labels == sample.layers["labels"])
        ground = image.min(axis=-1) >= 0
        away.append(np.abs(image - sample.layers["image"])[ground])
    assert np.mean(same) > 0.999
    away = np.concatenate(away)
    assert np.mean(away) < 2 and np.mean(away.max(axis=-1) <= 16) > 0.95


def darkened(number, tile):
    """A tile in a light of its own, which differs along one side."""
    light = np.linspace(0.6 + 0.05 * (number % 4), 1, tile.image.shape[1])[:, None]
    return tile._replace(image=np.rint(tile.image * light).astype(np.uint8))


def test_a_place_of_the_map_is_where_its_pixel_is():
    """The matrix of the metadata against the oracle's."""
    for about in records(12, SMALL, tile_px=PX):
        matrix = matrix_of(tuple(about["pose"].values()), about["camera"], (48, 64), PX)
        np.testing.assert_allclose(about["transform"]["matrix"], matrix, atol=1e-4 * np.abs(matrix).max())


def test_a_picture_that_is_larger_than_its_tiles_is_smooth(drawn_tiles):
    """A row close by shows each pixel of a tile several times, but few neighbours are equal."""
    rng = np.random.default_rng(0)
    noisy = [one._replace(image=rng.integers(0, 256, one.image.shape, np.uint8)) for one in drawn_tiles.tiles]
    tiles = replace(drawn_tiles, tiles=tuple(noisy))
    (sample,) = draw(1, LaneCamera(rows=480, columns=640, wobble=0), tiles=tiles, tile_px=128)
    row = sample.layers["image"][-1].astype(int)
    assert (np.diff(row, axis=0) != 0).any(axis=1).mean() > 0.6
    assert np.abs(np.diff(row, axis=0)).mean() < np.abs(np.diff(row[::16], axis=0)).mean() / 4


def test_lines_move_outwards():
    drawn = [about["camera"]["lines"] for about in records(32, replace(TINY, lines=0.05))]
    assert 0.03 < max(drawn) <= 0.05 and -0.05 <= min(drawn) < -0.03
    assert records(1)[0]["camera"]["lines"] == 0


def test_a_camera_has_its_own_positions(drawn_tiles):
    for transforms, name in (({"rotation": 20}, "rotation"), ({"quarter_turns": True}, "quarter-turns")):
        with refused("transforms", name, expected="camera"):
            draw_sample(RoadMap(TOWN), drawn_tiles, 0, camera=SMALL, transforms=transforms)


@pytest.mark.parametrize(
    "transforms", [pytest.param(VARIED, marks=pytest.mark.slow), VARIED.replace(blur=3, motion=12)]
)
def test_a_view_has_the_same_bits_in_each_batch(transforms, drawn_tiles):
    """Alone, among others, at another place of the batch, and of a map that is filled up to a larger one."""
    objects = furnish(TOWN, "all").objects
    options = {"camera": replace(SMALL, lines=0.05), "objects": objects, "object_set": load_objects(), "tile_px": 32}
    samples = draw(20, **options, transforms=transforms)
    road_map = RoadMap(TOWN, objects=objects)
    alone = draw_sample(
        *(road_map, drawn_tiles, 13),
        **{"tile_px": 32, "transforms": transforms, "camera": options["camera"], "objects": options["object_set"]},
    )
    settings = SampleSettings(Pictures(drawn_tiles, options["object_set"]), 0, 32, transforms, options["camera"])
    larger = RoadMap(np.pad(TOWN, (0, 9)), objects=furnish(TOWN, "all", seed=5).objects * 3)
    drawer = make_drawer(settings, [road_map, larger])
    _, moved, _ = drawer.draw([larger, road_map, larger], [40, 13, 2])
    for sample in (alone, moved):
        assert sample.record == samples[13].record
        for layer, pixels in sample.layers.items():
            np.testing.assert_array_equal(pixels, samples[13].layers[layer])


@pytest.mark.slow
def test_a_dataset_has_the_same_bytes_with_any_number_of_processor_cores(tmp_path):
    program = (
        "import os, sys; os.sched_setaffinity(0, set(range(int(sys.argv[1]))));"
        "import numpy as np; from elitelanes_jax import DatasetSpec, make_dataset;"
        "from tests.given_maps import random_maps;"
        "make_dataset(DatasetSpec(maps_from=random_maps(4), views=9, camera=['rows=120', 'columns=160', 'lines=0.07'],"
        "transforms='varied', furnish='all', split=(1, 0, 0)), sys.argv[2])"
    )
    out = []
    for cores, threads in ((1, "1"), (len(os.sched_getaffinity(0)), "2"), (1, "8")):
        out.append(tmp_path / f"{cores}-{threads}")
        environment = {**os.environ, "NPROC": threads, "PYTHONPATH": os.pathsep.join([".", "tests"])}
        subprocess.run([sys.executable, "-c", program, str(cores), out[-1]], check=True, env=environment)
    for other in out[1:]:
        assert tree_of(other) == tree_of(out[0])


def tree_of(folder):
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_the_sky_has_more_than_one_colour():
    """One of four horizons, which changes towards the upper edge."""
    skies = set()
    for sample in draw(32, replace(SMALL, pitch=0, wobble=0)):
        upper, lower = sample.layers["image"][0, 0], sample.layers["image"][20, 0]
        skies.add(tuple(sample.record["camera"]["sky"]))
        assert (np.abs(upper.astype(int) - lower) <= 60).all()
        assert sample.layers["labels"][:20].max() == 0
        assert len(np.unique(sample.layers["image"][:20, 0], axis=0)) > 4
    assert skies == {(115, 210, 255), (165, 150, 125), (40, 40, 40), (235, 235, 235)}


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
    things = [MapObject("floor_tag", 1.4, 1.6, 0.0, 0.0), MapObject("cone", 1.4, 1.6, 0.0, 0.3)] * 2
    seen = []
    for about in records(64, SMALL, objects=things, object_set=load_objects()):
        order = [one["instance"] for one in about["objects"]]
        assert 1 not in order and order == [number for number in (3, 2, 4) if number in order]
        seen += order
    assert {3, 4} <= set(seen)


def test_a_map_without_lanes_has_no_view():
    with refused("maps", "a map without any"):
        draw(1, codes=np.array([[4, 1], [0, 0]], np.int8))


def test_a_camera_looks_straight_down_at_most():
    steep = replace(TINY, pitch=80, field_of_view=170, wobble=0.5)
    cameras = [about["camera"] for about in records(32, steep)]
    assert max(camera["pitch"] for camera in cameras) == 90
    assert max(camera["field_of_view"] for camera in cameras) == 175


def test_the_robot_touches_no_object():
    """As `LaneDrive` finds. Poses that touch no object are those of the map without objects, to the bit."""
    things = (*furnish(TOWN, "lane_robots=4 lane_duckies=4").objects, MapObject("floor_tag", 1.5, 0.7, 0.0, 0.0))
    objects = jax.tree.map(lambda part: part[0], make_objects([RoadMap(TOWN, objects=things)]))
    touching = jax.jit(lambda pose: touches(objects, pose, pose, 0.075))
    moved = 0
    for plain, drawn in zip(records(192), records(192, objects=things, object_set=load_objects()), strict=True):
        assert not touching(Pose(**drawn["pose"]))
        if touching(Pose(**plain["pose"])):
            moved += 1
            assert drawn["camera"] == plain["camera"]
        else:
            assert all(drawn[name] == plain[name] for name in ("pose", "nearest", "camera", "transform"))
    assert 10 < moved < 182


def test_a_map_full_of_objects_has_views():
    full = [MapObject("building", column + 0.5, row + 0.5, 0.0, 1.0) for row in range(4) for column in range(4)]
    (drawn,) = records(1, objects=full, object_set=load_objects())
    assert drawn["pose"] != records(1)[0]["pose"]


def test_a_map_has_at_most_as_many_objects_as_masks_can_number(monkeypatch):
    monkeypatch.setattr(robots, "_MOST_OBJECTS", 70)
    things = [MapObject("cone", 0.1, 0.1, 0.0, 0.1)] * 71
    with refused("objects", "71", expected="at most 70"):
        draw(1, objects=things, object_set=load_objects())
    assert draw(1, objects=things[1:], object_set=load_objects())


def test_a_camera_may_not_be_an_array():
    with refused("camera: pitch", "array([3.])"):
        DatasetSpec(camera={"pitch": np.array([3.0])})


def test_a_camera_that_never_sees_the_ground_is_known():
    drawn = np.random.default_rng(0)
    blind = 0
    for _ in range(40):
        is_bent = drawn.uniform() < 0.5
        options = {
            "rows": 64,
            "columns": 96,
            "pitch": drawn.uniform(-90, -10),
            "field_of_view": drawn.uniform(20, 120),
            "distortion": (*drawn.uniform(-0.3, 0.1, 2),) if is_bent else None,
            "wobble": 0,
        }
        camera = LaneCamera(**options)
        falls = bool((rays_of(camera, samples=2).fall > 0).any())
        if sees_ground(camera):
            # The limit for lenses is not exact, and the last ray is within the lowest row.
            assert falls or is_bent or camera.pitch + camera.field_of_view / 2 < 1
        else:
            assert not falls
            blind += 1
    assert 5 < blind < 35
    # A wobble of a tenth turns the camera up to 4 degrees, and widens its view by 4 degrees on each side.
    level = LaneCamera(pitch=-40, field_of_view=75, wobble=0.01)
    assert not sees_ground(level) and sees_ground(level.replace(wobble=0.1))


def test_a_dataset_of_the_sky_says_so(tmp_path, monkeypatch):
    lines = []
    monkeypatch.setattr(dataset_make, "announce", lines.append)
    options = {"maps_from": [RoadMap([[6, 3], [12, 9]])], "split": (1, 0, 0), "tile_px": 16}
    for pitch in (19, -89):
        make_dataset(DatasetSpec(camera={"pitch": pitch, "rows": 16, "columns": 16}, **options), tmp_path / str(pitch))
    assert sum("no picture shows the road" in line for line in lines) == 1 and "above the horizon" in lines[-1]


def test_the_index_of_a_sample_is_a_number(drawn_tiles):
    """A text was written to the metadata as it was."""
    one, other = (draw_sample(RoadMap(TOWN), drawn_tiles, index, tile_px=16).record for index in ("3", 3))
    assert one == other and one["number"] == 3
