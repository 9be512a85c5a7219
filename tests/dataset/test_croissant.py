"""Croissant: what it names is there, it says what the card says, and mlcroissant loads it (make shards)."""

import hashlib
import json
import re
import shutil
import warnings
from fnmatch import fnmatch

import numpy as np
import pytest
from folders import files, read_picture
from given_maps import small

from elitelanes_jax.dataset import merge_dataset
from elitelanes_jax.dataset.make import make_dataset
from elitelanes_jax.tiles.tileset import default_tiles

LAYOUTS = ["imagefolder", "coco", "webdataset", "parquet"]
ROBOT = {"camera": {"rows": 24, "columns": 32}, "furnish": "lane_duckies=2"}


def needs(layout):
    for name, package in (("coco", "pycocotools"), ("parquet", "pyarrow")):
        if layout == name:
            pytest.importorskip(package)


def described(folder):
    return json.loads((folder / "croissant.json").read_text())


def nodes(value):
    """All records of a description."""
    if isinstance(value, dict):
        yield value
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from nodes(part)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_all_that_is_named_is_there(layout, tmp_path):
    needs(layout)
    out = tmp_path / "out"
    about = make_dataset(small(views=2, format=layout, **ROBOT), out)
    croissant = described(out)
    assert "http://mlcommons.org/croissant/1.1" in croissant["conformsTo"]
    names = {node["@id"] for node in nodes(croissant) if "@type" in node and "@id" in node}
    referred = {node["@id"] for node in nodes(croissant) if set(node) == {"@id"}}
    assert referred <= names and len(referred) > 1
    there = list(files(out))
    for entry in croissant["distribution"]:
        if entry["@type"] == "cr:FileObject":
            content = (out / entry["contentUrl"]).read_bytes()
            assert entry["sha256"] == hashlib.sha256(content).hexdigest()
        elif "containedIn" not in entry:
            for pattern in entry["includes"]:
                assert any(fnmatch(name, pattern) for name in there), pattern
    splits = next(entry for entry in croissant["recordSet"] if entry["@id"] == "splits")
    assert len(splits["data"]) == sum(count > 0 for count in about["pictures"].values())


@pytest.mark.parametrize("camera", [False, True])
def test_it_says_what_the_card_says(camera, tmp_path):
    out = tmp_path / "out"
    about = make_dataset(small(**(ROBOT if camera else {})), out)
    croissant, card = described(out), (out / "README.md").read_text()
    for sentence in croissant["description"].split(". "):
        assert sentence.strip(".") in " ".join(card.split())
    tags = re.search(r"tags: \[(.*)\]", card)[1].split(", ")
    tasks = re.search(r"task_categories: \[(.*)\]", card)[1].split(", ")
    assert croissant["keywords"] == [*tags, *tasks]
    assert croissant["license"] == "https://spdx.org/licenses/Apache-2.0" and "license: apache-2.0" in card
    (metadata,) = [entry for entry in croissant["recordSet"] if entry["@id"] == "metadata"]
    rows = [json.loads(line) for line in (out / "train" / "metadata.jsonl").read_text().splitlines()]
    fields = {field["@id"].split("/")[1] for field in metadata["field"]}
    assert fields - {"split"} == {name for row in rows for name in row if not name.endswith("_file_name")}
    for field in metadata["field"]:
        name = field["@id"].split("/")[1]
        assert name in ("split", "objects") or f"`{name}`" in card
    assert ("lane_offset" in fields) == camera == ("- lanes: 0.2 tiles beside" in card)
    assert (about["tile_set"].get("lane_offset") == 0.2) == camera


def test_parts_have_it_too(tmp_path):
    spec = small(**ROBOT)
    make_dataset(spec, tmp_path / "whole")
    for number in (1, 2):
        make_dataset(small(part=(number, 2), **ROBOT), tmp_path / str(number))
        description = described(tmp_path / str(number))["description"]
        assert f"Part {number} of 2" in description and "6 pictures of 6 road networks" in description
        sets = {entry["@id"] for entry in described(tmp_path / str(number))["recordSet"]}
        assert sets == {"splits", "image", "labels", "instances"}
    merge_dataset([tmp_path / "1", tmp_path / "2"], tmp_path / "merged")
    assert described(tmp_path / "merged") == described(tmp_path / "whole")


@pytest.mark.parametrize("layout", [*LAYOUTS, "part"])
@pytest.mark.filterwarnings("ignore")  # of mlcroissant and pandas
def test_mlcroissant_finds_no_error_and_loads_all(layout, tmp_path, monkeypatch):
    monkeypatch.setenv("CROISSANT_CACHE", str(tmp_path / "cache"))
    mlcroissant = pytest.importorskip("mlcroissant")
    needs(layout)
    out, part = tmp_path / "out", {"part": (1, 2)} if layout == "part" else {"format": layout}
    about = make_dataset(small(views=2, **part, **ROBOT), out)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = mlcroissant.Dataset(jsonld=out / "croissant.json")
        assert not loaded.metadata.ctx.issues.errors
        records = {entry.id: list(loaded.records(entry.id)) for entry in loaded.metadata.record_sets}
    if layout == "webdataset":
        train = records["train-image"]
        content = json.loads(records["train-metadata"][0]["train-metadata/json"])
        assert content["number"] == records["train-metadata"][0]["train-metadata/number"] == 0
        assert all(row["train-image/split"] == b"train" for row in train)
    elif layout == "parquet":
        train = [row for row in records["samples"] if row["samples/split"] == b"train"]
        assert all({"x", "y", "theta"} == {name.split("/")[-1] for name in row["samples/pose"]} for row in train)
    else:
        train = [row for row in records["image"] if row["image/split"] == b"train"]
    assert len(train) == (about["pictures"]["train"] if layout != "part" else 6)
    if layout == "imagefolder":
        for row in train:
            picture = read_picture(out / "train" / "image" / f"{row['image/number']:06d}.png")
            np.testing.assert_array_equal(np.array(row["image/image"]), picture[..., ::-1])
        lines = [json.loads(line) for line in (out / "train" / "metadata.jsonl").read_text().splitlines()]
        rows = [row for row in records["metadata"] if row["metadata/split"] == b"train"]
        for row, line in zip(rows, lines, strict=True):
            assert row["metadata/codes"] == line["codes"] and row["metadata/number"] == line["number"]
            assert row["metadata/nearest"]["metadata/nearest/d"] == pytest.approx(line["nearest"]["d"])
            assert len(row["metadata/objects"] or []) == len(line["objects"]["id"])


def test_the_lanes_of_a_tile_set_are_recorded(tmp_path):
    tiles = tmp_path / "tiles"
    shutil.copytree(default_tiles(), tiles)
    (tiles / "tileset.toml").write_text("lane_offset = 0.217\nlane_offset_spread = 0.0042\n")
    about = make_dataset(small(tiles=tiles, **ROBOT), tmp_path / "out")
    assert (about["tile_set"]["lane_offset"], about["tile_set"]["lane_offset_spread"]) == (0.217, 0.0042)
    card = (tmp_path / "out" / "README.md").read_text()
    assert "- lanes: 0.217 tiles beside the road's middle, with a standard deviation of 0.0042" in card
    rows = [json.loads(line) for line in (tmp_path / "out" / "train" / "metadata.jsonl").read_text().splitlines()]
    assert all((row["lane_offset"], row["lane_offset_spread"]) == (0.217, 0.0042) for row in rows)
