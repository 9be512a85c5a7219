"""The commands for tile sets, as their users call them."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from folders import files, read_picture

from elitelanes_jax.cli.main import main


def bare(folder):
    """The folder with its photographs only."""
    for file in folder.glob("*/*.png"):
        if file.name != "image.png":
            file.unlink()
    return folder


def test_a_good_set_is_described(folder, capsys):
    assert main(["tiles", "check", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "tiles: 4 tiles"
    assert lines[6] == "no end: maps with dead ends cannot be drawn"
    assert lines[5] == "rotated, 16 pictures of the codes 3, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15"
    assert lines[7].startswith("in tiles from the left end of each side") and len(lines) == 8 + 11 + 1
    assert lines[-1].endswith("lane_offset is 0.2")


def test_all_faults_are_listed_at_once(folder, capsys):
    """A straight road on a turn, a mask without road, a mask too few, a photograph under another name."""
    shutil.copy(folder / "straight_1" / "road.png", folder / "turn_1")
    cv2.imwrite(str(folder / "straight_1" / "road.png"), np.zeros((384, 384), np.uint8))
    (folder / "crossing3_1" / "red.png").unlink()
    (folder / "crossing4_1" / "image.png").rename(folder / "crossing4_1" / "photo.JPG")
    before = files(folder)
    assert main(["tiles", "check", str(folder)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    for line, (place, words) in zip(
        lines,
        (
            ("turn_1", "expected a road that reaches two sides that meet of the tile, got N, S"),
            ("straight_1", "expected a road that reaches two sides that face each other of the tile, got none"),
            ("crossing3_1", "expected image.png, road.png, red.png and yellow.png, got no red.png"),
            ("crossing4_1", "expected image.png, road.png, red.png and yellow.png, got no image.png"),
        ),
        strict=True,
    ):
        assert line.startswith(str(folder / place)), line
        assert words in line
    assert files(folder) == before


def test_masks_make_a_set_of_photographs(folder, capsys):
    given = {name: content for name, content in files(folder).items() if not name.endswith("image.png")}
    assert main(["tiles", "masks", str(bare(folder))]) == 0
    assert "12 masks of 4 tiles in " in capsys.readouterr().out
    assert set(files(folder)) == set(given) | {f"{name}/image.png" for name in {*map(first, given)}} | {"masks.png"}
    assert main(["tiles", "check", str(folder)]) == 0
    assert "4 tiles" in capsys.readouterr().out
    # Masks that exist stay, byte for byte, unless --overwrite is given.
    mine = folder / "turn_1" / "yellow.png"
    cv2.imwrite(str(mine), np.zeros((384, 384), np.uint8))
    (folder / "turn_1" / "red.png").unlink()
    before = files(folder)
    before.pop("masks.png")
    (folder / "masks.png").unlink()
    assert main(["tiles", "masks", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "1 mask of 4 tiles" in printed
    assert "11 existing ones unchanged" in printed
    after = files(folder)
    sheet = after.pop("masks.png")
    after.pop("turn_1/red.png")
    assert after == before
    assert main(["tiles", "masks", str(folder), "--overwrite", "--yellow", "0..5,0..1,0..1"]) == 0
    assert not read_picture(folder / "straight_1" / "yellow.png").any()
    assert "4 masks of 4 tiles" in capsys.readouterr().out
    # The others are as they were, and what was replaced is kept where no tile set looks.
    remade = files(folder)
    assert all("yellow" in name for name in after if remade[name] != after[name])
    assert all(remade[f"{first(name)}/.yellow.png.before"] == after[name] for name in after if "yellow" in name)
    assert main(["tiles", "check", str(folder)]) == 0
    assert read_picture(folder / "masks.png").shape[2] == 3
    assert (folder / ".masks.png.before").read_bytes() == sheet  # it was made again, and the one before is kept


def test_masks_replaced_again_and_again_are_all_kept(folder, capsys):
    mask, kept = folder / "turn_1" / "yellow.png", []
    for value in (255, 254, 253):  # by hand
        cv2.imwrite(str(mask), np.full((384, 384), value, np.uint8))
        kept.append(mask.read_bytes())
        assert main(["tiles", "masks", str(folder), "--overwrite", "--yellow", "0..5,0..1,0..1"]) == 0
    names = (".yellow.png.before", ".yellow.png.before-2", ".yellow.png.before-3")
    assert [(mask.parent / name).read_bytes() for name in names] == kept
    assert "kept as .yellow.png.before-3 and the like" in capsys.readouterr().out


def test_a_disk_that_fills_up_leaves_all_as_it_was(folder, capsys, monkeypatch):
    before = files(bare(folder))
    writes, write = [], Path.write_bytes

    def fail_late(file, content):
        writes.append(file)
        if len(writes) == 9:
            raise OSError(28, "No space left on device", str(file))
        return write(file, content)

    monkeypatch.setattr(Path, "write_bytes", fail_late)
    assert main(["tiles", "masks", str(folder)]) == 2
    assert ".png: No space left on device" in capsys.readouterr().err
    assert files(folder) == before


def first(name):
    return name.partition("/")[0]


SMALL = ["--seeds", "2", "--method", "ea", "--evaluations", "8000", "--tile-px", "16"]


@pytest.mark.slow
def test_maps_have_only_tiles_of_the_set(folder, tmp_path, capsys):
    shutil.rmtree(folder / "crossing3_1")
    assert main(["tiles", "check", str(folder)]) == 0
    assert "no crossing3: maps will have none" in capsys.readouterr().out
    out = tmp_path / "out"
    assert main(["generate", "--size", "5", "6", "--maps", "3", *SMALL, "--tiles", str(folder), "--out", str(out)]) == 0
    maps = [json.loads(file.read_text())["codes"] for file in sorted(out.glob("maps/*/map.json"))]
    assert len(maps) == 3
    assert not {7, 11, 13, 14} & set(np.unique(maps).tolist())


def test_without_ends_roads_that_lead_nowhere_can_be_left_out(folder, tmp_path, capsys):
    village = Path(__file__).parents[2] / "docs" / "examples" / "village.json"
    command = ["render", str(village), "--tile-px", "16", "--out", str(tmp_path / "out")]
    assert main([*command, "--tiles", str(folder)]) == 2
    assert "--dead-ends grass" in capsys.readouterr().err
    assert main([*command, "--tiles", str(folder), "--dead-ends", "grass"]) == 0
    fewer = cv2.imread(str(tmp_path / "out" / "road.png"), 0).sum()
    assert main([*command[:-1], str(tmp_path / "all")]) == 0
    assert 0 < fewer < cv2.imread(str(tmp_path / "all" / "road.png"), 0).sum()


def test_a_set_without_a_kind_of_tiles_is_named_if_maps_are_too_few(folder, tmp_path, capsys):
    shutil.rmtree(folder / "crossing3_1")
    out = tmp_path / "out"
    few = ["--quiet", "--seeds", "2", "--maps", "1", "--preset", "paper", "--generations", "0", "--tiles", str(folder)]
    assert main(["generate", "--size", "5", "6", *few, "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "found 0 of 1 map" in said
    assert "with tiles that are not in the alphabet); more codes in the alphabet or the tile set, more seeds" in said
    assert len(said.splitlines()) == 1
    assert not out.exists()
