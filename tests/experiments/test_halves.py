"""Optima by halves: against the certificates of the sweep, and the sweep over a half against enumeration."""

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from elitelanes_jax.benchmark.tasks import find_task
from experiments.search.exact.duals import UNIT, choose_duals, edge_gains, first_duals
from experiments.search.exact.graph import NEVER, carry_best, carry_counts, merge
from experiments.search.exact.halves import cost_to_go, find_highest, make_half
from experiments.search.exact.patterns import find_patterns
from experiments.search.exact.proof import find_optimum
from experiments.search.exact.sweep import sweep
from experiments.search.exact.tiles import BESIDE_TURN, CROSSING, STRAIGHT, TURN, score_across

certify = pytest.importorskip("experiments.search.certify", reason="no such system calls", exc_type=ImportError)


def test_equal_states_are_one_node_and_values_are_carried_along_edges():
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 3, (900, 2)).astype(np.uint64)
    target, states = merge(rows)
    np.testing.assert_array_equal(states[target], rows)
    assert [tuple(state) for state in states] == list(dict.fromkeys(map(tuple, rows)))
    source, gain = rng.integers(0, 40, 900).astype(np.int32), rng.integers(-9, 9, 900)
    shift, values = rng.integers(0, 2, 900).astype(np.int8), rng.integers(0, 50, (40, 3))
    values[rng.random(values.shape) < 0.9] = NEVER
    best, way = carry_best(len(states), source, target, gain, shift, values)
    counts = carry_counts(len(states), source, target, shift, np.maximum(values, 0))
    for node, number in np.ndindex(best.shape):
        edges = [edge for edge in np.flatnonzero(target == node) if number >= shift[edge]]
        came = {edge: values[source[edge], number - shift[edge]] for edge in edges}
        assert counts[node, number] == sum(max(value, 0) for value in came.values())
        reached = {edge: value + gain[edge] for edge, value in came.items() if value != NEVER}
        assert best[node, number] == max(reached.values(), default=NEVER)
        assert not reached or way[node, number] == max(reached, key=reached.get)


def two_halves(height, width, fill=True):
    upper = make_half(height // 2, width, fill=fill)
    return upper, upper if height % 2 == 0 else make_half(height - height // 2, width, fill=fill)


def certified(name):
    task = find_task(f"{name}-10000")
    return dict(zip(task.cyclomatic.tolist(), task.optimum.tolist(), strict=True))


@pytest.mark.parametrize(
    ("shape", "most"),
    [((3, 4), 3), *(pytest.param(shape, 6, marks=pytest.mark.slow) for shape in ((4, 4), (4, 5), (5, 6)))],
)
def test_bridges_are_allowed_if_asked_for(shape, most):
    upper, lower = two_halves(*shape)
    swept = sweep(shape, most + 1, fill=True).values
    found = [find_optimum(upper, lower, cyclomatic, bridgeless=False).score for cyclomatic in range(1, most + 1)]
    np.testing.assert_array_equal(found, np.nan_to_num(swept[1:], nan=-1))


def enumerate_half(height, width, fill, worth, price):
    """Returns the highest value over all links of a half, each measured anew."""
    best = -np.inf
    across_count, down_count = height * (width - 1), height * width
    for bits in itertools.product((0, 1), repeat=across_count + down_count):
        east = np.zeros((height, width), int)
        east[:, :-1] = np.reshape(bits[:across_count], (height, width - 1))
        south = np.reshape(bits[across_count:], (height, width))
        west, north = np.roll(east, 1, axis=1), np.roll(south, 1, axis=0)
        north[0] = 0
        count = north + east + south + west
        turn, crossing = (count == 2) & (north != south), count > 2
        if (
            (count == 1).any()
            or (fill and not count.all())
            or (turn[1:] & turn[:-1]).any()
            or (turn[:, 1:] & turn[:, :-1]).any()
        ):
            continue
        if (crossing[:, 1:] & crossing[:, :-1] & (east[:, :-1] > 0)).any():
            continue
        if (crossing[1:] & crossing[:-1] & (south[:-1] > 0)).any():
            continue
        upright, level = (count == 2) & (north == 1) & (south == 1), (count == 2) & (east == 1) & (west == 1)
        runs = [len(list(run)) for line in (*level, *upright.T) for there, run in itertools.groupby(line) if there]
        value = UNIT * sum(run**2 for run in runs) + price * np.maximum(count - 2, 0).sum()
        for column in range(width):
            run = next((row for row in range(height) if not upright[::-1][row, column]), height)
            if south[-1, column]:
                label = TURN if turn[-1, column] else CROSSING if crossing[-1, column] else STRAIGHT + run
            else:
                label = BESIDE_TURN if turn[-1, column] else 0
            value += worth[column, label]
        best = max(best, value)
    return best


@pytest.mark.parametrize("shape", [(1, 4), (2, 3), (2, 4), (3, 3)])
@pytest.mark.parametrize("fill", [True, False])
def test_the_highest_half_is_that_of_enumeration(shape, fill):
    draws = np.random.default_rng(0)
    worth, price = draws.integers(-9 * UNIT, 9 * UNIT, (shape[1], 16)), int(draws.integers(-5 * UNIT, 5 * UNIT))
    half = make_half(*shape, fill=fill)
    gains = edge_gains(half, worth, price)
    edges = find_highest(half, gains)
    value = sum(int(gain[edge]) for gain, edge in zip(gains, edges, strict=True))
    assert value == enumerate_half(*shape, fill, worth, price) == cost_to_go(half, gains)[0][0]
    assert [layer.label[edge] >= 0 for layer, edge in zip(half.layers, edges, strict=True)] == (
        ([False] * (shape[0] - 1) + [True]) * shape[1]
    )


@pytest.mark.parametrize(("height", "pattern"), [(6, None), (7, None), (6, 0b1000001), (7, 0b1001101)])
def test_labels_that_fit_are_worth_enough(height, pattern):
    upper, lower = two_halves(height, 7)
    halves = (upper,) if upper is lower else (upper, lower)
    duals = choose_duals(halves, 6, first_duals(halves), pattern, 0)
    first, second = duals.labels[0], duals.labels[-1]
    for one, other in np.ndindex(first.shape[1], first.shape[1]):
        if score_across(one, other) >= 0:
            linked = np.array([pattern is None or (pattern >> column & 1) == (one >= TURN) for column in range(7)])
            assert (first[:, one] + second[:, other] >= UNIT * score_across(one, other))[linked].all()


@pytest.mark.parametrize(
    "size",
    [(5, 5, True), (5, 5, False)]
    + [
        pytest.param((*sides, fill), marks=pytest.mark.slow)
        for fill, shapes in {True: ((6, 6), (7, 7), (8, 8), (7, 9), (9, 7), (9, 9)), False: ((6, 6), (8, 8))}.items()
        for sides in shapes
    ],
)
def test_certificates_by_halves_are_those_of_the_sweep(size):
    height, width, fill = size
    with ThreadPoolExecutor(1) as workers:
        niches = certify.certify_by_halves(size, workers)["niches"]  # measures each network that it finds
    expected = certified(f"{min(height, width)}x{max(height, width)}{'A' if fill else 'B'}")
    assert {niche["cyclomatic"]: niche["optimum"] for niche in niches} == expected


@pytest.mark.parametrize("size", ["6x6A", "6x6B", pytest.param("9x9A", marks=pytest.mark.slow)])
def test_no_pattern_of_a_network_is_left_out(size):
    task = find_task(f"{size}-10000")
    upper, lower = two_halves(*task.shape, task.fill)
    halves = (upper,) if upper is lower else (upper, lower)
    for cyclomatic, optimum, grid in zip(task.cyclomatic.tolist(), task.optimum.tolist(), task.witnesses, strict=True):
        score, crossings = -optimum // 2 - cyclomatic, 2 * (cyclomatic - 1)
        duals = choose_duals(halves, crossings, first_duals(halves), None, 0)
        linked = grid[task.shape[0] // 2 - 1] & 2 > 0
        pattern = min(sum(1 << place for place in np.flatnonzero(side).tolist()) for side in (linked, linked[::-1]))
        for target in (score, score - 1, score - 5, score - 20):
            assert pattern in find_patterns(halves, duals, crossings, target)
