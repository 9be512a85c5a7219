"""Targets: how they are read, and that maps are chosen nearest to them."""

import json

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import SearchSpec
from elitelanes_jax.problem.targets import ExampleValues, SupportPoints, parse_targets
from elitelanes_jax.search.resolve import resolve, search_from_plain

TWO = (ExampleValues("turn_share", (0.25, 0.5)), ExampleValues("crossings", (0.0, 3.0)))


def test_targets_are_read_from_mappings_and_pairs_alike():
    assert parse_targets({"turn_share": [0.25, 0.5], "crossings": (0, 3)}) == parse_targets(TWO) == TWO
    assert parse_targets({"mine": [4]}, ["mine"]) == (ExampleValues("mine", (4.0,)),)
    spec = SearchSpec(targets=TWO)
    search = resolve(spec, (6, 6))
    read = search_from_plain(json.loads(json.dumps(search.to_plain())), (6, 6))
    assert read == search and "symmetry" not in search.measured
    assert resolve(SearchSpec(targets={"symmetry": [1]}), (6, 6)).measured == ("symmetry",)


@pytest.mark.parametrize(
    ("targets", "subject", "got", "expected"),
    [
        (3, "targets", "3", "features"),
        ("turns", "targets", "'turns'", "features"),
        ([3], "targets", "3", "a feature"),
        ({"turns": 3}, "targets", "('turns', 3)", "a feature"),
        ({"turns": []}, "targets: turns", "none", "one value"),
        ({"turns": ["x"]}, "targets: turns", "'x'", "number"),
        ({"turns": [float("nan")]}, "targets: turns", "nan", "number"),
        ({"turn_share": [1.5]}, "targets: turn_share", "1.5", "0 to 1"),
        (
            {"turns": [1, 2], "tiles": [3]},
            "targets",
            "turns 2, tiles 1",
            "the same number",
        ),
        ([("turns", [1]), ("turns", [2])], "targets", "turns 2 times", "once"),
    ],
)
def test_wrong_targets_are_named(targets, subject, got, expected):
    with refused(subject, got, expected):
        SearchSpec(targets=targets)


def test_the_name_of_a_target_is_suggested():
    with refused("targets", "'turn'", hint="is it turns?"):
        SearchSpec(targets={"turn": [3]})


def test_targets_give_way_to_axes():
    def targets_of(spec):
        return resolve(spec, (6, 6)).settings.targets

    assert targets_of(SearchSpec(style="town")) and not targets_of(SearchSpec(style="town", axes="turns:5"))
    assert not targets_of(SearchSpec(style="town").replace(axes="turns:5"))
    both = SearchSpec(style="town", axes="turns:5", targets=TWO)
    assert targets_of(both) == TWO and both.replace() == both


def energy(chosen, wanted):
    """By the definition, without terms of the targets alone."""

    def mean(one, other):
        return np.mean([np.sqrt(((a - b) ** 2).sum()) for a in one for b in other])

    return 2 * mean(chosen, wanted) - mean(chosen, chosen)


@pytest.mark.parametrize("seed", range(4))
def test_every_choice_leaves_the_least_energy_distance(seed):
    rng = np.random.default_rng(seed)
    wanted, points = rng.normal(size=(4, 3)) + 5, rng.normal(size=(12, 3)) + 5
    targets = [ExampleValues(name, tuple(column)) for name, column in zip("abc", wanted.T, strict=True)]
    pursuit, taken = SupportPoints(points, targets), []
    points, wanted = points / wanted.std(axis=0), wanted / wanted.std(axis=0)
    for _ in range(8):
        number = int(np.argmin(pursuit.losses()))
        tried = [energy(points[[*taken, other]], wanted) for other in range(len(points))]
        assert tried[number] == pytest.approx(min(tried))
        pursuit.choose(number)
        taken.append(number)


def test_features_with_equal_targets_are_measured_by_the_candidates():
    targets = [ExampleValues("a", (2.0,)), ExampleValues("b", (7.0,))]
    features = np.array([[2.0, 9.0], [2.5, 7.0], [2.0, 7.0], [4.0, 7.0]])
    assert int(np.argmin(SupportPoints(features, targets).losses())) == 2
    unlike = np.array([[3.0, 7.0], [2.0, 9.0], [2.2, 40.0], [2.0, -20.0]])  # in b two hardly count, in a one does
    assert int(np.argmin(SupportPoints(unlike, targets).losses())) == 1
    assert SupportPoints(np.full((3, 2), 5.0), targets).losses().tolist() == pytest.approx([np.hypot(3, 2)] * 3)
    assert SupportPoints(np.empty((0, 2)), targets).losses().size == 0


def test_equal_examples_are_measured_in_deviations_of_the_candidates():
    """The standard deviation of three times 0.1 is 1e-17 in floats. In such units no other feature would count."""
    features = np.array([[0.1001, 5.0], [0.11, 1.0], [0.9, 1.0]])
    equal = (0.1, 0.1, 0.1)
    points = SupportPoints(features, [ExampleValues("box_fill", equal), ExampleValues("loops_per_tile", (1.0,) * 3)])
    assert np.argmin(points.losses()) == 1
    # Candidates may be equal too.
    points = SupportPoints(
        np.array([[0.1, 5.0], [0.1, 1.0], [0.1, 3.0]]),
        [ExampleValues("box_fill", (0.3, 0.3, 0.3)), ExampleValues("loops_per_tile", (1.0,) * 3)],
    )
    assert np.argmin(points.losses()) == 1 and points.losses().max() < 10
