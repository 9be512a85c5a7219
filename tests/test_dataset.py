"""Datasets: what is written, how it is split, that it can be killed, and what real readers make of it."""

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from elitelanes_jax.cli import main
from elitelanes_jax.dataset import Settings, make, make_dataset
from elitelanes_jax.dataset.formats import FORMATS, SPLITS
from elitelanes_jax.dataset.plan import given_maps, split_maps
from elitelanes_jax.dataset.settings import maps_by_side, maps_by_split, tiles_by_split
from elitelanes_jax.dataset.work import work_folder
from elitelanes_jax.errors import InputError
from elitelanes_jax.render import LABELS, render
from elitelanes_jax.roadmap import RoadMap
from elitelanes_jax.symmetry import canonical
from elitelanes_jax.tilesets import default_tiles, load_tiles
from elitelanes_jax.transforms import STANDARD, Transforms, View, warp
from elitelanes_jax.wfc import generate_batch
from elitelanes_jax.wishes import Wishes

SMALL = ["--maps", "20", "--size", "4", "5", "--tile-px", "16", "--evaluations", "4000", "--split", "0.6", "0.2", "0.2"]


def some_maps(count=12, side=5, seed=0):
    grids = generate_batch(np.random.default_rng(seed), count, (side, side), border="closed").grid
    return [RoadMap(np.asarray(grid, np.int8), niche=[number % 3]) for number, grid in enumerate(grids)]


def small(**others):
    return Settings(**{"maps": 12, "size": (5, 5), "tile_px": 16, "split": (0.5, 0.25, 0.25)} | others)


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def read(file):
    return cv2.imread(str(file), cv2.IMREAD_UNCHANGED)


def rows_of(folder, split):
    return [json.loads(line) for line in (folder / split / "metadata.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def evolved(tmp_path_factory):
    out = tmp_path_factory.mktemp("evolved") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        assert main(["dataset", *SMALL, "--out", str(out)]) == 0
    return out


def test_what_is_written(evolved):
    about = json.loads((evolved / "dataset.json").read_text())
    assert about["pictures"] == {"train": 12, "validation": 4, "test": 4}
    names = set(files(evolved))
    assert {"README.md", "contact-sheet.png", "dataset.json"} <= names
    forms, sides, pixels = set(), [], {split: np.zeros(4, int) for split in SPLITS}
    for split in SPLITS:
        rows = rows_of(evolved, split)
        assert len(rows) == about["pictures"][split]
        for row in rows:
            image, labels = (read(evolved / split / row[f"{name}_file_name"]) for name in ("image", "labels"))
            side = len(row["codes"])
            assert image.shape == (16 * side, 16 * side, 3)
            assert labels.shape == (16 * side, 16 * side)
            assert labels.max() < len(LABELS)
            pixels[split] += np.bincount(labels.ravel(), minlength=4)
            metrics = row["metrics"]
            assert (metrics["components"], metrics["dead_ends"], metrics["boundary_violations"]) == (1, 0, 0)
            forms.add(canonical(np.array(row["codes"])))
            sides.append(side)
            names -= {f"{split}/{row[f'{name}_file_name']}" for name in ("image", "labels")}
        names.remove(f"{split}/metadata.jsonl")
        assert pixels[split].tolist() == about["class_pixels"][split]
    assert names == {"README.md", "contact-sheet.png", "dataset.json"}
    assert len(forms) == 20
    assert sorted(sides) == [4] * 10 + [5] * 10


def test_labels_are_those_of_the_tiles_that_lie_there(evolved):
    tiles = load_tiles()
    places = {tile.name: place for place, tile in enumerate(tiles.pictures)}
    for split in SPLITS:
        for row in rows_of(evolved, split):
            tile = np.vectorize(places.__getitem__)(row["tiles"])
            chosen = np.stack([tile, row["quarter_turns"]], axis=-1)
            plain = render(row["codes"], tiles, tile_px=16, chosen=chosen)
            view = View(**row["transform"] | {"matrix": np.array(row["transform"]["matrix"]), "size": row["pixels"]})
            view = view._replace(size=tuple(row["pixels"]))
            np.testing.assert_array_equal(warp(plain.labels, view), read(evolved / split / row["labels_file_name"]))


def test_once_more_changes_nothing_and_other_settings_are_refused(evolved, capsys):
    before = files(evolved)
    assert main(["dataset", *SMALL, "--out", str(evolved)]) == 0
    assert main(["dataset", *SMALL, "--seed", "1", "--out", str(evolved)]) == 2
    assert "expected results of seed 1, got some of 0" in capsys.readouterr().err
    assert files(evolved) == before


def test_the_card_says_what_there_is(evolved):
    card = (evolved / "README.md").read_text()
    assert card.startswith("---\n")
    for words in (
        "license: apache-2.0",
        "20 pictures of 20 road networks, 4 x 4 to 5 x 5 tiles",
        "| 12 | 4 | 4 |",
        "lane separator",
    ):
        assert words in card
    assert read(evolved / "contact-sheet.png").shape[1] > 800


@pytest.mark.parametrize("name", ["imagefolder", "mmseg", "coco", "plain"])
def test_all_formats_hold_the_same(tmp_path, name):
    pytest.importorskip("pycocotools")
    maps = some_maps()
    make_dataset(small(format=name), tmp_path / name, maps=maps)
    make_dataset(small(format="plain"), tmp_path / "other", maps=maps)
    pictures = [
        sorted(data for file, data in files(out).items() if file.endswith(".png") and "sheet" not in file)
        for out in (tmp_path / name, tmp_path / "other")
    ]
    assert len(pictures[0]) == (2 if name != "plain" else 5) * 12
    assert set(pictures[0]) <= set(pictures[1])


def test_hugging_face_datasets_loads_it(evolved, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    loaded = datasets.load_dataset("imagefolder", data_dir=str(evolved), cache_dir=str(tmp_path))
    assert {split: len(part) for split, part in loaded.items()} == {"train": 12, "validation": 4, "test": 4}
    for split, part in loaded.items():
        for sample, row in zip(part, rows_of(evolved, split), strict=True):
            labels = read(evolved / split / row["labels_file_name"])
            np.testing.assert_array_equal(np.array(sample["labels"]), labels)
            np.testing.assert_array_equal(
                np.array(sample["image"])[..., ::-1], read(evolved / split / row["image_file_name"])
            )
            assert sample["codes"] == row["codes"]
            assert sample["transform"]["matrix"] == row["transform"]["matrix"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of its own
def test_hugging_face_datasets_loads_one_split(tmp_path, monkeypatch):
    """And masks of one's own, of which the held-out tiles have none, whatever their names."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    for name in ("img", "ann", "points", "size"):
        shutil.copy(tmp_path / "tiles/turn_1/road.png", tmp_path / f"tiles/turn_1/{name}.png")
    settings = small(tiles=tmp_path / "tiles", split=(1.0, 0.0, 0.0))
    make_dataset(settings, tmp_path / "one", maps=some_maps())
    loaded = datasets.load_dataset("imagefolder", data_dir=str(tmp_path / "one"), cache_dir=str(tmp_path / "cache"))
    assert {split: len(part) for split, part in loaded.items()} == {"train": 12}
    maps = [road_map for road_map in some_maps(120) if 15 not in road_map.codes][:12]
    make_dataset(small(tiles=tmp_path / "tiles", hold_out_tiles=True), tmp_path / "held", maps=maps)
    loaded = datasets.load_dataset("imagefolder", data_dir=str(tmp_path / "held"), cache_dir=str(tmp_path / "cache"))
    for sample in (*loaded["train"], *loaded["test"]):
        for name in ("img", "ann", "points", "size"):
            assert set(np.unique(np.array(sample[f"layers_{name}"]))) <= {0, 255}
        assert sample["size"] == [5, 5]


@pytest.mark.parametrize("name", ["imagefolder", "mmseg", "coco", "plain"])
def test_no_two_layers_lie_in_one_place(name):
    layout = FORMATS[name]
    layers = ["image", "labels", *layout.layers, "images", "img", "ann", "points", "annotations", "layers"]
    assert len({layout.file(split, 3, layer) for layer in layers for split in range(3)}) == 3 * len(layers)


def test_without_pycocotools_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycocotools", None)
    with pytest.raises(InputError, match=r"^format: coco needs pycocotools: pip install pycocotools$"):
        make_dataset(small(format="coco"), tmp_path / "out", maps=some_maps())
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of its own
def test_pycocotools_loads_it(tmp_path):
    coco = pytest.importorskip("pycocotools.coco")
    out = tmp_path / "out"
    make_dataset(small(format="coco"), out, maps=some_maps())
    for split, count in (("train", 6), ("val", 3), ("test", 3)):
        loaded = coco.COCO(str(out / "annotations" / f"{split}.json"))
        assert len(loaded.getImgIds()) == count
        for image in loaded.loadImgs(loaded.getImgIds()):
            labels = read(out / "labels" / split / image["file_name"])
            assert read(out / "images" / split / image["file_name"]).shape[:2] == (image["height"], image["width"])
            found = np.zeros_like(labels)
            for one in loaded.loadAnns(loaded.getAnnIds(image["id"])):
                mask = loaded.annToMask(one)
                assert mask.sum() == one["area"]
                found[mask > 0] = one["category_id"]
            np.testing.assert_array_equal(found, labels)


def test_mmsegmentation_loads_it(tmp_path):
    mmseg = pytest.importorskip("mmseg.datasets")  # needs all of PyTorch, so it is not among the tests' packages
    out = tmp_path / "out"
    make_dataset(small(format="mmseg"), out, maps=some_maps())
    for split, count in (("train", 6), ("val", 3), ("test", 3)):
        prefix = {"img_path": f"img_dir/{split}", "seg_map_path": f"ann_dir/{split}"}
        loaded = mmseg.BaseSegDataset(
            data_root=str(out), img_suffix=".png", data_prefix=prefix, metainfo={"classes": LABELS}
        )
        assert len(loaded) == count
        for sample in loaded:
            annotated = mmseg.transforms.LoadAnnotations()(dict(sample))
            np.testing.assert_array_equal(annotated["gt_seg_map"], read(sample["seg_map_path"]))


def test_mmsegmentation_finds_pairs(tmp_path):
    """As its BaseSegDataset does: an annotation for every image, of the same name."""
    out = tmp_path / "out"
    make_dataset(small(format="mmseg"), out, maps=some_maps())
    for split in ("train", "val", "test"):
        images = sorted(file.name for file in (out / "img_dir" / split).iterdir())
        assert images == sorted(file.name for file in (out / "ann_dir" / split).iterdir())
        for name in images:
            annotation = read(out / "ann_dir" / split / name)
            assert annotation.dtype == np.uint8
            assert annotation.ndim == 2
            assert annotation.shape == read(out / "img_dir" / split / name).shape[:2]


def test_layers_and_points_of_ones_own_go_through_the_same_view(tmp_path):
    """A picture whose masks are a disc about a point: in every view the disc's middle is the point."""
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    for place in (tmp_path / "tiles").iterdir():
        if place.is_dir():
            size = read(place / "image.png").shape[0]
            disc = cv2.circle(np.zeros((size, size), np.uint8), (size // 4, size // 3), size // 10, 255, -1)
            cv2.imwrite(str(place / "cones.png"), disc)
            (place / "points.json").write_text(json.dumps({"cone": [[size // 4 + 0.5, size // 3 + 0.5]]}))
    settings = small(tiles=tmp_path / "tiles", format="plain", tile_px=40, transforms=STANDARD)
    make_dataset(settings._replace(maps=3), tmp_path / "out", maps=some_maps(3))
    for row in (row for split in SPLITS for row in rows_of(tmp_path / "out", split)):
        [folder] = (tmp_path / "out").glob(f"*/{row['number']:06d}")
        mask = read(folder / "cones.png")
        assert set(np.unique(mask)) == {0, 255}
        _, _, boxes, centres = cv2.connectedComponentsWithStats(mask)
        height, width = mask.shape
        whole = [
            centre + 0.5
            for (x, y, w, h, _), centre in zip(boxes[1:], centres[1:], strict=True)
            if x and y and x + w < width and y + h < height
        ]
        points = np.array(row["points"]["cone"])
        assert len(whole) >= 9
        for centre in whole:
            assert np.hypot(*(points - centre).T).min() < 1


def test_held_out_tiles_are_in_no_other_split(tmp_path):
    tiles = load_tiles()
    maps = [road_map for road_map in some_maps(120) if 15 not in road_map.codes][:20]
    settings = small(maps=len(maps), hold_out_tiles=True)
    make_dataset(settings, tmp_path / "out", maps=maps)
    shown = {
        split: {name for row in rows_of(tmp_path / "out", split) for line in row["tiles"] for name in line}
        for split in SPLITS
    }
    assert shown["test"]
    assert not shown["test"] & (shown["train"] | shown["validation"])
    seen, _, unseen = tiles_by_split(tiles, settings)
    assert {tile.name for tile in (*seen.tiles, *unseen.tiles)} == {tile.name for tile in tiles.tiles}
    assert "crossing4_1" in {tile.name for tile in seen.tiles}


def test_too_few_maps_without_the_only_crossing_to_hold_out(tmp_path):
    grid = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    maps = [RoadMap(grid, niche=[0])] * 4
    with pytest.raises(InputError, match="expected 1 maps without crossing4, of which there is one picture only"):
        make_dataset(small(maps=4, size=(3, 3), hold_out_tiles=True), tmp_path / "out", maps=maps)


def test_nothing_to_hold_out(tmp_path):
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    for name in ("turn_2", "turn_3", "turn_4"):
        shutil.rmtree(tmp_path / "tiles" / name)
    settings = small(tiles=tmp_path / "tiles", hold_out_tiles=True)
    with pytest.raises(InputError, match="expected two pictures or more of straight, turn .* got one of turn"):
        make_dataset(settings, tmp_path / "out", maps=some_maps())


def test_a_map_is_drawn_in_several_views_all_in_one_split(tmp_path):
    about = make_dataset(small(views=3, transforms=STANDARD), tmp_path / "out", maps=some_maps())
    assert about["pictures"] == {"train": 18, "validation": 9, "test": 9}
    rows = {split: rows_of(tmp_path / "out", split) for split in SPLITS}
    maps = {split: {json.dumps(row["codes"]) for row in found} for split, found in rows.items()}
    assert sum(map(len, maps.values())) == len(set.union(*maps.values())) == 12
    assert len({json.dumps(row["transform"]["matrix"]) for found in rows.values() for row in found}) == 36


@pytest.mark.parametrize("count", [1, 2, 7, 10, 33, 1000])
@pytest.mark.parametrize("split", [(0.8, 0.1, 0.1), (1.0, 0.0, 0.0), (0.34, 0.33, 0.33), (0.0, 0.5, 0.5)])
def test_splits_have_their_shares(count, split):
    counts = maps_by_split(Settings(maps=count, split=split))
    assert sum(counts) == count
    assert all(abs(got - count * share) <= 1 for got, share in zip(counts, split, strict=True))


def test_each_niche_is_split_alike(tmp_path):
    maps = [road_map._replace(niche=[number // 40]) for number, road_map in enumerate(some_maps(200, 3))]
    splits = split_maps(Settings(maps=200), given_maps(maps, tmp_path), load_tiles())
    for niche in range(5):
        part = np.bincount(splits[niche * 40 : niche * 40 + 40], minlength=3)
        assert np.abs(part - (32, 4, 4)).max() <= 1


def test_sizes_share_the_maps():
    assert maps_by_side(Settings(maps=10, size=(3, 6))) == {3: 3, 4: 3, 5: 2, 6: 2}


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"size": (5, 4)}, "size: expected the smallest and the largest side, 2 to 1024, got 5 and 4"),
        ({"maps": 3, "size": (3, 8)}, "maps: expected one of each size at least, 6, got 3"),
        ({"split": (0.5, 0.5, 0.5)}, "split: expected three shares that sum to 1, got 0.5 0.5 0.5"),
        (
            {"transforms": Transforms(crop=100), "size": (5, 9)},
            "at the smallest scale, 80 pixels, got 100",
        ),
        ({"wishes": Wishes(fix=Path("city.json")), "size": (5, 9)}, "fix: expected maps of one size"),
        ({"tile_px": 8}, "tile_px: expected 16 to 512"),
        ({"seed": -1}, "seed: expected a whole number"),
        ({"views": 0}, "expected views to be a whole number, 1 or more"),
        ({"split": (float("nan"), 0.5, 0.5)}, "split: expected three shares"),
        ({"maps": 4, "split": (0.8, 0.1, 0.1)}, "maps: expected enough for one in the validation, 0.1 of them, got 4"),
        ({"transforms": Transforms(scale=(0.0, 0.0))}, "expected scale within 0.25 to 4"),
        ({"transforms": Transforms(crop=-5)}, "expected crop within 16"),
        ({"format": "tar"}, "format: expected one of imagefolder, mmseg, coco, plain, got 'tar'"),
        ({"wishes": Wishes(rules="london")}, "rules: expected"),
        ({"wishes": Wishes(where=("turns=",))}, "where 'turns=': expected a number"),
    ],
)
def test_bad_settings_are_named_and_leave_nothing(tmp_path, settings, said):
    with pytest.raises(InputError, match=said):
        make_dataset(small(**settings), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("maps", "said"),
    [
        (lambda: [], "maps: expected 12 of them, as settings say, got 0"),
        (lambda: some_maps(12, 6), "maps: expected square ones of 5 to 5 tiles, got number 0 of 6 x 6"),
        (
            lambda: [RoadMap(np.full((5, 5), 8, np.int8))] * 12,
            "maps: expected codes that the tile set has",
        ),
    ],
)
def test_given_maps_are_held_to_the_settings(tmp_path, maps, said):
    with pytest.raises(InputError, match=said):
        make_dataset(small(), str(tmp_path / "out"), maps=maps())
    with pytest.raises(InputError, match="expected workers to be a whole number, 1 or more, got 0"):
        make_dataset(small(), tmp_path / "out", workers=0, maps=some_maps())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--transform", "spin"], "transform: expected some of none"),
        (["--split", "a", "b", "c"], "expected a number, 0 or more, got 'a'"),
        (["--tiles", "nowhere"], "nowhere: expected a folder of tile pictures, got none"),
    ],
)
def test_bad_arguments_are_one_line(tmp_path, capsys, arguments, said):
    try:
        code = main(["dataset", *SMALL, *arguments, "--out", str(tmp_path / "out")])
    except SystemExit as stop:
        code = stop.code
    lines = capsys.readouterr().err.splitlines()
    assert code == 2
    assert len(lines) == 1
    assert said in lines[0]
    assert not (tmp_path / "out").exists()


def test_more_maps_than_there_are(tmp_path, capsys):
    few = ["--maps", "9", "--size", "2", "2", "--evaluations", "400", "--out", str(tmp_path / "out")]
    assert main(["dataset", *few, "--split", "1", "0", "0"]) == 1
    assert not (tmp_path / "out").exists()
    assert "found 1 different ones of 9 maps of 2 x 2 tiles" in capsys.readouterr().err


def test_a_second_run_is_refused(tmp_path):
    out = tmp_path / "out"
    with work_folder(out, {}), pytest.raises(InputError, match="out: expected no other run at work in it, got one"):
        make_dataset(small(), out, maps=some_maps())


def test_folders_of_others_are_left_alone(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    for out, said in (("out", "got one with files in it"), ("file", "got a file"), ("file/deeper", "not a directory")):
        with pytest.raises(InputError, match=said):
            make_dataset(small(), tmp_path / out, maps=some_maps())
    assert files(tmp_path) == {"out/thesis.txt": b"mine", "file": b"mine"}


def test_a_full_disk_stops_it_and_it_goes_on(tmp_path):
    """The system refuses files over a limit just as it refuses those that a full disk has no room for."""
    out, whole = tmp_path / "out", tmp_path / "whole"
    before = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (3000, resource.RLIM_INFINITY))"
    stopped = subprocess.run(_program(out, 2, before), capture_output=True, text=True)
    assert stopped.returncode == 1
    assert "OSError" in stopped.stderr
    assert f"File too large: '{out}/" in stopped.stderr
    assert not list(out.rglob("*.part"))
    make_dataset(_KILLED, out, maps=some_maps(40))
    make_dataset(_KILLED, whole, maps=some_maps(40))
    assert files(out) == files(whole)


def test_a_full_disk_is_one_line(tmp_path, monkeypatch, capsys):
    def full(*_, **__):
        raise OSError(28, "No space left on device", "train/image/000003.png")

    monkeypatch.setattr("elitelanes_jax.dataset.make_dataset", full)
    assert main(["dataset", *SMALL, "--out", str(tmp_path / "out")]) == 2
    said = "elitelanes: train/image/000003.png: No space left on device; what is complete stays"
    assert capsys.readouterr().err == f"{said}, and the same command goes on from there\n"


@pytest.mark.parametrize("number", range(4))
def test_an_interruption_while_it_draws_ends_it_and_it_goes_on(tmp_path, monkeypatch, number):
    """Wherever the main thread is at that moment."""
    drawn = make.draw_sample

    def interrupt(*arguments, **others):
        if arguments[2] == number:
            signal.raise_signal(signal.SIGINT)
        return drawn(*arguments, **others)

    monkeypatch.setattr(make, "draw_sample", interrupt)
    with pytest.raises(KeyboardInterrupt):
        make_dataset(small(), tmp_path / "out", maps=some_maps(), workers=3)
    monkeypatch.undo()
    make_dataset(small(), tmp_path / "out", maps=some_maps())
    make_dataset(small(), tmp_path / "whole", maps=some_maps())
    assert files(tmp_path / "out") == files(tmp_path / "whole")


_KILLED = Settings(maps=40, size=(5, 5), tile_px=32)


def _program(out, workers, before=""):
    lines = [
        "import sys, pathlib",
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})",
        "from test_dataset import _KILLED, make_dataset, some_maps",
        before,
        "maps = some_maps(40)",
        "print('ready', flush=True)",
        f"make_dataset(_KILLED, pathlib.Path({str(out)!r}), workers={workers}, maps=maps)",
    ]
    return [sys.executable, "-c", "\n".join(lines)]


def _killed(program, out, kills, longest, seed):
    """Kills runs at random moments, until so many have hit."""
    rng = random.Random(seed)
    hit = 0
    while hit < kills:
        with subprocess.Popen(program(out, rng.randint(1, 8)), stdout=subprocess.PIPE, text=True) as run:
            assert run.stdout.readline() == "ready\n"
            time.sleep(rng.uniform(0, longest))
            run.send_signal(rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGINT]))
        hit += run.returncode != 0
        if run.returncode == 0:
            shutil.rmtree(out)  # it was done before the kill; begin again


def test_killed_and_gone_on_with_it_is_the_same(tmp_path):
    make_dataset(_KILLED, tmp_path / "whole", maps=some_maps(40), workers=1)
    _killed(_program, tmp_path / "out", 4, 0.25, seed=0)
    make_dataset(_KILLED, tmp_path / "out", maps=some_maps(40), workers=3)
    assert files(tmp_path / "out") == files(tmp_path / "whole")


@pytest.mark.slow
def test_a_hundred_kills(tmp_path):
    make_dataset(_KILLED, tmp_path / "whole", maps=some_maps(40), workers=1)
    whole = files(tmp_path / "whole")
    for seed in range(16):
        out = tmp_path / f"out-{seed}"
        _killed(_program, out, 5, 0.25, seed)
        make_dataset(_KILLED, out, maps=some_maps(40), workers=3)
        assert files(out) == whole


@pytest.mark.slow
def test_twenty_kills_while_maps_evolve(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    arguments = ["dataset", "--maps", "40", "--size", "4", "6", "--tile-px", "32", "--evaluations", "40000", "--out"]
    assert main([*arguments, str(tmp_path / "whole")]) == 0

    def program(out, workers):
        command = [*arguments, str(out), "--workers", str(workers)]
        run = f"from elitelanes_jax.cli import main; print('ready', flush=True); raise SystemExit(main({command!r}))"
        return [sys.executable, "-c", run]

    for seed in range(4):
        _killed(program, tmp_path / "out", 5, 8, seed)
        assert main([*arguments, str(tmp_path / "out")]) == 0
        assert files(tmp_path / "out") == files(tmp_path / "whole")
        shutil.rmtree(tmp_path / "out")
