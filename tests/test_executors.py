"""Searches and datasets on executors give the bytes of one machine: threads, spawned processes, Dask, Submitit."""

import errno
import json
import os
import pickle
import shutil
import signal
import socket
import sys
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import chex
import cv2
import numpy as np
import pytest
from folders import files
from given_maps import random_maps, small
from killed_runs import digest
from refusals import refused

from elitelanes_jax import GenerateSpec, InputError, SearchSpec, evolve, generate, make_dataset
from elitelanes_jax._util import engine
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset import merge_dataset
from elitelanes_jax.search import parts as search_parts
from elitelanes_jax.search.keys import check_keys
from elitelanes_jax.search.resolve import resolve
from elitelanes_jax.tiles import load_objects, load_tiles, packed
from elitelanes_jax.tiles.object_set import default_objects
from elitelanes_jax.tiles.tileset import default_tiles

# When Submitit sets up logging, absl's handler closes the stream that was stderr at its own import: that of pytest.
os.environ["SUBMITIT_LOG_LEVEL"] = "NOCONFIG"

SEARCH = SearchSpec(method="ea", preset="paper", generations=20)
SPEC = GenerateSpec(size=(5, 6), seeds=6, maps=3, tile_px=16, search=SEARCH)
LONG = SPEC.replace(search=SEARCH.replace(generations=20_000))
COMMAND = ["generate", "--size", "5", "6", "--seeds", "6", "--maps", "3", "--tile-px", "16", "--method", "ea"]
COMMAND += ["--preset", "paper", "--generations", "20"]
EVOLVED = small(maps_from=None, maps=12, size="4..5", search=SearchSpec(preset="paper", evaluations=500))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The digest of the folder that one machine writes."""
    out = tmp_path_factory.mktemp("whole") / "maps"
    generate(SPEC, out)
    return digest(out)


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """The digest of a longer run, some of whose parts run when the first one has returned."""
    out = tmp_path_factory.mktemp("whole") / "long"
    generate(LONG, out)
    return digest(out)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """The files of a dataset that one machine makes."""
    out = tmp_path_factory.mktemp("whole") / "dataset"
    make_dataset(small(views=2), out)
    return files(out)


@pytest.fixture(scope="module")
def dataset_parts(tmp_path_factory):
    """The folder of both parts of that dataset."""
    place = tmp_path_factory.mktemp("parts")
    for index in (1, 2):
        make_dataset(small(views=2, part=(index, 2)), place / f"part-{index}")
    return place


@pytest.fixture
def threads():
    with ThreadPoolExecutor(2) as pool:
        yield pool


def fitness(usual, metrics):
    return usual + 50 * metrics.turns


class OneByOne:
    """Runs each call when it is submitted, as an executor of another library may; counts the calls."""

    def __init__(self, *, fails=()):
        self.calls, self.fails, self.sizes = 0, fails, []

    def submit(self, function, *arguments):
        self.sizes.append(len(pickle.dumps(arguments)))
        future = Future()
        if self.calls in self.fails:
            future.set_exception(self.fails[self.calls])
        else:
            future.set_result(function(*arguments))
        self.calls += 1
        return future


def test_each_position_is_in_its_part():
    for count in range(1, 20):
        for parts in range(1, count + 1):
            for position in range(count):
                assert position in engine.part_of(count, engine.part_with(count, position, parts), parts)


@pytest.mark.parametrize("count", [3, 100])
def test_any_number_of_parts_gives_the_files_of_one_machine(count, whole, tmp_path, threads):
    generate(SPEC, tmp_path / "maps", executor=threads, parts=count)
    assert digest(tmp_path / "maps") == whole
    assert [entry.name for entry in tmp_path.iterdir()] == ["maps"]


@pytest.mark.slow
def test_a_search_with_functions_of_ones_own_gives_the_same_arrays(threads):
    options = {"seeds": 4, "spec": SEARCH, "fitness": fitness}
    expected, got = evolve(3, (5, 5), **options), evolve(3, (5, 5), **options, executor=threads, parts=2)
    for name in ("grids", "fitness", "descriptor", "valid"):
        np.testing.assert_array_equal(getattr(got.elites, name), getattr(expected.elites, name))
    np.testing.assert_array_equal(got.history.best_fitness, expected.history.best_fitness)
    assert got.functions == expected.functions and got.search == expected.search


class Stale(OneByOne):
    """A worker that has another value of a global than the caller, as after an edit of an imported module."""

    def submit(self, function, *arguments):
        global TURN
        TURN, ours = 51, TURN
        try:
            return super().submit(function, *arguments)
        finally:
            TURN = ours


TURN = 50


def edited(usual, metrics):
    return usual + TURN * metrics.turns


def test_a_worker_with_another_version_of_a_function_is_refused():
    with refused("executor", "another one from a worker"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, fitness=edited, executor=Stale(), parts=2)


def test_parts_are_of_32_seeds_at_most():
    executor = OneByOne(fails=dict.fromkeys(range(3), engine.CancelledError()))
    with pytest.raises(ConnectionError, match="^part 1 of 3: "):
        evolve(0, (4, 4), seeds=65, spec=SEARCH, executor=executor)
    assert executor.calls == 3


def test_datasets_have_the_same_files(dataset, tmp_path, threads):
    make_dataset(small(views=2), tmp_path / "given", executor=threads, parts=5)
    assert files(tmp_path / "given") == dataset


def test_tasks_name_the_packages_own_pictures(tmp_path):
    furnished, executor = small(maps=3, maps_from=random_maps(3), split=(1, 0, 0), furnish="lane_duckies=1"), OneByOne()
    make_dataset(furnished, tmp_path / "sent", executor=executor, parts=3)
    assert executor.calls == 3
    assert max(executor.sizes) < 20_000


def test_tasks_pack_pictures_of_ones_own(tmp_path):
    tiles = shutil.copytree(default_tiles(), tmp_path / "tiles")
    (tiles / "tileset.toml").write_text('name = "mine"\n')
    picture = cv2.imread(str(tiles / "turn_1" / "image.png"))[:64, :64]
    for folder in tiles.glob("*_*"):
        for file in folder.glob("*.png"):
            cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), (64, 64), interpolation=0))
    decoded = sum(1 for _ in tiles.glob("*/image.png")) * picture.size * 2  # the masks are as large as the pictures
    objects = tmp_path / "objects"
    shutil.copytree(default_objects() / "duckie_1", objects / "duckie_1")
    options = {"maps_from": random_maps(3), "split": (1, 0, 0), "furnish": "lane_duckies=1"}
    spec, executor = small(maps=3, tiles=tiles, objects=objects, **options), OneByOne()
    make_dataset(spec, tmp_path / "here")
    make_dataset(spec, tmp_path / "sent", executor=executor, parts=2)
    assert files(tmp_path / "sent") == files(tmp_path / "here")
    in_objects = sum(file.stat().st_size for file in objects.rglob("*.png"))
    assert max(executor.sizes) < decoded / 2 + 2 * in_objects


def test_a_worker_with_other_pictures_in_its_package_is_named(tmp_path, monkeypatch):
    class Changed(OneByOne):
        def submit(self, *arguments):
            tiles = load_tiles()
            monkeypatch.setattr(packed, "own_tiles", lambda: replace(tiles, name="changed"))
            return super().submit(*arguments)

    with refused("worker ...", "...'changed'...", expected="tiles"):
        make_dataset(small(), tmp_path / "out", executor=Changed(), parts=1)


def test_a_set_that_is_nearly_the_packages_own_is_sent_whole():
    """The spread of its lanes was lost."""
    tiles, objects = replace(load_tiles(), lane_offset_spread=0.004), replace(load_objects(), name="mine")
    sent = pickle.loads(pickle.dumps(packed.Pictures(tiles, objects)))
    assert (sent.tiles.lane_offset_spread, sent.objects.name) == (0.004, "mine")


@pytest.mark.slow
def test_evolved_datasets_have_the_same_files(tmp_path, threads):
    make_dataset(EVOLVED, tmp_path / "one machine")
    make_dataset(EVOLVED, tmp_path / "evolved", executor=threads, parts=2)
    assert files(tmp_path / "evolved") == files(tmp_path / "one machine")


def test_a_lost_part_alone_is_evolved_again(whole, tmp_path, monkeypatch):
    monkeypatch.setattr("elitelanes_jax.maps.generation._WORTH_KEEPING", 0)
    lost = OneByOne(fails={2: engine.BrokenExecutor("a worker died")})
    words = "part 3 of 3: expected its result, but the executor lost it: BrokenExecutor: a worker died"
    with pytest.raises(ConnectionError, match=f"^{words}$"):
        generate(SPEC, tmp_path / "maps", executor=lost, parts=3)
    assert not (tmp_path / "maps").exists()
    again = OneByOne()
    generate(SPEC, tmp_path / "maps", executor=again, parts=3)
    assert again.calls == 1
    assert digest(tmp_path / "maps") == whole


DAMAGES = {
    "a device cut off": ("1-of-2.json", b'"cp'),
    "a table of another program": ("1-of-2.json", b"{}"),
    "a result cut off": ("1-of-2.npz", b"PK"),
}


@pytest.mark.parametrize(("file", "content"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_part_is_evolved_again(file, content, tmp_path):
    search, keys = resolve(SEARCH, (5, 6)), check_keys(3, 2)
    first = search_parts.evolve_parts(search, keys, engine.Pool(OneByOne(), 2), folder=tmp_path / "parts")
    (tmp_path / "parts" / file).write_bytes(content)
    again = OneByOne()
    parts = search_parts.evolve_parts(search, keys, engine.Pool(again, 2), folder=tmp_path / "parts")
    assert again.calls == 1
    for part, before in zip(parts, first, strict=True):
        chex.assert_trees_all_equal(part.result.elites, before.result.elites)


def test_parts_of_another_budget_are_evolved_again(whole, tmp_path, monkeypatch):
    monkeypatch.setattr("elitelanes_jax.maps.generation._WORTH_KEEPING", 0)
    shorter = SPEC.replace(search=SEARCH.replace(generations=10))
    with pytest.raises(ConnectionError):
        generate(shorter, tmp_path / "maps", executor=OneByOne(fails={2: engine.CancelledError()}), parts=3)
    again = OneByOne()
    generate(SPEC, tmp_path / "maps", executor=again, parts=3)
    assert again.calls == 3
    assert digest(tmp_path / "maps") == whole


def test_pictures_that_returned_are_not_drawn_again(dataset, tmp_path):
    with pytest.raises(ConnectionError, match=r"^part 4 of 4: "):
        make_dataset(small(views=2), tmp_path / "out", executor=OneByOne(fails={3: engine.CancelledError()}), parts=4)
    again = OneByOne()
    make_dataset(small(views=2), tmp_path / "out", executor=again, parts=4)
    assert again.calls == 1
    assert files(tmp_path / "out") == dataset


# What is wrong with an executor or beside it, and what is said.
WRONG = {
    "a number": ({"executor": 3}, "executor", "3", "submit"),
    "a class": ({"executor": ThreadPoolExecutor}, "executor", f"{ThreadPoolExecutor}", "submit"),
    "no function": ({"executor": SimpleNamespace(submit=3)}, "executor", "namespace(submit=3)", "submit"),
    "no executor": ({"parts": 3}, "parts", "none", "an executor"),
    "no parts": ({"executor": OneByOne(), "parts": 0}, "parts", "0", "1 or more"),
    "devices": ({"executor": OneByOne(), "devices": 2}, "devices", "2", "none with an executor"),
    "every": ({"executor": OneByOne(), "every": 2}, "every", "2", "none with an executor"),
    "a checkpoint": ({"executor": OneByOne(), "checkpoint": "x"}, "checkpoint", "'x'", "none with an executor"),
}


def test_an_executor_without_futures_is_refused():
    executor = SimpleNamespace(submit=lambda *arguments: None)
    with refused("executor", "None"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, executor=executor)


def test_a_future_without_the_result_of_its_call_is_refused():
    future = Future()
    future.set_result({})
    executor = SimpleNamespace(submit=lambda *arguments: future)
    with refused("executor", "{}"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, executor=executor)


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_executor_is_refused(case, tmp_path):
    arguments, subject, got, expected = WRONG[case]
    with refused(subject, got, expected):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, **arguments)
    if {"devices", "checkpoint", "every"}.isdisjoint(arguments):
        for make, spec in ((generate, SPEC), (make_dataset, small())):
            with refused(subject, got, expected):
                make(spec, tmp_path / "out", **arguments)
    assert not list(tmp_path.iterdir())


def test_a_wrong_progress_is_named_with_an_executor_too():
    with refused("progress", "'never'"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, executor=OneByOne(), progress="never")


def test_one_key_alone_is_refused():
    import jax

    with refused("key", "one key"):
        evolve(jax.random.key(0), (4, 4), spec=SEARCH, executor=OneByOne())


def test_a_shut_down_executor_is_one_line():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(ConnectionError, match=r"^part 1 of 2: .* cannot schedule new futures after shutdown"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, executor=executor, parts=2)


def test_a_worker_with_other_versions_is_named(monkeypatch):
    here = engine.installed_versions()
    answers = iter([here, here | {"jax": "0.1"}])
    monkeypatch.setattr(engine, "installed_versions", lambda *others: next(answers))
    with refused("worker ...", "0.1", expected=f"jax {here['jax']}"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, executor=OneByOne(), parts=1)


def test_a_worker_with_another_pyarrow_is_named(monkeypatch, tmp_path):
    here = engine.installed_versions("pyarrow")
    if here["pyarrow"] == "none":
        pytest.skip("needs pyarrow")
    answers, versions = iter([{}, {"pyarrow": "1.0"}]), engine.installed_versions
    monkeypatch.setattr(engine, "installed_versions", lambda *others: versions(*others) | next(answers))
    with refused("worker ...", "1.0", expected=f"pyarrow {here['pyarrow']}"):
        make_dataset(small(format="parquet"), tmp_path / "out", executor=OneByOne(), parts=1)


def fail_on_disk(_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/tmp/x")


def fail_by_a_bug(_):
    raise ZeroDivisionError("of a worker")


class TwoValuesError(Exception):
    """Pickle writes this error but cannot read it, because it keeps one of the two arguments."""

    def __init__(self, first, second):
        super().__init__(first)


def fail_with_two_values(_):
    raise TwoValuesError("a", 1)


def test_errors_of_a_worker_name_it():
    with pytest.raises(OSError, match=r"No space left on device: 'worker .+: /tmp/x'$"):
        list(engine.call_on_workers(OneByOne(), fail_on_disk, [0]))
    with pytest.raises(ZeroDivisionError, match=r"^of a worker\non the worker .") as error:
        list(engine.call_on_workers(OneByOne(), fail_by_a_bug, [0]))
    assert "in fail_by_a_bug\n" in error.value.__notes__[1]
    with pytest.raises(RuntimeError, match=r"^worker .+: TwoValuesError: a\non the worker ."):
        list(engine.call_on_workers(OneByOne(), fail_with_two_values, [0]))


def end_as_lost(_):
    raise engine.BrokenExecutor("the job's time is over")


def test_a_job_that_ends_as_lost_is_one_line():
    words = "part 1 of 1: expected its result, but the executor lost it: BrokenExecutor: the job's time is over"
    with pytest.raises(ConnectionError, match=f"^{words}$"):
        list(engine.call_on_workers(OneByOne(), end_as_lost, [0]))


def test_workers_without_the_package_are_one_line():
    missing = ModuleNotFoundError("No module named 'elitelanes_jax'")
    with refused("executor", "No module named 'elitelanes_jax'"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, executor=OneByOne(fails={0: missing}))


def test_functions_that_cannot_travel_are_refused(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cloudpickle", None)
    local = {"fitness": lambda usual, metrics: usual + metrics.turns}
    with refused("executor", expected="sent to workers", hint="pip install"):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, **local, executor=OneByOne())


def test_parts_of_a_dataset_are_joined_to_the_same_files(dataset, tmp_path, capsys):
    folders = [tmp_path / f"part-{index}" for index in (1, 2, 3)]
    for index, folder in enumerate(folders, start=1):
        about = make_dataset(small(views=2, part=(index, 3)), folder)
        assert about["part"] == [index, 3]
        assert make_dataset(small(views=2, part=(index, 3)), folder) == about, "a part that is complete"
    with refused(tmp_path / "part-1", "results with [1, 3]", expected="part None"):
        make_dataset(small(views=2), folders[0])
    merge_dataset(folders[::-1], tmp_path / "merged")
    assert files(tmp_path / "merged") == dataset
    assert main(["merge", *map(str, folders), "--out", str(tmp_path / "by command")]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"24 pictures in {tmp_path / 'by command'}")
    assert files(tmp_path / "by command") == dataset
    make_dataset(small(views=2), folders[0], force=True)
    assert files(folders[0]) == dataset


def test_wrong_parts_of_a_dataset_are_one_line(tmp_path):
    folders = [tmp_path / f"part-{index}" for index in (1, 2)]
    for index, folder in enumerate(folders, start=1):
        make_dataset(small(part=(index, 2)), folder)
    before = files(tmp_path)
    record = json.loads((folders[1] / "dataset.json").read_text())
    for about, got in (
        (record | {"part": [1, 2]}, "1/2 again, after ...part-1"),
        (record | {"part": [2, 3]}, "one of 3"),
        (record | {"versions": {"jax": "0.1"}}, "None"),
        (record | {"part": None}, "none"),
    ):
        (folders[1] / "dataset.json").write_text(json.dumps(about))
        with refused(tmp_path / "part-2", got):
            merge_dataset(folders, tmp_path / "out")
    # A missing setting counts as None, as this dataset has it.
    del record["settings"]["camera"]
    (folders[1] / "dataset.json").write_text(json.dumps(record))
    with refused(folders[1] / "dataset.json", "a damaged or another one"):
        merge_dataset(folders, tmp_path / "out")
    (folders[1] / "dataset.json").write_bytes(before["part-2/dataset.json"])
    with refused("parts", "all but 2/2"):
        merge_dataset(folders[:1], tmp_path / "out")
    assert files(tmp_path) == before
    with refused("part", "13", expected="at most 12"):
        small(part=(1, 13))


def cut(file):
    file.write_bytes(file.read_bytes()[:-30])


# What is done to the file of a picture of a part, or to its records, and what the error says came.
DAMAGE = {
    "missing": (Path.unlink, "no ..."),
    "empty": (lambda file: file.write_bytes(b""), "a damaged or another one"),
    "cut off": (cut, "a damaged or another one"),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("kind", ["picture", "records"])
def test_a_part_with_a_damaged_file_is_refused(dataset_parts, kind, damage, tmp_path):
    first, second = shutil.copytree(dataset_parts, tmp_path / "parts").iterdir()
    if second.name == "part-1":
        first, second = second, first
    spoil, got = DAMAGE[damage]
    picture = max(second.rglob("labels/*.png"))  # the contact sheet shows other pictures
    file = picture if kind == "picture" else second / "part.jsonl"
    spoil(file)
    if (kind, damage) == ("records", "missing"):
        got = "none"
    with refused(second if damage == "missing" else file, got):
        merge_dataset([first, second], tmp_path / "out")
    assert [folder.name for folder in tmp_path.iterdir()] == ["parts"]


@pytest.mark.parametrize(
    ("size", "got", "expected"),
    [
        (-100, "none", "/labels/"),
        (10, "none", "part.jsonl"),
    ],
)
def test_a_part_whose_checksums_are_cut_off_is_refused(dataset_parts, size, got, expected, tmp_path):
    place = shutil.copytree(dataset_parts, tmp_path / "parts")
    sums = place / "part-2" / "SHA256SUMS"
    sums.write_bytes(sums.read_bytes()[:size])
    with refused(tmp_path / "parts/part-2/SHA256SUMS", got, expected):
        merge_dataset([place / "part-1", place / "part-2"], tmp_path / "out")


def test_other_files_in_a_part_are_left_out(dataset, dataset_parts, tmp_path):
    place = shutil.copytree(dataset_parts, tmp_path / "parts")
    (place / "part-1" / "train" / "Thumbs.db").write_bytes(b"of the system")
    merge_dataset([place / "part-1", place / "part-2"], place / "part-1" / "joined")
    assert files(place / "part-1" / "joined") == dataset


@pytest.mark.slow
def test_spawned_processes_give_the_same_files(whole, dataset, tmp_path):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        generate(SPEC, tmp_path / "maps", executor=pool, parts=3)
        make_dataset(small(views=2), tmp_path / "dataset", executor=pool, parts=3)
    assert digest(tmp_path / "maps") == whole
    assert files(tmp_path / "dataset") == dataset


@pytest.mark.slow
def test_a_spawned_process_that_dies_loses_no_other_part(long, tmp_path, monkeypatch):
    monkeypatch.setattr("elitelanes_jax.maps.generation._WORTH_KEEPING", 0)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        after_one_part(monkeypatch, lambda: os.kill(next(iter(pool._processes)), signal.SIGKILL))
        with pytest.raises(ConnectionError, match="expected its result, but the executor lost it: BrokenProcessPool"):
            generate(LONG, tmp_path / "maps", executor=pool, parts=6)
    again = OneByOne()
    generate(LONG, tmp_path / "maps", executor=again, parts=6)
    assert again.calls < 6
    assert digest(tmp_path / "maps") == long


def after_one_part(monkeypatch, action):
    """Calls a function once, when the first part has returned."""
    save, calls = search_parts._save, []

    def save_and_act(*arguments):
        save(*arguments)
        if not calls:
            calls.append(action())

    monkeypatch.setattr(search_parts, "_save", save_and_act)
    return calls


@pytest.fixture
def cluster():
    """A Dask cluster of two processes here."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster


@pytest.mark.slow
def test_dask_does_not_warn(cluster, dataset, tmp_path):
    from distributed import Client

    with Client(cluster) as client:
        make_dataset(small(views=2), tmp_path / "dataset", executor=client.get_executor(), parts=3)
    assert files(tmp_path / "dataset") == dataset


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_killed_dask_worker_changes_nothing(cluster, long, dataset, tmp_path, monkeypatch):
    from distributed import Client

    with Client(cluster) as client:
        workers = client.run(os.getpid)
        assert len(workers) == 2
        killed = after_one_part(monkeypatch, lambda: os.kill(min(workers.values()), signal.SIGKILL))
        generate(LONG, tmp_path / "maps", executor=client.get_executor(), parts=6)
        assert len(killed) == 1
        assert set(client.run(os.getpid).values()) != set(workers.values()), "another process took its place"
        assert digest(tmp_path / "maps") == long
        make_dataset(small(views=2), tmp_path / "dataset", executor=client.get_executor(), parts=3)
        assert files(tmp_path / "dataset") == dataset
        own = evolve(0, (4, 4), seeds=2, spec=SEARCH, fitness=lambda usual: usual + 1, executor=client.get_executor())
        assert dict(own.functions).keys() == {"fitness"}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_command_uses_a_dask_scheduler(cluster, whole, tmp_path):
    address = cluster.scheduler_address
    assert main([*COMMAND, "--dask", address, "--parts", "3", "--out", str(tmp_path / "maps")]) == 0
    assert digest(tmp_path / "maps") == whole


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "tcp://10.255.255.1:8786", "nowhere", "tcp://nowhere:x"])
def test_an_address_that_does_not_answer_is_one_line_within_ten_seconds(address, tmp_path, capfd):
    pytest.importorskip("distributed")
    began = time.monotonic()
    assert main([*COMMAND, "--dask", address, "--out", str(tmp_path / "maps")]) == 2
    assert time.monotonic() - began < 10
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("elitelanes: --dask: expected the address of a Dask scheduler that answers, such as ")
    assert not list(tmp_path.iterdir())


def answer_nothing(connection):
    connection.recv(1 << 16)


def answer_zeros(connection):
    connection.sendall(bytes(72))
    connection.close()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("answer", [answer_nothing, socket.socket.close, answer_zeros])
def test_another_program_at_the_address_is_one_line_within_ten_seconds(answer, tmp_path, capfd):
    pytest.importorskip("distributed")
    connections = []  # kept open until the test ends
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            with suppress(OSError):
                while True:
                    connections.append(server.accept()[0])
                    answer(connections[-1])

        Thread(target=serve, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        began = time.monotonic()
        assert main([*COMMAND, "--dask", address, "--out", str(tmp_path / "maps")]) == 2
        assert time.monotonic() - began < 10
    (line,) = capfd.readouterr().err.splitlines()
    expected = "elitelanes: --dask: expected the address of a Dask scheduler that answers, such as tcp://host:8786"
    assert line.startswith(f"{expected}, got '{address}': ")
    assert line.endswith("no answer in 4 s") == (answer is answer_nothing)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_submitits_local_executor_gives_the_same_files(whole, dataset, tmp_path):
    submitit = pytest.importorskip("submitit")
    options = "cluster=local timeout_min=10"
    assert main([*COMMAND, "--slurm", options, "--parts", "2", "--out", str(tmp_path / "maps")]) == 0
    assert [entry.name for entry in tmp_path.iterdir()] == ["maps"]
    assert digest(tmp_path / "maps") == whole
    here = os.getpid()

    def fail_elsewhere(usual):
        if os.getpid() != here:
            raise ZeroDivisionError("of a worker")
        return usual

    executor = submitit.AutoExecutor(tmp_path / "logs", cluster="local")
    with pytest.raises(ZeroDivisionError, match=r"^of a worker\non the worker ."):
        evolve(0, (4, 4), seeds=2, spec=SEARCH, fitness=fail_elsewhere, executor=executor, parts=1)
    executor = submitit.AutoExecutor(tmp_path / "jobs", cluster="debug")
    make_dataset(small(views=2), tmp_path / "dataset", executor=executor, parts=2)
    assert files(tmp_path / "dataset") == dataset


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("timeout_min=60", "--slurm: expected SLURM's program sbatch on the PATH, got none; cluster=local needs none"),
        ("timeout", "--slurm: expected options of Submitit such as timeout_min=60, got 'timeout'"),
        ("cluster=local nothing=3", "--slurm: expected options of Submitit, got "),
        ("cluster=local slurm_nothing=3", "--slurm: expected options of Submitit, got Unknown argument 'nothing'"),
        ("cluster=local tasks_per_node=2", "--slurm: expected one task for each job, got tasks_per_node=2"),
        ("cluster=local timeout_min=abc", "--slurm: expected options of Submitit, got "),
        (
            "cluster=moon",
            "--slurm: expected options of Submitit, got AutoExecutor doesn't know any executor named moon",
        ),
    ],
)
def test_wrong_options_of_submitit_are_one_line(options, message, tmp_path, capsys, monkeypatch):
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", str(Path(os.sep, "nowhere")))
    assert main([*COMMAND, "--slurm", options, "--out", str(tmp_path / "maps")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"elitelanes: {message}")
    assert not list(tmp_path.iterdir())


# In place of SLURM's programs. A job runs here, and so does each job of an array.
SBATCH = """#!{python}
import os, re, subprocess, sys
text = open(sys.argv[-1]).read()
array = re.search(r"--array=0-(\\d+)", text)
for task in range(int(array[1]) + 1):
    names = {{"SLURM_ARRAY_JOB_ID": "7", "SLURM_ARRAY_TASK_ID": str(task), "SLURM_JOB_ID": str(8 + task)}}
    names |= dict.fromkeys(("SLURM_NTASKS", "SLURM_JOB_NUM_NODES"), "1")
    names |= dict.fromkeys(("SLURM_PROCID", "SLURM_NODEID", "SLURM_LOCALID"), "0")
    with open(os.devnull, "w") as log:
        subprocess.Popen(["bash", sys.argv[-1]], env=os.environ | names, stdout=log, stderr=log)
print("Submitted batch job 7")
"""
SRUN = """#!/bin/bash
while [[ $1 == --* ]]; do
  case $1 in --output|--error) shift 2 ;; *) shift ;; esac
done
exec "$@"
"""


@pytest.fixture
def slurm(tmp_path_factory, monkeypatch):
    """A folder on the PATH with programs in place of SLURM's."""
    pytest.importorskip("submitit")
    folder = tmp_path_factory.mktemp("slurm")
    programs = {"sbatch": SBATCH.format(python=sys.executable), "srun": SRUN, "sacct": "#!/bin/sh\n"}
    for name, text in programs.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return folder


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_an_array_of_slurm_gives_the_same_files(slurm, whole, tmp_path):
    options = "timeout_min=60 slurm_comment='two words' slurm_setup='export OF_THE_JOB=1' mem_gb=0.5"
    assert main([*COMMAND, "--slurm", options, "--parts", "2", "--out", str(tmp_path / "maps")]) == 0
    assert [entry.name for entry in tmp_path.iterdir()] == ["maps"]
    assert digest(tmp_path / "maps") == whole


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("parts", ["1", "2"])
def test_a_job_that_slurm_refuses_is_one_line(slurm, parts, tmp_path, capfd):
    (slurm / "sbatch").write_text("#!/bin/sh\necho 'sbatch: error: invalid partition specified: x' >&2\nexit 1\n")
    options = "timeout_min=60 slurm_partition=x"
    command = [*COMMAND, "--slurm", options, "--parts", parts, "--out", str(tmp_path / "maps"), "--quiet"]
    assert main(command) == 2
    *_, line = capfd.readouterr().err.splitlines()  # Submitit repeats what sbatch wrote
    assert line.startswith(f"elitelanes: part 1 of {parts}: expected it to start, but the executor lost it: ")
    assert line.endswith("sbatch: error: invalid partition specified: x")
    assert not list(tmp_path.iterdir())


class Submitit(OneByOne):
    """In place of Submitit's module and executor."""

    AutoExecutor = staticmethod(lambda folder, cluster: Submitit())

    def update_parameters(self, **values):
        raise ValueError(repr(values))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            "cluster=local a=1 b='2 c' c=007 d=0.5 slurm_setup='x y' e=True",
            "options of Submitit, got {'a': 1, 'b': '2 c', 'c': '007', 'd': 0.5, 'slurm_setup': ['x y'], 'e': True}",
        ),
        ("a='1", 'quotes in pairs, got "a=\'1"'),
        ("cluster=local slurm_nodes=2", "one task for each job, got slurm_nodes=2"),
        (
            "cluster=local setup='module load a' setup='module load b'",
            "each option once, got setup again in 'setup=module load b'",
        ),
    ],
)
def test_values_with_spaces_are_quoted(options, message, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", Submitit)
    assert main([*COMMAND, "--slurm", options, "--out", str(tmp_path / "maps")]) == 2
    assert capsys.readouterr().err == f"elitelanes: --slurm: expected {message}\n"


@pytest.mark.parametrize("out", ["%A_%a", "%j/maps", "half 50%"])
def test_a_name_that_slurm_would_change_is_refused(out, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "submitit", Submitit)
    assert main([*COMMAND, "--slurm", "cluster=local", "--out", str(tmp_path / out)]) == 2
    expected = f"expected an output folder without % in its path, got {tmp_path / out}"
    assert capsys.readouterr().err == f"elitelanes: --slurm: {expected}\n"
    assert not list(tmp_path.iterdir())


def test_a_second_command_leaves_the_jobs_of_the_first(tmp_path, monkeypatch, capsys):
    jobs = tmp_path / ".maps-jobs"
    command = [*COMMAND, "--slurm", "cluster=local", "--out", str(tmp_path / "maps")]

    class Executor(OneByOne):
        def update_parameters(self):
            pass

        def submit(self, function, /, *args):
            jobs.mkdir(exist_ok=True)
            if not (jobs / "1_submitted.pkl").exists():
                (jobs / "1_submitted.pkl").touch()
                assert main(command) == 2
            assert (jobs / "1_submitted.pkl").exists()
            return super().submit(function, *args)

    monkeypatch.setitem(sys.modules, "submitit", SimpleNamespace(AutoExecutor=lambda *_, **__: Executor()))
    assert main(command) == 0
    assert "expected no other run at work" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["maps"]


@pytest.mark.parametrize(
    ("error", "remains"), [(engine.CancelledError(), ["7_log.err"]), (InputError("", "", "of a worker"), [])]
)
def test_logs_remain_if_a_job_was_lost(error, remains, tmp_path, monkeypatch):
    def start(folder, cluster):
        folder.mkdir(exist_ok=True)
        (folder / "7_log.err").touch()
        executor = OneByOne(fails={0: error})
        executor.update_parameters = lambda: None
        return executor

    monkeypatch.setitem(sys.modules, "submitit", SimpleNamespace(AutoExecutor=start))
    assert main([*COMMAND, "--slurm", "cluster=local", "--out", str(tmp_path / "maps")]) == 2
    assert [file.name for file in tmp_path.rglob("*") if file.is_file()] == remains


@pytest.mark.parametrize(
    ("option", "module", "hint"),
    [
        ("--dask", "distributed", "Dask: pip install dask distributed, or the extra dask of elitelanes_jax"),
        ("--slurm", "submitit", "Submitit: pip install submitit, or the extra cluster of elitelanes_jax"),
    ],
)
def test_without_its_package_an_option_names_the_extra(option, module, hint, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    assert main([*COMMAND, option, "a=1", "--out", str(tmp_path / "maps")]) == 2
    assert capsys.readouterr().err == f"elitelanes: {option} needs {hint}\n"
