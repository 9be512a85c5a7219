"""The command, as its users call it."""

import gc
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest

from elitelanes_jax import measure
from elitelanes_jax.cli import main
from elitelanes_jax.dataset import Settings as DatasetSettings
from elitelanes_jax.interrupts import catch_interrupts
from elitelanes_jax.symmetry import canonical
from elitelanes_jax.tilesets import default_tiles
from elitelanes_jax.wishes import Wishes

SMALL = ["--size", "5", "6", "--seeds", "3", "--maps", "6", "--generations", "40", "--tile-px", "16"]


pytestmark = pytest.mark.usefixtures("own_compile_cache")


@pytest.fixture(scope="module")
def generated(own_compile_cache, tmp_path_factory):
    out = tmp_path_factory.mktemp("generated") / "out"
    assert main(["generate", *SMALL, "--out", str(out)]) == 0
    return out


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def read(file):
    return cv2.imread(str(file), cv2.IMREAD_UNCHANGED)


def test_what_is_written(generated):
    names = set(files(generated))
    one = {"image.png", "road.png", "red.png", "yellow.png", "labels.png", "map.json"}
    maps = {f"maps/{number:04d}/{name}" for number in range(6) for name in one}
    assert names == maps | {"overview.png", "archive.npz", "run.json"}


def test_each_map_is_what_its_file_says(generated):
    forms = set()
    for number in range(6):
        folder = generated / "maps" / f"{number:04d}"
        road_map = json.loads((folder / "map.json").read_text())
        codes = np.array(road_map["codes"])
        metrics = measure(codes)
        assert codes.shape == tuple(road_map["shape"]) == (5, 6)
        assert road_map["metrics"] == {name: value.item() for name, value in metrics._asdict().items()}
        assert (metrics.components, metrics.dead_ends, metrics.boundary_violations, metrics.coverage) == (1, 0, 0, 1)
        assert road_map["descriptor"]["cyclomatic"] == metrics.cyclomatic
        assert len(road_map["niche"]) == 5
        assert road_map["seed"][0] == 0
        assert np.shape(road_map["drawn"]["tiles"]) == (5, 6)
        forms.add(canonical(codes))
        labels = read(folder / "labels.png")
        assert labels.shape == (80, 96)
        masks = [read(folder / f"{name}.png") for name in ("road", "red", "yellow")]
        np.testing.assert_array_equal(labels, np.select([mask > 0 for mask in masks[::-1]], [3, 2, 1]))
        assert read(folder / "image.png").shape == (80, 96, 3)
    assert len(forms) == 6


def test_the_run_record_and_the_archive(generated):
    run = json.loads((generated / "run.json").read_text())
    assert run["settings"]["size"] == [5, 6]
    assert run["settings"]["seeds"] == 3
    assert run["settings"]["preset"] == "tuned"
    assert run["config"]["annealing"]["moves"]["transplant"] == 16
    assert run["weights"]["dead_ends"] == 480
    assert set(run["versions"]) == {"elitelanes_jax", "python", "jax", "jaxlib", "numpy", "opencv"}
    assert run["tile_set"]["name"] == "Elite Lanes drawn tiles"
    archive = np.load(generated / "archive.npz")
    assert archive["grids"].shape == (3, 400, 5, 6)
    assert archive["history.best_fitness"].shape == (3, 40)
    assert archive["metrics.bridges"].shape == archive["valid"].shape == (3, 400)
    assert archive["axes"].tolist() == [axis["metric"] for axis in run["axes"]]


def test_the_same_command_writes_the_same_files(generated, tmp_path):
    assert main(["generate", *SMALL, "--out", str(tmp_path / "again")]) == 0
    one, other = files(generated), files(tmp_path / "again")
    runs = [json.loads(written.pop("run.json")) for written in (one, other)]
    for run in runs:
        run.pop("times")
    assert runs[0] == runs[1]
    assert one == other


def test_another_seed_finds_other_maps(generated, tmp_path):
    assert main(["generate", *SMALL, "--seed", "5", "--out", str(tmp_path / "other")]) == 0
    assert (generated / "archive.npz").read_bytes() != (tmp_path / "other" / "archive.npz").read_bytes()


def test_the_table_that_is_printed(tmp_path, capsys):
    assert main(["generate", *SMALL, "--method", "ea", "--maps", "3", "--out", str(tmp_path / "out")]) == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert lines[0].split()[:3] == ["map", "fitness", "cyclomatic"]
    assert len(lines) == 5
    assert "3 maps in" in lines[-1]
    assert captured.err == ""


def test_photographed_tiles(real_tiles, tmp_path):
    from conftest import REAL_TILES

    assert main(["generate", *SMALL, "--tiles", str(REAL_TILES), "--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out" / "run.json").read_text())["tile_set"]["name"] == "real_tiles"


def test_rendering_a_map_again_gives_the_same_picture(generated, tmp_path):
    folder = generated / "maps" / "0002"
    assert main(["render", str(folder / "map.json"), "--tile-px", "16", "--out", str(tmp_path / "same")]) == 0
    written = files(tmp_path / "same")
    assert written == {name: content for name, content in files(folder).items() if name != "map.json"}
    arguments = ["render", str(folder / "map.json"), "--tile-px", "40", "--seed", "3", "--overlay"]
    assert main([*arguments, "--out", str(tmp_path / "other")]) == 0
    assert read(tmp_path / "other" / "overlay.png").shape == (200, 240, 3)


def test_checking_tiles(capsys, tmp_path):
    assert main(["tiles", "check", str(default_tiles())]) == 0
    assert "12 tiles" in capsys.readouterr().out
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    (tmp_path / "tiles" / "turn_1" / "red.png").unlink()
    (tmp_path / "tiles" / "turn_2" / "red.png").unlink()
    assert main(["tiles", "check", str(tmp_path / "tiles")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 2


def test_too_few_maps(tmp_path, capsys):
    arguments = ["generate", "--size", "3", "3", "--maps", "50", "--seeds", "1", "--generations", "20"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("elitelanes: found ")
    assert "of 50 maps among" in captured.err
    assert len(captured.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


WRONG = {
    "no maps": (["--maps", "0"], "argument --maps: expected a whole number, 1 or more, got '0'"),
    "half a seed": (["--seeds", "0.5"], "argument --seeds: expected a whole number, 1 or more, got '0.5'"),
    "no digit": (["--maps", "²"], "argument --maps: expected a whole number, 1 or more, got '²'"),
    "too many digits": (["--maps", "9" * 5000], "argument --maps: expected a whole number, 1 or more, got '9999"),
    "no preset": (["--preset", ""], "argument --preset: expected a name, got ''"),
    "no folder": (["--out", ""], "argument --out: expected a name, got ''"),
    "a thin grid": (["--size", "1", "5"], "argument --size: expected a whole number, 2 to 1024, got '1'"),
    "huge tiles": (["--tile-px", "1000"], "argument --tile-px: expected a whole number, 16 to 512, got '1000'"),
    "a negative seed": (["--seed", "-1"], "argument --seed: expected a whole number, 0 to 4294967295, got '-1'"),
    "no such method": (["--method", "luck"], "method: expected one of ea, map-elites, pso, gwo, got 'luck'"),
    "no such preset": (
        ["--preset", "luck"],
        "preset: expected one of paper, standard, tuned for map-elites, got 'luck'",
    ),
    "no such option": (["--luck"], "unrecognized arguments: --luck"),
    "generations and evaluations": (
        ["--generations", "1", "--evaluations", "1"],
        "argument --evaluations: not allowed with argument --generations",
    ),
    "no range": (["--where", "crossings"], "where 'crossings': expected NAME=LOW..HIGH, such as crossings=6..10"),
    "a range of nothing": (
        ["--where", "speed=3"],
        "where 'speed=3': expected a metric, or a share such",
    ),
    "a range upside down": (["--where", "bridges=5..2"], "where 'bridges=5..2': expected the lower limit first, got 5"),
    "a range without numbers": (["--where", "bridges=a..b"], "where 'bridges=a..b': expected a number, got 'a'"),
    "a range without limits": (["--where", "bridges=.."], "where 'bridges=..': expected at least one limit"),
    "half a bridge": (["--where", "bridges=0.5"], "where 'bridges=0.5': expected whole numbers, got 0.5"),
    "a share over 1": (
        ["--where", "straight_share=0..2"],
        "where 'straight_share=0..2': expected 0 to 1 (a part",
    ),
    "the same range twice": (["--where", "bridges=1", "bridges=2"], "where: expected each feature once, got bridges 2"),
    "no weight": (["--weights", "bridges"], "argument --weights: expected NAME=N with a whole number, got 'bridges'"),
    "a weight of nothing": (
        ["--weights", "speed=3"],
        "weights: expected a metric such as dead_ends, or",
    ),
    "no axis": (["--axes", "cyclomatic"], "axis 'cyclomatic': expected NAME:BINS or NAME:BINS:WIDTH"),
    "an axis of nothing": (
        ["--axes", "speed:3"],
        "axis 'speed:3': expected a metric, or a share such",
    ),
    "too many niches": (["--axes", "tiles:9999", "edges:9999"], "axes: expected at most 1,048,576 niches, got"),
    "the same weight twice": (
        ["--weights", "bridges=1", "--weights", "bridges=2"],
        "weights: expected each metric once, got bridges 2 times",
    ),
    "the same axis twice": (["--axes", "tiles:3", "--axes", "tiles:4"], "axes: expected each metric once, got tiles 2"),
    "dead ends": (
        ["--where", "dead_ends=3.."],
        "where 'dead_ends=3..': expected a range with 0, which all maps have that are kept",
    ),
    "empty cells without rules": (["--where", "coverage=..0.5"], "where 'coverage=..0.5': expected a range with 1,"),
    "no template": (["--fix", "nowhere.json"], "nowhere.json: no such file or directory"),
    "no such rules": (["--rules", "luck"], "rules: expected one of duckietown, got 'luck'"),
    "no such tiles": (["--tiles", "nowhere"], "nowhere: expected a folder of tile pictures, got none"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_the_user_got_wrong_is_one_line_and_exit_code_2(wrong, tmp_path, capsys):
    arguments, message = WRONG[wrong]
    try:
        code = main(["generate", *SMALL, "--out", str(tmp_path / "out"), *arguments])
    except SystemExit as stop:
        code = stop.code
    captured = capsys.readouterr()
    assert code == 2
    assert message in captured.err
    assert len(captured.err) < 200
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""
    assert not list(tmp_path.iterdir())


def test_folders_that_are_not_new_are_left_alone(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    for out, message in (
        (tmp_path, "expected a folder that is new or empty, got one with files in it"),
        (tmp_path / "file", "expected a folder that is new or empty, got a file"),
        (tmp_path / "file" / "out", "out: expected a place that can be written to"),
    ):
        for command in (["generate"], ["render", str(default_tiles())]):
            if command == ["render", str(default_tiles())]:
                (tmp_path / "map.json").write_text('{"codes": [[6, 3], [12, 9]]}')
                command = ["render", str(tmp_path / "map.json")]
            assert main([*command, "--out", str(out)]) == 2
            captured = capsys.readouterr()
            assert message in captured.err
            assert len(captured.err.splitlines()) == 1
    assert (tmp_path / "file").read_text() == "mine"


def test_a_disk_that_fails_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    def fail(file, *_):
        raise OSError(28, "No space left on device", str(file))

    monkeypatch.setattr("pathlib.Path.write_bytes", fail)
    assert main(["generate", *SMALL, "--out", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert "image.png: No space left on device" in captured.err
    assert len(captured.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_interrupted(tmp_path, capsys, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("elitelanes_jax.generate.render", interrupt)
    assert main(["generate", *SMALL, "--out", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err == "elitelanes: interrupted; nothing was written\n"
    assert not list(tmp_path.iterdir())


def test_maps_that_cannot_be_read_or_drawn(tmp_path, capsys):
    file = tmp_path / "map.json"
    for text, message in (
        ('{"codes": [[6, 99], [12, 9]]}', "map.json: grid: expected tile codes 0 to 15, got 99"),
        ('{"codes": [[8, 3], [12, 9]]}', "map.json: grid: expected tiles that the set"),
    ):
        file.write_text(text)
        assert main(["render", str(file), "--out", str(tmp_path / "out")]) == 2
        assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["map.json"]


def test_as_a_program():
    command = shutil.which("elitelanes", path=Path(sys.executable).parent)
    assert command, "the console script is installed"
    shown = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert shown.stdout.startswith("elitelanes 0.")
    wrong = subprocess.run([command, "generate"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert wrong.stderr == "elitelanes generate: the following arguments are required: --out\n"


def test_rendering_beside_the_map(generated, tmp_path, capsys):
    file = tmp_path / "mine.json"
    shutil.copy(generated / "maps" / "0001" / "map.json", file)
    assert main(["render", str(file), "--tile-px", "16"]) == 0
    assert (tmp_path / "mine" / "image.png").exists()
    assert f"96 x 80 pixels in {tmp_path / 'mine'}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.")]
)
def test_too_little_memory_is_one_line(error, tmp_path, capsys, monkeypatch):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("elitelanes_jax.wishes.evolve", fail)
    assert main(["generate", *SMALL, "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == (
        "elitelanes: not enough memory; fewer seeds, smaller maps or smaller tiles need less\n"
    )
    assert not list(tmp_path.iterdir())


def test_a_fault_of_the_program_is_not_blamed_on_the_user(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ValueError("a bug")

    monkeypatch.setattr("elitelanes_jax.wishes.evolve", fail)
    with pytest.raises(ValueError, match="a bug"):
        main(["generate", *SMALL, "--out", str(tmp_path / "out")])


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
@pytest.mark.parametrize(
    ("name", "later"), [("SIGTERM", 0.0), ("SIGTERM", 0.05), ("SIGINT", 0.3), ("SIGHUP", 1.0), ("SIGTERM", 2.0)]
)
def test_a_run_that_is_told_to_end_leaves_nothing(name, later, tmp_path):
    """At any moment: while it imports, compiles, evolves."""
    # Under nohup, or in the background of a script, the tests' own signals may be ignored, and that is inherited.
    heard = f"import signal; signal.signal(signal.{name}, signal.SIG_DFL)"
    program = f"{heard}; from elitelanes_jax.cli import run; run()"
    command = [sys.executable, "-c", program, "generate", "--generations", "9999999", "--out", str(tmp_path / "out")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            while not list(tmp_path.iterdir()):
                assert process.poll() is None
                time.sleep(0.01)
            time.sleep(later)
            process.send_signal(getattr(signal, name))
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert said == "elitelanes: interrupted; nothing was written\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_a_signal_that_is_lost_comes_again(capsys):
    """Python prints what is raised in a callback of the garbage collector, and native code may drop what it met."""

    def callback(phase, _):
        if phase == "stop":
            signal.raise_signal(signal.SIGTERM)

    def in_the_collector():
        gc.callbacks.append(callback)
        try:
            gc.collect()
        finally:
            gc.callbacks.remove(callback)
        time.sleep(10)

    def dropped():
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        time.sleep(10)

    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
    before = [signal.getsignal(number) for number in signals]
    for lost in (in_the_collector, dropped):
        with pytest.raises(KeyboardInterrupt), catch_interrupts():
            lost()
    assert capsys.readouterr().err == ""
    assert [signal.getsignal(number) for number in signals] == before
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_what_is_cleared_up_after_a_signal_is_not_disturbed():
    done = []

    def clears_up():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            for _ in range(4):
                time.sleep(0.1)
                signal.raise_signal(signal.SIGINT)
            try:
                raise OSError
            except OSError:
                time.sleep(0.3)
            done.append(True)

    with pytest.raises(KeyboardInterrupt), catch_interrupts():
        clears_up()
    assert done


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_a_signal_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with catch_interrupts():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_what_cannot_be_printed_is_done_all_the_same(tmp_path):
    program = "from elitelanes_jax.cli import run; run()"
    command = [sys.executable, "-c", program, "render", "map.json", "--tile-px", "16", "--out"]
    (tmp_path / "map.json").write_text('{"codes": [[6, 3], [12, 9]]}')
    ran = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {shlex.join([*command, 'out'])} | true"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert (tmp_path / "out" / "image.png").exists()


def test_names_that_the_terminal_cannot_show(tmp_path):
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    (tmp_path / "tiles" / "tileset.toml").write_text('name = "Straßen"', encoding="utf-8")
    program = "from elitelanes_jax.cli import run; run()"
    command = [sys.executable, "-c", program, "tiles", "check", str(tmp_path / "tiles")]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("Stra\\xdfen: 12 tiles")


@pytest.mark.parametrize(
    ("command", "wishes"), [("generate", Wishes()), ("dataset", DatasetSettings().wishes)], ids=["generate", "dataset"]
)
def test_the_help_names_the_budget_that_is_taken(command, wishes, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    assert f"grids each run evaluates; by default {wishes.evaluations} " in " ".join(capsys.readouterr().out.split())


def test_no_generations(tmp_path):
    small = ["generate", "--size", "2", "2", "--seeds", "2", "--maps", "1", "--tile-px", "16"]
    assert main([*small, "--generations", "0", "--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out" / "run.json").read_text())["times"]["evaluations_per_second"] is None


@pytest.mark.parametrize(
    ("cells", "rules", "message"),
    [
        ({(2, 1): 4}, [], "fix: expected cells without dead ends, got code 4 at row 2, column 1"),
        ({(1, 1): 15, (1, 2): 15}, ["--rules", "duckietown"], "fix: expected cells that keep the rules of duckietown"),
        ({(1, 1): 10, (1, 2): 10}, ["--rules", "duckietown"], "got unlinked_neighbours 1"),
    ],
)
def test_given_cells_that_no_map_has(cells, rules, message, tmp_path, capsys):
    rows = [[cells.get((row, column)) for column in range(6)] for row in range(5)]
    (tmp_path / "fix.json").write_text(json.dumps(rows))
    arguments = ["--fix", str(tmp_path / "fix.json"), *rules, "--out", str(tmp_path / "out")]
    assert main(["generate", *SMALL, *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_is_nearest_is_said_where_every_map_has_a_flaw(tmp_path, capsys):
    asked = ["--where", "crossings=30", "--rules", "duckietown", "--preset", "paper", "--method", "pso"]
    small = ["generate", "--size", "8", "8", "--evaluations", "40", "--maps", "2", *asked]
    assert main([*small, "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert "; nearest found, with other flaws: crossings " in error
    assert error.rstrip().endswith("; wider ranges, more seeds or evaluations find more")


def test_what_helps_against_a_shortage(tmp_path, capsys):
    small = ["generate", "--size", "4", "4", "--maps", "400", "--seeds", "1", "--generations", "5"]
    for arguments, remedy in (
        ([], "; more seeds or evaluations find more"),
        (["--method", "ea"], "; more seeds find more"),
        (["--size", "2", "2"], "; larger maps, more seeds or evaluations find more"),
    ):
        assert main([*small, *arguments, "--out", str(tmp_path / "out")]) == 1
        assert capsys.readouterr().err.rstrip().endswith(remedy)


def test_without_a_place_for_compiled_programs_it_is_only_slower(monkeypatch):
    from elitelanes_jax.compile_cache import use_compile_cache

    settings = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        monkeypatch.delenv("XDG_CACHE_HOME")

        def no_home():
            raise RuntimeError("Could not determine home directory.")

        monkeypatch.setattr("pathlib.Path.home", no_home)
        use_compile_cache()
        monkeypatch.setenv("XDG_CACHE_HOME", os.devnull)
        use_compile_cache()
        assert jax.config.values["jax_compilation_cache_dir"] is None
    finally:
        jax.config.update("jax_compilation_cache_dir", settings)
