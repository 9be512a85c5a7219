"""Map files."""

import copy
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import Drawn, RoadMap, as_maps, map_to_json, read_map, read_maps
from elitelanes_jax.maps.given import parse_given
from elitelanes_jax.network.plain_metrics import plain_measure

CODES = np.array([[6, 5, 3], [12, 5, 9]], np.int8)
WHOLE = RoadMap(
    CODES,
    {"components": 1, "coverage": 1.0},
    -12,
    {"cyclomatic": 1},
    [0, 0],
    (7, 2),
    Drawn("a set", [["turn_1"] * 3] * 2, [[0, 1, 2]] * 2),
)


# Whether a tile is off the alphabet depends on the search, so such a number does not contradict the codes.
OFF = RoadMap(CODES, plain_measure(CODES) | {"off_alphabet": 3}, fitness=4)


@pytest.mark.parametrize("road_map", [WHOLE, RoadMap(CODES), OFF])
def test_a_map_file_gives_the_map_back(road_map, tmp_path):
    file = tmp_path / "map.json"
    file.write_text(map_to_json(road_map))
    back = read_map(file)
    np.testing.assert_array_equal(back.codes, CODES)
    assert back.codes.dtype == np.int8
    assert vars(back) | {"codes": None} == vars(road_map) | {"codes": None}


@pytest.mark.parametrize(
    ("values", "subject", "got"),
    [
        ({"codes": [[99, 3], [12, 9]]}, "grid", "99 at A1 ([0, 0])"),
        ({"codes": [[0.5]]}, "grid", "float64"),
        ({"codes": None}, "grid", "None"),
        ({"metrics": {"turns": float("nan")}}, "metrics", '{"turns": NaN}'),
        ({"metrics": {1: 2.0}}, "metrics", "{1: 2.0}"),
        ({"descriptor": {("turns",): 2}}, "descriptor", "{('turns',): 2}"),
        ({"fitness": float("nan")}, "fitness", "NaN"),
        ({"niche": 3}, "niche", "3"),
        ({"seed": (1, 2, 3)}, "seed", "[1, 2, 3]"),
        ({"drawn": Drawn("a set", [["turn_1"]], [[0]])}, "drawn", "others"),
        ({"drawn": Drawn("a set", [["turn_1"] * 3] * 2, [[4] * 3] * 2)}, "drawn", '{"tile_set": "a set", "tiles":...'),
    ],
)
def test_no_map_is_made_that_no_file_could_hold(values, subject, got):
    with refused(subject, got):
        RoadMap(**{"codes": CODES} | values)
    with refused(subject, got):
        replace(WHOLE, **{"codes": CODES, "drawn": None} | values)


def test_a_map_of_numpy_s_numbers_is_written_like_one_of_python_s(tmp_path):
    measured = plain_measure(CODES)
    turns, coverage = measured["turns"], float(measured["coverage"])
    numbers = {"metrics": {"turns": np.int32(turns), "coverage": np.float32(coverage)}, "fitness": np.float32(2.5)}
    numbers |= {"niche": [np.int32(1)], "seed": [np.int64(7), 2]}
    file = tmp_path / "map.json"
    file.write_text(map_to_json(RoadMap(CODES.tolist(), **numbers)))
    back = read_map(file)
    assert (back.metrics, back.fitness, back.niche, back.seed) == (
        {"turns": turns, "coverage": coverage},
        2.5,
        [1],
        (7, 2),
    )
    np.testing.assert_array_equal(back.codes, CODES)


@pytest.mark.parametrize("number", [np.float16(2.5), np.float32(2.5), np.longdouble(2.5)])
def test_a_number_of_any_float_of_numpy_is_written(number):
    assert RoadMap(CODES, {"turns": number}, number) == RoadMap(CODES, {"turns": 2.5}, 2.5)


def test_a_map_cannot_be_changed_after_it_was_checked():
    codes = np.array([[6, 3], [12, 9]], np.int8)
    loop = RoadMap(codes)
    codes[0, 0] = 99
    with pytest.raises(ValueError, match="read-only"):
        loop.codes[0, 0] = 99
    assert loop.codes.tolist() == [[6, 3], [12, 9]]


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda road_map: pickle.loads(pickle.dumps(road_map))])
def test_a_copy_of_a_map_cannot_be_changed_either(copied):
    again = copied(WHOLE)
    assert again == WHOLE
    with pytest.raises(ValueError, match="read-only"):
        again.codes[0, 0] = 0


def test_maps_are_equal_if_their_files_are():
    again = replace(WHOLE)
    assert again == WHOLE
    assert hash(again) == hash(WHOLE)
    assert not any(other == WHOLE for other in (RoadMap(CODES), replace(WHOLE, codes=15 - CODES), "a text", None))
    assert WHOLE in [RoadMap([[0]]), again]


@pytest.mark.parametrize("name", ["loop.yaml", "loop.png", "loop.npz"])
def test_maps_are_saved_under_names_that_are_read_as_maps(name, tmp_path):
    with refused("file", tmp_path / name, expected=".json"):
        RoadMap([[6, 3], [12, 9]]).save(tmp_path / name)
    with refused("file", "None"):
        RoadMap([[6, 3], [12, 9]]).save(None)
    with refused("file", "a folder, ."):
        RoadMap([[6, 3], [12, 9]]).save(".")
    assert not [*tmp_path.iterdir()]


def test_a_map_file_is_easy_to_read():
    text = map_to_json(WHOLE)
    assert '  "shape": [2, 3],\n' in text
    assert '  "codes": [\n    [6, 5, 3],\n    [12, 5, 9]\n  ],\n' in text
    assert '    "coverage": 1.0\n' in text
    assert json.loads(text)["drawn"]["tiles"] == [["turn_1"] * 3] * 2


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("map.json", '{"codes": [[6, 3], [12, 9]]}'),
        ("map.yaml", "tiles: [[curve_left/W, curve_left/N], [curve_left/S, curve_left/E]]"),
    ],
)
def test_a_grid_of_codes_is_enough_and_a_byte_order_mark_is_read_over(name, text, tmp_path):
    for encoding in ("utf-8", "utf-8-sig"):
        (tmp_path / name).write_text(text, encoding=encoding)
        assert read_map(tmp_path / name).codes.tolist() == [[6, 3], [12, 9]]


def with_(name, text):
    return f'{{"codes": [[6, 3], [12, 9]], "{name}": {text}}}'


def drawn(tiles, turns):
    return f'{{"tile_set": "set", "tiles": {tiles}, "quarter_turns": {turns}}}'


@pytest.mark.parametrize(
    ("text", "subject", "got", "expected"),
    [
        ("{", "...map.json", "Expecting property name...", "readable"),
        ("[1]", "...map.json", "a list; name a file with one map", ""),
        ("[]", "...map.json", "a list; name a file with one map", ""),
        ('[{"codes": [[6, 3], [12, 9]]}]', "...map.json", "a list; name a file with one map", ""),
        ("[[6, 3], [12, 9]]", "...map.json", 'rows alone; write {"codes": ...} around them', ""),
        ("[[6, null], [12, 9]]", "...map.json", 'rows alone; write {"codes": ...} around them', ""),
        ('{"code": []}', "...map.json", 'no "codes"', ""),
        ('{"codes": [[1, 2], [3, 16]]}', "...map.json: grid", "16 at B2 ([1, 1])", ""),
        ('{"codes": [[1, 2], [3]]}', "...map.json: grid", "rows of several", ""),
        ('{"codes": [[1.5, 2], [3, 4]]}', "...map.json: grid", "1.5 at A1 ([0, 0])", ""),
        ('{"codes": [[]]}', "...map.json: shape", "1 x 0", "sides"),
        (with_("drawn", "3"), "...map.json: drawn", "3", ""),
        (
            with_("drawn", drawn('[["a", "b"], ["c", "d"]]', "[[0, 1], [2, 4]]")),
            "...map.json: drawn",
            '{"tile_set": "set", "tiles": [["a"...',
            "",
        ),
        (with_("drawn", drawn('[["a", "b"]]', "[[0, 1]]")), "...map.json: drawn", "others", ""),
        (with_("fitness", "1" + "0" * 309), "...map.json: fitness", "100000000000000000000000...", ""),
        (with_("descriptor", "[1]"), "...map.json: descriptor", "[1]", ""),
        (with_("format", '"another"'), "...map.json: format", "'another'", ""),
        ('{"codes": ' + "9" * 5000 + "}", "...map.json", "Exceeds the limit...", "readable"),
        ('{"codes": [[6, true], [12, 9]]}', "...map.json: grid", "true at B1 ([0, 1])", ""),
        ('{"codes": [[6, 3], [null, 9]]}', "...map.json: grid", "null at A2 ([1, 0])", ""),
        ('{"codes": [["6", 3], [12, 9]]}', "...map.json: grid", '"6" at A1 ([0, 0])', ""),
        (
            '{"codes": [[6, 3], [12, 1' + "0" * 23 + "]]}",
            "...map.json: grid",
            "1" + "0" * 23 + " at B2 ([1, 1])",
            "",
        ),
        (
            '{"codes": [[6, 3], [12, 1' + "0" * 999 + "]]}",
            "...map.json: grid",
            "1" + "0" * 76 + "... at B2 ([1, 1])",
            "",
        ),
        (with_("format", f'"{"a" * 999}"'), "...map.json: format", "'" + "a" * 76 + "...", ""),
        (with_("fitness", f'"{"a" * 999}"'), "...map.json: fitness", '"' + "a" * 76 + "...", ""),
        (with_("metrics", "9" * 10_000), "...map.json", "Exceeds the limit...", "readable"),
        (with_("drawn", "[" * 900 + "]" * 900), "...map.json...", "...", ""),
        ("[" * 100_000, "...map.json", "JSON nested too deeply", ""),
    ],
)
def test_bad_files_are_named(text, subject, got, expected, tmp_path):
    file = tmp_path / "map.json"
    file.write_text(text)
    with refused(subject, got, expected):
        read_map(file)


def test_a_folder_of_generate_is_all_its_maps(tmp_path):
    maps = [RoadMap([[6, 3], [12, 9]]), RoadMap([[6, 5, 3], [12, 5, 9]])]
    for name, road_map in zip(("0001", "0000"), maps, strict=True):
        (tmp_path / "maps" / name).mkdir(parents=True)
        road_map.save(tmp_path / "maps" / name / "map.json")
    assert as_maps(tmp_path) == read_maps(str(tmp_path)) == maps[::-1]
    assert as_maps([tmp_path, maps[0]]) == [*maps[::-1], maps[0]]
    with refused(tmp_path, "a folder without; a map in it is ...maps/0000/map.json"):
        read_map(tmp_path)


def test_rows_alone_are_no_list_of_maps(tmp_path):
    file = tmp_path / "map.json"
    file.write_text("[[6, 3], [12, 9]]")
    with refused(file, 'rows alone; write {"codes": ...} around them'):
        read_maps(file)


@pytest.mark.parametrize("read", [read_map, read_maps, as_maps, parse_given])
def test_the_text_of_a_map_is_no_file(read):
    """It is too long for a path; `Path.is_dir` raises an `OSError`."""
    with refused('{ "format": "elitela...', "File name too long"):
        read(map_to_json(WHOLE).replace("/", ""))


def test_a_map_that_was_changed_by_hand_keeps_its_objects_and_unsure_cells(tmp_path):
    measured = RoadMap(CODES, plain_measure(CODES), fitness=-12, objects=[MapObject("duckie", 0, 0, 0, 0.08)])
    file = tmp_path / "map.json"
    replace(measured, codes=np.zeros_like(CODES), unsure=[[0, 1]]).save(file)
    changed = read_map(file)
    assert (changed.fitness, changed.unsure, changed.objects) == (None, [[0, 1]], measured.objects)
    assert changed.metrics["tiles"] == 0


@pytest.mark.filterwarnings("error")
def test_a_share_that_no_float32_holds_is_measured_again(tmp_path):
    file = tmp_path / "map.json"
    RoadMap(CODES, plain_measure(CODES) | {"coverage": 1e300}).save(file)
    assert read_map(file).metrics["coverage"] == 1


@pytest.mark.parametrize("name", ["map.json", "map.yaml"])
def test_files_are_read_to_a_limit(name, tmp_path):
    """A file of 30 GB without a single block on the disk."""
    file = tmp_path / name
    with file.open("wb") as stream:
        stream.truncate(30 * 2**30)
    with refused(file, "a larger one", expected="32 MiB"):
        read_map(file)


@pytest.mark.slow
def test_the_largest_map_is_within_the_limit(tmp_path):
    codes = np.full((1024, 1024), 15, np.int8)
    drawn = Drawn("a set", [["crossing4_10"] * 1024] * 1024, [[3] * 1024] * 1024)
    file = tmp_path / "map.json"
    file.write_text(map_to_json(RoadMap(codes, drawn=drawn)))
    np.testing.assert_array_equal(read_map(file).codes, codes)
    file.write_text(json.dumps({"codes": codes.repeat(2, 1).tolist()}))
    with refused(f"{file}: shape", "1024 x 2048", expected="1024"):
        read_map(file)
