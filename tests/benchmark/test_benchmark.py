"""The benchmark: its tasks stay as they are, scores mean what they say, and only honest archives are scored."""

import copy
import hashlib
import json
import pickle
import re
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracle import fitness as oracle_fitness
from oracle import measure as oracle
from pages import blocks, run_program
from refusals import refused

from elitelanes_jax.benchmark.measuring import measure_grids
from elitelanes_jax.benchmark.operators import find_operators
from elitelanes_jax.benchmark.running import run_task
from elitelanes_jax.benchmark.scores import compute_scores, confidence_interval, grade
from elitelanes_jax.benchmark.submissions import (
    LEAST_RUNS,
    Submission,
)
from elitelanes_jax.benchmark.tasks import (
    BUDGETS,
    CURVE,
    PAIRS,
    PAIRS_BUDGETS,
    PAIRS_VERSION,
    SIZES,
    VERSION,
    find_task,
)
from elitelanes_jax.cli.main import main
from elitelanes_jax.cli.score import _table
from elitelanes_jax.network import Weights, mirror

PAGE = Path(__file__).parents[2] / "docs" / "benchmark.md"
TASK = find_task("5x5A-100000")


def perfect(task=TASK, runs=10):
    """Runs that found the witnesses at once."""
    budgets = len(task.budgets)
    return Submission(task, np.broadcast_to(task.witnesses, (runs, budgets, *task.witnesses.shape)).copy())


def test_the_tasks_of_a_version_do_not_change():
    """Whoever means to change them raises the version, and this sum."""
    tasks = [find_task(f"{size}-10000") for size in SIZES]
    archives = [task.optimum / np.array([1, 2, -4, np.inf])[:, None] for task in tasks]  # at the optimum, over it
    archives = [np.where(best, best, np.inf) for best in archives]  # and vacant
    scores = [compute_scores(task, best) for task, best in zip(tasks, archives, strict=True)]
    intervals = [confidence_interval(score) for one in scores for score in one]
    numbers = np.concatenate([np.ravel(scores_of) for scores_of in scores] + [np.ravel(intervals)])
    facts = {
        "tasks": [[task.name, task.shape, task.fill, *(part.tolist() for part in task[4:6])] for task in tasks],
        "budgets": BUDGETS,
        "runs": LEAST_RUNS,
        "weights": Weights()._asdict(),
        "scores": np.round(np.nan_to_num(numbers, nan=-1), 9).tolist(),
    }
    assert VERSION == 1
    assert hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16] == "6f421e5cdf8714d0"


@pytest.mark.parametrize("size", ["5x5A", *(pytest.param(size, marks=pytest.mark.slow) for size in SIZES[1:])])
def test_the_witnesses_have_the_highest_scores(size):
    task = find_task(f"{size}-10000")
    best, scores = perfect(task).score()
    np.testing.assert_array_equal(best[0, 0], task.optimum)
    assert all((values == 1).all() and values.shape == (10, 1) for values in scores)
    assert (perfect(task).grade() == 1).all()


def bits_of(operators):
    random, mutate = find_operators(operators, (6, 7), fill=False)
    grids = random(jax.random.key(5), 50)
    return np.asarray([grids, mutate(grids, jax.random.key(6))]).tolist()


def test_the_tasks_of_two_descriptors_do_not_change():
    tasks = [find_task(f"{size}-100000") for size in PAIRS]
    facts = {
        "tasks": [[task.name, task.shape, task.fill, task.niches.tolist(), task.optimum.tolist()] for task in tasks],
        "budgets": [PAIRS_BUDGETS, CURVE],
        "operators": [bits_of(name) for name in ("tiles", "links")],
    }
    assert PAIRS_VERSION == 2 and [len(task.niches) for task in tasks] == [51, 122, 100, 162]
    assert hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16] == "865616952d98093c"


@pytest.mark.parametrize("size", PAIRS)
def test_the_witnesses_of_two_descriptors_are_optimal_in_their_niches(size):
    task = find_task(f"{size}-10000")
    for grid, niche, optimum in zip(task.witnesses, task.niches.tolist(), task.optimum, strict=True):
        found = oracle(grid)
        assert [found["cyclomatic"], found[task.tiles]] == niche and oracle_fitness(found) == optimum < 0
        assert not oracle_flaws(grid, task.fill) and not found["bridges"]
    best, scores = perfect(task).score()
    assert (best == task.optimum).all() and (scores.optimal == 1).all() and (perfect(task).grade() == 1).all()


def test_a_bridge_is_a_flaw_if_a_task_has_two_descriptors():
    rows = ["63063", "cd5d9", "00000", "00000", "00000"]  # two rings
    grid = np.array([[int(code, 16) for code in row] for row in rows], np.int8)
    measured = measure_grids(find_task("5x5B-straights-10000"), grid[None])
    found = oracle(grid)
    assert measured.flaws[0] == oracle_flaws(grid, False) + 2 and found["bridges"] == 2
    assert measure_grids(find_task("5x5B-10000"), grid[None]).flaws[0] == oracle_flaws(grid, False)
    assert measured.niche.tolist() == [[found["cyclomatic"], found["straights"]]]


@pytest.mark.parametrize(
    "name",
    ["5x5A", "5x5A-1000", "6x6B-turns-10000", "7x7B-turns-1000000", "12x12B-10000", "5x5-10000", "5x5C-10000", "", 3],
)
def test_there_are_no_other_tasks(name):
    with refused("task", repr(name), expected="SIZE-BUDGET"):
        find_task(name)


def test_what_does_not_count_is_vacant():
    grids = np.array(perfect().grids)
    grids[0, 0, 0] = 0  # vacant
    unfilled = find_task("5x5B-10000").witnesses
    open_cell = next(grid for grid in unfilled if (grid == 0).any())
    ring = np.array([[6, 5, 3, 6, 3], [10, 0, 10, 10, 10], [12, 5, 9, 12, 9], [0] * 5, [0] * 5])  # turns side by side
    grids[1, 0, 0], grids[2, 0, 0] = open_cell, ring
    best, scores = perfect()._replace(grids=grids).score()
    assert np.isinf(best[:3, 0, 0]).all() and np.isfinite(best[:3, 0, 1]).all()
    np.testing.assert_array_equal(scores.coverage[:, 0], [0.5] * 3 + [1] * 7)
    np.testing.assert_array_equal(scores.precision, 1)
    np.testing.assert_array_equal(scores.coverage[:, 1], 1)


def oracle_flaws(grid, fill):
    """Counts the flaws of a grid by the oracle of the metrics."""
    metrics = oracle(grid)
    names = ("dead_ends", "boundary_violations", "mismatches", "adjacent_crossings", "adjacent_turns")
    return sum(metrics[name] for name in names) + abs(metrics["components"] - 1) + fill * (grid == 0).sum()


@pytest.mark.parametrize("name", ["5x5A-10000", "5x5B-10000"])
def test_the_graded_score_has_partial_credit_for_few_flaws(name):
    task = find_task(name)
    draws, rates = np.random.default_rng(4), np.linspace(0, 0.2, 8)
    grids = task.witnesses[draws.integers(len(task.witnesses), size=(len(rates), 1, 9))]
    spoilt = draws.random(grids.shape) < rates.reshape(-1, 1, 1, 1, 1)
    grids = np.where(spoilt, draws.integers(16, size=grids.shape), grids).astype(np.int8)
    graded = Submission(task, grids).grade()
    for archive, score in zip(grids[:, 0], graded[:, 0], strict=True):
        of_niches = []
        for cyclomatic, optimum in zip(task.cyclomatic, task.optimum, strict=True):
            of_niche = [0.0]
            for grid in archive:
                if oracle(grid)["cyclomatic"] == cyclomatic:
                    flaws = oracle_flaws(grid, task.fill)
                    nearness = max(oracle_fitness(oracle(grid)) / optimum, 0)
                    of_niche.append(1 / (2 + 2 * flaws) if flaws else (1 + nearness) / 2)
            of_niches.append(max(of_niche))
        assert score == pytest.approx(np.mean(of_niches))
    _, scores = Submission(task, grids).score()
    assert ((scores.reliability == 0) & (graded > 0)).any()


def test_grades_are_what_they_are_said_to_be():
    best = np.array([TASK.optimum, TASK.optimum / 2, [3, np.inf], [np.inf, np.inf]])
    flaws = np.array([[0, 0], [0, 0], [0, 4], [1, np.inf]])
    np.testing.assert_allclose(grade(TASK, best, flaws), [1, 0.75, (0.5 + 0.1) / 2, (0.25 + 0) / 2])


fitnesses = st.lists(st.one_of(st.integers(0, 40), st.none()), min_size=2, max_size=2)


@given(fitnesses)
def test_scores_are_what_they_are_said_to_be(above):
    values = [None if gap is None else int(best) + 2 * gap for gap, best in zip(above, TASK.optimum, strict=True)]
    scores = compute_scores(TASK, np.array([[np.inf if value is None else value for value in values]]))
    near = [max(value / best, 0) for value, best in zip(values, TASK.optimum, strict=True) if value is not None]
    assert scores.coverage == len(near) / 2
    assert scores.reliability == pytest.approx(sum(near) / 2)
    assert scores.optimal == sum(gap == 0 for gap in above) / 2
    assert scores.precision == pytest.approx(sum(near) / len(near)) if near else np.isnan(scores.precision)


def test_the_fitness_of_a_vacant_slot_fills_no_niche():
    scores = compute_scores(TASK, np.array([[np.iinfo(np.int32).max, TASK.optimum[1]]]))
    assert (scores.coverage, scores.precision, scores.optimal) == (0.5, 1, 0.5)


def test_intervals_cover_the_mean_and_leave_out_what_is_no_number():
    values = np.random.default_rng(1).random(20)
    low, high = confidence_interval(values)
    half = 1.96 * values.std() / np.sqrt(20)
    np.testing.assert_allclose([low, high], values.mean() + np.array([-half, half]), atol=0.02)
    assert confidence_interval(np.append(values, np.nan)) == (low, high)
    assert confidence_interval(np.ones(3)) == (1, 1)
    with refused("values", "shape [3, 2]"):
        confidence_interval(np.ones((3, 2)))
    assert np.isnan(confidence_interval(np.array([np.nan]))).all()
    with refused("values", "shape [0]"):
        confidence_interval([])


def test_the_table_of_scores_leaves_out_what_is_no_number():
    known, unknown = np.array([[np.nan], [0.5], [0.5]]), np.full((3, 1), np.nan)
    _, row = _table([10_000], {"precision": known, "optimal": unknown, "graded": known}).splitlines()
    assert re.split(r" {2,}", row.strip()) == ["10,000", "0.500 [0.500, 0.500]", "-", "0.500 [0.500, 0.500]"]


def arrays(**changed):
    given = {"version": VERSION} | perfect()._asdict() | {"task": TASK.name} | changed
    return {name: value for name, value in given.items() if value is not None}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"version": 2}, "expected version 1, got 2"),
        ({"version": "x"}, "expected version 1, got 'x'"),
        ({"task": "5x5A-1"}, "task: expected SIZE-BUDGET of"),
        ({"task": "5x5A-10000"}, "expected grids [R, 1, N, 5, 5] for 5x5A-10000, got [10, 2, 2, 5, 5]"),
        ({"task": "6x6A-100000"}, "expected grids [R, 2, N, 6, 6] for 6x6A-100000, got [10, 2, 2, 5, 5]"),
        ({"grids": None}, "expected arrays version, task, grids, got version, task"),
        ({"grids": perfect().grids[:0]}, "expected at least 1 run, got 0"),
        ({"operators": "flips"}, "operators: expected one of open, tiles, links, moves, got 'flips'"),
        ({"grids": perfect().grids[:, :, :0]}, "expected at least one slot in grids"),
        ({"grids": perfect().grids.astype(float)}, "expected whole numbers in grids, got float64"),
        ({"grids": perfect().grids + 8}, "expected tile codes 0 to 15 in grids"),
    ],
)
def test_other_archives_are_refused_in_one_line(changed, words, tmp_path, capsys):
    file = tmp_path / "a.npz"
    np.savez(file, **arrays(**changed))
    assert main(["score", str(file)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"elitelanes: {file}: ") and words in line


@pytest.mark.parametrize("use", [Submission.score, Submission.grade, lambda own: own.save("own.npz")])
def test_a_track_that_is_none_is_refused_before_it_is_written(use, tmp_path, monkeypatch):
    """Such an archive was written, and `load` refused it."""
    monkeypatch.chdir(tmp_path)
    with refused("submission: operators", "'Moves'"):
        use(perfect()._replace(operators="Moves"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", [None, b"", b"no archive", b"PK\x03\x04"])
def test_other_files_are_refused_in_one_line(content, tmp_path, capsys):
    file = tmp_path / "a.npz"
    if content is not None:
        file.write_bytes(content)
    assert main(["score", str(file)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"elitelanes: {file}: ")


@pytest.mark.parametrize(
    ("wrong", "got", "expected"),
    [
        ({"optimum": TASK.optimum + 2}, "-56 at cyclomatic number 3, run 0...", "-54"),
        (
            {"niches": TASK.niches + 1},
            "one at cyclomatic number 3, run 0...",
            "empty",
        ),
    ],
)
def test_a_certificate_that_is_wrong_is_told_of(wrong, got, expected):
    with refused("grids", got, expected):
        perfect()._replace(task=TASK._replace(**wrong)).score()


def test_the_page_lists_the_arrays_of_an_archive(tmp_path):
    perfect().save(tmp_path / "perfect.npz")
    listed = re.findall(r"^\| `(\w+)` \| (?:a|whole) ", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    with np.load(tmp_path / "perfect.npz") as stored:
        assert sorted(listed) == sorted(stored)


@pytest.mark.slow  # it compiles a search for itself
def test_the_page_makes_an_archive_and_scores_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    *_, (_, program), (_, scores) = blocks(PAGE.read_text(encoding="utf-8"), "python")
    exec(compile(scores, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == "[1.  0.5] (0.5, 1.0)\n"
    exec(compile(program, str(PAGE), "exec"), made := {})
    assert main(["score", "mine.npz"]) == 0
    title, head, row = capsys.readouterr().out.splitlines()
    assert title == "mine.npz: 5x5A-10000, 10 runs"
    assert head.split() == ["evaluations", "coverage", "reliability", "precision", "optimal", "graded"]
    assert row.split()[:2] == ["10,000", f"{made['scores'].coverage.mean():.3f}"]


@pytest.mark.slow
def test_the_page_runs_searches_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (_, program), (_, reading), *_ = blocks(PAGE.read_text(encoding="utf-8"), "python")
    run_program(program, str(PAGE), capsys)
    assert main(["score", "own.npz"]) == 0
    capsys.readouterr()
    exec(compile(reading, str(PAGE), "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    optima = [f"{task.cyclomatic[n]} cycles: optimum {task.optimum[n]}" for task in [TASK] for n in range(2)]
    assert [line.split(", ")[0] for line in printed] == optima
    exec(compile("\n".join(program.rstrip().splitlines()[:-4]), "own.py", "exec"), own := {})
    assert run_task(find_task("6x6B-10000"), own["search"], seeds=1).grids.shape[-2:] == (6, 6)


def walk(task, rng, sizes=(64,)):
    """Witnesses with a few cells drawn anew."""
    while True:
        for size in sizes:
            grids = task.witnesses[rng.integers(len(task.witnesses), size=size)]
            spoilt = rng.random(grids.shape) < 0.3
            measured = yield np.where(spoilt, rng.integers(16, size=grids.shape), grids)
            assert measured.fitness.shape == measured.cyclomatic.shape == measured.flaws.shape == (size,)


@pytest.mark.slow
def test_runs_keep_their_archive_at_every_budget():
    seen = []

    def search(task, rng):
        own = walk(task, rng, (64, 7, 300))
        measured = None
        while True:
            grids = own.send(measured)
            measured = yield grids
            seen.append((grids, measured))

    submission = run_task(TASK, search, seeds=[3])
    grids = np.concatenate([grids for grids, _ in seen])
    measured = [np.concatenate(parts) for parts in zip(*(measured for _, measured in seen), strict=True)]
    for index, budget in enumerate((10_000, 100_000)):
        fitness, cyclomatic, flaws, _ = (values[:budget] for values in measured)
        for niche in range(25):
            here = np.flatnonzero(cyclomatic == niche)
            kept = submission.grids[0, index, niche]
            if not len(here):
                assert not kept.any()
                continue
            here = here[flaws[here] == flaws[here].min()]
            first = here[fitness[here].argmin()]
            np.testing.assert_array_equal(kept, grids[first])
            assert flaws[first] == oracle_flaws(grids[first], TASK.fill)
    assert len(grids) - len(seen[-1][0]) < 100_000  # and no batch more
    best, _ = submission.score()
    assert best.shape == (1, 2, len(TASK.optimum)) and (best[0, 1] <= best[0, 0]).all()


def test_of_equal_grids_in_a_niche_the_first_is_kept():
    """Mirror images are equal, within a batch and in the next one."""
    first = next(grid for grid in TASK.witnesses if (grid != mirror(grid)).any())

    def search(task, rng):
        yield np.stack([first, mirror(first)])
        yield np.stack([mirror(first), mirror(first)])

    niche = oracle(first)["cyclomatic"]
    np.testing.assert_array_equal(run_task(TASK, search, 1).grids[0, -1, niche], first)


@pytest.mark.parametrize("change", [{"evaluations": 20_000}, {"optimum": TASK.optimum + 1}, {"fill": not TASK.fill}])
def test_runs_on_a_changed_task_are_not_written(change, tmp_path):
    """The archive has the task's name alone, so another task would be loaded."""
    task = TASK._replace(**change)
    with refused("submission: task", "a changed one"):
        perfect(task).save(tmp_path / "changed.npz")
    assert not any(tmp_path.iterdir())


def test_runs_are_the_same_for_the_same_seeds_and_can_be_written(tmp_path):
    task = find_task("5x5A-10000")
    one, other = run_task(task, walk), run_task(task, walk, 10)
    np.testing.assert_array_equal(one.grids, other.grids)
    assert len({grids.tobytes() for grids in one.grids}) > 1
    one.save(tmp_path / "mine.npz")
    read = Submission.load(tmp_path / "mine.npz")
    assert read.task.name == task.name
    np.testing.assert_array_equal(read.grids, one.grids)
    one._replace(grids=one.grids.astype(np.int64)).save(tmp_path / "wide.npz")
    assert Submission.load(tmp_path / "wide.npz").grids.dtype == np.int8


def test_a_search_may_end_early_and_faults_are_named():
    task = find_task("5x5A-100000")
    submission = run_task(task, lambda task, rng: iter_once(task.witnesses), 2)
    _, scores = submission.score()
    assert (scores.reliability == 1).all() and scores.reliability.shape == (2, 2)
    for batch, got in (
        (np.zeros((3, 4, 5), int), "int64 [3, 4, 5]"),
        (np.zeros((3, 5, 5)), "float64 [3, 5, 5]"),
        (None, "object []"),
        ([[1, 2], [3]], "... inhomog..."),
        (np.zeros((0, 5, 5), int), "int64 [0, 5, 5]"),
        (np.full((1, 5, 5), 16), "16 to 16"),
    ):
        with refused("search", got):
            run_task(task, lambda task, rng, batch=batch: iter_once(batch), 1)
    for seeds in (0, np.array(0)):
        with refused("seeds", "0"):
            run_task(task, walk, seeds)
    for seeds in (2, np.array(2), np.arange(2)):
        assert len(run_task(task, lambda task, rng: iter_once(task.witnesses), seeds).grids) == 2
    for search in (3, iter([]), lambda task, rng: 3):
        with refused("search", expected="generator function"):
            run_task("5x5A-10000", search)
    with refused("task", "'5x5C'", expected="SIZE-BUDGET"):
        run_task("5x5C", walk)


def iter_once(batch):
    yield batch


PAIR = find_task("5x5B-straights-10000")


def climb(task, rng, operators):
    """Mutates what was measured last, and keeps nothing."""
    grids = operators.random(60)
    while True:
        yield grids
        grids = operators.mutate(grids)


@pytest.mark.parametrize("name", [pytest.param("tiles", marks=pytest.mark.slow), "links", "moves"])
def test_runs_on_fixed_operators_repeat_and_change_one_thing(name, tmp_path):
    one = run_task(PAIR, climb, [3, 4], operators=name)
    np.testing.assert_array_equal(run_task(PAIR, climb, [4], operators=name).grids[0], one.grids[1])
    assert one.grids.shape == (2, len(PAIR.budgets), len(PAIR.niches), 5, 5) and PAIR.budgets[0] == 100
    one.save(tmp_path / "draft.npz")
    read = Submission.load(tmp_path / "draft.npz")
    assert read.operators == name and main(["score", str(tmp_path / "draft.npz")]) == 0
    random, mutate = find_operators(name, (5, 5), fill=False)
    with refused("count", "-1"):
        random(jax.random.key(0), -1)
    with refused("grids", "int8 [2, 6, 6]", expected="[B, 5, 5]"):
        mutate(np.zeros((2, 6, 6), np.int8), jax.random.key(0))
    parents = np.asarray(random(jax.random.key(0), 300))
    children = np.asarray(mutate(parents, jax.random.key(1)))
    changed = (parents != children).sum(axis=(1, 2))
    if name == "links":
        assert (changed == 2).all() and not any(oracle(grid)["mismatches"] for grid in children)
        pairs = {tuple(map(tuple, np.argwhere(one != other))) for one, other in zip(parents, children, strict=True)}
        assert len(pairs) == 40  # all pairs of neighbours
    elif name == "tiles":
        assert 0 < changed.max() <= 5
        assert {tuple(cell) for cell in np.argwhere((parents != children).any(axis=0))} == set(np.ndindex(5, 5))


def test_fixed_operators_refuse_grids_that_they_have_not_made():
    def smuggle(task, rng, operators):
        yield operators.random(2)
        yield task.witnesses[:1]

    def adopt(task, rng, operators):
        yield operators.mutate(task.witnesses[:1])

    with refused("search", "another at 0"):
        run_task(PAIR, smuggle, 1, operators="links")
    with refused("grids", "another at 0"):
        run_task(PAIR, adopt, 1, operators="links")
    with refused("operators", "'flips'"):
        run_task(PAIR, climb, 1, operators="flips")
    with refused("search", "one of (task, rng)"):
        run_task(PAIR, lambda task, rng: None, 1, operators="links")


def test_grids_that_a_search_makes_and_does_not_yield_count_for_its_operators():
    made = []

    def waste(task, rng, operators):
        yield operators.random(1)
        while True:
            made.append(len(operators.random(900)))

    run_task(PAIR, waste, 1, operators="links")
    assert 1 + sum(made[:-1]) < PAIR.evaluations <= 1 + sum(made)


@pytest.mark.parametrize(
    ("change", "got", "expected"),
    [
        (lambda grids: grids + 256, "259 to 271", ""),
        (lambda grids: grids + 0.4, "float64", ""),
        (lambda grids: grids[..., :4], "[10, 2, 2, 5, 4]", "[R, 2, N, 5, 5]"),
        (lambda grids: grids[:, :, :0], "[10, 2, 0, 5, 5]", "slot"),
        (lambda grids: grids[:0], "0", "at least 1"),
        (lambda _: [[1, 2]], "[1, 2]", "[R, 2, N, 5, 5]"),
    ],
)
def test_grids_that_do_not_fit_the_task_get_no_score(change, got, expected):
    grids = np.asarray(perfect().grids, int)
    with refused("submission", got, expected):
        perfect()._replace(grids=change(grids)).score()


def masked(values):
    """Returns an array whose first number is masked."""
    array = np.ma.array(values)
    array[(0,) * array.ndim] = np.ma.masked
    return array


def test_masked_numbers_are_refused():
    with refused("best", "a masked array"):
        compute_scores(TASK, masked(np.zeros((2, len(TASK.optimum)))))
    with refused("values", "a masked array"):
        confidence_interval(masked([1.0, 0.5]))
    hidden = perfect()._replace(grids=masked(perfect().grids))
    for use in (Submission.score, Submission.grade, lambda submission: submission.save("hidden.npz")):
        with refused("submission: grids", "a masked array"):
            use(hidden)
    with refused("search", "a masked array"):
        run_task(TASK, lambda task, rng: iter_once(masked(task.witnesses)), 1)


@pytest.mark.parametrize("values", [None, [0.5, None], [0.5, np.inf], [-np.inf], "0.5"])
def test_a_score_is_a_finite_number_or_nan(any_types, values):
    with refused("values", "array(..."):
        confidence_interval(values)


@pytest.mark.parametrize("kind", [bool, object, str, complex])
def test_a_fitness_is_a_number(kind):
    with refused("best", expected="numbers, infinite"):
        compute_scores(TASK, np.zeros((1, len(TASK.optimum)), kind))


def test_operators_make_no_more_grids_than_a_run_may_evaluate():
    made = []

    def search(task, rng, operators):
        grids = operators.random(9_990)
        yield grids
        made.append(operators.mutate(grids[:50]))
        yield made[0]

    run_task("5x5B-straights-10000", search, seeds=1, operators="links")
    assert (made[0][10:] == made[0][9]).all() and (made[0][8] != made[0][9]).any()


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_operators_are_not_copied(duplicate):
    def search(task, rng, operators):
        yield duplicate(operators).random(1)

    with refused("operators", "a copy"):
        run_task("5x5B-straights-10000", search, seeds=1, operators="links")
