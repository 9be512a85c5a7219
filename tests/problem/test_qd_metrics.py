"""Measures of a whole archive, on numbers that can be checked by hand."""

import numpy as np

from elitelanes_jax.problem.qd_metrics import coverage, gaps, qd_score

FITNESS = np.array([[5, -3, 2**31 - 1, 20], [2**31 - 1, 1, 2, 3]])
FILLED = np.array([[True, True, False, True], [False, True, True, True]])


def test_qd_score():
    assert qd_score(FITNESS, FILLED, 10).tolist() == [5 + 13 + 0, 9 + 8 + 7]


def test_coverage():
    assert coverage(FILLED).tolist() == [0.75, 0.75]
    assert coverage(FILLED, [True, True, False, False]).tolist() == [1, 0.5]


def test_gaps():
    np.testing.assert_array_equal(gaps(FITNESS, FILLED, [5, -5, 0, 0]), [[0, 2, np.nan, 20], [np.nan, 6, 2, 3]])
