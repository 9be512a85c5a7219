"""Datasets: the files, the splits, the readers of other libraries, and runs that are ended and continue."""

import json
import os
import shutil
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import killed_runs
import numpy as np
import pytest
from folders import files, read_picture
from given_maps import random_maps, small
from jax.random import key_data
from refusals import refused

from elitelanes_jax import DatasetSpec, RoadMap, load_tiles, make_dataset, measure, mirror, render, rotate
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset._card import _origin, sample_sheet
from elitelanes_jax.dataset._layouts import write_sample
from elitelanes_jax.dataset._plan import _Size
from elitelanes_jax.dataset._samples import Sample
from elitelanes_jax.dataset._splits import split_maps
from elitelanes_jax.dataset._transforms import STANDARD
from elitelanes_jax.dataset._views import DrawnTransform, warp
from elitelanes_jax.dataset.planning import plan_dataset
from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network import canonical_form, plain_measure
from elitelanes_jax.optimizers import seed_keys
from elitelanes_jax.search import SearchSpec
from elitelanes_jax.search.resolve import resolve
from elitelanes_jax.search.selection import Choice
from elitelanes_jax.tiles import LABEL_COLOURS, LABELS
from elitelanes_jax.tiles.tileset import default_tiles

# The searches of all tests of the command are one compiled program for each size.
SEARCH = ["--preset", "paper", "--evaluations", "2000", "--tile-px", "16"]
EVOLVED = [*SEARCH, "--maps", "20", "--size", "3..4", "4", "--split", "0.6", "0.2", "0.2"]


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
    """A dataset of 12 given maps."""
    folder = tmp_path_factory.mktemp("given") / "out"
    make_dataset(small(), folder, workers=1)
    return folder


def test_an_evolved_dataset_has_these_files(evolved):
    about = json.loads((evolved / "dataset.json").read_text())
    assert about["pictures"] == {"train": 12, "validation": 4, "test": 4}
    names = set(files(evolved))
    assert {"README.md", "contact-sheet.png", "croissant.json", "dataset.json"} <= names
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
    assert names == {"README.md", "contact-sheet.png", "croissant.json", "dataset.json"}
    assert read_picture(evolved / "contact-sheet.png").shape[1] > 800
    card = (evolved / "README.md").read_text()
    assert card.startswith("---\n") and "license: apache-2.0" in card and "| 12 | 4 | 4 |" in card
    assert (
        "\n20 pictures of 20 road networks, 3 x 4 to 4 x 4 tiles: views from above, 16 pixels a tile.\n" in card
        and "lane separator" in card
    )
    assert [name for name in row if f"`{name}`" not in card] == []
    assert len(forms) == 20
    assert sorted(sizes) == [(3, 4)] * 10 + [(4, 4)] * 10


def test_the_card_has_fixed_cells_and_the_inventory():
    search = SearchSpec(fix=[[6, None], [None, 9]], inventory="turn=4")
    lines = _origin(plan_dataset(DatasetSpec(size=2, search=search)).identity)
    assert "- tile codes that every map keeps: [[6, None], [None, 9]]" in lines
    assert [
        line for line in lines if line.startswith("- tiles that every map needs at most: {") and "'turn': 4" in line
    ]


@pytest.mark.parametrize(
    ("size", "shape", "where"),
    [
        ((30, 66), 1, (65, 174, 0, 240)),
        ((66, 30), 1, (0, 240, 65, 174)),
        ((50, 50), 1, (0, 240, 0, 240)),
        ((61, 79), 61 / 79, (0, 185, 0, 240)),
        ((16, 1536), 16 / 1536, (0, 2, 0, 240)),
    ],
)
def test_a_sheet_keeps_the_proportions_of_pictures(size, shape, where, tmp_path):
    cv2.imwrite(str(tmp_path / "image.png"), np.full((*size, 3), (30, 20, 10), np.uint8))
    cv2.imwrite(str(tmp_path / "labels.png"), np.full(size, 3, np.uint8))
    sheet = sample_sheet(tmp_path, [("image.png", "labels.png", ["one"])], "title", shape)
    y, x = 3 * 28, 28  # the first cell
    cell = sheet[y : y + round(240 * shape), x : x + 2 * 240 + 4]
    top, bottom, left, right = where
    expected = np.full_like(cell, 236)
    expected[top:bottom, left:right] = (10, 20, 30)
    expected[top:bottom, 244 + left : 244 + right] = LABEL_COLOURS[3]
    np.testing.assert_array_equal(cell, expected)


def test_labels_are_those_of_the_tiles_in_the_record(evolved):
    tiles = load_tiles()
    places = {tile.name: place for place, tile in enumerate(tiles.pictures)}
    for split in SPLITS:
        for row in rows_of(evolved, split):
            tile = np.vectorize(places.__getitem__)(row["tiles"])
            chosen = np.stack([tile, row["quarter_turns"]], axis=-1)
            plain = render(row["codes"], tiles, tile_px=16, chosen=chosen)
            matrix, size = np.array(row["transform"]["matrix"]), tuple(row["pixels"])
            view = DrawnTransform(**row["transform"] | {"matrix": matrix, "size": size})
            np.testing.assert_array_equal(
                warp(plain.labels, view), read_picture(evolved / split / row["labels_file_name"])
            )


def test_a_complete_dataset_stays_and_other_settings_are_refused(evolved, capsys):
    before = files(evolved)
    assert main(["dataset", *EVOLVED, "--out", str(evolved)]) == 0
    assert main(["dataset", *EVOLVED, "--seed", "1", "--out", str(evolved)]) == 2
    assert "expected results with seed 1, got results with 0; use another folder, or --force" in capsys.readouterr().err
    assert files(evolved) == before


def test_maps_from_a_list_are_drawn_as_given_ones_and_go_on_after_an_error(tmp_path, monkeypatch):
    """A list as the explorer saves it, with maps of two sizes, one of them twice: rotated, mirrored."""
    maps = [*random_maps(6), *random_maps(3, side=6)]
    maps = [replace(one, metrics={"crossings": plain_measure(one.codes)["crossings"]}) for one in maps]
    listed = [{**vars(road_map), "codes": road_map.codes.tolist()} for road_map in (*maps[:5], *maps)]
    listed += [{"codes": mirror(rotate(road_map.codes)).tolist()} for road_map in maps]
    known = [{name: value for name, value in one.items() if value is not None} for one in listed]
    (tmp_path / "list.json").write_text(json.dumps(known))
    spec = DatasetSpec(maps_from=tmp_path / "list.json", tile_px=16, split=(0.5, 0.25, 0.25))
    assert (spec.maps, spec.size, spec.shapes) == (9, ((5, 6),), [(5, 5), (6, 6)])
    make_dataset(small(maps_from=maps), tmp_path / "expected", workers=1)

    drawn = []

    def full_disk(*given):
        drawn.append(given)
        if len(drawn) == 5:
            raise OSError(28, "No space left on device", "picture")
        return write_sample(*given)

    monkeypatch.setattr("elitelanes_jax.dataset._drawing.write_sample", full_disk)
    with pytest.raises(OSError, match="No space left"):
        make_dataset(spec, tmp_path / "out", workers=1)
    make_dataset(spec, tmp_path / "out", workers=1)
    assert len(drawn) == 5 + 9 - 4
    assert files(tmp_path / "out") == files(tmp_path / "expected")


DAMAGES = {
    "cut": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "zero": lambda c: bytes(len(c)),
}


def interrupt_after(number, monkeypatch):
    """Makes a run of a dataset fail after some samples, as on a full disk."""
    drawn = []

    def full_disk(*given):
        drawn.append(given)
        if len(drawn) > number:
            raise OSError(28, "No space left on device", "picture")
        return write_sample(*given)

    monkeypatch.setattr("elitelanes_jax.dataset._drawing.write_sample", full_disk)


@pytest.mark.parametrize("what", ["pictures", "labels", "records"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_files_are_drawn_again(damage, what, given, tmp_path, monkeypatch):
    """After a loss of power, the last files of a run may be cut off, empty or zero."""
    with monkeypatch.context() as patch:
        interrupt_after(9, patch)
        with pytest.raises(OSError, match="No space left"):
            make_dataset(small(), tmp_path / "out", workers=1)
    unfinished = tmp_path / ".out-unfinished"
    pattern = {"pictures": "files/*/image/*.png", "labels": "files/*/labels/*.png", "records": "kept/records/*.jsonl"}
    damaged = sorted(unfinished.glob(pattern[what]))[:3]
    assert damaged
    for file in damaged:
        file.write_bytes(DAMAGES[damage](file.read_bytes()))
    make_dataset(small(), tmp_path / "out", workers=1)
    assert files(tmp_path / "out") == files(given)


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_rounds_are_evolved_again(damage, tmp_path, monkeypatch):
    spec = small(maps_from=None, maps=20, size="3..4 4", search=SearchSpec(preset="paper", evaluations=2000))
    make_dataset(spec, tmp_path / "expected", workers=1)
    with monkeypatch.context() as patch:
        interrupt_after(3, patch)
        with pytest.raises(OSError, match="No space left"):
            make_dataset(spec, tmp_path / "out", workers=1)
    rounds = [*(tmp_path / ".out-unfinished" / "kept" / "maps").iterdir()]
    assert len(rounds) == 2
    for file in rounds:
        file.write_bytes(DAMAGES[damage](file.read_bytes()))
    make_dataset(spec, tmp_path / "out", workers=1)
    assert files(tmp_path / "out") == files(tmp_path / "expected")


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


def test_hugging_face_datasets_loads_each_split_of_maps_that_differ(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    ring, ladder = np.array([[6, 3], [12, 9]]), np.array([[6, 7, 3], [12, 13, 9]])
    furnished = furnish(RoadMap(np.array([[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]])), "trees=3 duckies=4")
    maps = [RoadMap(ring, fitness=3, niche=[1, 2], seed=(0, 1)), furnished, RoadMap(ladder, fitness=3.5)]
    maps.append(RoadMap(np.array([[6, 5, 5, 3], [12, 5, 5, 9]])))
    make_dataset(small(maps_from=maps, split=(0.5, 0.25, 0.25)), str(tmp_path / "out"))
    found = []
    for split in SPLITS:
        options = {"data_dir": str(tmp_path / "out" / split), "cache_dir": str(tmp_path / "cache"), "split": "train"}
        loaded = datasets.load_dataset("imagefolder", **options)
        assert [row["codes"] for row in loaded] == [row["codes"] for row in rows_of(tmp_path / "out", split)]
        found += loaded["size"]
    assert sorted(found) == [[2, 2], [2, 3], [2, 4], [3, 4]]


def test_given_maps_need_pictures_of_their_tiles(tmp_path):
    tiles = shutil.copytree(default_tiles(), tmp_path / "tiles", ignore=shutil.ignore_patterns("end_*"))
    stubs = np.array([[4, 0], [1, 0]], np.int8)
    with refused("maps_from", "end, map 0"):
        make_dataset(small(maps_from=[stubs], split=(1, 0, 0), tiles=tiles), str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_without_pycocotools_the_message_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycocotools", None)
    with refused("format: coco needs pycocotools", "pip install pycocotools, ... extra coco ..."):
        make_dataset(small(format="coco"), tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of its own
def test_pycocotools_loads_it(given, tmp_path):
    coco = pytest.importorskip("pycocotools.coco")
    out = tmp_path / "coco"
    make_dataset(small(format="coco"), out)
    pictures, same = (
        sorted(data for name, data in files(one).items() if name.endswith(".png") and "sheet" not in name)
        for one in (out, given)
    )
    assert pictures == same
    for split, count in (("train", 6), ("val", 3), ("test", 3)):
        loaded = coco.COCO(str(out / "annotations" / f"{split}.json"))
        assert len(loaded.getImgIds()) == count and 0 not in loaded.getImgIds()
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


def test_all_views_of_a_map_are_in_one_split(tmp_path):
    about = make_dataset(small(views=3, transforms=STANDARD), tmp_path / "out")
    assert about["pictures"] == {"train": 18, "validation": 9, "test": 9}
    rows = {split: rows_of(tmp_path / "out", split) for split in SPLITS}
    maps = {split: {json.dumps(row["codes"]) for row in found} for split, found in rows.items()}
    assert sum(map(len, maps.values())) == len(set.union(*maps.values())) == 12
    assert len({json.dumps(row["transform"]["matrix"]) for found in rows.values() for row in found}) == 36


def test_memory_does_not_depend_on_the_number_of_views(tmp_path, monkeypatch):
    """Two thousand million views of 12 maps, until the disk is full."""
    drawn = []

    def draw_quickly(*_, **__):
        return Sample({}, {"number": len(drawn)})

    def full_disk(*_):
        drawn.append(1)
        if len(drawn) > 1200:
            raise OSError(28, "No space left on device", "picture")
        return 0  # the checksum

    monkeypatch.setattr("elitelanes_jax.dataset._sampling.draw_from_above", draw_quickly)
    monkeypatch.setattr("elitelanes_jax.dataset._drawing.write_sample", full_disk)
    spec = small(views=2 * 10**9)
    tracemalloc.start()
    for _ in range(2):
        with pytest.raises(OSError, match="No space left"):
            make_dataset(spec, tmp_path / "out", workers=2)
    assert tracemalloc.get_traced_memory()[1] < 2e8
    tracemalloc.stop()
    assert len(drawn) >= 1202


def test_each_niche_is_split_in_the_same_shares():
    maps = [replace(road_map, niche=[number // 40]) for number, road_map in enumerate(random_maps(200, 6))]
    splits = split_maps(DatasetSpec(maps=200, size=6), maps)
    for niche in range(5):
        part = np.bincount(splits[niche * 40 : niche * 40 + 40], minlength=3)
        assert np.abs(part - (32, 4, 4)).max() <= 1


def test_each_round_evolves_other_seeds():
    size = _Size(5, resolve(SearchSpec(), (5, 5)), 9, Path())
    rounds = np.concatenate([size.keys(number).data for number in range(3)])
    np.testing.assert_array_equal(rounds, key_data(seed_keys(5, 48)))


def test_maps_differ_from_those_of_earlier_rounds_and_of_other_sizes(tmp_path, monkeypatch):
    excluded, (other, *maps) = [], random_maps(20, 6)

    def choose(count, seed, *, exclude, min_difference):
        excluded.append(exclude)
        return Choice([maps.pop() for _ in range(8)], 8, {}, 0)

    monkeypatch.setattr("elitelanes_jax.dataset._plan.evolve_search", lambda *_: SimpleNamespace(choose=choose))
    size = _Size(5, resolve(SearchSpec(), (6, 6)), 16, tmp_path)
    first, second = size.rounds([other.codes])
    assert len(second) == 8
    assert [len(grids) for grids in excluded] == [1, 9]
    np.testing.assert_array_equal(excluded[1], [other.codes, *(road_map.codes for road_map in first)])


def test_fewer_maps_than_asked_for_end_the_command(tmp_path, capsys):
    few = [*SEARCH, "--maps", "44", "--size", "3", "4", "--split", "1", "0", "0"]  # all that there are
    assert main(["dataset", *few, "--out", str(tmp_path / "out")]) == 1
    assert not (tmp_path / "out").exists()
    message = capsys.readouterr().err
    found = int(message.split("elitelanes: found ")[1].split()[0])
    assert 10 <= found < 44
    assert f"{found} different ones of 44 maps of 3 x 4 tiles; larger sizes, more evaluations or fewer maps" in message


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


def furnished(what):
    search = SearchSpec(fill=False, where=["empty_cells=2.."], method="ea", preset="paper", evaluations=2000)
    return DatasetSpec(maps=4, size=4, split=(1, 0, 0), tile_px=16, search=search, furnish=what)


@pytest.mark.slow
def test_maps_are_kept_for_other_objects_if_some_do_not_fit(tmp_path, monkeypatch):
    out, kept = tmp_path / "out", "the maps are kept"
    with refused("furnish: map ...: houses", "99, of which ... fit", hint=kept):
        make_dataset(furnished("houses=99"), out)
    with monkeypatch.context() as patch:
        patch.setattr("elitelanes_jax.dataset._plan.evolve_search", interrupt)
        with refused("furnish: map ...: duckies", "99, of which ... fit", hint=kept):
            make_dataset(furnished("duckies=99"), out)
        make_dataset(furnished("duckies=1"), out)
        for name in ("duckies=1", None):
            with pytest.raises(KeyboardInterrupt):
                make_dataset(furnished(name), tmp_path / f"new-{name}")
    make_dataset(furnished("duckies=1"), tmp_path / "expected")
    assert files(out) == files(tmp_path / "expected")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["expected", "out"]


@pytest.mark.slow
def test_pictures_with_other_objects_are_not_resumed(tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("elitelanes_jax.dataset._finishing.write_card", interrupt)
        with pytest.raises(KeyboardInterrupt):
            make_dataset(furnished("duckies=1"), out)
        patch.setattr("elitelanes_jax.dataset._plan.evolve_search", interrupt)
        with refused(out, "results with 1...", expected="furnish duckies 2", hint="force=True"):
            make_dataset(furnished("duckies=2"), out)
        with refused(out, "results with ...", expected="furnish None", hint="force=True"):
            make_dataset(furnished(None), out)
    make_dataset(furnished(None), out, force=True)
    make_dataset(furnished(None), tmp_path / "expected")
    assert files(out) == files(tmp_path / "expected")


def test_pictures_of_unknown_objects_are_drawn_anew(tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("elitelanes_jax.dataset._finishing.write_card", interrupt)
        with pytest.raises(KeyboardInterrupt):
            make_dataset(furnished(None), out)
    with refused(out, "that of dataset", expected="render"), output_folder(out, {"command": "render"}):
        pass
    (objects,) = tmp_path.glob("*/*/pictures.json")
    objects.unlink()
    make_dataset(furnished("duckies=1"), out)
    make_dataset(furnished("duckies=1"), tmp_path / "expected")
    assert files(out) == files(tmp_path / "expected")


def interrupt(*_, **__):
    raise KeyboardInterrupt


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no such processes")
@pytest.mark.slow
@pytest.mark.parametrize("what", ["dataset", "evolved"])
@pytest.mark.parametrize("kills", [3, 99])
def test_ended_at_any_moment_it_continues_to_the_same_files(kills, what, tmp_path):
    program = [sys.executable, killed_runs.__file__, tmp_path / "out", str(kills), "0", what, "SIGINT", "SIGKILL"]
    ran = subprocess.run(program, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    *digests, last = map(json.loads, ran.stdout.splitlines())
    assert last == {"kills": kills} and len(digests) > 1 and len({one["digest"] for one in digests}) == 1


def test_it_works_where_the_system_counts_processors_otherwise(tmp_path, monkeypatch, given):
    """Runs as on macOS and Windows, which lack `os.sched_getaffinity`."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    make_dataset(small(), tmp_path / "out")
    assert files(tmp_path / "out") == files(given)


WITHOUT_FCNTL = """
import sys

sys.modules["fcntl"] = None
from elitelanes_jax._util.folders import output_folder

with output_folder(sys.argv[1], {}):
    try:
        with output_folder(sys.argv[1], {}):
            print("two at once")
    except ValueError as error:
        print(error)
"""


def test_one_run_at_a_time_has_a_folder_without_fcntl(tmp_path):
    """Runs as on Windows, which lacks the module `fcntl`."""
    command = [sys.executable, "-c", WITHOUT_FCNTL, str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{tmp_path / 'out'}: expected no other run at work in it, got one, process ")
