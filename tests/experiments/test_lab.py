"""The study of photographs in gym-duckietown: its tile sets and its table."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import load_tiles
from elitelanes_jax.tiles.tileset import default_tiles

lab = pytest.importorskip(
    "experiments.perception.gym_duckietown.lab", reason="flax and optax are not here", exc_type=ImportError
)


def test_a_mirrored_picture_is_left_out_of_a_set(tmp_path, capsys):
    textures = {name: default_tiles() / name / "image.png" for name in ("straight_1", "turn_1", "crossing4_1")}
    crossing = cv2.imread(str(default_tiles() / "crossing3_1" / "image.png"))
    for name, picture in (("crossing3_1", crossing), ("crossing3_2", crossing[:, ::-1])):
        textures[name] = tmp_path / f"{name}.png"
        cv2.imwrite(str(textures[name]), picture)
    lab.build_set(tmp_path / "set", textures)
    assert sorted(tile.name for tile in load_tiles(tmp_path / "set").tiles) == sorted(set(textures) - {"crossing3_2"})
    assert "got stop lines on the outgoing lanes" in capsys.readouterr().out
    with refused(tmp_path / "none.png", "none"):
        lab.build_set(tmp_path / "other", {"turn_1": tmp_path / "none.png"})
    assert not (tmp_path / "other").exists()


def test_the_table_has_the_median_and_the_range_of_the_seeds():
    run = {"offset": 0.4, "offset_90": 1.0, "angle": 0.03, "straight": 0.2, "curve": 0.6, "crossing": 0.7}
    results = {
        "photographs-stream": {
            "0": run | {"rides": 32, "stay": 31, "own_lane": 29},
            "1": run | {"offset": 0.2, "usual-60 rides": 32, "usual-60 stay": 30, "usual-60 own_lane": 28},
            "2": run | {"offset": 0.3, "arc offset": 0.1, "arc straight": 0.2, "arc curve": 0.3, "arc crossing": 0.4},
        },
        "committed-labels": {
            "0": {"background": 0.9, "road": 0.8, "stop line": 0.7, "lane separator": 0.6, "paved": 0.5}
        },
    }
    rows = lab.report(results).splitlines()
    assert "| five photographs, stream | 3 | 0.300 (0.200 to 0.400) |" in rows[2]
    assert "rides of 20 s in random light" in rows[0] and "rides of 60 s in random light" not in rows[0]
    assert rows[2].endswith("| 31 and 29 of 32 | 30 and 28 of 32 |")
    assert rows[6] == "| five photographs, stream | 1 | 0.100 | 0.200 | 0.300 | 0.400 |"
    assert rows[-1].endswith("| 1 | 0.900 | 0.800 | 0.700 | 0.600 | 0.500 |")


def test_the_gap_has_the_errors_in_each_drawing(monkeypatch):
    """The network finds what the first two values of each picture say, in hundredths of a tile and of a radian."""
    from experiments.perception.gym_duckietown import gap

    monkeypatch.setattr(gap, "read_weights", lambda file, task: None)
    monkeypatch.setattr(gap, "find_poses", lambda weights, images: images[:, 0, 0] / 100)
    images = [[np.full((2, 120, 160, 3), 1 + index, np.uint8)] for index in range(len(gap.DRAWINGS))]
    lanes = np.array([[0.01, -0.01], [np.nan, np.nan]])
    rows = gap.report({"net": Path("net.npz")}, images, lanes).splitlines()[2:]
    assert rows[0] == "| net | drawn tiles, our camera | 1 | 0.000 | 0.020 |"
    assert rows[3] == "| net | the same, random light | 1 | 1.755 | 0.050 |"


@pytest.mark.slow
def test_a_set_is_cut_from_one_photograph_of_a_floor(tmp_path):
    (tmp_path / "sets").mkdir()
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    lab.cut_floor(tmp_path / "sets" / "cut", tmp_path / "tiles")
    kinds = {tile.name.split("_")[0] for tile in load_tiles(tmp_path / "sets" / "cut").tiles}
    assert kinds == {"straight", "turn", "crossing3", "crossing4"}
