"""What is drawn holds the data."""

import re
import sys
import warnings
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from conftest import ALL_SHAPES, grids
from hypothesis import given, settings
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax import Axis, evolve, repair
from elitelanes_jax.network import gridlock_loop
from elitelanes_jax.plots import archive_map, history, road_map, seed_band
from elitelanes_jax.problem import qd_score
from elitelanes_jax.problem.descriptor import niche_index, paper_axes
from elitelanes_jax.search import History

mpl.use("Agg")
import matplotlib.pyplot as plt

DOCS = Path(__file__).parents[1] / "docs"
VACANT = np.iinfo(np.int32).max


@pytest.fixture(autouse=True)
def figures_are_closed():
    yield
    plt.close("all")


def artist(ax, label):
    """Paths of the collection of a label, as arrays of points."""
    (found,) = [collection for collection in ax.collections if collection.get_label() == label]
    return [path.vertices for path in found.get_paths()]


@settings(max_examples=40)
@given(grids(ALL_SHAPES))
def test_a_map_has_a_ribbon_for_each_link_and_a_bar_for_each_end(grid):
    """Repaired or not: what is not answered is drawn to the tile's side, and ends there."""
    _, ax = plt.subplots()
    assert road_map(grid, ax=ax) is ax
    metrics = oracle(grid)
    connections = sum(int(code).bit_count() for code in grid.flat)
    unanswered = connections - 2 * metrics["edges"]
    stubs = sum(int(code).bit_count() == 1 for code in grid.flat)
    for label in ("lanes", "road", "kerb"):
        assert len(artist(ax, label)) == metrics["edges"] + unanswered
    assert len(artist(ax, "ends")) == unanswered + stubs
    assert ax.get_aspect() == 1
    assert ax.get_xlim() == (0, grid.shape[1]) and ax.get_ylim() == (grid.shape[0], 0)
    plt.close("all")


@settings(max_examples=40)
@given(grids(ALL_SHAPES))
def test_lanes_lead_from_tile_to_tile_over_the_middle_of_their_side(grid):
    grid = np.asarray(repair(grid))
    _, ax = plt.subplots()
    road_map(grid, ax=ax)
    crossed = set()
    for line in artist(ax, "lanes"):
        assert (np.linalg.norm(np.diff(line, axis=0), axis=1) < 0.51).all()
        sides = [tuple(2 * point) for point in line if sorted(point * 2 % 2) == [0, 1]]
        assert len(sides) == 1
        crossed |= set(sides)
    height, width = grid.shape
    across = {(2 * c + 2, 2 * r + 1) for r, c in product(range(height), range(width)) if grid[r, c] & 4}
    down = {(2 * c + 1, 2 * r + 2) for r, c in product(range(height), range(width)) if grid[r, c] & 2}
    assert crossed == across | down
    plt.close("all")


def test_ribbons_are_of_one_width_and_meet_in_turns():
    ax = road_map([[6, 3], [12, 9]])
    steps = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in artist(ax, "lanes")]
    assert sum(steps) == pytest.approx(np.pi, rel=0.005)
    thin = road_map([[6, 3], [12, 9]], width=0.2)
    for drawn, label, width in ((ax, "road", 0.5), (ax, "kerb", 0.6), (thin, "road", 0.2), (thin, "kerb", 0.24)):
        for outline in artist(drawn, label):
            points = outline[:-1]
            left, right = points[: len(points) // 2], points[len(points) // 2 :][::-1]
            np.testing.assert_allclose(np.linalg.norm(left - right, axis=1), width, rtol=1e-6)
            for point in (*left, *right):  # a ring road is a circle about the middle
                assert abs(np.linalg.norm(point - 1) - 0.5) == pytest.approx(width / 2, abs=0.002)


@pytest.mark.parametrize("shape", [(2, 6), (6, 2)])
def test_lane_lines_have_their_width_on_wide_and_on_high_maps(shape):
    figure, ax = plt.subplots()
    road_map(repair(np.full(shape, 15)), width=0.5, ax=ax)
    (lines,) = [collection for collection in ax.collections if collection.get_label() == "lanes"]
    figure.canvas.draw()
    (left, _), (right, _) = ax.transData.transform([(0, 0), (1, 0)])
    assert lines.get_linewidth()[0] * figure.dpi / 72 == pytest.approx(0.09 * 0.5 * (right - left), rel=0.01)


def test_a_loop_has_a_ribbon_for_each_of_its_links():
    eight = np.array([[6, 7, 3], [10, 10, 10], [12, 13, 9]])
    loop = gridlock_loop(np.delete(eight, 1, axis=0))
    for tiles in (loop, [[*tile] for tile in loop], np.array(loop)):
        assert len(artist(road_map(eight[[0, 2]], loop=tiles), "loop")) == len(loop) == 4
    assert "loop" not in {collection.get_label() for collection in road_map(eight).collections}
    for wrong, got in (
        (((0, 0), (0, 2)), "(0, 0) before (0, 2)"),
        (((1, 0), (1, 1)), "(1, 0) before (1, 1)"),
        ([(0, 0), (0.5, 1)], "[(0, 0), (0.5, 1)]"),
        ([0, 1], "[0, 1]"),
        (3, "3"),
    ):
        with refused("loop", got):
            road_map(eight, loop=wrong)


def test_thumbnails_have_no_lanes_and_marks_are_the_cells():
    marked = np.zeros((3, 4), bool)
    marked[1, 2] = marked[2, 0] = True
    ax = road_map(np.zeros((3, 4), int), lanes=False, marked=marked)
    assert {collection.get_label() for collection in ax.collections} == {"marked", "kerb", "road", "ends"}
    corners = [tuple(points[:-1].min(axis=0)) for points in artist(ax, "marked")]
    assert corners == [(2, 1), (0, 2)]
    with refused("marked", "(4, 3)"):
        road_map(np.zeros((3, 4), int), marked=marked.T)
    for wrong, got in (
        (marked.astype(str), "array([['False', ..."),
        (np.ma.array(marked, mask=marked), "a masked array"),
    ):
        with refused("marked", got):
            road_map(np.zeros((3, 4), int), marked=wrong)
    with refused("width", "1", expected="at most 0.8"):
        road_map(np.zeros((3, 4), int), width=1)
    with refused("grid", "16 at A1 ([0, 0])"):
        road_map([[16, 0], [0, 0]])


AXES = (Axis("cyclomatic", 3, 2), Axis("components", 2, 1, start=1), Axis("straight_share", 4, 250))


def test_a_heat_map_is_the_archive_reduced_by_the_best():
    rng = np.random.default_rng(0)
    fitness = rng.integers(-50, 50, (2, 24))
    fitness[rng.random((2, 24)) < 0.6] = VACANT
    for across, down in (
        ("cyclomatic", ["straight_share"]),
        ("straight_share", ["components"]),
        ("straight_share", ["components", "cyclomatic"]),
        ("components", ["straight_share", "cyclomatic"]),
    ):
        ax = archive_map(fitness, AXES, across=across, down=down)
        shown = ax.images[0].get_array()
        by_name = {axis.metric: axis for axis in AXES}
        heads = list(product(*(range(by_name[name].bins) for name in down)))
        assert shown.shape == (len(heads), by_name[across].bins)
        for (row, indices), column in product(enumerate(heads), range(by_name[across].bins)):
            wanted = dict(zip(down, indices, strict=True)) | {across: column}
            best = VACANT
            for bins in product(*(range(axis.bins) for axis in AXES)):
                if all(bins[AXES.index(by_name[name])] == index for name, index in wanted.items()):
                    values = np.array([axis.start + index * axis.width for axis, index in zip(AXES, bins, strict=True)])
                    best = min(best, *fitness[:, niche_index(values, AXES)])
            assert np.ma.is_masked(shown[row, column]) == (best == VACANT)
            assert best == VACANT or shown[row, column] == best
    assert ax.patch.get_hatch()
    alone = archive_map(SimpleNamespace(fitness=np.where(fitness == VACANT, np.inf, fitness)[0]), AXES)
    np.testing.assert_array_equal(alone.images[0].get_array().count(), (fitness[0] < VACANT).sum())


def test_a_heat_map_shows_a_fitness_over_the_largest_int32():
    axes = (Axis("crossings", 4, 1),)
    for vacant in (VACANT, np.inf, np.nan):
        cells = archive_map([3e9, vacant, 5e9, 1], axes).images[0].get_array()
        assert cells.tolist() == [[3e9, None, 5e9, 1]]
    as_float32 = archive_map(np.array([2, VACANT, 3, 1], np.float32), axes).images[0].get_array()
    assert as_float32.tolist() == [[2, None, 3, 1]]


def test_a_heat_map_shows_the_papers_space_whole_and_names_its_bins():
    axes = paper_axes((12, 12))
    fitness = np.arange(400)
    ax = archive_map(fitness, axes)
    expected = fitness.reshape(25, 16).T
    np.testing.assert_array_equal(ax.images[0].get_array(), expected)
    assert ax.get_xlabel() == "cyclomatic"
    named = " ".join(ax.get_ylabel().split())
    assert named == "components · dead ends · adjacent crossings · adjacent turns"
    heads = [label.get_text() for label in ax.get_yticklabels()]
    assert heads[:3] == ["1 · 0 · 0 · 0", "1 · 0 · 0 · 1+", "1 · 0 · 1+ · 0"]
    across = dict(zip(ax.get_xticks().tolist(), [label.get_text() for label in ax.get_xticklabels()], strict=True))
    assert across[0] == "0–1" and across[24] == "48+"
    shares = archive_map(np.zeros(24), AXES, across="straight_share", down="cyclomatic")
    assert [label.get_text() for label in shares.get_xticklabels()] == ["0%", "25%", "50%", "75%"]
    fine = (Axis("straight_share", 8, 100), Axis("turn_share", 10, 100), Axis("crossings", 4, 1))
    many = archive_map(np.zeros(320), fine, across="crossings")
    heads = [label.get_text() for label in many.get_yticklabels()]
    assert heads[:3] == ["0% · 0%", "0% · 50%", "10% · 0%"] and heads[-1] == "70%+ · 50%"
    for axis, heads in (
        (Axis("turn_share", 3, 100, start=200), ["<30%", "30%", "40%+"]),
        (Axis("turns", 3, 2, start=4), ["≤5", "6–7", "8+"]),
        (Axis("mean_block", 3, 1500, start=3000), ["<4.5", "4.5", "6+"]),
    ):
        named = archive_map(np.arange(3), [axis]).get_xticklabels()
        assert [label.get_text() for label in named] == heads
    row = archive_map(np.arange(4), (Axis("crossings", 4, 1),))
    assert row.images[0].get_array().tolist() == [[0, 1, 2, 3]] and not row.get_yticks().size


@pytest.mark.parametrize(
    ("fitness", "axes", "names", "subject", "got", "expected"),
    [
        (np.zeros(5), AXES, {}, "fitness", "shape (5,)", "24"),
        (np.zeros((0, 24)), AXES, {}, "fitness", "shape (0, 24)", "24"),
        (np.zeros(24), (), {}, "axes", "none", "at least one axis"),
        (
            np.zeros(4),
            ["crossings:4"],
            {},
            "axes",
            "one without",
            "",
        ),
        (np.zeros(4), AXES[1:2] * 2, {}, "axes", "components 2 times", ""),
        (np.zeros(24), AXES, {"across": "bridges"}, "across", "cyclomatic, components, straight_share, bridges", ""),
        (np.zeros(24), AXES, {"across": "components", "down": "components"}, "across", "components, components", ""),
        (np.zeros(4), AXES[:1], {"down": "cyclomatic"}, "down", "cyclomatic, cyclomatic", ""),
        (np.float64(0), AXES, {}, "fitness", "shape ()", "24"),
        (np.ma.masked_equal(np.arange(24), 0), AXES, {}, "fitness", "a masked array", ""),
        (["a"] * 24, AXES, {}, "fitness", "['a', 'a', 'a', 'a', 'a', 'a', 'a'...", ""),
        ([[1, 2], [3]], AXES, {}, "fitness", "[[1, 2], [3]]", ""),
    ],
)
def test_a_heat_map_of_something_else_is_refused(fitness, axes, names, subject, got, expected):
    with refused(subject, got, expected):
        archive_map(fitness, axes, **names)


def test_a_result_has_its_own_axes():
    elites = SimpleNamespace(fitness=np.zeros(24))
    result = SimpleNamespace(elites=elites, search=SimpleNamespace(axes=AXES))
    table = archive_map(result).images[0].get_array()
    np.testing.assert_array_equal(archive_map(result, AXES).images[0].get_array(), table)
    with refused("axes", "(Axis(metric='turns', ..."):
        archive_map(result, (Axis("turns", 24, 1),))


def test_the_widest_axis_that_is_not_down_is_across():
    bins = {axis.metric: axis.bins for axis in AXES}
    widest = max(bins, key=bins.get)
    shown = archive_map(np.zeros(24), AXES, down=widest)
    second = max(bins.keys() - {widest}, key=bins.get)
    assert shown.images[0].get_array().shape == (bins[widest], bins[second])


def test_a_history_is_the_median_in_a_band():
    rng = np.random.default_rng(1)
    best = np.minimum.accumulate(rng.integers(0, 1000, (9, 30)), axis=1)
    steps, counts = np.arange(1, 31), np.arange(270).reshape(9, 30)
    record = History(steps, 40 * steps, best, counts, np.ones(30), np.zeros((9, 30), np.int32))
    ax = history(record, label="ours", quantiles=(0.125, 0.875))
    (line,) = ax.lines
    np.testing.assert_array_equal(line.get_xdata(), record.evaluations)
    np.testing.assert_array_equal(line.get_ydata(), np.sort(best, axis=0)[4])
    band = ax.collections[0].get_paths()[0].vertices
    for x, low, high in zip(record.evaluations, np.sort(best, axis=0)[1], np.sort(best, axis=0)[7], strict=True):
        heights = band[band[:, 0] == x, 1]
        assert (heights.min(), heights.max()) == (low, high)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("evaluations a seed", "best fitness")
    assert history(record, "elite_count", ax=ax) is ax
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), np.arange(30) + 120)
    single = seed_band(record.evaluations, best[0], linewidth=4)
    np.testing.assert_array_equal(single.lines[0].get_ydata(), best[0])
    with refused("name", "'speed'", expected="best_fitness"):
        history(record, "speed")
    with refused("values", "shape (30, 9)", expected="[S, 30]"):
        seed_band(record.evaluations, best.T)
    for quantiles in ((0.9, 0.1), (0, 0.5, 1), None, ("a", "b"), (0, 2), (float("nan"), 1)):
        with refused("quantiles", repr(quantiles), expected="two"):
            seed_band(record.evaluations, best, quantiles=quantiles)


@pytest.mark.parametrize("vacant", [np.int32(VACANT), np.float32(np.inf)])
def test_a_history_is_drawn_from_the_step_on_at_which_each_seed_has_an_elite(vacant):
    best = np.array([[vacant, vacant, 7, 6], [vacant, 9, 9, 8], [vacant, vacant, 8, 8]], vacant.dtype)
    counts = np.zeros((3, 4), np.int32)
    record = History(np.arange(4), np.arange(4), best, counts, np.ones(4), counts)
    with warnings.catch_warnings(action="error"):
        ax = history(record)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), [np.nan, np.nan, 8, 8])
    assert ax.get_ylim()[1] < 10


def test_without_matplotlib_the_message_says_what_to_install(monkeypatch):
    for name in ("matplotlib", "matplotlib.pyplot"):
        monkeypatch.setitem(sys.modules, name, None)
    with refused("plots need matplotlib", "pip install matplotlib, ... extra plots ..."):
        road_map([[0, 0], [0, 0]])


PAGE = (DOCS / "plots.md").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("number", range(5))
def test_each_program_of_the_page_runs_by_itself(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    programs = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(programs) == 5
    exec(compile(programs[number], "plots.md", "exec"), {})
    written = ["map.svg", "archive.png", "turns.png", "runs.png", "qd-scores.png"]
    assert [file.name for file in tmp_path.iterdir()] == [written[number]]


@pytest.mark.slow
def test_the_score_of_the_page_puts_every_run_of_the_better_preset_above_the_other():
    worst = int(re.search(r"worst=(\d+)\)", PAGE)[1])
    scores = {}
    for preset in ("standard", "tuned"):
        elites = evolve(0, (6, 6), seeds=8, preset=preset, evaluations=20_000).elites
        scores[preset] = qd_score(elites.fitness, elites.valid, worst=worst)
        (row,) = re.findall(rf"\| {worst} \| (\d+) \| (\d+) \|", PAGE)
        assert int(row[preset == "tuned"]) == np.median(scores[preset])
    assert scores["standard"].max() < scores["tuned"].min()
