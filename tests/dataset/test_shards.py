"""Shards: the samples of other layouts, the readers of other libraries, and runs that are ended and continue."""

import contextlib
import gc
import importlib.util
import io
import json
import re
import sys
import tarfile
import warnings
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from folders import files, read_picture
from given_maps import small
from refusals import refused

from elitelanes_jax import DatasetSpec, RoadMap, make_dataset
from elitelanes_jax._util.engine import Pool
from elitelanes_jax.dataset._drawing import Drawing, _tasks
from elitelanes_jax.dataset._records import Samples, record_line
from elitelanes_jax.dataset._transforms import STANDARD
from elitelanes_jax.maps.spec import SPLITS

SHARDS = ["webdataset", "parquet"]
LAYERS = ("image", "labels", "instances")
LOOP, WIDE = [[6, 5, 3], [10, 0, 10], [12, 5, 9]], [[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]]
TOWN = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [14, 5, 5, 11], [12, 5, 5, 9]])


@pytest.fixture(autouse=True)
def small_shards(monkeypatch):
    """Four samples in a shard, three rows in a row group, and no network."""
    monkeypatch.setattr("elitelanes_jax.dataset._records._BLOCK", 4)
    monkeypatch.setattr("elitelanes_jax.dataset._shards._ROWS", 3)
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")


def needs(name):
    if name == "parquet":
        pytest.importorskip("pyarrow")


def robot_views(**others):
    """Views from a robot with objects. One map has a fitness, a seed and a fraction, another one other metrics."""
    maps = [
        RoadMap(TOWN, metrics={"density": 0.5}, fitness=3, niche=[1, 2], seed=(0, 1)),
        RoadMap(np.array(LOOP), metrics={"crossings": 0, "density": 1}),
        RoadMap(np.array(WIDE)),
    ]
    options = {"maps_from": maps, "split": (1, 0, 0), "views": 3, "furnish": "duckies=1", "transforms": STANDARD}
    return small(camera={"rows": 24, "columns": 32, "lines": 0.05}, **options | others)


def decoded(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


def samples_of(folder, split, name):
    """Yields (pictures, record) of each sample of a split, read by nothing of ours."""
    if name == "webdataset":
        for shard in sorted((folder / split).glob("*.tar")):
            with tarfile.open(shard) as archive:
                contents = {entry.name: archive.extractfile(entry).read() for entry in archive}
            for file, content in contents.items():
                key, _, kind = file.partition(".")
                if kind == "json":
                    layers = [layer for layer in LAYERS if f"{key}.{layer}.png" in contents]
                    yield {layer: contents[f"{key}.{layer}.png"] for layer in layers}, json.loads(content)
    else:
        from pyarrow import parquet

        for shard in sorted((folder / "data").glob(f"{split}-*.parquet")):
            for row in parquet.read_table(shard).to_pylist():
                layers = [layer for layer in LAYERS if layer in row]
                yield {layer: row.pop(layer)["bytes"] for layer in layers}, without_none(row)


def without_none(value):
    """Removes what a column has for samples without it."""
    if isinstance(value, dict):
        return {key: without_none(part) for key, part in value.items() if part is not None}
    if isinstance(value, list):
        return [without_none(part) for part in value]
    return value


@contextlib.contextmanager
def open_files_allowed():
    """The package webdataset does not close the shards that it has read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        yield
        gc.collect()


@pytest.mark.parametrize("name", SHARDS)
@pytest.mark.parametrize("spec", [small, robot_views])
def test_shards_have_the_pictures_and_the_metadata_of_coco(name, spec, tmp_path):
    """The layout coco keeps the records as they are drawn."""
    needs(name)
    pytest.importorskip("pycocotools")
    make_dataset(spec(format="coco"), tmp_path / "coco")
    about = make_dataset(spec(format=name), tmp_path / "out", workers=1)
    for shard in tmp_path.rglob("*.parquet"):
        from pyarrow.parquet import read_metadata

        rows = read_metadata(shard)
        assert max(rows.row_group(index).num_rows for index in range(rows.num_row_groups)) <= 3
    for split, short in zip(SPLITS, ("train", "val", "test"), strict=True):
        lines = (tmp_path / "coco" / "metadata" / f"{short}.jsonl").read_text() if about["pictures"][split] else ""
        found = list(samples_of(tmp_path / "out", split, name))
        assert len(found) == about["pictures"][split] == len(lines.splitlines())
        for (pictures, record), line in zip(found, lines.splitlines(), strict=True):
            expected = json.loads(line)
            assert record == without_none(expected)
            assert len(pictures) == 2 + ("objects" in expected)
            for layer, content in pictures.items():
                folder = tmp_path / "coco" / {"image": "images"}.get(layer, layer) / short
                assert content == (folder / f"{record['number']:06d}.png").read_bytes()
    make_dataset(spec(format=name), tmp_path / "again", workers=3)
    assert files(tmp_path / "again") == files(tmp_path / "out")


@pytest.mark.parametrize("name", SHARDS)
def test_shards_go_on_after_an_error(name, tmp_path, monkeypatch):
    """The second shard of the training split is not complete; the first one is not drawn again."""
    needs(name)
    spec = small(views=2, format=name)
    make_dataset(spec, tmp_path / "expected")
    from elitelanes_jax.dataset._sampling import draw_from_above

    drawn = []

    def full_disk(*given):
        drawn.append(given[2])
        if len(drawn) == 6:
            raise OSError(28, "No space left on device", "picture")
        return draw_from_above(*given)

    monkeypatch.setattr("elitelanes_jax.dataset._sampling.draw_from_above", full_disk)
    with pytest.raises(OSError, match="No space left"):
        make_dataset(spec, tmp_path / "out", workers=1)
    files_so_far = files(tmp_path / ".out-unfinished" / "files")
    assert len(files_so_far) == 1, "no part of a shard is left"
    before = len(drawn)
    make_dataset(spec, tmp_path / "out", workers=1)
    assert len(drawn) - before == 24 - 4 + 12, "the rest, and the samples of the sheet"
    assert files(tmp_path / "out") == files(tmp_path / "expected")


@pytest.mark.parametrize("what", ["shard", "records", "line"])
def test_a_damaged_shard_is_drawn_again(what, tmp_path, monkeypatch):
    spec = small(views=2, format="webdataset")
    make_dataset(spec, tmp_path / "expected")
    from elitelanes_jax.dataset._finishing import finish

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("elitelanes_jax.dataset.make.finish", interrupt)
        with pytest.raises(KeyboardInterrupt):
            make_dataset(spec, tmp_path / "out", workers=1)
    unfinished = tmp_path / ".out-unfinished"
    file = next(iter(sorted((unfinished / "files").rglob("*.tar"))))
    if what != "shard":
        file = unfinished / "kept" / "records" / "train-0.jsonl"
    content = file.read_bytes()
    # A zero in the middle damages one line of the records.
    damaged = content[: len(content) // 2] + (b"\0" + content[len(content) // 2 + 1 :] if what == "line" else b"")
    file.write_bytes(damaged)
    monkeypatch.setattr("elitelanes_jax.dataset.make.finish", finish)
    make_dataset(spec, tmp_path / "out", workers=1)
    assert files(tmp_path / "out") == files(tmp_path / "expected")


def test_an_executor_writes_the_same_shards(tmp_path):
    spec = robot_views(format="webdataset")
    make_dataset(spec, tmp_path / "here")
    with ThreadPoolExecutor(2) as pool:
        make_dataset(spec, tmp_path / "executor", executor=pool, parts=2)
    assert files(tmp_path / "executor") == files(tmp_path / "here")


def test_a_part_has_no_shards():
    with refused("part", "parquet"):
        small(format="parquet", part=(1, 2))


@pytest.mark.parametrize("name", SHARDS)
def test_the_readme_of_shards_loads_them(name, tmp_path):
    needs(name)
    make_dataset(robot_views(format=name), tmp_path / "out")
    card = (tmp_path / "out" / "README.md").read_text()
    first, arrays = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    for package in ("webdataset", "datasets") if name == "webdataset" else ("datasets",):
        if package in first and not importlib.util.find_spec(package):
            first = ""
    printed = io.StringIO()
    for program in (first, arrays):
        with contextlib.redirect_stdout(printed), open_files_allowed():
            exec(program.replace("DIR", str(tmp_path / "out")), {})
    assert printed.getvalue().endswith("9 (24, 32, 3) (24, 32) (2,)\n")


@pytest.mark.parametrize("name", SHARDS)
def test_given_maps_are_read_from_shards(name, tmp_path):
    needs(name)
    spec = small(views=2, format=name)
    make_dataset(spec, tmp_path / "out")
    given = DatasetSpec(maps_from=tmp_path / "out", split=(1, 0, 0)).maps_from.maps
    assert [one.codes.tolist() for one in given] == [one.codes.tolist() for one in spec.maps_from.maps]


def test_webdataset_reads_shards(tmp_path):
    webdataset = pytest.importorskip("webdataset")
    make_dataset(robot_views(), tmp_path / "files")
    make_dataset(robot_views(format="webdataset"), tmp_path / "out")
    shards = sorted(map(str, (tmp_path / "out" / "train").glob("*.tar")))
    assert len(shards) == 3

    def decode(name, content):
        return decoded(content) if name.endswith(".png") else None

    with open_files_allowed():
        samples = list(webdataset.WebDataset(shards, shardshuffle=False).decode(decode))
    assert [sample["json"]["number"] for sample in samples] == list(range(9))
    for sample in samples:
        for layer in LAYERS:
            file = tmp_path / "files" / "train" / layer / f"{sample['__key__']}.png"
            np.testing.assert_array_equal(sample[f"{layer}.png"], read_picture(file))


def test_hugging_face_datasets_streams_parquet(tmp_path):
    datasets = pytest.importorskip("datasets")
    spec = robot_views(split=(0.34, 0.33, 0.33), maps_from=[TOWN, LOOP, WIDE])
    make_dataset(spec, tmp_path / "files")
    make_dataset(spec.replace(format="parquet", maps_from=spec.maps_from), tmp_path / "out")
    for split in SPLITS:
        rows = list(datasets.load_dataset(str(tmp_path / "out"), split=split, streaming=True))
        expected = [
            json.loads(line) for line in (tmp_path / "files" / split / "metadata.jsonl").read_text().splitlines()
        ]
        assert len(rows) == len(expected) == 3
        for row, record in zip(rows, expected, strict=True):
            assert (row["number"], row["codes"], row["nearest"]) == (
                record["number"],
                record["codes"],
                record["nearest"],
            )
            for layer in LAYERS:
                picture = read_picture(tmp_path / "files" / split / layer / f"{record['number']:06d}.png")
                picture = picture[..., ::-1] if picture.ndim == 3 else picture
                np.testing.assert_array_equal(np.array(row[layer]), picture)


@pytest.mark.parametrize(("samples", "blocks"), [(0, []), (3, [1]), (4, [1]), (5, [2, 2]), (8, [2, 2]), (9, [3, 3, 3])])
def test_blocks_know_how_many_there_are(samples, blocks, tmp_path):
    made = list(Samples(1, np.zeros(samples, int), range(samples), tmp_path, tmp_path).blocks_of(0))
    assert [block.total for block in made] == blocks
    assert [index for block in made for index in block.indices] == list(range(samples))


def test_a_resumed_run_has_the_same_parts(tmp_path):
    samples = Samples(1, np.array([0, 0, 1, 1]), range(4), tmp_path, tmp_path)
    drawing = Drawing(None, 1, None, "imagefolder", None, dict.fromkeys(range(4)))

    def parts():
        return [[portion.indices for portion in task.portions] for task in _tasks(Pool(None, 2), drawing, samples)]

    assert parts() == [[[0, 1]], [[2, 3]]]
    next(samples.blocks()).records.write_bytes(record_line(0, {}))
    assert parts() == [[[1]], [[2, 3]]]


def test_without_pyarrow_the_message_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with refused("format: parquet needs pyarrow", "pip install pyarrow, ... extra shards ..."):
        make_dataset(small(format="parquet"), tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "about", [{"metrics": {"own": 2**70}}, {"fitness": 2**60}, {"niche": [2**70]}, {"seed": (2**70, 0)}]
)
def test_numbers_that_no_column_holds_are_refused_before_maps_are_drawn(about, tmp_path):
    """They were an error of pyarrow without a name, after all maps of a shard were drawn."""
    needs("parquet")
    spec = small(maps_from=[RoadMap(LOOP, **about)], split=(1, 0, 0), format="parquet")
    with refused("maps_from", "11..., map 0"):
        make_dataset(spec, tmp_path / "out")
    assert not list(tmp_path.iterdir())
