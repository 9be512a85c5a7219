"""Pages of tags to print: read by OpenCV's detector, at their size, from the pages as they are printed."""

import io
import re

import cv2
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import RoadMap
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats.tags import LARGEST_TAG, SIGN_TAGS
from elitelanes_jax.maps import furnish
from elitelanes_jax.tiles import write_tags
from elitelanes_jax.tiles.tag_pages import _pages

LOOPS = [[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]]
DPI = 150


def read(page):
    """The numbers of the tags of a page, with the four corners of each in millimetres, from its top left one."""
    content = io.BytesIO()
    page.savefig(content, format="png", dpi=DPI)
    grey = cv2.imdecode(np.frombuffer(content.getvalue(), np.uint8), cv2.IMREAD_GRAYSCALE)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, numbers, _ = cv2.aruco.ArucoDetector(family).detectMarkers(grey)
    return {int(number): square[0] * 25.4 / DPI for number, square in zip(numbers.ravel(), corners, strict=True)}


def test_tags_are_read_at_their_size_and_the_right_way_up():
    town = furnish(LOOPS, "signs street_names")
    tags = [(thing.tag, thing.kind) for thing in town.objects if thing.tag is not None]
    found = {}
    for page in _pages(tags):
        found |= read(page)
    assert sorted(found) == sorted(number for number, _ in tags)
    for square in found.values():
        sides = np.linalg.norm(square - np.roll(square, -1, axis=0), axis=1)
        np.testing.assert_allclose(sides, 65, atol=0.4)  # a pixel has 0.17 mm
        across = square[1] - square[0]
        # OpenCV has the family upside down: its first corner is the lower right one.
        assert across[0] == pytest.approx(-65, abs=0.4) and abs(across[1]) < 0.4


def test_a_page_is_a4_and_the_same_bytes(tmp_path):
    town = furnish(LOOPS, "signs")
    assert write_tags(town, tmp_path / "a.pdf") == write_tags(town, tmp_path / "b.pdf") == 12
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", content)
    assert len(boxes) == 2  # six on a page
    for box in boxes:
        assert [float(side) * 25.4 / 72 for side in box] == pytest.approx([210, 297], abs=0.01)


def test_every_number_has_a_tag():
    assert max(map(max, SIGN_TAGS.values())) <= LARGEST_TAG


def test_the_command_writes_tags_instead_of_a_plan(tmp_path, capsys):
    file, out = tmp_path / "map.json", str(tmp_path / "tags.pdf")
    RoadMap(LOOPS).save(file)
    assert main(["plan", str(file), "--tags", "--out", out]) == 2
    assert "map.json: expected signs with tags, as furnish places them, got none" in capsys.readouterr().err
    furnish(LOOPS, "signs").save(file)
    assert main(["plan", str(file), "--tags", "--out", out]) == 0
    assert capsys.readouterr().out == f"12 tags to print, in {out}\n"
    assert main(["plan", str(file), "--tags", "--out", str(tmp_path / "tags.svg")]) == 2
    assert "--out: expected a name that ends in .pdf, got" in capsys.readouterr().err
    with refused("file", "'tags.png'", expected=".pdf"):
        write_tags(file, "tags.png")
