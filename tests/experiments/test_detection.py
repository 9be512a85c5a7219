"""The experiment on detection: what its network learns from, its judge, and that it runs."""

from functools import partial

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.perception import detection
from experiments.perception.detection import KINDS, SIZES, Pictures

centernet = pytest.importorskip(
    "experiments.perception.centernet", reason="flax and optax are not here", exc_type=ImportError
)

SIDE = 32

targets = jax.jit(partial(centernet.targets, size=(SIDE // 2, SIDE // 2), count=3))
sides = st.integers(0, SIDE - 2).flatmap(lambda low: st.tuples(st.just(low), st.integers(1, SIDE - low)))


@given(st.lists(st.tuples(sides, sides, st.integers(-1, 2)), min_size=1, max_size=4))
def test_each_box_is_learned_at_its_middle(drawn):
    padding = 5 - len(drawn)
    boxes = np.array([(x, y, wide, high) for (x, wide), (y, high), _ in drawn] + [(0, 0, 0, 0)] * padding, np.float32)
    kinds = np.array([kind for *_, kind in drawn] + [-1] * padding)
    heat, true, share = map(np.asarray, targets(boxes, kinds))
    peaks, owned = set(), set()
    for (x, y, wide, high), kind in zip(boxes.tolist(), kinds.tolist(), strict=True):
        row, column = int(y + high / 2) // 2, int(x + wide / 2) // 2
        if kind >= 0:
            peaks.add((row, column, kind))
    assert peaks == set(map(tuple, np.argwhere(heat == 1).tolist()))
    for row, column in np.ndindex(SIDE // 2, SIDE // 2):
        at = 2 * column + 1, 2 * row + 1
        to_sides = [(at[0] - x, at[1] - y, x + wide - at[0], y + high - at[1]) for x, y, wide, high in boxes.tolist()]
        if share[row, column] > 0:
            assert tuple(true[row, column].tolist()) in to_sides
            owned.add(to_sides.index(tuple(true[row, column].tolist())))
    assert share.sum() == pytest.approx(len(owned), abs=1e-4)


def pictures_of(boxes, kinds):
    kinds = np.array(kinds)
    image = np.zeros((len(boxes), 64, 64, 3), np.uint8)
    return Pictures(image, np.array(boxes, np.float32), kinds, np.ones(kinds.shape, np.float32))


def test_precisions_are_those_of_a_calculation_by_hand():
    there = pictures_of([[[4, 4, 10, 10], [30, 30, 20, 20]], [[4, 4, 6, 6], [0, 0, 0, 0]]], [[0, 0], [1, -1]])
    right, twice, beside = [4, 5, 10, 10, 0.9, 0], [4, 4, 10, 10, 0.8, 0], [30, 42, 20, 20, 0.7, 0]
    found = np.array([[right, twice, beside], [[4, 4, 6, 6, 0.5, 1], [0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]]])
    by_size = dict(zip(SIZES, detection.average_precisions(there, found).tolist(), strict=True))
    assert by_size["all"][0] == pytest.approx(51 / 101)  # precision 1 at recalls 0, 0.01, ..., 0.5, then 0
    assert by_size["all"][1] == pytest.approx(1) == by_size["4 to 8"][1]
    assert by_size["16 to 32"][0] == 0
    assert np.isnan(by_size["8 or more"][1:]).all() and np.isnan(by_size["4 to 8"][0])
    hidden = there._replace(visible=np.array([[1, 0.2], [1, 0]], np.float32))
    assert detection.average_precisions(hidden, found, 0.25)[0, 0] == pytest.approx(1)
    assert detection.average_precisions(hidden, found)[0, 0] == pytest.approx(51 / 101)


def test_of_two_boxes_around_one_object_the_better_one_is_kept(monkeypatch):
    near, better, other = [10, 10, 20, 10, 0.5, 0], [11, 10, 20, 10, 0.9, 0], [11, 10, 20, 10, 0.4, 1]
    peaks = np.array([[better, near, other] + [[0] * 6] * 77], np.float32)
    monkeypatch.setattr(centernet, "_peaks", lambda *_: peaks.copy())
    found = centernet.detect(None, np.zeros((1, 64, 64, 3), np.uint8), 2)
    assert found[0, :3].tolist() == [*peaks[0, :1].tolist(), [0] * 6, peaks[0, 2].tolist()]


def rectangles(count, seed):
    """Pictures with two rectangles, bright for kind 0, dark for kind 1."""
    rng = np.random.default_rng(seed)
    corners = rng.integers([[2, 2], [34, 2]], [[12, 40], [44, 40]], (count, 2, 2))
    boxes = np.concatenate([corners, rng.integers(10, 20, (count, 2, 2))], axis=-1).astype(np.float32)
    images = rng.integers(90, 150, (count, 64, 64, 3)).astype(np.uint8)
    kinds = rng.integers(0, 2, (count, 2))
    for image, own, shades in zip(images, boxes.astype(int), kinds, strict=True):
        for (x, y, wide, high), kind in zip(own, shades, strict=True):
            image[y : y + high, x : x + wide] = (230, 20)[kind]
    return Pictures(images, boxes, kinds, np.ones(kinds.shape, np.float32))


@pytest.mark.slow
def test_it_learns_and_a_resumed_training_gives_the_same_weights(tmp_path):
    def stop(step, loss):
        if step > 50:
            raise KeyboardInterrupt

    def weights_of(file, report):
        return centernet.train(*rectangles(64, 0)[:3], len(KINDS), 3, steps=200, batch=8, file=file, report=report)

    weights = weights_of(tmp_path / "whole", lambda step, loss: None)
    with pytest.raises(KeyboardInterrupt):
        weights_of(tmp_path / "cut", stop)
    resumed = weights_of(tmp_path / "cut", lambda step, loss: None)
    assert all((one == other).all() for one, other in zip(*map(jax.tree.leaves, (weights, resumed)), strict=True))
    test = rectangles(32, 1)
    found = centernet.detect(weights, test.image, len(KINDS))
    assert np.nanmean(detection.average_precisions(test, found)[0]) > 0.9
