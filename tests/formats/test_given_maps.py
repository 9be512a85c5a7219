"""Maps are taken in the same forms wherever several are."""

import json
from collections import deque

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import DatasetSpec, PickSpec, RoadMap, SearchSpec
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
        with refused("map", repr(source)):
            as_map(source)


@pytest.mark.parametrize("name", TAKE)
@pytest.mark.parametrize(
    ("maps", "place", "got", "expected"),
    [
        (3, "", "3", "files of maps"),
        (np.array(3), "", "array(3)", "files of maps"),
        ([3], "map 0: grid", "3", ""),
        ([CODES, [[16]]], "map 1: grid", "16 at A1 ([0, 0])", ""),
        ([CODES, [[6, 3], [12]]], "map 1: grid", "rows of several", ""),
        ("none.json", "none.json", "no such file or directory", ""),
        ({"codes": CODES}, "", "{'codes': [[6, 5, 3], [10, 0, 10], [12, 5, 9]]}", "files of maps"),
    ],
)
def test_other_things_are_refused_by_name(name, maps, place, got, expected):
    argument = "" if name == "as_maps" else name
    with refused(": ".join(filter(None, (argument, place))), got, expected):
        TAKE[name](maps)


def test_several_maps_are_several(file):
    several = [CODES, str(file), RoadMap(np.array(OTHER))]
    for maps in (several, tuple(several), iter(several), np.array([CODES, CODES, OTHER])):
        assert [one.codes.tolist() for one in as_maps(maps)] == [CODES, CODES, OTHER]
    with refused("grids", "several sizes"):
        make_levels(jax.random.key(0), [CODES, [[6, 3], [12, 9]]])


@pytest.mark.parametrize(
    ("content", "subject", "got"),
    [
        (b"\xff", "...data.jsonl", "'utf-8' codec can't decode..."),
        (b"[" * 100_000, "...data.jsonl", "maximum recursion..."),
        (
            b'{"number": "b", "codes": [[6, 3], [12, 9]]}',
            "...data.jsonl",
            '{"number": "b", "codes": [[6, 3], [12, 9]]}',
        ),
        (b'{"number": 1, "codes": [[99]]}', "...data.jsonl: grid", "99 at A1 ([0, 0])"),
    ],
)
def test_bad_metadata_of_a_dataset_is_named(content, subject, got, tmp_path):
    (tmp_path / "dataset.json").touch()
    (tmp_path / "train").mkdir()
    (tmp_path / "maps.jsonl").write_text('{"number": 0, "codes": [[6, 3], [12, 9]]}\n')
    assert parse_given(tmp_path).maps[0].codes.tolist() == [[6, 3], [12, 9]]
    (tmp_path / "train" / "metadata.jsonl").write_bytes(content)
    with refused(subject, got):
        parse_given(tmp_path)


def test_a_folder_without_maps_names_the_folders_that_have_some(tmp_path):
    run = tmp_path / "run"
    (run / "maps").mkdir(parents=True)
    (run / "run.json").write_text("{}")
    with refused(run, "one without"):
        parse_given(run)
    (run / "run.json").unlink()
    (run / "maps" / "town.json").write_text(json.dumps({"codes": CODES}))
    with refused(run, "one without", hint=f"{run / 'maps'}"):
        parse_given(run)
