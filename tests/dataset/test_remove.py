"""--force replaces a dataset of an earlier run, and no folder with anything else in it."""

import importlib.util
import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest
from filelock import FileLock
from given_maps import files, random_maps, small

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.locks import LOCK
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset._formats import FORMATS
from elitelanes_jax.dataset._remove import remove_dataset
from elitelanes_jax.dataset._work import WORK
from elitelanes_jax.dataset.make import make_dataset

OTHERS = random_maps(seed=1)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("written") / "out"
    make_dataset(small(), out, maps=random_maps())
    return out


@pytest.fixture
def folder(written, tmp_path):
    return Path(shutil.copytree(written, tmp_path / "out"))


@pytest.mark.parametrize("name", FORMATS)
def test_another_dataset_takes_the_place_of_one_of_any_format(name, folder, tmp_path):
    if FORMATS[name].needs and not importlib.util.find_spec(FORMATS[name].needs):
        pytest.skip(f"{FORMATS[name].needs} is not installed")
    with pytest.raises(InputError, match=r"expected results of .*, got some of "):
        make_dataset(small(format=name, seed=1), folder, maps=OTHERS)
    make_dataset(small(format=name, seed=1), folder, maps=OTHERS, force=True)
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]
    make_dataset(small(format=name, seed=1), tmp_path / "new", maps=OTHERS)
    assert files(folder) == files(tmp_path / "new")
    remove_dataset(folder)
    assert not list(folder.iterdir())


@contextmanager
def killed_before(monkeypatch, owner, name, dies):
    """Within the block a function of the standard library raises `KeyboardInterrupt` when its arguments say so."""
    usual = getattr(owner, name)

    def function(*arguments, **options):
        if dies(*arguments):
            raise KeyboardInterrupt
        return usual(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, function)
        with pytest.raises(KeyboardInterrupt):
            yield


def test_the_one_before_stays_until_the_new_one_is_complete(folder, tmp_path, monkeypatch):
    """Killed while it draws, or at any step of the change of places: nothing is lost, and the same call ends it."""
    written, spec = files(folder), small(seed=1)
    make_dataset(spec, tmp_path / "expected", maps=OTHERS)
    with killed_before(monkeypatch, Path, "replace", lambda _, target: target.name == "README.md"):
        make_dataset(spec, folder, maps=OTHERS, force=True)
    assert files(folder) == written
    drawn = min((tmp_path / ".out.new").rglob("*000000.png"))
    for number, (owner, name, dies, left) in enumerate(
        [
            (Path, "rename", lambda _, target: target.name == ".out.old", {"out", ".out.new"}),
            (Path, "rename", lambda _, target: target.name == "out", {".out.new", ".out.old"}),
            (shutil, "rmtree", lambda place: place.parent.name == ".out.old", {"out", ".out.old"}),
        ]
    ):
        place = tmp_path / str(number)
        for entry in ("out", ".out.new"):
            shutil.copytree(tmp_path / entry, place / entry)
        with killed_before(monkeypatch, owner, name, dies):
            make_dataset(spec, place / "out", maps=OTHERS, force=True)
        assert {entry.name for entry in place.iterdir()} == left
        make_dataset(spec, place / "out", maps=OTHERS, force=True)
        assert files(place) == {f"out/{name}": content for name, content in files(tmp_path / "expected").items()}
        again = place / "out" / drawn.relative_to(tmp_path / ".out.new")
        assert again.stat().st_mtime_ns == drawn.stat().st_mtime_ns, "it was not drawn again"


def test_an_unfinished_dataset_is_removed_too(folder):
    written = files(folder)
    (folder / "dataset.json").rename(folder / "record")
    work = folder / WORK
    for name in ("maps/given.jsonl", "records/000/000003.json", LOCK):
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        (work / name).write_text("")
    (folder / "record").rename(work / "settings.json")
    (folder / "train" / "image" / ".000002.png.part").write_text("half a picture")
    make_dataset(small(), folder, maps=random_maps(), force=True)
    assert files(folder) == written


@pytest.mark.parametrize(
    ("add", "found"),
    [
        (lambda folder: (folder / "notes.txt").write_text("mine"), "notes.txt"),
        (lambda folder: (folder / "train" / "notes.png").write_text("mine"), "train/notes.png"),
        (lambda folder: (folder / "train" / "image" / "12.png").write_text("mine"), "train/image/12.png"),
        (lambda folder: (folder / ".git").mkdir() or (folder / ".git" / "HEAD").write_text("mine"), ".git/HEAD"),
        (lambda folder: (folder / "link").symlink_to(folder.parent), "link"),
        (lambda folder: (folder / "dataset.json").unlink(), "no dataset.json"),
        (lambda folder: (folder / "dataset.json").write_text("{}"), "dataset.json of another program"),
    ],
)
def test_a_folder_with_anything_else_is_never_removed(add, found, folder, capsys):
    add(folder)
    before = files(folder)
    assert main(["dataset", "--maps", "12", "--size", "5", "--seed", "1", "--force", "--out", str(folder)]) == 2
    assert f"expected a folder with files of an earlier run alone, got one with {found}" in capsys.readouterr().err
    assert files(folder) == before


def test_a_folder_in_which_another_run_is_at_work_stays(folder):
    before = files(folder)
    (folder / WORK).mkdir()
    with (
        FileLock(folder / WORK / LOCK),
        pytest.raises(InputError, match="expected no other run at work in it, got one"),
    ):
        remove_dataset(folder)
    assert before.items() <= files(folder).items()


def test_a_new_folder_and_an_empty_one_need_no_removal(tmp_path):
    for folder in (tmp_path / "new", tmp_path):
        remove_dataset(folder)
    assert not list(tmp_path.iterdir())
