"""Ultralytics and PyTorch read our datasets, in an environment of their own: make yolo."""

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from given_maps import small
from pages import blocks, commands
from standing_oracle import TOWN

from elitelanes_jax import RoadMap, make_dataset
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats import OBJECT_KINDS

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv-yolo" / "bin" / "python"
RING = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]], np.int8)
MAPS = {"maps_from": [RoadMap(TOWN), RoadMap(RING)], "tile_px": 32, "furnish": ["lane_duckies=9 lane_robots=3"]}
SPECS = {
    "all": {"maps_from": [*MAPS["maps_from"], RoadMap(RING[:, [0, 1, 3]])], "split": (0.4, 0.3, 0.3)},
    "robot": {"split": (0.5, 0.5, 0), "views": 3, "camera": ("rows=60", "columns=80")},
    "no-validation": {"split": (0.5, 0, 0.5)},
    "training-alone": {"split": (1, 0, 0)},
    "test-alone": {"split": (0, 0, 1)},
}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not PYTHON.exists(), reason="make yolo makes its environment")]


def run(program, *arguments, folder):
    ran = subprocess.run([PYTHON, program, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-2000:]
    return ran.stdout.splitlines()


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("datasets")
    for name, values in SPECS.items():
        make_dataset(small(format="coco", **MAPS | values), folder / name)
    return folder


def test_ultralytics_reads_boxes_and_outlines(datasets, tmp_path, monkeypatch):
    files = [datasets / name / "data.yaml" for name in SPECS]
    boxes = run(Path(__file__).with_name("yolo_reads.py"), *files, folder=tmp_path)
    for name in SPECS:
        card = (datasets / name / "README.md").read_text()
        (program,) = [text for _, text in blocks(card, "python") if "outline" in text]
        monkeypatch.chdir(datasets)
        exec(program.replace("DIR", name), {})
    outlines = run(Path(__file__).with_name("yolo_reads.py"), *files, folder=tmp_path)
    for name, text, outlined in zip(SPECS, boxes, outlines, strict=True):
        about = json.loads((datasets / name / "dataset.json").read_text())["pictures"]
        read, segmented = json.loads(text), json.loads(outlined)
        assert read["names"] == list(OBJECT_KINDS) and {"train", "val"} <= set(read["splits"])
        present = [split for split, long in zip(("train", "val", "test"), about, strict=True) if about[long]]
        for split, pictures in read["splits"].items():
            source = split if split in present else present[0]
            rows = (datasets / name / "metadata" / f"{source}.jsonl").read_text().splitlines()
            assert len(rows) == len(pictures)
            for row in map(json.loads, rows):
                found, count = pictures[f"{row['number']:06d}.png"]
                again, outlined_count = segmented["splits"][split][f"{row['number']:06d}.png"]
                assert count == 0 and outlined_count == len(row["objects"])
                for one, thing in zip(found, row["objects"], strict=True):
                    x, y, wide, high = thing["box"]
                    expected = list(OBJECT_KINDS).index(thing["kind"]), x + wide / 2, y + high / 2, wide, high
                    np.testing.assert_allclose(one, expected, atol=1e-3)
                np.testing.assert_allclose(np.reshape(again, (-1, 5)), np.reshape(found, (-1, 5)), atol=1e-3)


def test_the_page_trains_a_network(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8")
    (command,) = [command for command in commands(page) if "patches" in command]
    (program,) = [text for _, text in blocks(page, "python") if "import torch" in text]
    assert main(command) == 0
    Path("train.py").write_text(program)
    lines = run("train.py", folder=tmp_path)
    (printed,) = [text for _, text in blocks(page, "text") if "step 20" in text]
    assert [re.sub(r"\d\.\d+", "", line) for line in lines] == [
        re.sub(r"\d\.\d+", "", line) for line in printed.splitlines()
    ]
    overlaps = [float(line.split()[-1]) for line in lines if "IoU" in line]
    assert min(overlaps[:2]) > 0.9 and min(overlaps) > 0.5
