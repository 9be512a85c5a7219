"""The folder of layers of dt-maps: there and back."""

import math
import re
import time

import numpy as np
import pytest
import yaml
from conftest import grids
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from test_map_objects import WRITTEN, check_same

from elitelanes_jax import InputError, RoadMap, read_map
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats import OBJECT_KINDS, MapObject, as_maps, without_dead_ends
from elitelanes_jax.formats.dt_maps import to_dt_maps, to_duckiematrix
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.maps.given import parse_given
from elitelanes_jax.network import plain_measure
from elitelanes_jax.network.codes import ROAD_ALPHABET

ROW = np.array([[*ROAD_ALPHABET, 0]], np.int8)
BOMB = "[" + ", ".join(["&b0 [x, x]", *(f"&b{i} [*b{i - 1}, *b{i - 1}]" for i in range(1, 25))]) + "]"


def write(folder, road_map, **settings):
    for name, text in to_dt_maps(as_map(road_map), **settings).items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")


def test_all_tiles_and_kinds_are_read_as_they_are_written(tmp_path):
    objects = []
    for index, (kind, usual) in enumerate({**OBJECT_KINDS, "other:boat": OBJECT_KINDS["other"]}.items()):
        tag = 7 if "sign" in kind else None
        pose = 0.3 * index, 0.5, 0.1 * index - 1
        objects.append(MapObject(kind, *pose, usual.height * 1.5, tag, index % 2 > 0))
    write(tmp_path, RoadMap(ROW, objects=objects), tile_size=0.6)
    found = read_map(tmp_path)
    np.testing.assert_array_equal(found.codes, ROW)
    check_same(found.objects, objects, WRITTEN)


@pytest.mark.parametrize(("convert", "codes"), [(to_dt_maps, [[9, 6]]), (to_duckiematrix, [[3, 6, 5, 5]])])
def test_tiles_with_the_line_ends_of_windows_are_turned_as_they_say(tmp_path, convert, codes):
    """Turned the other way, these maps have fewer loose ends."""
    for name, text in convert(as_map(codes)).items():
        (tmp_path / f"{name}.yaml").write_bytes(text.replace("\n", "\r\n").encode())
    assert read_map(tmp_path).codes.tolist() == codes


def test_frames_are_relative_to_others(tmp_path):
    """An object on another one's frame moves with it."""
    write(tmp_path, RoadMap([[6, 3], [12, 9]], objects=[MapObject("duckie", 0.5, 1.5, math.pi / 2, 0.08)]), tile_size=1)
    frames, citizens = (tmp_path / f"{name}.yaml" for name in ("frames", "citizens"))
    child = "  map_0/child: {relative_to: map_0/duckie_0, pose: {x: 0.25, y: 0.0, z: 0, roll: 0, pitch: 0, yaw: 0.5}}\n"
    frames.write_text(frames.read_text(encoding="utf-8") + child, encoding="utf-8")
    citizens.write_text(citizens.read_text(encoding="utf-8") + "  map_0/child: {color: red}\n", encoding="utf-8")
    assert read_map(tmp_path).objects[1][1:4] == pytest.approx((0.5, 1.25, math.pi / 2 + 0.5), abs=1e-5)


def test_objects_of_several_layers_may_share_a_frame(tmp_path):
    write(tmp_path, RoadMap([[6, 3], [12, 9]], objects=[MapObject("duckie", 0.5, 1.5, 0, 0.08)]))
    (tmp_path / "ground_tags.yaml").write_text("ground_tags: {map_0/duckie_0: {id: 3}}\n", encoding="utf-8")
    assert {(thing.kind, thing.x, thing.y) for thing in read_map(tmp_path).objects} == {
        ("duckie", 0.5, 1.5),
        ("floor_tag", 0.5, 1.5),
    }


def test_no_object_has_the_name_of_a_tile(tmp_path):
    objects = [MapObject("tree", 1, 1, 0, 0.25), MapObject("other:tile_0", 1.1, 0.9, 1, 0.1)]
    write(tmp_path, RoadMap([[6, 3], [12, 9]], objects=objects))
    found = read_map(tmp_path)
    assert found.codes.tolist() == [[6, 3], [12, 9]]
    check_same(found.objects, objects, WRITTEN)


def test_dead_ends_and_sizes_are_refused():
    """As for Duckietown's other maps."""
    with refused("grid", "dead ends at A1 ([0, 0]), B1 ([0, 1])"):
        to_dt_maps(RoadMap([[2, 8]]))
    with refused("tile_size", "0"):
        to_dt_maps(RoadMap([[6, 3], [12, 9]]), tile_size=0)


def test_angles_of_any_size_are_angles(tmp_path):
    """Two that are as large as a float can be have an infinite sum."""
    write(tmp_path, RoadMap([[6, 3], [12, 9]]), tile_size=1)
    frames = tmp_path / "frames.yaml"
    text = frames.read_text(encoding="utf-8").replace("relative_to: map_0", "relative_to: huge")
    text = re.sub("yaw: [^}]*", "yaw: 1e308", text)
    huge = "  huge: {relative_to: map_0, pose: {x: 0, y: 0, yaw: 1e308}}\n"
    frames.write_text(text + huge, encoding="utf-8")
    with refused(f"{tmp_path / 'tiles.yaml'}: map_0/tile_0_1", "'curve' with yaw -0.562327"):
        read_map(tmp_path)


def test_long_ways_to_the_map_and_long_names_are_refused(tmp_path):
    """The time to follow a chain of frames, or the parts of a name, grows with the square of the length."""
    (tmp_path / "tiles.yaml").write_text("tiles: {map_0/f99: {type: 4way, i: 0, j: 0}}")
    frames = {f"map_0/f{index}": f"map_0/f{index - 1}" for index in range(100)} | {"map_0/f0": "map_0"}
    lines = [f"  {name}: {{relative_to: {above}, pose: {{x: 0}}}}\n" for name, above in frames.items()]
    (tmp_path / "frames.yaml").write_text("".join(["frames:\n", *lines]))
    with refused(f"{tmp_path / 'frames.yaml'}: map_0/f99: relative_to", "a longer way or a circle"):
        read_map(tmp_path)
    (tmp_path / "tiles.yaml").write_text(f"tiles:\n  ? {'m/' * 600}\n  : {{type: 4way, i: 0, j: 0}}\n")
    with refused(tmp_path / "tiles.yaml", "m/m/m/m/m/m/m/m/m/m/m/m/m/m/m/m/m/m/m..."):
        read_map(tmp_path)


def write_spoilt(folder, layer, old, new):
    """Writes a map with a duckie and a sign, and changes a piece of one file."""
    objects = [MapObject("duckie", 1, 1, 0, 0.08), MapObject("sign_stop", 1, 1, 0, 0.18, 1)]
    write(folder, RoadMap([[6, 3], [12, 9]], objects=objects), tile_size=1)
    file = folder / f"{layer}.yaml"
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.parametrize(
    ("layer", "old", "new", "subject", "got", "expected"),
    [
        ("tiles", "type: curve", "type: bend", "...tiles.yaml: map_0/tile_0_1: type", "'bend'", ""),
        ("tiles", "type: curve", "type: [1]", "...tiles.yaml: map_0/tile_0_1: type", "['1']", ""),
        ("tiles", "i: 1", "i: 2000", "...tiles.yaml", "2001 x 2", ""),
        ("tiles", "i: 1", "i: one", "...tiles.yaml: map_0/tile_1_1: i", "'one'", ""),
        ("tiles", "i: 1", "i: 0.5", "...tiles.yaml: map_0/tile_1_1: i", "0.5", ""),
        ("tiles", "i: 1", "i: 0", "...tiles.yaml: map_0/tile_1_1", "map_0/tile_0_1 in the same one", ""),
        ("tiles", "map_0/tile_0_1: {i: 0, j: 1, ", "map_0/first: {", "...tiles.yaml: map_0/first", "none", ""),
        ("tiles", "tile_0_1", "tile_9", "...tiles.yaml: map_0/tile_9", "none", ""),
        ("frames", "yaw: 1.570796", "yaw: 1.2", "...tiles.yaml: map_0/tile_0_0", "'curve' with yaw 1.2", "right angle"),
        ("frames", "to: map_0\n", "to: map_1\n", "...frames.yaml: map_0/tile_0_1: relative_to", "'map_1'", ""),
        (
            "frames",
            "to: map_0\n",
            "to: map_0/tile_0_1\n",
            "...frames.yaml: map_0/tile_0_1: relative_to",
            "a longer way or a circle",
            "",
        ),
        ("frames", "pose: {", "pose: 3 #", "...frames.yaml: map_0/tile_0_1: pose", "'3'", ""),
        ("frames", "x: 0.5", "x: half", "...frames.yaml: map_0/tile_0_1: x", "'half'", ""),
        ("frames", "relative_to: map_0", "unit: miles", "...frames.yaml: map_0/tile_0_1: unit", "'miles'", ""),
        ("frames", "map_0/duckie_0:", "map_0/duckie_7:", "...citizens.yaml: map_0/duckie_0", "none", ""),
        ("citizens", "citizens:", "people:", "...citizens.yaml", "None", ""),
        ("citizens", "{color: yellow, height: 0.08}", "yellow", "...citizens.yaml: map_0/duckie_0", "'yellow'", ""),
        ("citizens", "height: 0.08", "height: 80", "...citizens.yaml: map_0/duckie_0: height", "80.0", ""),
        ("traffic_signs", "id: 1", "id: 999", "...traffic_signs.yaml: map_0/sign_stop_1: tag", "999", ""),
        (
            "traffic_signs",
            "type: stop",
            "type: go on",
            "...traffic_signs.yaml: map_0/sign_stop_1: kind",
            "'other:go on'",
            "",
        ),
        ("traffic_signs", "type: stop, ", "", "...traffic_signs.yaml: map_0/sign_stop_1: type", "None", ""),
        (
            "traffic_signs",
            "type: stop",
            "type: null",
            "...traffic_signs.yaml: map_0/sign_stop_1: type",
            "'null'",
            "kind",
        ),
        ("tiles", "i: 1", "i: 1e308", "...tiles.yaml", "100000000000000001097906...", ""),
        ("tile_maps", "x: 1.0", "x: 0", "...tile_maps.yaml: map_0: tile_size", "0.0", ""),
        ("tile_maps", "y: 1.0", "y: 2.0", "...tile_maps.yaml: map_0: tile_size", "x 1 and y '2.0'", ""),
        ("tile_maps", "map_0:", "map_1: {}\n  map_0:", "...tile_maps.yaml", "2", ""),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, layer, old, new, subject, got, expected):
    """One message names the file, and the tile, frame or object."""
    write_spoilt(tmp_path, layer, old, new)
    with refused(subject, got, expected) as caught:
        read_map(tmp_path)
    assert str(caught.value).startswith(str(tmp_path))


def test_a_position_of_more_tiles_than_a_float_can_hold_is_refused(tmp_path):
    (tmp_path / "tiles.yaml").write_text("tiles: {map_0/tile: {type: 4way}}")
    (tmp_path / "frames.yaml").write_text("frames: {map_0/tile: {pose: {x: 1e308, y: 0}}}")
    (tmp_path / "tile_maps.yaml").write_text("tile_maps: {map_0: {tile_size: 0.1}}")
    with refused(f"{tmp_path / 'tiles.yaml'}: map_0/tile", "1e+308 m", expected="0.1 m"):
        read_map(tmp_path)


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
        read_map(tmp_path)
    assert time.perf_counter() - start < 0.7 and len(str(caught.value)) < 900


def test_a_folder_without_layers_is_refused(tmp_path):
    """The first file that is missing is named."""
    with refused(tmp_path, "a folder without"):
        read_map(tmp_path)
    file = tmp_path / "maps" / "0000" / "map.json"
    file.parent.mkdir(parents=True)
    file.touch()
    for folder in (tmp_path, file.parents[1]):
        with refused(folder, f"a folder without; a map in it is {file}"):
            read_map(folder)
    (tmp_path / "tiles.yaml").write_text("tiles: {map_0/tile_0_0: {type: 4way}}")
    with refused(tmp_path / "frames.yaml", "no such file or directory"):
        read_map(tmp_path)


# How other people write the same town: what differs from the folders that we write.

LIBRARY, MATRIX = {"curve": 6, "3way": 14}, {"curve": 9, "3way": 13}  # the codes at yaw 0
TOWN = np.array([[6, 7, 3, 0], [14, 15, 11, 0], [10, 10, 12, 3], [12, 13, 5, 9]], np.int8)
THINGS = [MapObject("sign_stop", 2.08, 0.7, 0.0, 0.18, 33), MapObject("duckie", 0.4, 3.25, 1.5, 0.08)]
SIZE = 0.585
SHAPES = {
    "the library's": {"turned": LIBRARY, "cells": True, "above": "map_0"},
    "the Duckiematrix's": {"unit": "tiles"},
    "of its documentation": {"unit": "tiles", "above": "map_0"},
    "with empty parents": {"unit": "tiles", "above": "''"},
    "with null as a word": {"unit": "tiles", "above": "null"},
    "in metres from corners": {},
    "in metres from middles": {"middles": True},
    "in metres from corners that rounding has moved": {"middles": -1e-6},
    "with cells and no places of tiles": {"cells": True, "places": False},
    "with names and no places of tiles": {"places": False, "bare": True, "frames": False},
    "of another name": {"root": "lab_7", "unit": "tiles"},
    "without tile_maps.yaml": {"unit": "tiles", "tile_map": None},
    "with a size that is a number": {"unit": "tiles", "tile_map": SIZE},
    "far from the origin": {"unit": "tiles", "moved": (-2, -3)},
    "a map that is placed in a world": {"unit": "tiles", "origin": (1.0, 2.0, 0.5)},
    "objects placed in the world": {"unit": "tiles", "origin": (1.0, 2.0, 0.5), "worldly": True},
    "an editor's, in degrees": {"cells": True, "above": "map_0", "degrees": True},
    "signs named as in maps of one file": {"unit": "tiles", "sign": "sign_stop"},
    "signs named as in the database of tags": {"unit": "tiles", "sign": "Stop"},
    "objects on tiles": {"unit": "tiles", "on_tiles": True},
    "only what is needed of a pose": {"unit": "tiles", "short": True},
}


def kind_of(code, turned):
    """The kind of a tile, and its quarter turns counter-clockwise."""
    kinds = {"straight": 10, "4way": 15} | turned
    for kind, base in kinds.items():
        for turns in range(4):
            if base << turns & 15 | base << turns >> 4 == code:
                return kind, turns
    return "floor", 0


def write_shape(folder, *, turned=MATRIX, cells=False, above="~", unit=None, middles=False, places=True, root="map_0",
                tile_map="table", moved=(0, 0), origin=(0, 0, 0), worldly=False, degrees=False, sign="stop",
                on_tiles=False, short=False, bare=False, frames=True):  # fmt: skip
    """Writes the town in a shape; returns its codes and objects."""
    codes = np.array([[15, 0, 15], [0, 15, 15]], np.int8) if bare else TOWN
    things = [] if bare else THINGS
    rows, size = len(codes), 1 if unit else SIZE

    def pose(x, y, yaw):
        parts = {"x": x, "y": y, "z": 0, "roll": 0, "pitch": 0, "yaw": yaw}
        return {name: value for name, value in parts.items() if value or not short}

    layers = {"frames": {root: {"relative_to": None, "pose": pose(*origin)}}, "tiles": {}, "traffic_signs": {}}
    layers |= {"citizens": {}, "watchtowers": {f"{root}/tower": {"configuration": "WT18"}}}
    above = above.replace("map_0", root)
    for (row, i), code in np.ndenumerate(codes):
        x, y = i + moved[0], rows - 1 - row + moved[1]
        name, (kind, turns) = f"{root}/tile_{x}_{y}", kind_of(int(code), turned)
        layers["tiles"][name] = {"type": kind} | ({"i": x, "j": y} if cells else {})
        yaw = -90.0 * turns % 360 if degrees else turns * math.pi / 2 - (2 * math.pi if turns == 3 else 0)
        where = ((x + middles / 2) * size, (y + middles / 2) * size) if places else (0, 0)
        if frames:
            about = {"unit": unit} if unit else {}
            layers["frames"][name] = {"relative_to": "ABOVE", **about, "pose": pose(*where, yaw)}
    for index, thing in enumerate(things):
        layer, about = ("citizens", {"color": "yellow"}) if thing.kind == "duckie" else (
            "traffic_signs", {"type": sign, "id": thing.tag, "family": "36h11"})  # fmt: skip
        name, parent = f"{root}/thing_{index}", "ABOVE"
        x, y, yaw = thing.x * SIZE, (rows - thing.y) * SIZE, thing.angle
        x, y = x + moved[0] * SIZE, y + moved[1] * SIZE
        if worldly:
            name, turn = f"thing_{index}", complex(math.cos(origin[2]), math.sin(origin[2]))
            place = complex(*origin[:2]) + turn * complex(x, y)
            x, y, yaw = place.real, place.imag, yaw + origin[2]
        if on_tiles:  # of the north-west corner, which is a curve
            parent, (_, turns) = f"{root}/tile_0_{rows - 1}", kind_of(int(codes[0, 0]), turned)
            place = complex(x - SIZE / 2, y - (rows - 0.5) * SIZE) / 1j**turns
            x, y, yaw = place.real, place.imag, yaw - turns * math.pi / 2
        layers[layer][name] = about
        layers["frames"][name] = {"relative_to": parent, "pose": pose(x, y, yaw)}
    if tile_map:
        table = {"x": SIZE, "y": SIZE} if tile_map == "table" else tile_map
        layers["tile_maps"] = {root: {"tile_size": table}}
    for name, values in layers.items():
        text = yaml.safe_dump({"version": 1.0, name: values}, sort_keys=False).replace("ABOVE", above)
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return codes, things


@pytest.mark.parametrize("shape", SHAPES)
def test_folders_of_others_are_read(tmp_path, shape):
    codes, things = write_shape(tmp_path, **SHAPES[shape])
    found = read_map(tmp_path)
    np.testing.assert_array_equal(found.codes, codes)
    check_same(found.objects or (), things, WRITTEN)


@settings(max_examples=50)
@given(grids(), st.sampled_from([LIBRARY, MATRIX]))
def test_a_map_without_loose_ends_is_turned_one_way_alone(grid, turned):
    """However a complete map is turned, the other way has connections that nobody returns."""
    codes = without_dead_ends(grid)
    other = {id(LIBRARY): MATRIX, id(MATRIX): LIBRARY}[id(turned)]
    wrong = np.zeros_like(codes)
    for cell, code in np.ndenumerate(codes):
        kind, turns = kind_of(int(code), turned)
        base = ({"straight": 10, "4way": 15, "floor": 0} | other)[kind]
        wrong[cell] = base << turns & 15 | base << turns >> 4
    assert plain_measure(codes)["dead_ends"] == 0
    assert (plain_measure(wrong)["dead_ends"] == 0) == (not codes.any())


def test_commands_take_a_folder(tmp_path, capsys):
    folder = tmp_path / "lab.v2"
    folder.mkdir()
    write_shape(folder, unit="tiles")
    assert main(["show", str(folder)]) == 0
    assert capsys.readouterr().out.startswith("  A B C D\n1 ┌─┬─┐\n2 ├─┼─┤\n")
    out = tmp_path / "out"
    assert main(["export", str(folder), str(folder / ".." / "lab.v2"), "--to", "opendrive", "--out", str(out)]) == 0
    assert [file.name for file in out.iterdir()] == ["lab.v2.xodr"]
    assert main(["render", str(folder), "--tile-px", "16"]) == 2
    assert "--out: expected a folder for the pictures of" in capsys.readouterr().err
    assert main(["render", str(folder), "--tile-px", "16", "--out", str(tmp_path / "drawn")]) == 0
    assert main(["explore", str(folder), "--tile-px", "16", "--out", str(tmp_path / "page.html")]) == 0
    assert main(["pack", str(tmp_path), "--split", "1", "0", "0", "--trips", "2", "--out", str(tmp_path / "pack")]) == 0
    assert parse_given(folder).maps[0].codes.tolist() == TOWN.tolist() == as_maps(folder)[0].codes.tolist()
