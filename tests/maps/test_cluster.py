"""Parts of a run on an executor's workers: the bytes of the one run."""

import os
import pickle
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

import pytest
from folders import files
from killed_runs import digest

from elitelanes_jax import DatasetSpec, GenerateSpec, InputError, SearchSpec, generate, make_dataset
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset import make
from elitelanes_jax.maps import cluster, dask_executor, generate_on, parts

SEARCH = SearchSpec(method="ea", preset="paper", generations=12)
SPEC = GenerateSpec(size=(5, 6), maps=3, seeds=7, tile_px=16, search=SEARCH)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("one") / "maps"
    generate(SPEC, folder)
    return digest(folder)


class Lossy(ThreadPoolExecutor):
    """Workers of which the one with a certain part dies."""

    def __init__(self, lost=None):
        super().__init__(1)
        self.lost, self.ran = lost, []

    def submit(self, function, spec, folder):
        self.ran.append(spec.part[0])
        return super().submit(self.die if spec.part[0] == self.lost else function, spec, folder)

    def die(self, spec, folder):
        raise RuntimeError("the machine is gone")


def test_workers_search_what_one_machine_does(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "_SEEDS_A_PART", 3)
    out = tmp_path / "maps"
    executor = Lossy(lost=3)
    with executor, pytest.raises(ConnectionError) as error:
        generate_on(executor, SPEC, out)
    assert str(error.value) == "part 3 of 3: expected a worker to run it, got RuntimeError: the machine is gone"
    assert executor.ran == [1, 2, 3] and not out.exists()

    with Lossy() as executor, pytest.raises(InputError, match="expected results with seed 1, got results with 0"):
        generate_on(executor, SPEC.replace(seed=1), out)
    assert executor.ran == []

    with Lossy() as executor:
        assert len(generate_on(executor, SPEC, out)) == 3
    assert executor.ran == [3], "parts that are done are not run again"
    assert digest(out) == whole
    assert [entry.name for entry in tmp_path.iterdir()] == ["maps"], "what was kept is gone"


def test_bad_requests_are_refused_before_anything_runs(tmp_path):
    out = tmp_path / "maps"
    with Lossy() as executor:
        with pytest.raises(InputError, match="^part: expected none, because workers run all the parts, got 1/2$"):
            generate_on(executor, SPEC.replace(part=(1, 2)), out)
        with pytest.raises(InputError, match="none: expected a folder of tile pictures"):
            generate_on(executor, SPEC.replace(tiles=tmp_path / "none"), out)
        out.mkdir()
        (out / "mine.txt").write_text("")
        with pytest.raises(InputError, match="expected a folder that is new or empty"):
            generate_on(executor, SPEC, out)
        assert executor.ran == []
    assert [entry.name for entry in out.iterdir()] == ["mine.txt"]


class Pickling(Executor):
    """A worker that is given pickled calls, as one on another machine is, and dies at the call of a number."""

    def __init__(self, dies_at=None):
        self.dies_at, self.calls = dies_at, []

    def submit(self, function, *arguments):
        self.calls.append(function.__name__)
        future = Future()
        if len(self.calls) == self.dies_at:
            future.set_exception(RuntimeError("the machine is gone"))
        else:
            function, arguments = pickle.loads(pickle.dumps((function, arguments)))
            future.set_result(pickle.loads(pickle.dumps(function(*arguments))))
        return future


def test_workers_search_and_draw_the_dataset_of_one_machine(tmp_path, monkeypatch):
    monkeypatch.setattr(make, "_PICTURES_A_JOB", 3)
    spec = DatasetSpec(maps=4, split=(0.5, 0.5, 0), views=2, size=((4, 5), (5, 5)), tile_px=16, search=SEARCH)
    make_dataset(spec, tmp_path / "one")
    monkeypatch.chdir(tmp_path)
    out = Path("many")  # a worker has a folder of its own to be in
    with pytest.raises(ConnectionError) as error:
        make_dataset(spec, out, executor=Pickling(dies_at=4))
    assert str(error.value) == "pictures 3 to 5: expected a worker to run it, got RuntimeError: the machine is gone"
    drawn = Pickling()
    make_dataset(spec, out, executor=drawn)
    assert drawn.calls.count("_evolve_on_worker") == 2
    assert files(out) == files(tmp_path / "one")
    make_dataset(spec, out, executor=(again := Pickling()))
    assert again.calls == []


@pytest.mark.parametrize("command", ["generate", "dataset"])
def test_a_scheduler_that_does_not_answer(command, tmp_path, capsys, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(cluster, "_SECONDS_TO_ANSWER", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://"):
        assert main([command, "--scheduler", address, "--out", str(tmp_path / "maps")]) == 2
        said = capsys.readouterr().err
        assert (
            re.match(r".*scheduler: expected the address of a Dask scheduler, such as tcp:\S+, got '(.*?)':", said)[1]
            == address
        )


def test_without_dask_it_is_said(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["generate", "--scheduler", "tcp://127.0.0.1:9", "--out", str(tmp_path / "maps")]) == 2
    assert "a cluster needs Dask: pip install distributed" in capsys.readouterr().err


def complete_despite_a_killed_worker(started, make):
    """Kills a worker of a Dask cluster once something has started that a call makes with an executor."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as workers:

        def kill_one():
            while not started():
                time.sleep(0.01)
            with distributed.Client(workers.scheduler_address) as client:
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

        with ThreadPoolExecutor(1) as killer, dask_executor(workers.scheduler_address) as executor:
            killed = killer.submit(kill_one)
            make(executor)
            killed.result()


@pytest.mark.slow
def test_a_dask_cluster_whose_worker_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "_SEEDS_A_PART", 2)
    spec, out = SPEC.replace(search=SEARCH.replace(generations=30_000)), tmp_path / "maps"
    generate(spec, tmp_path / "one")
    complete_despite_a_killed_worker(
        lambda: list(tmp_path.glob(".maps-unfinished/kept/.[1-4]-unfinished")),
        lambda executor: generate_on(executor, spec, out),
    )
    assert digest(out) == digest(tmp_path / "one")


@pytest.mark.slow
def test_a_dataset_on_a_dask_cluster_whose_worker_is_killed(tmp_path):
    spec = DatasetSpec(maps=16, views=25, size=((5, 6), (6, 6)), tile_px=64, search=SEARCH)
    make_dataset(spec, tmp_path / "one")
    complete_despite_a_killed_worker(
        lambda: len(list(tmp_path.glob(".many-unfinished/kept/records/*/*.json"))) >= 50,
        lambda executor: make_dataset(spec, tmp_path / "many", executor=executor),
    )
    assert files(tmp_path / "many") == files(tmp_path / "one")


@pytest.mark.slow
def test_the_command_on_a_dask_cluster(whole, tmp_path):
    distributed = pytest.importorskip("distributed")
    options = ["--size", "5", "6", "--maps", "3", "--seeds", "7", "--tile-px", "16", "--method", "ea"]
    options += ["--preset", "paper", "--generations", "12"]
    with distributed.LocalCluster(n_workers=1, dashboard_address=None) as workers:
        command = [sys.executable, "-m", "elitelanes_jax", "generate", *options, "--out", tmp_path / "maps"]
        ran = subprocess.run(
            [*command, "--scheduler", workers.scheduler_address], capture_output=True, text=True, check=True
        )
    assert re.search("searching 1 part of 1 on workers", ran.stderr)
    assert digest(Path(tmp_path / "maps")) == whole
