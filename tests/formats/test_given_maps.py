"""Maps are taken in the same forms wherever several are."""

import json
import re
from collections import deque

import jax
import numpy as np
import pytest

from elitelanes_jax import DatasetSpec, InputError, PickSpec, RoadMap, SearchSpec
from elitelanes_jax.drive import make_levels
from elitelanes_jax.formats import as_maps
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.maps.given import parse_given

CODES = [[6, 5, 3], [10, 0, 10], [12, 5, 9]]
OTHER = [[6, 7, 3], [14, 15, 11], [12, 13, 9]]


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "map.json"
    path.write_text(json.dumps({"codes": CODES}))
    return path


def forms(file):
    """The map in each form, alone and in a list."""
    alone = [RoadMap(np.array(CODES)), np.array(CODES), jax.numpy.array(CODES), CODES, tuple(CODES), file, str(file)]
    several = [np.array([CODES]), iter([CODES]), (str(file),), deque([CODES]), {alone[0]}, {"town": CODES}.values()]
    return [*alone, *([one] for one in alone), *several]


TAKE = {
    "as_maps": lambda maps: as_maps(maps)[0].codes,
    "like": lambda maps: SearchSpec(like=maps, rules=None).options["like"][0],
    "initial": lambda maps: SearchSpec(initial=maps).options["initial"][0],
    "unlike": lambda maps: PickSpec(unlike=maps).unlike[0],
    "maps_from": lambda maps: DatasetSpec(maps_from=maps, split=(1, 0, 0)).maps_from.maps[0].codes,
    "grids": lambda maps: make_levels(jax.random.key(0), maps, 2).grid[1],
}


@pytest.mark.parametrize("name", TAKE)
def test_maps_are_taken_in_every_form(name, file):
    for maps in forms(file):
        assert np.array_equal(TAKE[name](maps), CODES), maps


def test_one_map_is_taken_in_every_form(file):
    for source in forms(file):
        assert np.array_equal(as_map(source).codes, CODES), source
    for source in (3, np.array(3), {"codes": CODES}):
        with pytest.raises(InputError, match="^map: expected a map, a grid or a file of one, got "):
            as_map(source)


@pytest.mark.parametrize("name", TAKE)
@pytest.mark.parametrize(
    ("maps", "message"),
    [
        (3, "expected maps, grids or files of maps, got 3"),
        (np.array(3), r"expected maps, grids or files of maps, got array\(3\)"),
        ([3], "map 0: grid: expected rows of tile codes"),
        ([CODES, [[16]]], "map 1: grid: expected tile codes 0 to 15, got 16"),
        ([CODES, [[6, 3], [12]]], "map 1: grid: expected rows of one length"),
        ("none.json", "none.json: no such file"),
        ({"codes": CODES}, "none|codes"),
    ],
)
def test_other_things_are_refused_by_name(name, maps, message):
    with pytest.raises(InputError, match=message) as caught:
        TAKE[name](maps)
    assert name == "as_maps" or str(caught.value).startswith(f"{name}: ")


def test_several_maps_are_several(file):
    several = [CODES, str(file), RoadMap(np.array(OTHER))]
    for maps in (several, tuple(several), iter(several), np.array([CODES, CODES, OTHER])):
        assert [one.codes.tolist() for one in as_maps(maps)] == [CODES, CODES, OTHER]
    with pytest.raises(InputError, match="grids: expected one or more of one size, got several sizes"):
        make_levels(jax.random.key(0), [CODES, [[6, 3], [12, 9]]])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff", "expected a readable JSON file"),
        (b"[" * 100_000, "expected the metadata of a dataset, got maximum recursion"),
        (b'{"number": "b", "codes": [[6, 3], [12, 9]]}', "expected a sample with a number"),
        (b'{"number": 1, "codes": [[99]]}', "grid: expected tile codes 0 to 15"),
    ],
)
def test_bad_metadata_of_a_dataset_is_named(content, words, tmp_path):
    (tmp_path / "dataset.json").touch()
    (tmp_path / "a.jsonl").write_text('{"number": 0, "codes": [[6, 3], [12, 9]]}\n')
    assert parse_given(tmp_path).maps[0].codes.tolist() == [[6, 3], [12, 9]]
    (tmp_path / "b.jsonl").write_bytes(content)
    with pytest.raises(InputError, match=rf"^{re.escape(str(tmp_path))}.b.jsonl: {words}"):
        parse_given(tmp_path)


def test_a_folder_without_maps_names_the_folders_that_have_some(tmp_path):
    run = tmp_path / "run"
    (run / "maps").mkdir(parents=True)
    (run / "run.json").write_text("{}")
    expected = "a folder with map.json or other files of maps in it, got one without"
    with pytest.raises(InputError, match=f"^.*run: expected {expected}$"):
        parse_given(run)
    (run / "run.json").unlink()
    (run / "maps" / "town.json").write_text(json.dumps({"codes": CODES}))
    with pytest.raises(InputError, match=f"^.*run: expected {expected}; name .*maps$"):
        parse_given(run)
