"""The bounds: never above a certificate, and the parts against enumeration."""

import itertools

import bounds
import numpy as np
import pytest

from elitelanes_jax.benchmark.tasks import find_task


@pytest.mark.parametrize("size", ["5x5A", "6x6A", "7x7A", "8x8A", "7x9A"])
def test_no_certificate_is_below_its_bound(size):
    task = find_task(f"{size}-10000")
    proven = bounds.bounds(*task.shape, int(task.cyclomatic.max()))
    for cyclomatic, optimum in zip(task.cyclomatic.tolist(), task.optimum.tolist(), strict=True):
        assert proven[cyclomatic] <= optimum


def enumerate_part(height, width, bins):
    """Goes over all links of a part of a grid that is open at the bottom."""
    scores = np.full(bins, -1)
    across, down = height * (width - 1), height * width
    for bits in itertools.product((0, 1), repeat=across + down):
        east = np.zeros((height, width), int)
        east[:, :-1] = np.reshape(bits[:across], (height, width - 1))
        south = np.reshape(bits[across:], (height, width))
        west, north = np.roll(east, 1, axis=1), np.roll(south, 1, axis=0)
        north[0] = 0
        count = north + east + south + west
        turn, crossing = (count == 2) & (north != south), count > 2
        if count.min() < 2:
            continue
        if (turn[1:] & turn[:-1]).any() or (turn[:, 1:] & turn[:, :-1]).any():
            continue
        if (crossing[:, 1:] & crossing[:, :-1] & (east[:, :-1] > 0)).any():
            continue
        if (crossing[1:] & crossing[:-1] & (south[:-1] > 0)).any():
            continue
        upright, level = (count == 2) & (north == 1) & (south == 1), (count == 2) & (east == 1) & (west == 1)
        score = 0
        for lines, is_upright in ((level, False), (upright.T, True)):
            for line in lines:
                runs = [len(list(run)) if there else 0 for there, run in itertools.groupby(line.tolist())]
                score += sum(run**2 for run in runs)
                score += runs[-1] ** 2 if is_upright else 0
        place = int((count - 2).sum())
        if place < bins:
            scores[place] = max(scores[place], score)
    return scores


@pytest.mark.parametrize("shape", [(1, 4), (2, 3), (2, 4), (3, 3)])
def test_parts_are_those_of_enumeration(shape):
    np.testing.assert_array_equal(bounds.part_scores(*shape, 9), enumerate_part(*shape, 9))


def test_it_names_what_is_wrong(capsys):
    with pytest.raises(SystemExit, match="2"):
        bounds.main(["12x15"])
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected a size such as 12x12, sides of 2 to 14, got '12x15'" in line
