"""Scores of predictions: against counts by hand and pycocotools' own, and what is refused."""

import json
import shutil

import cv2
import numpy as np
import pytest
from given_maps import small
from refusals import refused

from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset import score_predictions
from elitelanes_jax.dataset.make import make_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("scoring") / "out"
    make_dataset(small(tile_px=16, views=2), out)
    return out


def predict(dataset, folder, change):
    folder.mkdir()
    pairs = []
    for file in sorted((dataset / "test" / "labels").glob("*.png")):
        labels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        found = change(labels.copy())
        cv2.imwrite(str(folder / file.name), found)
        pairs.append((labels.ravel(), found.ravel()))
    return (np.concatenate(part) for part in zip(*pairs, strict=True))


def test_the_overlap_of_each_class_is_that_of_counted_pixels(dataset, tmp_path):
    rng = np.random.default_rng(0)

    def change(labels):
        flips = rng.random(labels.shape) < 0.3
        labels[flips] = rng.integers(0, 3, int(flips.sum()))
        return labels

    expected, found = predict(dataset, tmp_path / "found", change)
    scores = score_predictions(dataset, tmp_path / "found")
    by_hand = []
    for label, name in enumerate(("background", "road", "stop line", "lane separator")):
        is_one, is_other = expected == label, found == label
        by_hand.append((is_one & is_other).sum() / max((is_one | is_other).sum(), 1))
        assert scores[name] == pytest.approx(by_hand[-1], nan_ok=True) or np.isnan(scores[name])
    assert 0 < scores["mean"] < 0.9 and score_predictions(dataset, dataset / "test" / "labels")["mean"] == 1


@pytest.mark.parametrize(
    ("change", "got"),
    [
        (lambda labels: labels[1:], "[79, 80]"),
        (lambda labels: labels + 4, "label 7"),
        # In 8 bits, label 256 would be label 0.
        (lambda labels: labels.astype(np.uint16) + 256, "label 259"),
        (
            lambda labels: np.dstack([labels] * 3),
            "a picture in colours",
        ),
    ],
)
def test_wrong_labels_are_named(change, got, dataset, tmp_path):
    predict(dataset, tmp_path / "found", change)
    first = min((tmp_path / "found").iterdir())
    with refused(f"predictions: {first.name}", got):
        score_predictions(dataset, tmp_path / "found")


def test_wrong_folders_are_named(dataset, tmp_path):
    with refused(tmp_path, "another one", expected="folder"):
        score_predictions(tmp_path, tmp_path)
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "dataset.json").write_text("[" * 10**5)
    with refused(tmp_path / "deep", "another one", expected="folder"):
        score_predictions(tmp_path / "deep", tmp_path)
    make_dataset(small(part=(1, 6)), tmp_path / "part")
    with refused(tmp_path / "part", "a part", expected="a whole dataset"):
        score_predictions(tmp_path / "part", tmp_path)
    labels = sorted((dataset / "test" / "labels").glob("*.png"))
    with refused(f"predictions: {labels[0].name}", "none"):
        score_predictions(dataset, tmp_path)
    for file in labels:
        shutil.copy(file, tmp_path)
    (tmp_path / labels[-1].name).unlink()
    with refused(f"predictions: {labels[-1].name}", "none"):
        score_predictions(dataset, tmp_path)
    for file in labels:
        (tmp_path / file.name).write_text("no picture")
    with refused(f"predictions: {labels[0].name}", "another file"):
        score_predictions(dataset, tmp_path)
    with refused("predictions", dataset / "dataset.json", expected="coco"):
        score_predictions(dataset, dataset / "dataset.json")
    with refused("predictions", "none, nowhere"):
        score_predictions(dataset, "nowhere")
    with refused("split", "'val'"):
        score_predictions(dataset, tmp_path, split="val")
    make_dataset(small(tile_px=16, split=(1, 0, 0)), tmp_path / "train")
    with refused("split", "test"):
        score_predictions(tmp_path / "train", tmp_path)
    make_dataset(small(tile_px=16, format="webdataset"), tmp_path / "tar")
    with refused(tmp_path / "tar", "webdataset"):
        score_predictions(tmp_path / "tar", tmp_path)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: text + '{"number": 1',
        lambda text: text + "{}\n",
        lambda text: text + "[]\n",
        lambda text: text.replace('"number": ', '"number": "a", "n": ', 1),
        lambda text: "",
        lambda text: text.split("\n", 1)[1],
    ],
)
def test_a_damaged_list_of_pictures_is_named(spoil, dataset, tmp_path):
    """A list without some of its pictures was scored without them."""
    shutil.copytree(dataset, tmp_path / "spoilt")
    file = tmp_path / "spoilt" / "test" / "metadata.jsonl"
    file.write_text(spoil(file.read_text()))
    with refused(file):
        score_predictions(tmp_path / "spoilt", dataset / "test" / "labels")


def test_a_missing_label_map_of_the_dataset_is_no_missing_prediction(dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "spoilt")
    file = min((tmp_path / "spoilt" / "test" / "labels").glob("*.png"))
    file.unlink()
    with refused(file, "none"):
        score_predictions(tmp_path / "spoilt", dataset / "test" / "labels")


@pytest.fixture
def views(dataset, tmp_path):
    """A dataset whose pictures have lane poses, and these poses."""
    folder = tmp_path / "views"
    shutil.copytree(dataset, folder)
    file = folder / "test" / "metadata.jsonl"
    rng = np.random.default_rng(1)
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    poses = [{"number": row["number"], "d": rng.uniform(-0.1, 0.1), "phi": rng.uniform(-1, 1)} for row in rows]
    file.write_text("".join(f"{json.dumps(row | {'nearest': pose})}\n" for row, pose in zip(rows, poses, strict=True)))
    return folder, poses


def write_poses(folder, poses):
    (folder / "poses.jsonl").write_text("".join(f"{json.dumps(pose)}\n" for pose in poses))
    return folder / "poses.jsonl"


def test_lane_poses_are_scored_in_centimetres_and_radians(views, tmp_path, capsys):
    folder, poses = views
    errors = np.linspace(0.01, 0.04, len(poses))
    # A whole turn is no error, and the order of the lines does not matter.
    found = [
        {"number": pose["number"], "d": pose["d"] - error, "phi": pose["phi"] + error + 2 * np.pi, "note": "x"}
        for pose, error in zip(poses, errors, strict=True)
    ]
    file = write_poses(tmp_path, found[::-1])
    scores = score_predictions(folder, file)
    offsets, angles = (np.array([pose[name] for pose in poses]) for name in ("d", "phi"))
    assert scores == pytest.approx(
        {
            "offset_cm": np.median(errors) * 58.5,
            "offset_cm_90": np.percentile(errors, 90) * 58.5,
            "offset_cm_constant": np.median(abs(offsets - np.median(offsets))) * 58.5,
            "angle_rad": np.median(errors),
            "angle_rad_90": np.percentile(errors, 90),
            "angle_rad_constant": np.median(abs(angles - np.median(angles))),
        }
    )
    assert main(["score", str(folder), "--predictions", str(file)]) == 0
    assert capsys.readouterr().out.splitlines()[0].split() == ["offset_cm", f"{scores['offset_cm']:.3f}"]


@pytest.mark.parametrize(
    ("change", "place", "got"),
    [
        (lambda poses: poses[1:], "", "none for {first}"),
        (lambda poses: [*poses, poses[0]], "", "{first} again in line {after}"),
        (lambda poses: [poses[0] | {"d": None}], ": line 1: d", "None"),
        (lambda poses: [poses[0], poses[1] | {"phi": float("nan")}], ": line 2: phi", "nan"),
        (lambda poses: [poses[0] | {"number": -1}], ": line 1: number", "-1"),
        (lambda poses: [{"d": 0}], ": line 1", "{{'d': 0}}"),
    ],
)
def test_a_wrong_lane_pose_is_named_by_its_line(change, place, got, views, tmp_path):
    folder, poses = views
    got = got.format(first=poses[0]["number"], after=len(poses) + 1)
    with refused(f"predictions{place}", got):
        score_predictions(folder, write_poses(tmp_path, change(poses)))


def test_lane_poses_need_views_of_robots_and_lines_of_json(views, dataset, tmp_path):
    file = write_poses(tmp_path, views[1])
    with refused(dataset, "another one", expected="robots'"):
        score_predictions(dataset, file)
    # An empty line at the end belongs to no picture.
    file.write_text(f"{file.read_text()}\n")
    assert score_predictions(views[0], file.rename(tmp_path / "POSES.JSONL"))["offset_cm"] == 0
    file.write_bytes(b"\xff\n")
    with refused("predictions: line 1", "another text"):
        score_predictions(views[0], file)
    with refused("predictions", tmp_path / "poses.json", expected=".jsonl"):
        score_predictions(views[0], file.rename(tmp_path / "poses.json"))


@pytest.fixture(scope="module")
def detections(tmp_path_factory):
    """A dataset with objects, and results of a network that finds them all."""
    pytest.importorskip("pycocotools")
    out = tmp_path_factory.mktemp("detections") / "out"
    make_dataset(small(tile_px=64, format="coco", furnish="lane_duckies=4"), out)
    table = json.loads((out / "annotations" / "objects_test.json").read_text())
    results = [
        {"image_id": one["image_id"], "category_id": one["category_id"], "bbox": one["bbox"], "score": 0.9}
        for one in table["annotations"]
    ]
    return out, results


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools
def test_boxes_are_scored_as_coco_does(detections, tmp_path, capsys):
    out, results = detections
    file = tmp_path / "results.json"
    file.write_text(json.dumps(results))
    assert score_predictions(out, file) == {"AP": 1, "AP50": 1, "AP75": 1}
    file.write_text(json.dumps([one | {"segmentation": [], "caption": ""} for one in results[: len(results) // 2]]))
    assert 0 < score_predictions(out, file)["AP50"] < 1
    # A network that finds nothing.
    file.write_text("[]")
    assert score_predictions(out, file) == {"AP": 0, "AP50": 0, "AP75": 0}
    # A split without objects.
    shutil.copytree(out, tmp_path / "bare")
    objects = tmp_path / "bare" / "annotations" / "objects_test.json"
    objects.write_text(json.dumps(json.loads(objects.read_text()) | {"annotations": []}))
    assert np.isnan([*score_predictions(tmp_path / "bare", file).values()]).all()
    assert not capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "subject", "got"),
    [
        ({"score": float("nan")}, "predictions: entry 1: score", "nan"),
        ({"score": "0.9"}, "predictions: entry 1: score", "'0.9'"),
        ({"category_id": 1001}, "predictions: entry 1: category_id", "1001"),
        ({"category_id": 1.5}, "predictions: entry 1: category_id", "1.5"),
        ({"category_id": [1]}, "predictions: entry 1: category_id", "[1]"),
        ({"image_id": 10**6}, "predictions: entry 1: image_id", "1000000"),
        ({"image_id": True}, "predictions: entry 1: image_id", "True"),
        ({"bbox": [0, 0, -1, 1]}, "predictions: entry 1: bbox", "[0, 0, -1, 1]"),
        ({"bbox": [0, 0]}, "predictions: entry 1: bbox", "[0, 0]"),
        ({"bbox": [0, 0, 1, float("inf")]}, "predictions: entry 1: bbox", "[0, 0, 1, inf]"),
        ({"bbox": None}, "predictions: entry 1: bbox", "None"),
    ],
)
def test_a_wrong_result_is_named_by_its_entry_and_field(change, subject, got, detections, tmp_path):
    out, results = detections
    (tmp_path / "results.json").write_text(json.dumps([results[0], results[1] | change]))
    with refused(subject, got):
        score_predictions(out, tmp_path / "results.json")


@pytest.mark.parametrize(
    ("text", "subject", "got"),
    [
        ("[1, 2]", "predictions: entry 0", "1"),
        ('[{"image_id": 1}]', "predictions: entry 0", "one without category_id"),
        ('{"annotations": []}', "predictions", "{'annotations': []}"),
        ("[" * 10**5, "predictions", "...results.json"),
    ],
)
def test_other_json_is_no_list_of_results(text, subject, got, detections, tmp_path):
    (tmp_path / "results.json").write_text(text)
    with refused(subject, got):
        score_predictions(detections[0], tmp_path / "results.json")


def test_the_command_names_its_option(detections, tmp_path, capsys):
    (tmp_path / "results.json").write_text("[1]")
    assert main(["score", str(detections[0]), "--predictions", str(tmp_path / "results.json")]) == 2
    assert capsys.readouterr().err.startswith("elitelanes: --predictions: entry 0: expected a table with ")


def test_a_damaged_file_of_objects_is_named(detections, tmp_path):
    out, _ = detections
    shutil.copytree(out, tmp_path / "spoilt")
    file = tmp_path / "spoilt" / "annotations" / "objects_test.json"
    (tmp_path / "results.json").write_text("[]")
    for text in ("{", "[]", '{"annotations": [{}], "images": []}'):
        file.write_text(text)
        with refused(file, "another file"):
            score_predictions(tmp_path / "spoilt", tmp_path / "results.json")
