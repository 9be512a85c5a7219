"""The command, as its users call it."""

import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import jax
import numpy as np
import pytest
from folders import files, read_picture

from elitelanes_jax import RoadMap, SearchSpec, measure, use_compile_cache
from elitelanes_jax._util.interruption import catch_interrupts
from elitelanes_jax._util.progress import Progress
from elitelanes_jax.cli import program
from elitelanes_jax.cli.generate import _COLUMNS, describe_maps
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats.road_map import map_to_json
from elitelanes_jax.network import canonical_form
from elitelanes_jax.search.resolve import plain_spec
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
        labels = read_picture(folder / "labels.png")
        assert labels.shape == (80, 96)
        masks = [read_picture(folder / f"{name}.png") for name in ("road", "red", "yellow")]
        np.testing.assert_array_equal(labels, np.select([mask > 0 for mask in masks[::-1]], [3, 2, 1]))
        assert read_picture(folder / "image.png").shape == (80, 96, 3)
    assert len(forms) == 6


def test_the_run_record_and_the_archive(generated):
    run = json.loads((generated / "run.json").read_text())
    assert run["settings"]["size"] == [5, 6]
    assert run["settings"]["seeds"] == 3
    spec = plain_spec(SearchSpec(method="ea", preset="paper", generations=5))
    assert run["settings"]["search"] == json.loads(json.dumps(spec))
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


@pytest.mark.parametrize(
    ("crossings", "left", "said"),
    [
        ([2, 1, 4], None, []),
        ([2, 0, 0], None, ["2 of 3 maps have no crossing; --where crossings=1.. asks for one"]),
        ([0], None, ["1 of 1 map has no crossing"]),
        (
            [2, 5],
            [3, 0],
            ["0 to 3 of the shelf's 5 crossings are left; --where crossings=5.. asks for maps that use more"],
        ),
        ([2, 2], [3, 3], ["3 of the shelf's 5 crossings are left; --where crossings=3.. asks for maps that use more"]),
        ([5, 5], [0, 0], []),
    ],
)
def test_what_maps_have_few_of_is_said(crossings, left, said):
    metrics = [dict.fromkeys(_COLUMNS, 0) | {"crossings": count} for count in crossings]
    for figures, count in zip(metrics, left or [], strict=False):
        figures |= {"crossings3_left": count, "crossings4_left": 0}
    loop = np.array([[6, 3], [12, 9]], np.int8)
    maps = [RoadMap(loop, metrics=figures, fitness=0.0) for figures in metrics]
    lines = describe_maps(maps, len(maps), Path("out")).splitlines()
    assert lines[len(maps) + 2 :] == said


def test_a_quiet_command_prints_nothing(tmp_path, capsys):
    assert main(["generate", *SMALL, "--quiet", "--out", str(tmp_path / "quiet")]) == 0
    captured = capsys.readouterr()
    assert captured.out == captured.err == "" and files(tmp_path / "quiet")


def test_rendering_a_map_again_gives_the_same_picture(generated, tmp_path):
    folder = generated / "maps" / "0002"
    assert main(["render", str(folder / "map.json"), "--tile-px", "16", "--out", str(tmp_path / "same")]) == 0
    written = files(tmp_path / "same")
    assert written == {name: content for name, content in files(folder).items() if name != "map.json"}
    arguments = ["render", str(folder / "map.json"), "--tile-px", "40", "--seed", "3", "--overlay"]
    assert main([*arguments, "--out", str(tmp_path / "other")]) == 0
    assert read_picture(tmp_path / "other" / "overlay.png").shape == (200, 240, 3)


def test_as_a_program():
    command = shutil.which("elitelanes", path=Path(sys.executable).parent)
    assert command, "the console script is installed"
    wrong = subprocess.run([command, "generate"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert wrong.stderr == "elitelanes generate: the following arguments are required: --out\n"


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (OSError(28, "No space left on device", "image.png"), 2, "image.png: No space left on device"),
        (KeyboardInterrupt(), 130, "interrupted; nothing was written"),
        *(
            (error, 1, "not enough memory; fewer seeds, smaller maps or smaller tiles need less")
            for error in (
                MemoryError(),
                RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."),
                RuntimeError("INTERNAL: CUDA: out of memory"),
            )
        ),
    ],
)
def test_what_ends_a_command_is_one_line_and_leaves_nothing(error, code, said, tmp_path, capsys, monkeypatch):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(Path, "write_bytes", fail)
    assert main(["generate", *SMALL, "--quiet", "--out", str(tmp_path / "out")]) == code
    assert capsys.readouterr().err == f"elitelanes: {said}\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("dataset --floor 4 3 --out out", ""),
        ("dataset --resolution 128 --out out", ""),
        ("generate --inventroy straight=3 --out out", "; is it --inventory?"),
        ("generate --evals 100 --out out", "; is it --evaluations?"),
    ],
)
def test_an_unknown_option_names_a_known_one_only_if_they_are_alike(line, hint, capsys):
    with pytest.raises(SystemExit):
        main(line.split())
    command, *arguments = line.removesuffix(" --out out").split()
    message = f"elitelanes {command}: unrecognized arguments: {' '.join(arguments)}{hint}"
    assert capsys.readouterr().err == f"{message}\n"


def test_a_fault_of_the_program_is_not_blamed_on_the_user(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ValueError("a bug")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(ValueError, match="a bug"):
        main(["generate", *SMALL, "--out", str(tmp_path / "out")])


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
@pytest.mark.parametrize(
    ("name", "loads", "later"),
    [
        *(("SIGTERM", False, 0.0), ("SIGINT", False, 0.3), ("SIGHUP", False, 0.5)),
        ("SIGINT", True, 0.3),
        *(pytest.param("SIGTERM", False, later, marks=pytest.mark.slow) for later in (0.05, 1.0, 2.0)),
        *(pytest.param("SIGINT", True, later, marks=pytest.mark.slow) for later in (0.1, 0.2, 0.4, 0.6)),
    ],
)
def test_a_run_that_is_told_to_end_leaves_nothing(name, loads, later, tmp_path):
    """At any moment: while modules load, where an exception may be a traceback or a crash, compiles, evolves."""
    # Under nohup, or in the background of a script, the tests' own signals may be ignored, and that is inherited.
    # Until the package's root and the command's own handler are there, an interruption is Python's.
    heard = f"signal.signal(signal.{name}, signal.default_int_handler); print(flush=True)"
    command = [sys.executable, "-c", f"import signal, elitelanes_jax.__main__; {heard}; {COMMAND}", "generate"]
    command += ["--generations", "9999999", "--quiet", "--out", str(tmp_path / "out")]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        try:
            assert process.stdout.readline() == "\n"
            while not loads and not list(tmp_path.iterdir()):
                assert process.poll() is None
                time.sleep(0.01)
            time.sleep(later)
            process.send_signal(getattr(signal, name))
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert said == "elitelanes: interrupted; nothing was written\n" or (loads and said == "elitelanes: interrupted\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_a_signal_after_the_work_prints_nothing():
    program = (
        "import os, signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # it may be ignored, see above
        "from elitelanes_jax.cli import program\n"
        "program._flush = lambda stream: os.kill(os.getpid(), signal.SIGINT)\n"
        "program.leave(lambda: 0)\n"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (130, "")


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_a_signal_while_modules_load_is_heard_when_they_are_loaded(tmp_path, monkeypatch):
    """Commands that count no steps, such as drive, ignored it."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "outer_module.py").write_text("import inner_module\nlast = [1].count(1)\n")
    (tmp_path / "inner_module.py").write_text("import signal\nsignal.raise_signal(signal.SIGTERM)\nlast = len('a')\n")
    with catch_interrupts():
        with pytest.raises(KeyboardInterrupt):
            import outer_module  # noqa: F401
        assert sys.getprofile() is None
    loaded = [sys.modules.pop(name) for name in ("outer_module", "inner_module")]
    assert [module.last for module in loaded] == [1, 1]


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_a_signal_that_is_lost_is_heard_when_work_counts(monkeypatch):
    """Python drops an exception in a callback of the garbage collector, and would print its traceback."""
    printed = []
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: printed.append(dropped.exc_type))

    def callback(phase, _):
        if phase == "stop":
            signal.raise_signal(signal.SIGTERM)

    def in_the_collector():
        gc.callbacks.append(callback)
        try:
            gc.collect()
        finally:
            gc.callbacks.remove(callback)

    def dropped():
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)

    def compile_something(bar):
        with bar.doing("compiling"):
            pass

    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in signals]
    for lose in (in_the_collector, dropped):
        for count in (lambda bar: bar.count(), lambda bar: bar.update(1), compile_something):
            with catch_interrupts():
                lose()
                with pytest.raises(KeyboardInterrupt):
                    count(Progress("work"))
    assert [signal.getsignal(number) for number in signals] == before
    assert not printed
    Progress("later work").count()


def test_errors_that_python_drops_are_printed_unless_they_are_interruptions(monkeypatch):
    printed = []
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: printed.append(dropped.exc_type))

    class Dropped:
        def __init__(self, error):
            self.error = error

        def __del__(self):
            raise self.error

    with catch_interrupts():
        Dropped(KeyboardInterrupt)
        Dropped(OSError)
    Dropped(KeyboardInterrupt)
    assert printed == [OSError, KeyboardInterrupt]


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_a_signal_that_became_another_error_is_an_interruption(capsys):
    """As in native code of NumPy that asks an object of JAX for its dtype."""

    class Asked:
        @property
        def dtype(self):
            signal.raise_signal(signal.SIGTERM)

    with catch_interrupts():
        assert program.guarded("el", lambda: np.result_type(Asked()), "nothing was written") == 130
    assert capsys.readouterr().err == "el: interrupted; nothing was written\n"
    with pytest.raises(TypeError), catch_interrupts():
        program.guarded("el", lambda: np.result_type("no type at all"), "nothing was written")


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


def test_without_docstrings():
    command = [sys.executable, "-OO", "-m", "elitelanes_jax", "dataset", "--help"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "\n  --maps N              by default 1000\n" in shown


def test_names_that_the_terminal_cannot_show(tmp_path):
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    (tmp_path / "tiles" / "tileset.toml").write_text('name = "Straßen"', encoding="utf-8")
    command = [sys.executable, "-c", COMMAND, "tiles", "check", str(tmp_path / "tiles")]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("Stra\\xdfen: 14 tiles")


@pytest.mark.slow
def test_no_generations_with_the_default_method(tmp_path):
    small = ["generate", "--size", "2", "2", "--seeds", "2", "--maps", "1", "--tile-px", "16"]
    assert main([*small, "--generations", "0", "--out", str(tmp_path / "out")]) == 0
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["times"]["evaluations_per_second"] is None
    assert (run["settings"]["search"]["method"], run["settings"]["search"]["preset"]) == ("map-elites", "tuned")
    assert run["config"]["annealing"]["moves"]["transplant"] == 16
    assert np.load(tmp_path / "out" / "archive.npz")["grids"].shape == (2, 400, 2, 2)


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
        jax.config.update("jax_compilation_cache_dir", f"{os.devnull}/cache")  # as its variable does
        assert use_compile_cache() is None
        assert jax.config.values["jax_compilation_cache_dir"] is None
    finally:
        jax.config.update("jax_compilation_cache_dir", settings)


def test_the_program_is_named_as_it_can_be_started(monkeypatch):
    """`make demo` starts it in the environment's folder, which is not on the PATH."""
    for found, started, name in (
        (None, ".venv/bin/elitelanes", ".venv/bin/elitelanes"),
        ("/bin/elitelanes", "/bin/elitelanes", "elitelanes"),
        (None, "pytest", "elitelanes"),
    ):
        monkeypatch.setattr(program, "which", lambda _, found=found: found)
        monkeypatch.setattr("sys.argv", [started])
        assert program.program_name() == name


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (
            ["plan", "town", "--out", "my map: a.doc"],
            "--out: expected a name that ends in .pdf, .svg or .png, got 'my map",
        ),
        (["render", "town"], "--out: expected a folder for the pictures of town, which has no suffix to leave out"),
        (["generate", "--floor", "1", "4", "--out", "maps"], "--floor: expected at least 1.592"),
    ],
)
def test_a_message_names_the_argument_that_was_given(command, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("town").write_text(map_to_json(np.full((3, 3), 5, np.int8)))
    assert main(command) == 2
    assert capsys.readouterr().err.startswith(f"elitelanes: {message}")
    assert [path.name for path in tmp_path.iterdir()] == ["town"]
