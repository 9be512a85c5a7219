"""Output folders: whole or not at all."""

import pytest

from elitelanes_jax.folders import check_new_folder, new_folder


def everything(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("out", ["out", "deep/down/out"])
def test_a_folder_appears_when_all_is_written(tmp_path, out):
    with new_folder(tmp_path / out) as folder:
        (folder / "file").write_text("text")
        assert not (tmp_path / out).exists()
    assert (tmp_path / out / "file").read_text() == "text"
    assert not [path for path in everything(tmp_path) if ".out" in path]


def test_an_empty_folder_is_as_good_as_none(tmp_path):
    (tmp_path / "out").mkdir()
    with new_folder(tmp_path / "out") as folder:
        (folder / "file").write_text("text")
    assert everything(tmp_path) == ["out", "out/file"]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_nothing_remains_of_what_went_wrong(tmp_path, error):
    def write():
        with new_folder(tmp_path / "out") as folder:
            (folder / "file").write_text("text")
            raise error

    with pytest.raises(error):
        write()
    assert everything(tmp_path) == []


def test_folders_that_cannot_be_made_are_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    for folder, got in ((tmp_path / "file", "got a file"), (tmp_path, "got one with files in it")):
        with pytest.raises(ValueError, match=f"expected a folder that is new or empty, {got}"):
            check_new_folder(folder)
    with pytest.raises(ValueError, match="expected a place that can be written to, got .*file, which cannot"):
        check_new_folder(tmp_path / "file" / "out")
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(ValueError, match="new: expected a place that can be written to"):
        check_new_folder(tmp_path / "new")
    assert (tmp_path / "file").read_text() == "mine"
