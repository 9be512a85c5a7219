"""Searches that are killed or interrupted: they go on where they were, and end the same, byte for byte."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import chex
import jax
import numpy as np
import pytest
from certified import evolve, same
from killed_runs import digest
from refusals import refused

from elitelanes_jax import GenerateSpec, NotEnoughMapsError, Result, SearchInterrupted, SearchSpec
from elitelanes_jax._util.files import new_file
from elitelanes_jax._util.folders import has_unfinished, locked
from elitelanes_jax.maps import generate
from elitelanes_jax.search import _programs
from elitelanes_jax.search import running as search
from elitelanes_jax.search._checkpoint import Checkpoint
from elitelanes_jax.search._compiling import CompiledPrograms
from elitelanes_jax.search._programs import Programs

SHAPE = (5, 6)
KEYS = jax.random.split(jax.random.key(5), 3)
GENERATIONS = 135  # a call of 128, and seven of 1

run = partial(evolve, KEYS, SHAPE, method="ea", preset="paper", generations=GENERATIONS)


@pytest.fixture(autouse=True)
def short_calls(monkeypatch):
    monkeypatch.setattr(_programs, "_SECONDS_A_CALL", 0.0)


@pytest.fixture(scope="module")
def whole():
    return run()


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """The folder as it was after each checkpoint of a search."""
    place, folders = tmp_path_factory.mktemp("kept"), []
    save = Checkpoint.save

    def save_and_copy(self, result):
        save(self, result)
        folders.append(shutil.copytree(self.folder, place / f"at-{len(folders)}"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Checkpoint, "save", save_and_copy)
        patch.setattr(_programs, "_SECONDS_A_CALL", 0.0)
        run(checkpoint=place / "folder", every=0)
    return folders


def test_from_every_checkpoint_on_it_ends_the_same(kept, whole):
    done = [int(Result.load(folder / "result.npz").state.generation) for folder in kept]
    assert done == [*range(128, 136), 135]
    for folder in (kept[0], kept[3], kept[-1]):
        again = shutil.copytree(folder, folder.with_name(f"{folder.name}-again"))
        same(run(checkpoint=again, every=0), whole)
        same(Result.load(again / "result.npz"), whole)


def test_a_finished_search_is_not_run_again_and_a_larger_budget_goes_on(kept, whole, tmp_path, monkeypatch):
    folder = shutil.copytree(kept[-1], tmp_path / "folder")
    before = (folder / "result.npz").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(Programs, "_advance", None)
        same(run(checkpoint=folder), whole)
    assert (folder / "result.npz").read_bytes() == before
    same(run(checkpoint=folder, style="paper"), whole)  # which says the same by another name
    more = run(checkpoint=folder, generations=140)
    same(more, run(generations=140))


def test_one_key_alone_and_a_search_that_goes_on_from_a_state(whole, tmp_path):
    alone = partial(run.func, KEYS[0], SHAPE, **run.keywords)
    one = alone(checkpoint=tmp_path / "alone")
    np.testing.assert_array_equal(one.elites.grids, whole.elites.grids[0])
    same(alone(checkpoint=tmp_path / "alone"), one)
    half = run(generations=130)
    for _ in range(2):
        rest = run(generations=5, state=half.state, checkpoint=tmp_path / "rest")
        chex.assert_trees_all_equal(rest.elites, whole.elites)
        assert rest.history.generation.tolist() == [131, 132, 133, 134, 135]
    with refused(tmp_path / "rest", "results with 130", expected="after 0"):
        run(checkpoint=tmp_path / "rest")


def interrupt_at(patch, number, kind=Programs, method="_run_on_parts"):
    """Interrupts the call of this number in which programs run in threads, or compile, as Ctrl-C does."""
    original, calls = getattr(kind, method), []

    def interrupted(*arguments):
        calls.append(None)
        if len(calls) == number:
            raise KeyboardInterrupt
        return original(*arguments)

    patch.setattr(kind, method, interrupted)


@pytest.mark.parametrize(("number", "done"), [(2, 0), (3, 128), (6, 131)])
def test_an_interruption_has_what_was_found(number, done, whole, monkeypatch):
    with monkeypatch.context() as patch:
        interrupt_at(patch, number)
        with pytest.raises(SearchInterrupted, match=f"at generation {done} of 135") as caught:
            run()
    found = caught.value.result
    assert isinstance(caught.value, KeyboardInterrupt)
    assert found is caught.value.result
    np.testing.assert_array_equal(found.history.best_fitness, whole.history.best_fitness[:, :done])
    rest = run(generations=GENERATIONS - done, state=found.state)
    chex.assert_trees_all_equal(rest.elites, whole.elites)


@pytest.mark.parametrize("number", [1, 2])
def test_an_interruption_before_any_grid_is_evaluated_has_nothing(number, monkeypatch):
    with monkeypatch.context() as patch:
        interrupt_at(patch, number)
        with pytest.raises(KeyboardInterrupt) as caught:
            evolve(KEYS, SHAPE, generations=3)
    assert type(caught.value) is KeyboardInterrupt


@pytest.mark.parametrize("moment", ["collect_parts", "save"])
def test_an_interruption_at_the_very_end_has_what_was_found(moment, whole, tmp_path, monkeypatch):
    """It comes while the elites are collected, or while the last checkpoint is written."""
    kind = Programs if moment == "collect_parts" else Checkpoint
    finish = getattr(kind, moment)

    def interrupted(*arguments):
        monkeypatch.setattr(kind, moment, finish)
        raise KeyboardInterrupt

    monkeypatch.setattr("elitelanes_jax.search._checkpoint._SECONDS_TO_KEEP", 0)
    monkeypatch.setattr(kind, moment, interrupted)
    with pytest.raises(SearchInterrupted, match="at generation 135 of 135") as caught:
        run(checkpoint=tmp_path)
    chex.assert_trees_all_equal(caught.value.result.elites, whole.elites)
    same(Result.load(tmp_path / "result.npz"), whole)


def compiled_anew(setup, keys, *arguments):
    return Programs(setup, jax.ShapeDtypeStruct(keys.shape, keys.dtype), *arguments, folder=None)


def test_an_interruption_while_compiling_keeps_what_was_there_before(whole, monkeypatch):
    half = run(generations=130)
    for state, kind in ((None, KeyboardInterrupt), (half.state, SearchInterrupted)):
        with monkeypatch.context() as patch:
            patch.setattr(search, "find_programs", compiled_anew)
            interrupt_at(patch, 1, CompiledPrograms, "_compile")
            with pytest.raises(KeyboardInterrupt) as caught:
                run(generations=5, state=state)
        assert type(caught.value) is kind
    chex.assert_trees_all_equal(caught.value.result.elites, half.elites)


def test_an_interrupted_search_is_kept_where_it_took_long(whole, tmp_path, monkeypatch):
    for worth, left in ((10, []), (0, ["result.npz", "search.json"])):
        with monkeypatch.context() as patch:
            patch.setattr("elitelanes_jax.search._checkpoint._SECONDS_TO_KEEP", worth)
            interrupt_at(patch, 5)
            with pytest.raises(SearchInterrupted):
                run(checkpoint=tmp_path / "folder")
        assert sorted(file.name for file in tmp_path.rglob("*.*")) == left
    assert Result.load(tmp_path / "folder" / "result.npz").state.generation == 130
    same(run(checkpoint=tmp_path / "folder"), whole)


@pytest.mark.parametrize(
    ("change", "subject", "got", "expected"),
    [
        (
            {"method": "map-elites"},
            "...folder",
            "results with 'ea'",
            "method 'map-elites'",
        ),
        ({"weights": {"bridges": 3}}, "...folder", "results with None", "weights bridges 3"),
        ({"generations": 100}, "...folder", "4,000 evaluations (100 generations)", "5,400"),
        ({"shape": (6, 5)}, "...folder", "results with [5, 6]", "size [6, 5]"),
        ({"key": KEYS[::-1]}, "...folder", "results with '...'", "keys"),
        ({"every": -1}, "every", "-1", ""),
    ],
)
def test_the_checkpoint_of_another_search_is_refused(change, subject, got, expected, kept, tmp_path):
    folder = shutil.copytree(kept[-1], tmp_path / "folder")
    (folder / "lock").unlink()
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with refused(subject, got, expected) as caught:
        evolve(**{"key": KEYS, "shape": SHAPE} | run.keywords | {"checkpoint": folder} | change)
    assert "\n" not in str(caught.value)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_folders_in_use_damaged_or_of_another_version_are_refused(kept, tmp_path, monkeypatch):
    folder = shutil.copytree(kept[-1], tmp_path / "folder")
    with monkeypatch.context() as patch:
        patch.setattr(search, "installed_versions", lambda: {"jax": "0.1"})
        with refused(tmp_path / "folder", f"results with '{jax.__version__}'", expected="versions jax '0.1'"):
            run(checkpoint=folder)
    with (
        locked(folder, folder),
        refused(tmp_path / "folder", "one, ..."),
    ):
        run(checkpoint=folder)
    whole = (folder / "result.npz").read_bytes()
    (folder / "result.npz").write_bytes(whole[: len(whole) // 2])
    with refused(tmp_path / "folder" / "result.npz", "a file that cannot be read as such: ..."):
        run(checkpoint=folder)
    assert len((folder / "result.npz").read_bytes()) == len(whole) // 2
    with refused(tmp_path / "folder" / "result.npz", "...: file exists"):
        run(checkpoint=folder / "result.npz")


def test_the_part_of_a_file_that_a_kill_left_is_removed(kept, whole, tmp_path, monkeypatch):
    """Otherwise many kills would fill the disk."""
    folder = shutil.copytree(kept[0], tmp_path / "folder")
    with monkeypatch.context() as patch, new_file(folder / "result.npz") as part:
        part.write_bytes(b"PK")
        # Neither renamed nor removed, as after a kill.
        patch.setattr(Path, "replace", lambda self, target: None)
        patch.setattr(Path, "unlink", lambda self: None)
    assert part.exists()
    (folder / ".notes.txt").write_text("the user's own")
    same(run(checkpoint=folder), whole)
    assert sorted(file.name for file in folder.iterdir()) == [".notes.txt", "result.npz", "search.json"]


def test_checkpoints_come_as_often_as_asked_for_and_take_little_of_the_time(tmp_path, monkeypatch, whole):
    clock = [0.0]
    monkeypatch.setattr("elitelanes_jax.search._checkpoint.time.monotonic", lambda: clock[0])
    monkeypatch.setattr(Result, "save", lambda self, path: clock.__setitem__(0, clock[0] + 3.0))
    often, seldom = Checkpoint(tmp_path, {}, 0), Checkpoint(tmp_path, {}, 20)
    clock[0] = 50.0  # compiling
    assert often.is_due() and not seldom.is_due()
    assert not seldom.keeps_interrupted
    clock[0] = 60.0
    assert seldom.keeps_interrupted and not seldom.is_due()
    clock[0] = 70.0
    assert seldom.is_due()
    seldom.save(whole)
    often.save(whole)
    assert often.is_due() and not seldom.is_due()
    clock[0] = 132.9
    assert not seldom.is_due()
    clock[0] = 133.1
    assert seldom.is_due()
    (tmp_path / "result.npz").touch()
    assert Checkpoint(tmp_path, {}, 20).keeps_interrupted, "one that is there is kept up to date"


SMALL = GenerateSpec(size=SHAPE, seeds=3, maps=2, tile_px=16, search=SearchSpec(**run.keywords))


def test_generate_goes_on_after_an_interruption(tmp_path, monkeypatch):
    generate(SMALL, tmp_path / "whole")
    monkeypatch.setattr("elitelanes_jax.search._checkpoint._SECONDS_TO_KEEP", 0)
    monkeypatch.setattr(importlib.import_module("elitelanes_jax.maps.generation"), "_WORTH_KEEPING", 0)
    out, hidden = tmp_path / "out", tmp_path / ".out-unfinished"
    with monkeypatch.context() as patch:
        interrupt_at(patch, 4)
        with pytest.raises(KeyboardInterrupt):
            generate(SMALL, out)
    assert has_unfinished(out)
    with refused(tmp_path / "out", "results with 3", expected="seeds 2"):
        generate(SMALL.replace(seeds=2), out)
    with locked(hidden, out), refused(tmp_path / "out", "one, ..."):
        generate(SMALL, out)
    with monkeypatch.context() as patch:  # while it draws
        patch.setattr(Path, "write_bytes", lambda *_: interrupt())
        with pytest.raises(KeyboardInterrupt):
            generate(SMALL, out)
    with monkeypatch.context() as patch:  # when the folder comes to its place
        patch.setattr(Path, "rename", full_disk)
        with pytest.raises(OSError, match="No space"):
            generate(SMALL, out)
    assert sorted(file.name for file in tmp_path.iterdir()) == [".out-unfinished", "whole"]
    with monkeypatch.context() as patch:
        patch.setattr(Programs, "_advance", None)
        with pytest.raises(NotEnoughMapsError, match=r"found \d+ of 60 maps"):
            generate(SMALL.replace(maps=60), out)
        generate(SMALL, out)
    assert digest(out) == digest(tmp_path / "whole")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["out", "whole"]
    assert json.loads((out / "run.json").read_text())["times"]["seconds"]["evolve"] > 0


RENAME = Path.rename


def interrupt():
    raise KeyboardInterrupt


def full_disk(path, target):
    if path.parent.name.startswith(".out-"):
        raise OSError(28, "No space left on device", str(path))
    return RENAME(path, target)


def killed(out, kills, seed):
    program = Path(__file__).parents[1] / "killed_runs.py"
    command = [sys.executable, str(program), str(out), str(kills), str(seed)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ, timeout=3000)
    assert ran.returncode == 0, ran.stderr
    *digests, last = map(json.loads, ran.stdout.splitlines())
    assert last == {"kills": kills}
    assert len(digests) >= 2
    assert len({record["digest"] for record in digests}) == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no such processes")
@pytest.mark.parametrize("kills", [3, pytest.param(100, marks=pytest.mark.slow)])
def test_killed_at_any_moment_it_ends_the_same(kills, tmp_path):
    killed(tmp_path / "out", kills, seed=kills)
