"""Checks of single values, words for messages, and files of arrays: what they refuse."""

import os
import pickle
import sys
import zipfile
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax._util.checks import check_named, clip_to_int32, file_named, folder, path, real
from elitelanes_jax._util.errors import InputError, suggest
from elitelanes_jax._util.npz import read_npz
from elitelanes_jax.cli.arguments import naming_options
from elitelanes_jax.maps import GenerateSpec
from elitelanes_jax.maps.spec import parse_part, parse_split
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.problem.inventory import parse_numbers


@pytest.mark.parametrize(
    "number",
    [10**400, -(10**400), float("inf"), "1e400", float("nan")],
    ids=["large", "small", "infinite", "text", "nan"],
)
def test_a_number_that_no_float_holds_is_refused(number):
    with refused("", expected="a number"):
        real(0)(number)
    assert real(0)(10**300) == 1e300 and real(0)(sys.float_info.max) == sys.float_info.max


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble])
def test_a_number_of_any_type_of_numpy_is_compared_as_a_number_of_python(dtype):
    assert real(0)(dtype(0.5)) == 0.5 and type(real(0)(dtype(0.5))) is float
    for check in (real(0), real(0, 1e6), real(0, exclusive=True)):
        for number in ("inf", "nan"):
            with refused("", f"np.{dtype.__name__}(...{number}...)"):
                check(dtype(number))


@pytest.mark.parametrize("text", ["a\0b", "a\ud800"])
@pytest.mark.parametrize("kind", [str, Path])
@pytest.mark.parametrize("check", [path, folder, file_named(".json")], ids=["path", "folder", "file"])
def test_a_path_with_characters_that_no_path_has_is_refused(check, kind, text):
    with refused("", "'a...", expected="path"):
        check(kind(text))


def test_a_path_may_have_bytes_that_are_no_text():
    assert path("a\udcff") == Path("a\udcff")


@pytest.mark.parametrize(
    ("value", "clipped"),
    [(2**31 - 1, 2**31 - 1), (2**31, 2**31 - 1), (-(2**31), -(2**31)), (-(2**31) - 1, -(2**31)), (2.0**40, 2.0**40)],
)
def test_whole_numbers_are_clipped_to_32_bits(value, clipped):
    assert clip_to_int32(value) == clipped
    if isinstance(value, int):
        assert clip_to_int32(np.array(value)) == clipped
        assert clip_to_int32(np.array([value, 3])).tolist() == clip_to_int32([value, 3]) == [clipped, 3]
    assert clip_to_int32(np.array([2**64 - 1], np.uint64)) == 2**31 - 1
    assert clip_to_int32(np.array([-1], np.int8)) == -1


def test_a_folder_with_the_long_name_of_a_file_is_refused_in_one_line():
    with refused("", "the name of a file, 'aaa..."):
        folder("a" * 300 + ".png")


def test_nothing_is_suggested_for_an_empty_name():
    assert suggest("", ["size"]) == suggest("--", ["--size"]) == ""
    assert suggest("siz", ["size"]) == "is it size?"


def test_code_without_a_module_is_warned():
    with pytest.warns(UserWarning, match="of ours"):
        exec("from elitelanes_jax._util.errors import warn_user; warn_user('of ours')", {})


@pytest.mark.parametrize("name", ["grids", "settings"])
def test_an_archive_with_other_members_than_arrays_is_refused(name, tmp_path):
    with zipfile.ZipFile(tmp_path / "runs.npz", "w") as archive:
        archive.writestr(name, "[]")
    with refused(tmp_path / "runs.npz", f"...: {name} is no array"):
        read_npz(tmp_path / "runs.npz")


def test_an_error_that_gets_a_name_keeps_its_subject():
    def check(value):
        raise InputError("where turns", "more")

    with refused("large: where turns", ""):
        check_named("large", check, 3)
    with refused("where turns", ""):
        check_named("where", check, 3)
    with refused("whe: where turns", ""):
        check_named("whe", check, 3)


@pytest.mark.parametrize("subject", ["size_px", "size.json", "size/map.json"])
def test_a_name_that_begins_with_another_one_is_not_taken_for_it(subject):
    def check(value):
        raise InputError(subject, "more")

    with refused(f"size: {subject}"):
        check_named("size", check, 3)
    with refused(subject), naming_options(GenerateSpec()):
        check(3)


def test_an_error_has_its_parts_and_survives_pickling():
    error = InputError("map.yaml", "rows of\n    one length", 3, "is it tiles?")
    assert str(error) == "map.yaml: expected rows of one length, got 3; is it tiles?"
    assert str(error.within("--map")) == "--map: map.yaml: expected rows of one length, got 3; is it tiles?"
    copy = pickle.loads(pickle.dumps(error.replace(subject="").advise("or rows")))
    assert str(copy) == "expected rows of one length, got 3; is it tiles?; or rows"
    assert (copy.subject, copy.expected, copy.got) == ("", "rows of one length", "3")
    assert str(InputError("map.yaml", "", "no such file")) == "map.yaml: no such file"


@pytest.mark.parametrize(
    "read",
    [check_shape, parse_part, parse_split, lambda pair: parse_numbers("weights", ["turns"], [pair], least=0)],
)
def test_items_without_end_are_refused(read):
    """A list of them would fill the memory."""
    with pytest.raises(InputError):
        read(count())


def test_a_file_to_write_has_one_of_the_suffixes(tmp_path):
    check = file_named(".html", ".htm")
    assert check(tmp_path / "page.HTM") == tmp_path / "page.HTM" and check(os.devnull) == Path(os.devnull)
    (tmp_path / "page").touch()
    for name in ("page", "new", "page.txt", "a" * 300):
        with refused("", tmp_path / name, expected=".html or .htm"):
            check(tmp_path / name)
