"""What is written can be read: each writer at its limits, and all that reads its files."""

import numpy as np
import pytest
from PIL import Image
from refusals import refused

from elitelanes_jax import DatasetSpec, RoadMap, make_dataset, read_map
from elitelanes_jax._util.npz import npz_bytes, read_npz
from elitelanes_jax.benchmark import Submission, find_task
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.road_map import Drawn, map_to_json
from elitelanes_jax.network.checks import LONGEST_SIDE


def test_pictures_larger_than_a_tile_s_may_be_are_made_into_a_dataset(tmp_path):
    maps = [np.full((2, 257), 5, np.int8)]  # 4,112 pixels: a file of a tile has 4,096 at most
    spec = DatasetSpec(maps_from=maps, tile_px=16, split="1 0 0", transforms="none")
    about = make_dataset(spec, tmp_path / "out")
    with Image.open(tmp_path / "out" / "train" / "labels" / "000000.png") as labels:
        assert labels.size == (4112, 32)
    assert (tmp_path / "out" / "contact-sheet.png").exists()
    assert make_dataset(spec, tmp_path / "out") == about


@pytest.mark.parametrize(
    ("settings", "subject", "got", "expected"),
    [
        ({"size": "2 1024", "tile_px": 32}, "tile_px", "32768", "at most 32766"),
        ({"size": 27, "tile_px": 512}, "tile_px", "191102976", "at most 178956970"),
        ({"size": 128, "camera": []}, "size", "32768", "at most 32766"),
    ],
)
def test_pictures_that_cannot_be_read_are_refused_before_any_search(settings, subject, got, expected):
    with refused(subject, got, expected):
        DatasetSpec(maps=10, **settings)
    DatasetSpec(maps=10, **settings | {"size": 26, "transforms": "none"})
    DatasetSpec(maps=10, **settings | {"tile_px": 31})


@pytest.mark.slow
def test_archives_that_are_all_but_vacant_are_read(tmp_path):
    """Vacant places of an archive take no room in its file: they shrink to a thousandth."""
    grids = np.zeros((4, 2**20, 12, 12), np.int8)
    (tmp_path / "archive.npz").write_bytes(npz_bytes({"grids": grids}, None))
    assert read_npz(tmp_path / "archive.npz")[1]["grids"].shape == grids.shape


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".json", ".yaml"])
def test_maps_of_the_largest_size_are_read(suffix, tmp_path):
    codes = np.full((LONGEST_SIDE, LONGEST_SIDE), 14, np.int8)
    drawn = Drawn("a set", [["crossing3_1"] * LONGEST_SIDE] * LONGEST_SIDE, [[3] * LONGEST_SIDE] * LONGEST_SIDE)
    file = tmp_path / f"map{suffix}"
    file.write_text(map_to_json(RoadMap(codes, drawn=drawn)) if suffix == ".json" else to_duckietown(codes))
    np.testing.assert_array_equal(read_map(file).codes, codes)


def test_a_raw_archive_too_large_to_be_read_is_not_written(tmp_path):
    task = find_task("8x8A-100000")
    budgets = len(task.budgets)
    grids = np.broadcast_to(np.int8(0), (10, budgets, 2**20, *task.shape))
    with refused(tmp_path / "out.npz", "1,342,177,280", expected="at most 536,866,816"):
        Submission(task, grids).save(tmp_path / "out.npz")
