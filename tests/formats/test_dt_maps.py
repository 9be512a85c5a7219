"""The folder of layers of dt-maps: there and back."""

import math
import re
import time

import numpy as np
import pytest
from test_map_objects import WRITTEN, check_same

from elitelanes_jax import InputError, RoadMap
from elitelanes_jax.formats import OBJECT_KINDS, MapObject, read_dt_maps, to_dt_maps
from elitelanes_jax.network.codes import ROAD_ALPHABET

ROW = np.array([[*ROAD_ALPHABET, 0]], np.int8)
BOMB = "[" + ", ".join(["&b0 [x, x]", *(f"&b{i} [*b{i - 1}, *b{i - 1}]" for i in range(1, 25))]) + "]"


def write(folder, road_map, **settings):
    for name, text in to_dt_maps(road_map, **settings).items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")


def test_all_tiles_and_kinds_are_read_as_they_are_written(tmp_path):
    objects = []
    for index, (kind, usual) in enumerate({**OBJECT_KINDS, "other:boat": OBJECT_KINDS["other"]}.items()):
        tag = 7 if "sign" in kind else None
        pose = 0.3 * index, 0.5, 0.1 * index - 1
        objects.append(MapObject(kind, *pose, usual.height * 1.5, tag, index % 2 > 0))
    write(tmp_path, RoadMap(ROW, objects=objects), tile_size=0.6)
    found = read_dt_maps(tmp_path)
    np.testing.assert_array_equal(found.codes, ROW)
    check_same(found.objects, objects, WRITTEN)


def test_frames_are_relative_to_others(tmp_path):
    """An object on another one's frame moves with it."""
    write(tmp_path, RoadMap([[6, 3], [12, 9]], objects=[MapObject("duckie", 0.5, 1.5, math.pi / 2, 0.08)]), tile_size=1)
    frames, citizens = (tmp_path / f"{name}.yaml" for name in ("frames", "citizens"))
    child = "  map_0/child: {relative_to: map_0/duckie_0, pose: {x: 0.25, y: 0.0, z: 0, roll: 0, pitch: 0, yaw: 0.5}}\n"
    frames.write_text(frames.read_text(encoding="utf-8") + child, encoding="utf-8")
    citizens.write_text(citizens.read_text(encoding="utf-8") + "  map_0/child: {color: red}\n", encoding="utf-8")
    assert read_dt_maps(tmp_path).objects[1][1:4] == pytest.approx((0.5, 1.25, math.pi / 2 + 0.5), abs=1e-5)


def test_no_object_has_the_name_of_a_tile(tmp_path):
    objects = [MapObject("tree", 1, 1, 0, 0.25), MapObject("other:tile_0", 1.1, 0.9, 1, 0.1)]
    write(tmp_path, RoadMap([[6, 3], [12, 9]], objects=objects))
    found = read_dt_maps(tmp_path)
    assert found.codes.tolist() == [[6, 3], [12, 9]]
    check_same(found.objects, objects, WRITTEN)


def test_dead_ends_and_sizes_are_refused():
    """As for Duckietown's other maps."""
    with pytest.raises(InputError, match="got dead ends at row 0, column 0"):
        to_dt_maps(RoadMap([[2, 8]]))
    with pytest.raises(InputError, match="tile_size: expected metres"):
        to_dt_maps(RoadMap([[6, 3], [12, 9]]), tile_size=0)


def test_angles_of_any_size_are_angles(tmp_path):
    """Two that are as large as a float can be have an infinite sum."""
    write(tmp_path, RoadMap([[6, 3], [12, 9]]), tile_size=1)
    frames = tmp_path / "frames.yaml"
    text = frames.read_text(encoding="utf-8").replace("relative_to: map_0", "relative_to: huge")
    text = re.sub("yaw: [^}]*", "yaw: 1e308", text)
    huge = "  huge: {relative_to: map_0, pose: {x: 0, y: 0, yaw: 1e308}}\n"
    frames.write_text(text + huge, encoding="utf-8")
    with pytest.raises(InputError, match="at a right angle, got 'curve' with yaw"):
        read_dt_maps(tmp_path)


def write_spoilt(folder, layer, old, new):
    """Writes a map with a duckie and a sign, and changes a piece of one file."""
    objects = [MapObject("duckie", 1, 1, 0, 0.08), MapObject("sign_stop", 1, 1, 0, 0.18, 1)]
    write(folder, RoadMap([[6, 3], [12, 9]], objects=objects), tile_size=1)
    file = folder / f"{layer}.yaml"
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.parametrize(
    ("layer", "old", "new", "words"),
    [
        ("tiles", "type: curve", "type: bend", "tiles: expected straight, curve"),
        ("tiles", "i: 1", "i: 2000", "tiles: expected sides of 1 to 1024"),
        ("tiles", "i: 1", "i: one", "i: expected a number, got 'one'"),
        ("frames", "yaw: 1.570796", "yaw: 1.2", "at a right angle, got 'curve' with yaw 1.2"),
        ("frames", "relative_to: map_0", "relative_to: map_1", "frames: expected frames relative to map_0"),
        ("frames", "pose: {", "pose: 3 #", "frames.yaml: expected readable YAML|expected a pose"),
        ("citizens", "citizens:", "people:", "citizens.yaml: expected a table of tables under 'citizens'"),
        ("tile_maps", "x: 1.0", "x: 0", "tile_size: expected metres"),
        ("tile_maps", "{x: 1.0, y: 1.0}", "1.0", "tile_size: expected a table, got '1.0'"),
        ("tiles", "i: 1", "i: 0", "tiles: expected one tile in each cell, got several"),
        ("tiles", "i: 1", "i: 0.5", "i: expected a whole number, got 0.5"),
        ("tiles", "type: curve", "type: [1]", "tiles: expected straight, curve"),
        ("traffic_signs", "type: stop", "type: go on", "kind: expected one of .*got 'other:go on'"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, layer, old, new, words):
    """One message names the folder or the file."""
    write_spoilt(tmp_path, layer, old, new)
    with pytest.raises(InputError, match=words):
        read_dt_maps(tmp_path)


@pytest.mark.parametrize(
    ("layer", "old", "new"),
    [
        ("tiles", "type: curve", "type: BOMB"),
        ("tiles", "i: 1", "i: BOMB"),
        ("frames", "relative_to: map_0", "relative_to: BOMB"),
        ("frames", "yaw: 1.570796", "yaw: BOMB"),
        ("frames", "pose: {", "pose: BOMB #"),
        ("citizens", "{color: yellow, height: 0.08}", "BOMB"),
        ("traffic_signs", "type: stop", "type: BOMB"),
        ("traffic_signs", "height: 0.18", "height: BOMB"),
        ("tile_maps", "x: 1.0", "x: BOMB"),
    ],
)
def test_aliases_are_not_unfolded(tmp_path, layer, old, new):
    """Unfolded, the texts have 200 MB."""
    write_spoilt(tmp_path, layer, old, new.replace("BOMB", BOMB))
    start = time.perf_counter()
    with pytest.raises(InputError) as caught:
        read_dt_maps(tmp_path)
    assert time.perf_counter() - start < 0.7 and len(str(caught.value)) < 900


def test_a_folder_without_layers_is_refused(tmp_path):
    """The first file that is missing is named."""
    with pytest.raises(InputError, match="frames.yaml: expected a readable YAML file, got: No such file"):
        read_dt_maps(tmp_path)
