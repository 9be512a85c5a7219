"""Files that are read up to a limit, and written whole or not at all."""

import sys
from contextlib import ExitStack
from pathlib import Path
from stat import S_IMODE

import pytest
from refusals import refused

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import check_new, never_replacing, new_file, parse_json, write_atomic


def names(folder):
    return [entry.name for entry in folder.iterdir()]


def test_the_message_names_the_file_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("mine")
    for file, why in ((tmp_path / "file" / "out", "Not a directory"), (tmp_path / ("a" * 256), "File name too long")):
        with pytest.raises(OSError, match=f"{why}: '{file}'$"):
            write_atomic(file, b"text")
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize(
    "name", ["a" * 250 + ".json", "a." + "b" * 253, "\N{GRINNING FACE}" * 63 + ".x", "." + "a" * 254]
)
def test_the_longest_names_are_written(name, tmp_path):
    write_atomic(tmp_path / name, b"text")
    assert names(tmp_path) == [name]


@pytest.mark.skipif(sys.platform == "win32", reason="no such permissions")
@pytest.mark.parametrize("mode", [0o600, 0o444])
def test_a_replaced_file_keeps_its_permissions_and_links_to_it(mode, tmp_path):
    (tmp_path / "deep").mkdir()
    file, link = tmp_path / "deep" / "file.txt", tmp_path / "link"
    link.symlink_to(Path("deep", "file.txt"))
    write_atomic(link, b"new")  # a link to a new file
    assert file.read_text() == "new"
    file.chmod(mode)
    write_atomic(link, b"newer")
    assert link.is_symlink() and file.read_text() == "newer" and S_IMODE(file.stat().st_mode) == mode
    assert names(tmp_path / "deep") == ["file.txt"] and sorted(names(tmp_path)) == ["deep", "link"]


@pytest.mark.skipif(sys.platform == "win32", reason="no links")
def test_links_that_lead_nowhere_are_kept(tmp_path):
    link, loop = tmp_path / "link", tmp_path / "loop"
    link.symlink_to("nowhere")
    loop.symlink_to("loop")
    for file in (link, loop):
        with refused(file, "a link that leads nowhere"):
            check_new(file)
    with pytest.raises(OSError, match=f"Too many levels of symbolic links: '{loop}'"):
        write_atomic(loop, b"text")
    assert link.is_symlink() and loop.is_symlink() and len(names(tmp_path)) == 2


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), KeyboardInterrupt(), InputError("bad", "more")]
)
def test_a_file_stays_as_it_was_if_another_cannot_be_written(error, tmp_path):
    (tmp_path / "file.png").write_text("mine")

    def fails():
        with new_file(tmp_path / "file.png") as part:
            assert part.suffix == ".png"
            part.write_text("half")
            raise error

    with pytest.raises(type(error)):
        fails()
    assert names(tmp_path) == ["file.png"]
    assert (tmp_path / "file.png").read_text() == "mine"


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e400", "-1E+999", "1" * 400 + ".0"])
def test_json_has_finite_numbers_alone(number):
    with refused("JSON", f"{number[:70]}..."):
        parse_json(f'{{"a": [{number}]}}')
    assert parse_json("[1e308, -0.5, 2, 1e-400]") == [1e308, -0.5, 2, 0]


def test_two_at_once_may_write_one_file(tmp_path):
    with ExitStack() as stack:
        parts = [stack.enter_context(new_file(tmp_path / "deep" / "file")) for _ in range(2)]
        for number, part in enumerate(parts):
            part.write_text(str(number))
    assert (tmp_path / "deep" / "file").read_text() in ("0", "1")
    assert names(tmp_path / "deep") == ["file"]


def test_files_that_exist_are_named(tmp_path):
    check_new(tmp_path / "file")
    (tmp_path / "file").write_text("mine")
    with refused(tmp_path / "file", "an existing one"):
        check_new(tmp_path / "file")


def test_a_file_of_another_process_is_not_replaced(tmp_path):
    file = tmp_path / "file"

    def write_at_the_same_moment():
        with never_replacing(file), new_file(file) as part:
            part.write_text("mine")
            file.write_text("of the other")

    with refused(tmp_path / "file", "an existing one"):
        write_at_the_same_moment()
    assert names(tmp_path) == ["file"]
    assert file.read_text() == "of the other"
    write_atomic(file, b"replaced as always")
    assert file.read_text() == "replaced as always"
