"""Datasets: the files, the splits, the readers of other libraries, and runs that are ended and continue."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import killed_runs
import numpy as np
import pytest
from folders import files, read_picture
from given_maps import random_maps, small

from elitelanes_jax import DatasetSpec, InputError, RoadMap, load_tiles, make_dataset, measure, mirror, render, rotate
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset import STANDARD, tiles_by_split
from elitelanes_jax.dataset._layouts import LAYOUTS, write_sample
from elitelanes_jax.dataset._plan import given_maps, split_maps
from elitelanes_jax.dataset._views import View, warp
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network import canonical_form, plain_measure
from elitelanes_jax.tiles import LABELS, default_tiles

# The searches of all tests of the command are one compiled program for each size.
SEARCH = ["--preset", "paper", "--evaluations", "2000", "--tile-px", "16"]
EVOLVED = [*SEARCH, "--maps", "20", "--size", "3..4", "4", "--split", "0.6", "0.2", "0.2"]
NAMES = ("imagefolder", "mmseg", "coco", "plain")


def rows_of(folder, split):
    return [json.loads(line) for line in (folder / split / "metadata.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def evolved(tmp_path_factory):
    """A dataset of evolved maps of two sizes, made by the command."""
    out = tmp_path_factory.mktemp("evolved") / "out"
    assert main(["dataset", *EVOLVED, "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Datasets of the same 12 given maps, by format."""
    folder = tmp_path_factory.mktemp("given")
    for name in NAMES:
        if name != "coco" or _installed("pycocotools"):
            make_dataset(small(format=name), folder / name, maps=random_maps(), workers=1)
    return folder


def _installed(package):
    try:
        __import__(package)
    except ImportError:
        return False
    return True


def test_an_evolved_dataset_has_these_files(evolved):
    about = json.loads((evolved / "dataset.json").read_text())
    assert about["pictures"] == {"train": 12, "validation": 4, "test": 4}
    names = set(files(evolved))
    assert {"README.md", "contact-sheet.png", "dataset.json"} <= names
    forms, sizes, pixels = set(), [], {split: np.zeros(4, int) for split in SPLITS}
    for split in SPLITS:
        rows = rows_of(evolved, split)
        assert len(rows) == about["pictures"][split]
        for row in rows:
            image, labels = (read_picture(evolved / split / row[f"{name}_file_name"]) for name in ("image", "labels"))
            # The sides of a view change places when it is rotated by a quarter turn.
            assert sorted(labels.shape) == [16 * len(row["codes"]), 16 * 4]
            assert image.shape == (*labels.shape, 3)
            assert labels.max() < len(LABELS)
            pixels[split] += np.bincount(labels.ravel(), minlength=4)
            metrics = row["metrics"]
            assert (metrics["components"], metrics["dead_ends"], metrics["boundary_violations"]) == (1, 0, 0)
            forms.add(canonical_form(np.array(row["codes"])))
            sizes.append((len(row["codes"]), len(row["codes"][0])))
            names -= {f"{split}/{row[f'{name}_file_name']}" for name in ("image", "labels")}
        names.remove(f"{split}/metadata.jsonl")
        assert pixels[split].tolist() == about["class_pixels"][split]
    assert names == {"README.md", "contact-sheet.png", "dataset.json"}
    assert read_picture(evolved / "contact-sheet.png").shape[1] > 800
    card = (evolved / "README.md").read_text()
    assert card.startswith("---\n") and "license: apache-2.0" in card and "| 12 | 4 | 4 |" in card
    assert "20 pictures of 20 road networks, 3 x 4 to 4 x 4 tiles" in card and "lane separator" in card
    assert len(forms) == 20
    assert sorted(sizes) == [(3, 4)] * 10 + [(4, 4)] * 10


def test_labels_are_those_of_the_tiles_in_the_record(evolved):
    tiles = load_tiles()
    places = {tile.name: place for place, tile in enumerate(tiles.pictures)}
    for split in SPLITS:
        for row in rows_of(evolved, split):
            tile = np.vectorize(places.__getitem__)(row["tiles"])
            chosen = np.stack([tile, row["quarter_turns"]], axis=-1)
            plain = render(row["codes"], tiles, tile_px=16, chosen=chosen)
            matrix, size = np.array(row["transform"]["matrix"]), tuple(row["pixels"])
            view = View(**row["transform"] | {"matrix": matrix, "size": size})
            np.testing.assert_array_equal(
                warp(plain.labels, view), read_picture(evolved / split / row["labels_file_name"])
            )


def test_a_complete_dataset_stays_and_other_settings_are_refused(evolved, capsys):
    before = files(evolved)
    assert main(["dataset", *EVOLVED, "--out", str(evolved)]) == 0
    assert main(["dataset", *EVOLVED, "--seed", "1", "--out", str(evolved)]) == 2
    assert "expected results with seed 1, got results with 0; use another folder, or --force" in capsys.readouterr().err
    assert files(evolved) == before


@pytest.mark.parametrize("name", NAMES[:3])
def test_all_formats_have_the_same_pictures(given, name):
    if name == "coco":
        pytest.importorskip("pycocotools")
    pictures, plain = (
        sorted(data for file, data in files(given / one).items() if file.endswith(".png") and "sheet" not in file)
        for one in (name, "plain")
    )
    assert len(pictures) == 2 * 12
    assert len(plain) == 5 * 12
    assert set(pictures) <= set(plain)


def test_maps_from_a_list_are_drawn_as_given_ones_and_go_on_after_an_error(tmp_path, monkeypatch):
    """A list as the explorer saves it, with maps of two sizes, one of them twice: rotated, mirrored."""
    maps = [*random_maps(6), *random_maps(3, side=6)]
    maps = [replace(one, metrics={"crossings": plain_measure(one.codes)["crossings"]}) for one in maps]
    listed = [{**vars(road_map), "codes": road_map.codes.tolist()} for road_map in (*maps[:5], *maps)]
    listed += [{"codes": mirror(rotate(road_map.codes)).tolist()} for road_map in maps]
    known = [{name: value for name, value in one.items() if value is not None} for one in listed]
    (tmp_path / "list.json").write_text(json.dumps(known))
    spec = DatasetSpec(maps_from=tmp_path / "list.json", tile_px=16, split=(0.5, 0.25, 0.25))
    assert (spec.maps, spec.size, spec.shapes, spec.maps_from.repeated) == (9, ((5, 6),), [(5, 5), (6, 6)], 14)
    make_dataset(small(maps=9, size="5..6"), tmp_path / "expected", maps=maps, workers=1)

    drawn = []

    def full_disk(*given):
        drawn.append(given)
        if len(drawn) == 5:
            raise OSError(28, "No space left on device", "picture")
        write_sample(*given)

    monkeypatch.setattr("elitelanes_jax.dataset.make.write_sample", full_disk)
    with pytest.raises(OSError, match="No space left"):
        make_dataset(spec, tmp_path / "out", workers=1)
    make_dataset(spec, tmp_path / "out", workers=1)
    assert len(drawn) == 5 + 9 - 4
    assert files(tmp_path / "out") == files(tmp_path / "expected")
    with pytest.raises(InputError, match=r"^maps: expected none beside the specification's maps_from"):
        make_dataset(spec, tmp_path / "other", maps=maps)


def test_metrics_are_measured_where_a_file_has_none(tmp_path):
    (tmp_path / "map.json").write_text('{"codes": [[6, 3], [12, 9]]}')
    (road_map,) = DatasetSpec(maps_from=[tmp_path], split=(1, 0, 0)).maps_from.maps
    assert road_map.metrics == {name: value.item() for name, value in measure(road_map.codes)._asdict().items()}


def test_hugging_face_datasets_loads_it(evolved, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    loaded = datasets.load_dataset("imagefolder", data_dir=str(evolved), cache_dir=str(tmp_path))
    assert {split: len(part) for split, part in loaded.items()} == {"train": 12, "validation": 4, "test": 4}
    for split, part in loaded.items():
        for sample, row in zip(part, rows_of(evolved, split), strict=True):
            labels = read_picture(evolved / split / row["labels_file_name"])
            np.testing.assert_array_equal(np.array(sample["labels"]), labels)
            np.testing.assert_array_equal(
                np.array(sample["image"])[..., ::-1], read_picture(evolved / split / row["image_file_name"])
            )
            assert sample["codes"] == row["codes"]
            assert sample["transform"]["matrix"] == row["transform"]["matrix"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of its own
def test_hugging_face_datasets_loads_one_split_and_layers_of_any_name(tmp_path, monkeypatch):
    """Loads a dataset without validation and test, and one whose held-out tiles lack the layers of the others."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    layers = ("img", "ann", "points", "size")
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    for name in layers:
        shutil.copy(tmp_path / "tiles/turn_1/road.png", tmp_path / f"tiles/turn_1/{name}.png")
    spec = small(tiles=tmp_path / "tiles", split=(1.0, 0.0, 0.0))
    make_dataset(spec, tmp_path / "one", maps=random_maps())
    loaded = datasets.load_dataset("imagefolder", data_dir=str(tmp_path / "one"), cache_dir=str(tmp_path / "cache"))
    assert {split: len(part) for split, part in loaded.items()} == {"train": 12}
    maps = [road_map for road_map in random_maps(120) if 15 not in road_map.codes][:12]
    make_dataset(small(tiles=tmp_path / "tiles", hold_out_tiles=True), tmp_path / "held", maps=maps)
    loaded = datasets.load_dataset("imagefolder", data_dir=str(tmp_path / "held"), cache_dir=str(tmp_path / "cache"))
    for sample in (*loaded["train"], *loaded["test"]):
        for name in layers:
            assert set(np.unique(np.array(sample[f"layers_{name}"]))) <= {0, 255}
        assert sample["size"] == [5, 5]


@pytest.mark.parametrize("name", NAMES)
def test_no_two_layers_have_one_file(name):
    layout = LAYOUTS[name]
    layers = ["image", "labels", *layout.layers, "images", "img", "ann", "points", "annotations", "layers"]
    assert len({layout.file(split, 3, layer) for layer in layers for split in range(3)}) == 3 * len(layers)


def test_without_pycocotools_the_message_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycocotools", None)
    with pytest.raises(InputError, match=r"^format: coco needs pycocotools: pip install pycocotools$"):
        make_dataset(small(format="coco"), tmp_path / "out", maps=random_maps())
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of its own
def test_pycocotools_loads_it(given):
    coco = pytest.importorskip("pycocotools.coco")
    out = given / "coco"
    for split, count in (("train", 6), ("val", 3), ("test", 3)):
        loaded = coco.COCO(str(out / "annotations" / f"{split}.json"))
        assert len(loaded.getImgIds()) == count
        for image in loaded.loadImgs(loaded.getImgIds()):
            labels = read_picture(out / "labels" / split / image["file_name"])
            assert read_picture(out / "images" / split / image["file_name"]).shape[:2] == (
                image["height"],
                image["width"],
            )
            found = np.zeros_like(labels)
            for one in loaded.loadAnns(loaded.getAnnIds(image["id"])):
                mask = loaded.annToMask(one)
                assert mask.sum() == one["area"]
                found[mask > 0] = one["category_id"]
            np.testing.assert_array_equal(found, labels)


def test_mmsegmentation_finds_pairs(given):
    """Finds an annotation of the same name and size for every image, as its BaseSegDataset does."""
    for split, count in (("train", 6), ("val", 3), ("test", 3)):
        images, labels = (sorted((given / "mmseg" / kind / split).iterdir()) for kind in ("img_dir", "ann_dir"))
        assert len(images) == count and [one.name for one in images] == [one.name for one in labels]
        for image, annotation in zip(map(read_picture, images), map(read_picture, labels), strict=True):
            assert annotation.dtype == np.uint8 and annotation.shape == image.shape[:2]


def test_the_tile_sets_own_layers_and_points_get_the_same_view(tmp_path):
    """Draws discs about points: in every view the middle of a disc is its point."""
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    for place in (tmp_path / "tiles").iterdir():
        if place.is_dir():
            size = read_picture(place / "image.png").shape[0]
            disc = cv2.circle(np.zeros((size, size), np.uint8), (size // 4, size // 3), size // 10, 255, -1)
            cv2.imwrite(str(place / "cones.png"), disc)
            (place / "points.json").write_text(json.dumps({"cone": [[size // 4 + 0.5, size // 3 + 0.5]]}))
    spec = small(maps=3, split=(1, 0, 0), tiles=tmp_path / "tiles", format="plain", tile_px=40, transforms=STANDARD)
    make_dataset(spec, tmp_path / "out", maps=random_maps(3))
    rows = rows_of(tmp_path / "out", "train")
    assert len(rows) == 3
    for row in rows:
        mask = read_picture(tmp_path / "out" / "train" / row["folder"] / "cones.png")
        assert set(np.unique(mask)) == {0, 255}
        _, _, boxes, centres = cv2.connectedComponentsWithStats(mask)
        height, width = mask.shape
        inside = [
            centre + 0.5
            for (x, y, w, h, _), centre in zip(boxes[1:], centres[1:], strict=True)
            if x and y and x + w < width and y + h < height
        ]
        points = np.array(row["points"]["cone"])
        assert len(inside) >= 9
        for centre in inside:
            assert np.hypot(*(points - centre).T).min() < 1


def test_held_out_tiles_are_in_no_other_split(tmp_path):
    tiles = load_tiles()
    maps = [road_map for road_map in random_maps(120) if 15 not in road_map.codes][:20]
    spec = small(maps=len(maps), hold_out_tiles=True)
    make_dataset(spec, tmp_path / "out", maps=maps)
    shown = {
        split: {name for row in rows_of(tmp_path / "out", split) for line in row["tiles"] for name in line}
        for split in SPLITS
    }
    assert shown["test"]
    assert not shown["test"] & (shown["train"] | shown["validation"])
    seen, _, unseen = tiles_by_split(tiles, spec)
    assert {tile.name for tile in (*seen.tiles, *unseen.tiles)} == {tile.name for tile in tiles.tiles}
    assert "crossing4_1" in {tile.name for tile in seen.tiles}


def test_too_few_maps_without_the_only_crossing_to_hold_out(tmp_path):
    grid = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    maps = [RoadMap(np.where(np.arange(9).reshape(3, 3) < lost, 0, grid), niche=[0]) for lost in range(4)]
    with pytest.raises(InputError, match="expected 1 map without crossing4, which have only one picture"):
        make_dataset(small(maps=4, size=3, hold_out_tiles=True), tmp_path / "out", maps=maps)
    assert not (tmp_path / "out").exists()


def test_a_single_turn_cannot_be_held_out(tmp_path):
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    for name in ("turn_2", "turn_3", "turn_4"):
        shutil.rmtree(tmp_path / "tiles" / name)
    spec = small(tiles=tmp_path / "tiles", hold_out_tiles=True)
    with pytest.raises(InputError, match="expected two pictures or more of straight, turn .* got one of turn"):
        make_dataset(spec, tmp_path / "out", maps=random_maps())


def test_all_views_of_a_map_are_in_one_split(tmp_path):
    about = make_dataset(small(views=3, transforms=STANDARD), tmp_path / "out", maps=random_maps())
    assert about["pictures"] == {"train": 18, "validation": 9, "test": 9}
    rows = {split: rows_of(tmp_path / "out", split) for split in SPLITS}
    maps = {split: {json.dumps(row["codes"]) for row in found} for split, found in rows.items()}
    assert sum(map(len, maps.values())) == len(set.union(*maps.values())) == 12
    assert len({json.dumps(row["transform"]["matrix"]) for found in rows.values() for row in found}) == 36


def test_each_niche_is_split_in_the_same_shares(tmp_path):
    maps = [replace(road_map, niche=[number // 40]) for number, road_map in enumerate(random_maps(200, 3))]
    splits = split_maps(DatasetSpec(maps=200, size=3), given_maps(maps, tmp_path), load_tiles())
    for niche in range(5):
        part = np.bincount(splits[niche * 40 : niche * 40 + 40], minlength=3)
        assert np.abs(part - (32, 4, 4)).max() <= 1


@pytest.mark.parametrize(
    ("size", "maps", "message"),
    [
        (5, lambda: [], "maps: expected 12 of them, as the specification says, got 0"),
        (5, lambda: random_maps(12, 6), "maps: expected sizes 5..5, got 6 x 6, map 0"),
        ("5 4..5", lambda: random_maps(12, 6), "maps: expected sizes 5..5 x 4..5, got 6 x 6, map 0"),
        (5, lambda: [RoadMap(np.full((5, 5), 8, np.int8))] * 12, "maps: expected codes that the tile set has"),
    ],
)
def test_given_maps_have_to_fit_the_specification(tmp_path, size, maps, message):
    tiles = shutil.copytree(default_tiles(), tmp_path / "tiles", ignore=shutil.ignore_patterns("end_*"))
    with pytest.raises(InputError, match=f"^{message}"):
        make_dataset(small(size=size, tiles=tiles), str(tmp_path / "out"), maps=maps())
    assert not (tmp_path / "out").exists()


def test_the_number_of_workers_is_checked(tmp_path):
    with pytest.raises(InputError, match="^workers: expected a whole number, 1 or more, got 0$"):
        make_dataset(small(), tmp_path / "out", workers=0, maps=random_maps())
    assert not (tmp_path / "out").exists()


def test_fewer_maps_than_asked_for_end_the_command(tmp_path, capsys):
    few = [*SEARCH, "--maps", "44", "--size", "3", "4", "--split", "1", "0", "0"]  # all that there are
    assert main(["dataset", *few, "--out", str(tmp_path / "out")]) == 1
    assert not (tmp_path / "out").exists()
    message = capsys.readouterr().err
    found = int(message.split("elitelanes: found ")[1].split()[0])
    assert 10 <= found < 44
    assert f"{found} different ones of 44 maps of 3 x 4 tiles; larger sizes, more evaluations or fewer maps" in message


def test_a_dataset_that_lost_pictures_is_not_called_complete(evolved, tmp_path, capsys):
    out = tmp_path / "out"
    shutil.copytree(evolved, out)
    next((out / "validation" / "labels").iterdir()).unlink()
    assert main(["dataset", *EVOLVED, "--out", str(out)]) == 2
    said = f"elitelanes: {out}: expected 4 files validation/labels/*.png, got 3; --force draws all\n"
    assert capsys.readouterr().err == said
    assert main(["dataset", *EVOLVED, "--out", str(out), "--force"]) == 0
    assert files(out) == files(evolved)


def test_a_full_disk_is_one_line_of_the_command(tmp_path, small_files_only, evolved, capsys):
    out = tmp_path / "out"
    small_files_only(15000)
    code = main(["dataset", *EVOLVED, "--out", str(out)])
    small_files_only(-1)
    assert code == 2
    place, reason = capsys.readouterr().err.split(": ", 1)[1].split(": ")
    assert Path(place).is_relative_to(out) or Path(place).is_relative_to(tmp_path / ".out-unfinished" / "kept")
    assert reason == "File too large; what is complete is kept, and the same command resumes\n"
    assert main(["dataset", *EVOLVED, "--out", str(out)]) == 0
    assert files(out) == files(evolved)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no such processes")
@pytest.mark.parametrize("what", ["dataset", pytest.param("evolved", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kills", [6, pytest.param(99, marks=pytest.mark.slow)])
def test_ended_at_any_moment_it_continues_to_the_same_files(kills, what, tmp_path):
    program = [sys.executable, killed_runs.__file__, tmp_path / "out", str(kills), "0", what, "SIGINT", "SIGKILL"]
    ran = subprocess.run(program, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    *digests, last = map(json.loads, ran.stdout.splitlines())
    assert last == {"kills": kills} and len(digests) > 1 and len({one["digest"] for one in digests}) == 1


def test_it_works_where_the_system_counts_processors_otherwise(tmp_path, monkeypatch, given):
    """Runs as on macOS and Windows, which lack `os.sched_getaffinity`."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    make_dataset(small(), tmp_path / "out", maps=random_maps())
    assert files(tmp_path / "out") == files(given / "imagefolder")


WITHOUT_FCNTL = """
import sys
from pathlib import Path

sys.modules["fcntl"] = None
sys.path.insert(0, sys.argv[1])
from given_maps import random_maps, small

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax.dataset.make import make_dataset

out = Path(sys.argv[2])
with output_folder(out / "other", {}):
    try:
        make_dataset(small(), out / "other", maps=random_maps())
    except InputError as error:
        print(error)
make_dataset(small(), out / "out", maps=random_maps())
"""


def test_it_works_without_fcntl(tmp_path, given):
    """Runs as on Windows, which lacks the module `fcntl`: one run at a time has a folder there too."""
    command = [sys.executable, "-c", WITHOUT_FCNTL, str(Path(__file__).parents[1]), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"{tmp_path / 'other'}: expected no other run at work in it, got one\n"
    assert files(tmp_path / "out") == files(given / "imagefolder")
