"""Objects in datasets: boxes by points that are projected one by one, masks by a slow renderer, and the layouts."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from refusals import refused
from standing_oracle import TILE, TOWN, draw_back_to_front, some_objects

from elitelanes_jax import DatasetSpec, RoadMap, SearchSpec, make_dataset
from elitelanes_jax.dataset import _card, draw_sample
from elitelanes_jax.dataset.planning import plan_dataset
from elitelanes_jax.drive.camera_options import LaneCamera
from elitelanes_jax.formats import OBJECT_KINDS, MapObject
from elitelanes_jax.maps import faults
from elitelanes_jax.tiles import load_objects

PX = 32
VIEWS = LaneCamera(rows=120, columns=160)


def project_points(points, about, size):
    """Where OpenCV sees points (metres ahead of the camera, to the left, upwards): columns, rows and depths."""
    camera = about["camera"]
    focal = size[0] / 2 / np.tan(np.radians(camera["field_of_view"]) / 2)
    pitch = np.radians(camera["pitch"])
    turn = np.array([[0, -1, 0], [-np.sin(pitch), 0, -np.cos(pitch)], [np.cos(pitch), 0, -np.sin(pitch)]])
    there = (np.asarray(points) - [0, 0, camera["height"]]) @ turn.T
    lens = np.array([[focal, 0, size[1] / 2], [0, focal, size[0] / 2], [0, 0, 1.0]])
    seen, _ = cv2.projectPoints(there, np.zeros(3), np.zeros(3), lens, np.zeros(4))
    return seen[:, 0], there[:, 2]


def outline_of(thing, picture, about):
    """The corners of every opaque pixel of an object's picture, in metres ahead of the camera, left and up."""
    pose, camera = about["pose"], about["camera"]
    east, north = (thing.x - pose["x"]) * TILE, (pose["y"] - thing.y) * TILE
    ahead = east * np.cos(pose["theta"]) + north * np.sin(pose["theta"]) - camera["forward"]
    left = north * np.cos(pose["theta"]) - east * np.sin(pose["theta"])
    metre = thing.height / picture.shape[0]
    return [
        (ahead, left + (picture.shape[1] / 2 - column - right) * metre, (picture.shape[0] - row - below) * metre)
        for row, column in np.argwhere(picture[..., 3] >= 128)
        for right in (0, 1)
        for below in (0, 1)
    ]


def test_boxes_and_masks_are_those_of_projected_outlines_and_of_a_slow_renderer(drawn_tiles):
    objects, boxes = load_objects(), 0
    for number in range(3):
        road_map = RoadMap(TOWN, objects=some_objects(10, number))
        sample = draw_sample(road_map, drawn_tiles, number, tile_px=PX, camera=VIEWS, objects=objects)
        plain = draw_sample(road_map, drawn_tiles, number, tile_px=PX, camera=VIEWS)
        about, instances = sample.record, sample.layers["instances"]
        pictures = objects.choose(road_map.objects, [0, number, 2])
        views = {index: one.views for index, one in enumerate(pictures)}
        things = [replace_kind(thing, index) for index, thing in enumerate(road_map.objects)]
        camera = about["camera"] | {"rows": 120, "columns": 160}
        pose = tuple(about["pose"][name] for name in ("x", "y", "theta"))
        owners, _ = draw_back_to_front(things, views, pose, camera)
        assert (owners != instances).sum() <= 2
        hidden = instances > 0
        np.testing.assert_array_equal(sample.layers["labels"], np.where(hidden, 0, plain.layers["labels"]))
        assert {one["instance"] for one in about["objects"]} == set(np.unique(instances)) - {0}
        for one in about["objects"]:
            index, mask = one["instance"] - 1, instances == one["instance"]
            columns, rows = (np.flatnonzero(mask.any(axis=axis)) for axis in (0, 1))
            x, y, wide, high = one["box"]
            assert (x, y) == (columns[0], rows[0]) and (x + wide - 1, y + high - 1) == (columns[-1], rows[-1])
            alone, _ = draw_back_to_front([things[index]], {index: views[index]}, pose, camera)
            assert 0 < one["visible"] <= 1 and one["visible"] <= mask.sum() / (alone > 0).sum() + 1e-9
            thing = road_map.objects[index]
            there = np.hypot(thing.x - pose[0], thing.y - pose[1]) * TILE
            assert abs(one["distance"] - there) <= 0.067
            picture = view_of(pictures[index], thing, about)
            points, depth = project_points(outline_of(thing, picture, about), about, (120, 160))
            if (depth > 0.02).all():
                whole = np.array(one["whole"])
                np.testing.assert_allclose(
                    [*whole[:2], *whole[:2] + whole[2:]], [*points.min(0), *points.max(0)], atol=0.5
                )
                boxes += 1
                low, high = np.maximum(points.min(0), 0), np.minimum(points.max(0), (160, 120))
                if one["visible"] > 0.999:  # nothing hides it
                    np.testing.assert_allclose([x, y, x + wide, y + one["box"][3]], [*low, *high], atol=1.5)
    assert boxes > 3


def replace_kind(thing, kind):
    return thing._replace(kind=kind)


def view_of(pictures, thing, about):
    pose, camera = about["pose"], about["camera"]
    x = pose["x"] + camera["forward"] / TILE * np.cos(pose["theta"])
    y = pose["y"] - camera["forward"] / TILE * np.sin(pose["theta"])
    return pictures.view(np.arctan2(thing.y - y, x - thing.x) - thing.angle)


def test_a_share_is_visible_of_what_is_cut_off_or_hidden(drawn_tiles):
    drawn = draw_sample(RoadMap(TOWN), drawn_tiles, 0, tile_px=PX, camera=VIEWS).record
    x, y, theta = (drawn["pose"][name] for name in ("x", "y", "theta"))

    def at(kind, ahead, left, height):
        ahead, left = ahead / TILE, left / TILE
        east, south = ahead * np.cos(theta) - left * np.sin(theta), -ahead * np.sin(theta) - left * np.cos(theta)
        return MapObject(kind, x + east, y + south, theta + np.pi, height)

    def seen(*things):
        road_map = RoadMap(np.pad(TOWN, 0), objects=things)
        record = draw_sample(road_map, drawn_tiles, 0, tile_px=PX, camera=VIEWS, objects=load_objects()).record
        return {one["instance"]: one for one in record["objects"]}

    (tree,) = seen(at("tree", 0.5, 0, 0.1)).values()
    assert tree["visible"] == 1 and tree["distance"] == pytest.approx(0.5 - 0.066, abs=1e-6)
    both = seen(at("tree", 0.5, 0, 0.1), at("truck", 0.4, 0, 0.06))
    assert both[2]["visible"] == 1 and 0 < both[1]["visible"] < 0.8
    near = seen(at("tree", 0.2, 0, 0.25))[1]
    assert near["visible"] < 0.9 and near["whole"][1] < 0
    assert not seen(at("tree", -0.5, 0, 0.1))


def test_a_whole_object_ends_before_the_camera(drawn_tiles):
    """Looking down at the foot of a tree, whose top is behind the camera."""
    steep = replace(VIEWS, pitch=60, forward=0.3, wobble=0)
    pose = draw_sample(RoadMap(TOWN), drawn_tiles, 0, tile_px=PX, camera=steep).record["pose"]
    x, y, theta = (pose[name] for name in ("x", "y", "theta"))
    ahead = 0.33 / TILE
    tree = MapObject("tree", x + ahead * np.cos(theta), y - ahead * np.sin(theta), theta + np.pi, 0.25)
    road_map = RoadMap(TOWN, objects=[tree])
    record = draw_sample(road_map, drawn_tiles, 0, tile_px=PX, camera=steep, objects=load_objects()).record
    (seen,) = record["objects"]
    assert record["pose"] == pose and -steep.rows < seen["whole"][1] < 0


def test_the_camera_is_in_no_object(drawn_tiles):
    pose = draw_sample(RoadMap(TOWN), drawn_tiles, 0, tile_px=PX, camera=VIEWS).record["pose"]
    robot = MapObject("duckiebot", pose["x"], pose["y"], pose["theta"], 0.12)
    road_map = RoadMap(TOWN, objects=[robot])
    moved = draw_sample(road_map, drawn_tiles, 0, tile_px=PX, camera=VIEWS, objects=load_objects()).record["pose"]
    assert np.hypot(moved["x"] - robot.x, moved["y"] - robot.y) * TILE > robot.radius + 0.075
    assert draw_sample(road_map, drawn_tiles, 0, tile_px=PX, camera=VIEWS).record["pose"] == moved  # drawn or not


SPEC = {"split": (0.5, 0, 0.5), "views": 3, "camera": ("rows=60", "columns=80"), "tile_px": 32, "seed": 1}


@pytest.fixture(scope="module")
def maps():
    other = np.array([[6, 3, 0, 0], [10, 14, 5, 3], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)
    return [RoadMap(codes, objects=some_objects(12)) for codes in (TOWN, other)]


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools
@pytest.mark.parametrize("layout", ["coco", "imagefolder"])
def test_layouts_have_the_boxes_and_masks(layout, maps, tmp_path):
    pytest.importorskip("pycocotools")
    out = tmp_path / "dataset"
    spec = DatasetSpec(maps_from=maps, format=layout, furnish=["lane_duckies=9 lane_robots=3", "trees=0.5"], **SPEC)
    make_dataset(spec, out, workers=1)
    assert make_dataset(spec, out)["object_set"]["name"] == "objects"
    metadata = out / ("metadata/train.jsonl" if layout == "coco" else "train/metadata.jsonl")
    rows = [json.loads(line) for line in metadata.read_text().splitlines()]
    assert len(rows) == 3
    place = {"coco": "instances/train/{:06d}.png", "imagefolder": "train/instances/{:06d}.png"}[layout]
    total = 0
    for row in rows:
        instances = cv2.imread(str(out / place.format(row["number"])), cv2.IMREAD_UNCHANGED)
        listed = row["objects"]
        numbers = listed["id"] if layout == "imagefolder" else [one["instance"] for one in listed]
        assert set(numbers) == set(np.unique(instances)) - {0}
        total += len(numbers)
        if layout == "imagefolder":
            assert set(listed) == {"id", "category", "bbox", "whole", "visible", "distance"}
            assert (out / "train" / row["instances_file_name"]).exists()
    assert total > 3
    card = (out / "README.md").read_text()
    assert "image-segmentation, object-detection" in card and "- object set: objects" in card
    if layout == "imagefolder":
        assert all(f"`{name}`" in card for name in rows[0])
    else:
        check_coco(out, rows)


def check_coco(out, rows):
    from pycocotools.coco import COCO

    coco = COCO(out / "annotations" / "objects_train.json")
    assert [one["name"] for one in coco.loadCats(coco.getCatIds())] == list(OBJECT_KINDS)
    for row in rows:
        instances = cv2.imread(str(out / f"instances/train/{row['number']:06d}.png"), cv2.IMREAD_UNCHANGED)
        annotations = coco.loadAnns(coco.getAnnIds(row["number"] + 1))
        lines = (out / f"labels/train/{row['number']:06d}.txt").read_text().splitlines()
        assert len(annotations) == len(lines) == len(row["objects"])
        for annotation, line, one in zip(annotations, lines, row["objects"], strict=True):
            np.testing.assert_array_equal(coco.annToMask(annotation), instances == one["instance"])
            assert annotation["bbox"] == one["box"] and annotation["visible"] == one["visible"]
            kind, *shares = map(float, line.split())
            x, y, wide, high = np.array(shares) * (80, 60, 80, 60)
            np.testing.assert_allclose([x - wide / 2, y - high / 2, wide, high], one["box"], atol=1e-3)
            assert list(OBJECT_KINDS)[int(kind)] == one["kind"]
    assert "train: images/train" in (out / "data.yaml").read_text()


def write_cones(folder):
    """Writes an object set of one cone."""
    place = folder / "cone_1"
    place.mkdir(parents=True)
    cone = load_objects().kinds["cone"][0]
    cv2.imwrite(str(place / "image.png"), cone.views[0])
    (place / "object.toml").write_text('kind = "cone"\nheight = 0.08\nfootprint = [0.05, 0.05]\n')


@pytest.mark.parametrize(
    ("furnish", "lacks"),
    [
        ("cones=0.5 duckies=0.1", "duckie"),
        ("signs", "sign_4_way_intersect"),
        ("cones=2 lights=0.5", "trafficlight"),
        ("street_names=possible", "sign_street_name"),
        ({"objects": [{"kind": "other:kite", "x": 0.5, "y": 0.5}]}, "other:kite"),
    ],
)
@pytest.mark.parametrize("evolves", [True, False])
def test_a_set_without_a_kind_to_place_is_refused_before_the_search(furnish, lacks, evolves, maps, tmp_path):
    """It was refused while the pictures were drawn, after the search of all maps."""
    write_cones(tmp_path / "mine")
    source = {"maps": 4, "size": 7, "search": SearchSpec(rules="duckietown")} if evolves else {"maps_from": maps}
    spec = DatasetSpec(furnish=furnish, objects=tmp_path / "mine", split=(1, 0, 0), **source)
    with refused("objects", lacks, expected="'mine' has (cone)"):
        plan_dataset(spec)


def test_a_set_may_lack_kinds_that_are_not_placed(maps, tmp_path):
    write_cones(tmp_path / "mine")
    rings = [RoadMap([[6, 3], [12, 9]]), RoadMap([[6, 5, 3], [12, 5, 9]])]
    for source, furnish in ((maps, "cones=0.5"), (rings, "cones=0.5 signs=possible lights=0.5")):
        spec = DatasetSpec(maps_from=source, furnish=furnish, objects=tmp_path / "mine", split=(1, 0, 0))
        assert plan_dataset(spec).objects.name == "mine"


def test_a_set_without_a_kind_is_refused_before_anything_is_drawn(maps, tmp_path):
    write_cones(tmp_path / "mine")
    with refused("objects", "duckie"):
        make_dataset(DatasetSpec(maps_from=maps, objects=tmp_path / "mine", **SPEC), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    views = DatasetSpec(maps_from=[replace(one, objects=None) for one in maps], **SPEC)
    assert "object_set" not in make_dataset(views, tmp_path / "bare")
    assert not list((tmp_path / "bare").rglob("*instances*"))
    assert "object" not in (tmp_path / "bare" / "README.md").read_text()


def test_crossings_without_room_for_signs_are_counted(tmp_path, monkeypatch):
    lines = []
    monkeypatch.setattr(faults, "announce", lines.append)
    full = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    settings = {"maps_from": [RoadMap(full)], "split": (1, 0, 0), "tile_px": PX, "furnish": ["signs=possible"]}
    make_dataset(DatasetSpec(**settings), tmp_path / "out")
    assert lines == ["5 of 5 crossings have no room for signs, because a road is at a corner"]


def test_kinds_do_not_overprint_each_other(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(_card, "write_text", lambda picture, text, place, *_: written.append((text, *place)))
    cv2.imwrite(str(tmp_path / "picture.png"), np.zeros((480, 640, 3), np.uint8))
    boxes = [[8 * i, 60 + 3 * (i % 4), 30 + i, 20] for i in range(40)]
    objects = [{"kind": f"sign_{i}", "box": box} for i, box in enumerate([*boxes, [0, 0, 640, 480]])]
    _card.draw_boxes(tmp_path / "picture.png", objects)
    assert written[0][0] == "sign_40" and 5 < len(written) < 41
    for index, (_, x, y) in enumerate(written):
        for text, left, other_y in written[:index]:
            assert abs(y - other_y) >= 16 or x >= left + 8 * len(text) or left >= x + 8 * len(text) - 8
