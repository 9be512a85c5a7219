"""The command, as its users call it."""

import gc
import json
import os
import re
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

from elitelanes_jax.cli import program
from elitelanes_jax.cli.main import main
from elitelanes_jax.cli.signals import catch_interrupts
from elitelanes_jax.network.metrics import measure
from elitelanes_jax.network.symmetry import canonical_form
from elitelanes_jax.search.compile_cache import use_compile_cache
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import default_tiles

# The EA with the paper's settings compiles fast; all searches that go on for generations use this one program.
SMALL = ["--size", "5", "6", "--seeds", "3", "--maps", "6", "--generations", "5", "--tile-px", "16"]
SMALL += ["--method", "ea", "--preset", "paper"]

COMMAND = "from elitelanes_jax.__main__ import run; run()"


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    out = tmp_path_factory.mktemp("generated") / "out"
    assert main(["generate", *SMALL, "--out", str(out)]) == 0
    return out


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def read(file):
    return cv2.imread(str(file), cv2.IMREAD_UNCHANGED)


def test_a_folder_has_maps_a_contact_sheet_an_archive_and_a_record(generated):
    names = set(files(generated))
    one = {"image.png", "road.png", "red.png", "yellow.png", "labels.png", "map.json"}
    maps = {f"maps/{number:04d}/{name}" for number in range(6) for name in one}
    assert names == maps | {"contact-sheet.png", "archive.npz", "run.json"}


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
        forms.add(canonical_form(codes))
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
    assert SearchSpec.from_plain(run["settings"]["search"]) == SearchSpec(method="ea", preset="paper", generations=5)
    assert run["config"]["population"] == 20
    assert run["weights"]["dead_ends"] == 480
    assert set(run["versions"]) == {"elitelanes_jax", "python", "jax", "jaxlib", "numpy", "opencv"}
    assert run["tile_set"]["name"] == "Elite Lanes drawn tiles"
    archive = np.load(generated / "archive.npz")
    assert archive["grids"].shape == (3, 20, 5, 6)
    assert archive["history.best_fitness"].shape == (3, 5)
    assert archive["metrics.bridges"].shape == archive["valid"].shape == (3, 20)
    assert archive["axes"].tolist() == [axis["metric"] for axis in run["axes"]]


def test_the_same_command_writes_the_same_files(generated, tmp_path):
    assert main(["generate", *SMALL, "--out", str(tmp_path / "again")]) == 0
    one, other = files(generated), files(tmp_path / "again")
    runs = [json.loads(written.pop("run.json")) for written in (one, other)]
    for run in runs:
        run.pop("times")
    assert runs[0] == runs[1]
    assert one == other


def test_another_seed_finds_other_maps_and_the_table_shows_them(generated, tmp_path, capsys):
    out = tmp_path / "other"
    assert main(["generate", *SMALL, "--maps", "3", "--seed", "5", "--out", str(out)]) == 0
    assert (generated / "archive.npz").read_bytes() != (out / "archive.npz").read_bytes()
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert lines[0].split()[:3] == ["map", "fitness", "cyclomatic"]
    for number, line in enumerate(lines[1:4]):
        road_map = json.loads((out / "maps" / f"{number:04d}" / "map.json").read_text())
        expected = [f"{number:04d}", str(road_map["fitness"]), str(road_map["metrics"]["cyclomatic"])]
        assert line.split()[:3] == expected
    assert lines[4:] == [
        f"3 maps in {out / 'maps'}, all of them on {out / 'contact-sheet.png'}",
        f"elitelanes explore {out} --open shows all elites",
    ]
    assert captured.err == "evolving 3 maps of 5 x 6 tiles: ea, paper, 3 runs of 5 generations\n"


def test_a_quiet_command_prints_nothing_and_a_verbose_one_tells_its_steps(tmp_path, capsys):
    for loud in ("quiet", "verbose"):
        assert main(["generate", *SMALL, f"--{loud}", "--out", str(tmp_path / loud)]) == 0
        captured = capsys.readouterr()
        if loud == "quiet":
            assert captured.out == captured.err == ""
    assert re.search(
        r"^evolving 6 maps .*^ea 5x6 5/5 generations, best .*^found 6 of 6 maps among 60 elites",
        captured.err,
        re.M | re.S,
    )
    assert captured.out.splitlines()[-2].startswith("6 maps in ")
    written = [files(tmp_path / loud) for loud in ("quiet", "verbose")]
    assert written[0].keys() == written[1].keys()


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


def test_tiles_are_described_or_all_their_faults_are(capsys, tmp_path):
    assert main(["tiles", "check", str(default_tiles())]) == 0
    assert "14 tiles" in capsys.readouterr().out
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    (tmp_path / "tiles" / "turn_1" / "red.png").unlink()
    (tmp_path / "tiles" / "turn_2" / "red.png").unlink()
    assert main(["tiles", "check", str(tmp_path / "tiles")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 2


def test_too_few_maps_are_one_line_and_exit_code_1(tmp_path, capsys):
    assert main(["generate", *SMALL, "--quiet", "--maps", "50", "--out", str(tmp_path / "out")]) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("elitelanes: found ")
    assert "of 50 maps among" in captured.err
    assert len(captured.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


WRONG = {
    "no maps": (["--maps", "0"], "--maps: expected a whole number, 1 or more, got '0'"),
    "half a seed": (["--seeds", "0.5"], "--seeds: expected a whole number, 1 to 1000000, got '0.5'"),
    "no digit": (["--maps", "²"], "--maps: expected a whole number, 1 or more, got '²'"),
    "too many digits": (["--maps", "9" * 5000], "--maps: expected a whole number, 1 or more, got '9999"),
    "no preset": (["--preset", ""], "--preset: expected a name, got ''"),
    "no folder": (["--out", ""], "generate: argument --out: expected a name, got ''"),
    "no tiles": (["--tiles", ""], "--tiles: expected a name, got ''"),
    "a thin grid": (["--size", "1", "5"], "--size: expected sides from 2 to 1024 for new maps, got 1 x 5"),
    "half a grid": (
        ["--size", "5", "x"],
        "--size: expected a whole number, 0 or more, got 'x'",
    ),
    "one side": (["--size", "5"], "generate: argument --size: expected 2 arguments"),
    "huge tiles": (["--tile-px", "1000"], "--tile-px: expected a whole number, 16 to 512, got '1000'"),
    "a negative seed": (["--seed", "-1"], "--seed: expected a whole number, 0 to 4294967295, got '-1'"),
    "no such method": (["--method", "luck"], "--method: expected one of map-elites, ea, pso, gwo, got 'luck'"),
    "no such preset": (
        ["--method", "map-elites", "--preset", "luck"],
        "--preset: expected one of tuned, paper, standard, irregular for map-elites, got 'luck'",
    ),
    "no such preset of the method": (["--preset", "standard"], "--preset: expected one of tuned, paper for ea, got"),
    "no such option": (["--luck"], "generate: unrecognized arguments: --luck"),
    "generations and evaluations": (
        ["--generations", "1", "--evaluations", "1"],
        "--generations: expected it or evaluations, got both, 1 and 1",
    ),
    "no range": (["--where", "crossings"], "--where 'crossings': expected NAME=LOW..HIGH, such as crossings=6..10"),
    "a range of nothing": (["--where", "speed=3"], "--where 'speed=3': expected a metric, or a share such"),
    "a name that is nearly one": (
        ["--where", "cycles=3"],
        "--where 'cycles=3': expected a metric, or a share such as "
        "straight_share, got 'cycles'; is it cyclomatic? (elitelanes metrics explains all: components, cyclomatic, ",
    ),
    "a range upside down": (
        ["--where", "bridges=5..2"],
        "--where 'bridges=5..2': expected the lower limit first, got 5 before 2",
    ),
    "a range without numbers": (["--where", "bridges=a..b"], "--where 'bridges=a..b': expected a number, got 'a'"),
    "a range without limits": (["--where", "bridges=.."], "--where 'bridges=..': expected at least one limit"),
    "half a bridge": (["--where", "bridges=0.5"], "--where 'bridges=0.5': expected whole numbers, got 0.5"),
    "a share over 1": (["--where", "straight_share=0..2"], "--where 'straight_share=0..2': expected 0 to 1 (a part"),
    "the same range twice": (
        ["--where", "bridges=1", "bridges=2"],
        "--where: expected each feature once, got bridges 2 times",
    ),
    "no weight": (["--weights", "bridges"], "--weights: expected NAME=N with a whole number, -2147483648 to "),
    "a weight of nothing": (["--weights", "speed=3"], "--weights: expected a metric such as dead_ends, or"),
    "no axis": (["--axes", "cyclomatic"], "--axes 'cyclomatic': expected NAME:BINS or NAME:BINS:WIDTH"),
    "an axis of nothing": (["--axes", "speed:3"], "--axes 'speed:3': expected a metric, or a share such"),
    "too many niches": (["--axes", "tiles:9999", "edges:9999"], "--axes: expected at most 1,048,576 niches, got"),
    "the same weight twice": (
        ["--weights", "bridges=1", "--weights", "bridges=2"],
        "--weights: expected each metric once, got bridges 2 times",
    ),
    "the same axis twice": (
        ["--axes", "tiles:3", "--axes", "tiles:4"],
        "--axes: expected each metric once, got tiles 2 times",
    ),
    "dead ends": (
        ["--where", "dead_ends=3.."],
        "--where 'dead_ends=3..': expected a range with 0, which maps of 5 x 6 tiles have",
    ),
    "empty cells without rules": (["--where", "coverage=..0.5"], "--where 'coverage=..0.5': expected a range with 1,"),
    "no template": (["--fix", "nowhere.json"], "--fix: nowhere.json: no such file or directory"),
    "no template of that name": (["--fix", "fix.json"], "--fix: fix.json: no such file or directory"),
    "no map to begin with": (["--from", "nowhere.json"], "--from: nowhere.json: "),
    "no such rules": (["--rules", "luck"], "--rules: expected one of duckietown, got 'luck'"),
    "no such tiles": (["--tiles", "nowhere"], "nowhere: expected a folder of tile pictures, got none"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_users_mistake_is_one_line_and_exit_code_2(wrong, tmp_path, capsys):
    arguments, message = WRONG[wrong]
    try:
        code = main(["generate", *SMALL, "--out", str(tmp_path / "out"), *arguments])
    except SystemExit as stop:
        code = stop.code
    captured = capsys.readouterr()
    assert code == 2
    assert captured.err.startswith(
        f"elitelanes {message}" if message.startswith("generate") else f"elitelanes: {message}"
    )
    assert len(captured.err) < 800
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""
    assert not list(tmp_path.iterdir())


def test_folders_that_are_not_new_are_left_alone(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    for out, message in (
        (tmp_path, "expected a folder that is new or empty, got one with files in it"),
        (tmp_path / "file", "expected a folder that is new or empty, got a file"),
        (tmp_path / "file" / "out", "out: expected a path that can be written to"),
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

    monkeypatch.setattr(Path, "write_bytes", fail)
    assert main(["generate", *SMALL, "--quiet", "--out", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert "image.png: No space left on device" in captured.err
    assert len(captured.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_an_interrupted_command_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_bytes", interrupt)
    assert main(["generate", *SMALL, "--quiet", "--out", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err == "elitelanes: interrupted; nothing was written\n"
    assert not list(tmp_path.iterdir())


def test_maps_that_cannot_be_read_or_drawn(tmp_path, capsys):
    file, tiles = tmp_path / "map.json", tmp_path / "tiles"
    shutil.copytree(default_tiles(), tiles, ignore=shutil.ignore_patterns("end_*"))
    for text, message in (
        ('{"codes": [[6, 99], [12, 9]]}', "map.json: grid: expected tile codes 0 to 15, got 99"),
        ('{"codes": [[8, 3], [12, 9]]}', "map.json: grid: expected tiles that the set"),
    ):
        file.write_text(text)
        assert main(["render", str(file), "--tiles", str(tiles), "--out", str(tmp_path / "out")]) == 2
        assert message in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"map.json", "tiles"}


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
    "error",
    [
        MemoryError(),
        RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."),
        RuntimeError("INTERNAL: CUDA: out of memory"),
    ],
)
def test_too_little_memory_is_one_line(error, tmp_path, capsys, monkeypatch):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(Path, "write_bytes", fail)
    assert main(["generate", *SMALL, "--quiet", "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == (
        "elitelanes: not enough memory; fewer seeds, smaller maps or smaller tiles need less\n"
    )
    assert not list(tmp_path.iterdir())


def test_a_fault_of_the_program_is_not_blamed_on_the_user(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ValueError("a bug")

    monkeypatch.setattr(Path, "write_bytes", fail)
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
    command = [sys.executable, "-c", f"{heard}; {COMMAND}", "generate", "--generations", "9999999"]
    command += ["--quiet", "--out", str(tmp_path / "out")]
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
def test_a_command_that_is_told_to_end_while_its_modules_load_prints_no_traceback(tmp_path):
    """An exception within the loading of NumPy or JAX would end in a traceback or a crash."""
    # Until the package's root and the command's own handler are there, an interruption is Python's.
    root = "import signal, elitelanes_jax.__main__"
    heard = f"{root}; signal.signal(signal.SIGINT, signal.default_int_handler); print(flush=True)"
    command = [sys.executable, "-c", f"{heard}; {COMMAND}", "generate", "--quiet", "--generations", "9999999"]
    for number in range(6):
        files = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        with subprocess.Popen([*command, "--out", str(tmp_path / "out")], **files) as process:
            assert process.stdout.readline() == "\n"
            time.sleep(0.1 + 0.1 * number)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=60)
        assert process.returncode == 130
        assert said in ("", "elitelanes: interrupted; nothing was written\n")
        assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_a_signal_that_is_lost_comes_again(capsys):
    """Python only prints an exception in a callback of the garbage collector, and native code may drop one."""

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
def test_clearing_up_after_a_signal_is_not_disturbed():
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


def test_a_failure_to_print_does_not_undo_the_work(tmp_path):
    command = [sys.executable, "-c", COMMAND, "render", "map.json", "--tile-px", "16", "--out"]
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
    command = [sys.executable, "-c", COMMAND, "tiles", "check", str(tmp_path / "tiles")]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("Stra\\xdfen: 14 tiles")


def test_no_generations_with_the_default_method(tmp_path):
    small = ["generate", "--size", "2", "2", "--seeds", "2", "--maps", "1", "--tile-px", "16"]
    assert main([*small, "--generations", "0", "--out", str(tmp_path / "out")]) == 0
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["times"]["evaluations_per_second"] is None
    assert (run["settings"]["search"]["method"], run["settings"]["search"]["preset"]) == ("map-elites", "tuned")
    assert run["config"]["annealing"]["moves"]["transplant"] == 16
    assert np.load(tmp_path / "out" / "archive.npz")["grids"].shape == (2, 400, 2, 2)


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


def test_the_nearest_map_is_told_where_every_map_has_a_flaw(tmp_path, capsys):
    asked = ["--where", "crossings=8", "--rules", "duckietown", "--generations", "0"]
    assert main(["generate", *SMALL, *asked, "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert "; nearest found, with other flaws: crossings " in error
    assert error.rstrip().endswith("; wider ranges, more seeds or evaluations find more")


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["--method", "map-elites"], "; more seeds or evaluations find more"),
        ([], "; more seeds find more"),
        (["--method", "map-elites", "--size", "3", "8"], "; larger maps, more seeds or evaluations find more"),
    ],
)
def test_a_shortage_of_maps_tells_what_finds_more(arguments, remedy, tmp_path, capsys):
    few = [*SMALL, "--maps", "400", "--generations", "0"]
    assert main(["generate", *few, *arguments, "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.rstrip().endswith(remedy)


def test_without_a_place_for_compiled_programs_it_is_only_slower(monkeypatch):
    settings = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        monkeypatch.delenv("XDG_CACHE_HOME")

        def no_home():
            raise RuntimeError("Could not determine home directory.")

        monkeypatch.setattr(Path, "home", no_home)
        use_compile_cache()
        monkeypatch.setenv("XDG_CACHE_HOME", os.devnull)
        use_compile_cache()
        assert jax.config.values["jax_compilation_cache_dir"] is None
    finally:
        jax.config.update("jax_compilation_cache_dir", settings)


def test_the_last_line_names_a_program_that_can_be_started(tmp_path, monkeypatch, capsys):
    """`make demo` starts it in the environment's folder, which is not on the PATH."""
    line = "generate --size 5 6 --maps 1 --generations 3 --method ea --preset paper --tile-px 16"
    for number, (found, started, name) in enumerate(
        (
            (None, ".venv/bin/elitelanes", ".venv/bin/elitelanes"),
            ("/bin/elitelanes", "/bin/elitelanes", "elitelanes"),
            (None, "pytest", "elitelanes"),
        )
    ):
        monkeypatch.setattr(program, "which", lambda _, found=found: found)
        monkeypatch.setattr("sys.argv", [started])
        out = tmp_path / str(number)
        assert main([*line.split(), "--out", str(out)]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == f"{name} explore {out} --open shows all elites"
