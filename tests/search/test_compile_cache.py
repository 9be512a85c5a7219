"""Programs in files: a later process loads them, and finds the same; files that are of no use are replaced."""

import gc
import os
import pickle
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import weakref
import zlib
from functools import partial
from threading import Thread

import jax
import numpy as np
import pytest
from compiled_programs import forget_programs

from elitelanes_jax import use_compile_cache
from elitelanes_jax._util.progress import reporting
from elitelanes_jax._util.threads import start_thread
from elitelanes_jax.search import _compiling, _programs, compile_cache
from elitelanes_jax.search._compiling import CompiledPrograms, ProgramKey
from elitelanes_jax.search._programs import Programs
from elitelanes_jax.search.compile_cache import find_file, find_folder, load, save
from elitelanes_jax.search.evolution import evolve
from elitelanes_jax.search.keys import keys_of_seeds
from elitelanes_jax.search.resolve import resolve
from elitelanes_jax.search.running import compile_search
from elitelanes_jax.search.spec import SearchSpec

SHAPE = (4, 5)
run = partial(evolve, 3, SHAPE, seeds=2, method="ea", preset="paper", generations=3, progress=False)
NAMES = {"start", "advance", "collect"}


def names(file):
    return {name for name, _, _ in load(file).programs}


def arrays(result):
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves((result.elites, result.state))]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of the files, empty at first; no search knows the programs of an earlier one."""
    forget_programs()
    monkeypatch.setattr(compile_cache, "LOADED", time.time_ns())  # somebody may edit sources during the tests
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "cache"))
    yield tmp_path / "cache" / "searches"
    forget_programs()
    jax.config.update("jax_compilation_cache_dir", before)


def test_forgotten_programs_leave_nothing(folder):
    class Doubled:
        def __call__(self, usual):
            return usual * 2

    fitness = Doubled()
    known = weakref.ref(fitness)
    run(fitness=fitness)
    del fitness
    forget_programs()
    gc.collect()
    assert known() is None


def in_a_new_process(monkeypatch):
    """As in a new process, no program is known; from here on none may be traced."""
    forget_programs()
    monkeypatch.setattr(CompiledPrograms, "_lower", None)


@pytest.mark.parametrize(
    "settings",
    [
        {"where": "crossings=1..", "weights": "bridges=3", "devices": 1},
        *(
            pytest.param(slow, marks=pytest.mark.slow)
            for slow in (
                {"method": "map-elites", "preset": "tuned", "features": {}},
                {"axes": ["symmetry:5"]},
                {"method": "map-elites"},
                {"method": "pso"},
                {"method": "gwo"},
            )
        ),
    ],
    ids=str,
)
def test_loaded_programs_find_what_compiled_ones_find(settings, folder, monkeypatch):
    compiled = run(**settings)
    (file,) = folder.iterdir()
    with monkeypatch.context() as patch:
        in_a_new_process(patch)
        loaded = run(**settings)
        more = run(**settings | {"generations": 2}, state=loaded.state)
    assert arrays(loaded) == arrays(compiled)
    assert loaded.history.evaluations.tolist() == compiled.history.evaluations.tolist()
    assert jax.tree.structure(loaded) == jax.tree.structure(compiled)
    assert arrays(more) == arrays(run(**settings | {"generations": 5}))
    assert [*folder.iterdir()] == [file]


@pytest.mark.slow
def test_a_run_of_no_generations_is_completed_by_a_later_one(folder, monkeypatch):
    start = run(generations=0)
    (file,) = folder.iterdir()
    assert names(file) == {"start", "collect"}
    forget_programs()
    whole = run()
    assert names(file) == NAMES
    in_a_new_process(monkeypatch)
    assert arrays(run(generations=0)) == arrays(start)
    assert arrays(run()) == arrays(whole)


@pytest.mark.slow
def test_programs_are_optimised_from_so_many_cells_on(monkeypatch):
    levels = {"start": [], "advance": [], "collect": []}
    keep = CompiledPrograms._keep

    def note(programs, keys, compiled):
        for key in keys:
            levels[key.program].append(key.level)
        keep(programs, keys, compiled)

    monkeypatch.setattr(CompiledPrograms, "_keep", note)
    _programs._find.cache_clear()
    results = [run()]
    cells = 2 * 4 * 5 * int(results[0].history.evaluations[-1])  # of two seeds
    monkeypatch.setattr(_compiling, "_MOST_CELLS", (2 * cells, 3 * cells))
    results += [run() for _ in range(3)]
    assert levels == {"start": [0], "advance": [0, 1, 2], "collect": [0]}
    assert len({tuple(arrays(result)) for result in results}) == 1


@pytest.mark.slow
def test_a_search_goes_on_while_another_one_needs_a_higher_level(folder, monkeypatch):
    prepare = Programs.prepare

    def prepare_then_another(programs, **given):
        prepare(programs, **given)
        programs._evaluated_cells = 10**12  # as a search in another thread does before it compiles

    monkeypatch.setattr(Programs, "prepare", prepare_then_another)
    assert len(run().history.generation) == 3


@pytest.mark.parametrize(("platform", "levels"), [("cpu", [0, 1, 2]), ("gpu", [2, 2, 2])])
def test_only_programs_for_the_processor_have_levels(platform, levels):
    assert [_compiling.least_level(platform, cells) for cells in (0, 10**8, 10**9)] == levels


def test_options_that_this_compiler_does_not_know_are_left_out(monkeypatch):
    known, unknown = ("xla_backend_optimization_level", "0"), ("xla_of_another_version", True)
    monkeypatch.setattr(_compiling, "_OPTIONS", (dict([known, unknown]),))
    monkeypatch.setattr(_compiling, "_unknown_options", set())
    for _ in range(2):
        assert _compiling.compile_at(jax.jit(lambda x: x + 1).lower(1.0), 0)(1.0) == 2
        assert _compiling._unknown_options == {"xla_of_another_version"}


@pytest.mark.slow
def test_a_search_finds_what_other_threads_compiled(folder, monkeypatch):
    spec = SearchSpec(method="ea", preset="paper", evaluations=200)
    keys = keys_of_seeds(3, range(2))
    waits = [start_thread(partial(compile_search, resolve(spec, (size, 5)), keys)) for size in (4, 3)]
    for wait in waits:
        wait()
    assert len(list(folder.iterdir())) == 2
    monkeypatch.setattr(CompiledPrograms, "_compile", None)
    found = [evolve(3, (size, 5), seeds=2, spec=spec, progress=False) for size in (4, 3)]
    monkeypatch.undo()
    forget_programs()
    folder.rename(folder.with_name("aside"))
    assert arrays(found[0]) == arrays(evolve(3, (4, 5), seeds=2, spec=spec, progress=False))


def flip(content):
    return content[:-50] + bytes([content[-50] ^ 1]) + content[-49:]


def other_programs(content):
    """A whole file whose programs JAX cannot load."""
    stored = pickle.loads(zlib.decompress(content))
    programs = {key: (bytes(len(code)), *trees) for key, (code, *trees) in stored.programs.items()}
    return zlib.compress(pickle.dumps(stored._replace(programs=programs)))


def test_files_of_no_use_are_replaced_and_one_line_says_so(folder, capsys):
    first = partial(run, generations=0)  # needs no program of generations, which takes long to compile
    expected = arrays(first())
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    line = rf"{re.escape(str(file))}: compiled programs cannot be loaded \(.+\); they are compiled again\n"
    for spoilt in (flip(whole), other_programs(whole)):
        file.write_bytes(spoilt)
        forget_programs()
        capsys.readouterr()
        with reporting(quiet=False):
            assert arrays(first()) == expected
        assert re.fullmatch(line, capsys.readouterr().err)
        assert names(file) == {"start", "collect"}
    for spoilt in (whole[: len(whole) // 2], b"", b"{}\n" * 99):
        for quiet in (False, True):
            file.write_bytes(spoilt)
            with reporting(quiet=quiet):
                assert load(file) is None
            assert re.fullmatch("" if quiet else line, capsys.readouterr().err)


def test_programs_are_not_taken_from_the_folder_of_jax(folder):
    """XLA cannot serialise again what it has loaded: functions would be missing when it runs."""
    before = jax.config.jax_persistent_cache_min_compile_time_secs
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    try:
        first = arrays(run(generations=0))
        assert not [*folder.parent.glob(f"jit_{compile_cache._NAME}*")]
        for _ in range(2):
            (file,) = folder.iterdir()
            file.unlink()
            forget_programs()
            assert arrays(run(generations=0)) == first
            forget_programs()
            assert arrays(run(generations=0)) == first
    finally:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", before)


def test_a_file_is_found_by_all_that_its_programs_depend_on(folder, monkeypatch):
    find = partial(find_file, folder, SHAPE)
    file = find("static")
    assert find("static") == file and file.parent == folder
    assert find("other") != file
    with jax.numpy_rank_promotion("raise"):
        assert find("static") != file
    for name in ("_digest_sources", "installed_versions", "_processor"):
        with monkeypatch.context() as patch:
            patch.setattr(compile_cache, name, lambda: "others")
            assert find("static") != file
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_max_isa=SSE4_2")
    assert find("static") != file
    monkeypatch.undo()
    jax.config.update("jax_compilation_cache_dir", None)
    assert find_folder() is None


def test_functions_of_the_user_are_in_no_file(folder):
    run(features={"corner": lambda grid: grid[0, 0].astype(int)}, generations=0)
    run(fitness=lambda usual: usual + 1, generations=0)
    assert not folder.exists()


@pytest.mark.parametrize(
    ("fitness", "level"),
    [(lambda usual: usual / 3, 2), pytest.param(lambda usual: usual // 3, 0, marks=pytest.mark.slow)],
)
def test_floats_of_the_user_are_rounded_the_same_in_each_run(fitness, level, monkeypatch):
    """The compiler fuses products with sums at some levels of optimisation."""
    keys: list[ProgramKey] = []
    compiles = CompiledPrograms._compile
    monkeypatch.setattr(
        CompiledPrograms, "_compile", lambda self, new, *others: [keys.extend(new), compiles(self, new, *others)]
    )
    run(fitness=fitness, generations=1)
    assert keys and all(key.level == level for key in keys)


def test_programs_of_other_sources_than_those_loaded_are_not_kept(folder, monkeypatch):
    sources = compile_cache._list_sources()
    assert len(sources) > 50
    monkeypatch.setattr(compile_cache, "_list_sources", lambda: [*sources, folder.parent / "edited.py"])
    folder.parent.mkdir()
    (folder.parent / "edited.py").write_text("")
    later = compile_cache.LOADED + 10**9  # file systems round times
    os.utime(folder.parent / "edited.py", ns=(later, later))
    assert find_file(folder, "static") is None
    monkeypatch.setattr(compile_cache, "_list_sources", list)
    assert find_file(folder, "static") is None


def test_settings_under_which_programs_are_not_kept(folder):
    assert find_folder() == folder
    jax.config.update("jax_enable_compilation_cache", False)
    try:
        assert find_folder() is None
    finally:
        jax.config.update("jax_enable_compilation_cache", True)
    if use := getattr(jax.sharding, "use_abstract_mesh", None):  # from JAX 0.8 on
        with use(jax.sharding.AbstractMesh((1,), ("x",))):
            assert find_folder() is None


def test_the_folder_may_change_in_a_process(folder, tmp_path):
    run(generations=0)
    (file,) = folder.iterdir()
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "other"))
    run(generations=0)
    assert [one.name for one in (tmp_path / "other" / "searches").iterdir()] == [file.name]


def test_a_file_of_another_user_is_read(folder, monkeypatch):
    save(folder / "file", [b"bytes"])

    def refuse(*_):
        raise PermissionError("of another user")

    monkeypatch.setattr(os, "utime", refuse)
    assert load(folder / "file") == [b"bytes"]


@pytest.mark.slow
def test_threads_that_trace_and_threads_that_lower_do_not_wait_for_each_other(folder):
    """In Python 3.11, one thread at a time computes a `cached_property`, of whatever object."""
    shapes = [(4, 5), (4, 6), (4, 7)]
    for shape in shapes:
        evolve(3, shape, seeds=2, method="ea", preset="paper", generations=0, progress=False)
    forget_programs()
    calls = [(shape, 2) for shape in shapes] + [((3, width), 0) for width in (5, 6, 7)]
    threads = [
        Thread(
            target=partial(evolve, 3, shape, seeds=2, method="ea", preset="paper", generations=most, progress=False),
            daemon=True,
        )
        for shape, most in calls
    ]
    for thread in threads:
        thread.start()
        time.sleep(0.05)
    for thread in threads:
        thread.join(timeout=300)
    assert not any(thread.is_alive() for thread in threads)


def test_files_used_least_recently_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_cache, "_MOST_BYTES", 2500)
    draw = random.Random(0)
    content = draw.randbytes(900)  # random, so that it stays as long when it is compressed
    folder = tmp_path / "searches"
    files = [folder / name for name in "dcba"]
    for age, file in enumerate(files[:3]):
        save(file, content)
        os.utime(file, (age, age))
    assert not files[0].exists()
    assert load(files[1]) == content  # it is used: the other one is older now
    save(files[3], content)
    assert [file.exists() for file in files] == [False, True, False, True]
    save(files[0], draw.randbytes(2600))  # the last one stays, however large it is
    assert [file.exists() for file in files] == [True, False, False, False]


# By zstandard: "road " 30 times, then "stop line lane separator " 4 times, in a compressed block.
COMPRESSED = "28b52ffd20fa3d0100e8726f61642073746f70206c696e65206c616e6520736570617261746f720200244f7438409537"


def frame(*blocks, window=False, checksum=False):
    """Bytes of Zstandard (RFC 8878) whose blocks are (kind, size in the header, bytes)."""
    head = b"\x28\xb5\x2f\xfd" + (bytes([4 * checksum, 88]) if window else bytes([32 + 4 * checksum, 9]))
    for index, (kind, size, content) in enumerate(blocks):
        is_last = index == len(blocks) - 1
        head += (is_last | kind << 1 | size << 3).to_bytes(3, "little") + content
    return head + bytes(4 * checksum)


@pytest.mark.parametrize(
    "whole",
    [
        bytes.fromhex(COMPRESSED),
        frame((0, 5, b"roads")),
        frame((1, 900, b"r"), (0, 5, b"roads"), window=True),
        frame((0, 0, b""), checksum=True),
        frame((0, 300, bytes(300)), (1, 7, b"r"), window=True, checksum=True),
    ],
)
def test_a_program_by_zstandard_is_cut_off_at_every_byte_but_the_last(whole):
    assert not compile_cache._is_cut_off(whole)
    assert all(compile_cache._is_cut_off(whole[:end]) for end in range(len(whole)))


def test_programs_of_jax_that_were_cut_off_are_removed(folder):
    """JAX would warn of such a program in each process, and compile it again each time."""
    assert use_compile_cache() == folder.parent
    whole, by_zstandard = zlib.compress(random.Random(0).randbytes(900)), bytes.fromhex(COMPRESSED)
    files = {"jit_zstandard-0-cache": by_zstandard, "jit_whole-1-cache": whole, "notes": b"mine"}
    cut_off = {"jit_half-2-cache": whole[:400], "jit_all_but_one-3-cache": whole[:-1], "jit_none-4-cache": b""}
    cut_off |= {"jit_zstandard-5-cache": by_zstandard[:-1]}
    for name, content in (files | cut_off | {"jit_other-5-cache": b"{}"}).items():
        (folder.parent / name).write_bytes(content)
    assert use_compile_cache() == folder.parent
    assert {file.name for file in folder.parent.iterdir()} == {*files, ".checked"}
    later = folder.parent / "jit_later-6-cache"
    later.write_bytes(whole[:-1])
    (folder.parent / "jit_whole-1-cache").write_bytes(whole[:-1])
    use_compile_cache()
    assert {file.name for file in folder.parent.iterdir()} == {*files, ".checked"} - {"jit_whole-1-cache"}


CACHED = """
import sys
import jax
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
from elitelanes_jax import use_compile_cache
use_compile_cache()
print(jax.jit(lambda x: x * 3 + 1)(1.0))
"""


@pytest.mark.slow
def test_a_program_of_jax_that_was_cut_off_is_made_anew_without_a_word(tmp_path):
    def output():
        ran = subprocess.run(
            [sys.executable, "-c", CACHED, tmp_path], capture_output=True, text=True, check=True, env=os.environ
        )
        return ran.stdout + ran.stderr

    assert output() == "4.0\n"
    (file,) = tmp_path.glob("jit__lambda*-cache")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert output() == "4.0\n"
    assert len(file.read_bytes()) == len(whole)


@pytest.mark.filterwarnings("ignore:Error writing persistent compilation cache")
def test_where_nothing_can_be_written_none_are_kept(folder, small_files_only):
    small_files_only(1000)
    expected = arrays(run(generations=0))
    small_files_only(2**30)
    assert not [*folder.glob("*")]
    assert arrays(run(generations=0)) == expected


PROGRAM = """
import hashlib, sys
import jax
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
from elitelanes_jax import evolve
found = evolve(3, (4, 5), seeds=2, preset="paper", generations=3, progress=False)
digest = hashlib.sha256(b"".join(leaf.tobytes() for leaf in map(jax.numpy.asarray, jax.tree.leaves(found.elites))))
print(digest.hexdigest())
"""


def start(cache):
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, cache], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def end(process):
    out, err = process.communicate(timeout=600)
    return process.returncode, out, err


def test_a_second_process_compiles_nothing(tmp_path):
    """The file keeps its place on disk, which every new one changes."""
    first = end(start(tmp_path))
    (file,) = (tmp_path / "searches").iterdir()
    before = file.stat().st_ino
    second = end(start(tmp_path))
    assert first == second and first[0] == 0 and first[2] == ""
    assert file.stat().st_ino == before


@pytest.mark.slow
def test_processes_that_start_at_once_and_are_killed_leave_no_wrong_file(tmp_path):
    expected = end(start(tmp_path / "alone"))
    assert expected[0] == 0
    draw = random.Random(0)
    for _ in range(3):
        cache = tmp_path / "cache"
        shutil.rmtree(cache, ignore_errors=True)
        processes = [start(cache) for _ in range(20)]
        killed = draw.sample(processes, 10)
        for process in killed:
            time.sleep(draw.uniform(0, 3))
            process.send_signal(signal.SIGKILL)
        for process in processes:
            code, out, err = end(process)
            assert (code, out, err) == expected or (process in killed and code == -signal.SIGKILL)
        assert end(start(cache)) == expected
        for file in (cache / "searches").iterdir():
            assert file.name.startswith(".") or load(file) is not None
