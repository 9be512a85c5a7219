"""The measures of realism against their definitions, and the way from maps to features."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import SearchSpec
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.network import measure_town
from elitelanes_jax.search.resolve import resolve
from experiments.realism.study import (
    FEATURES,
    PEOPLE,
    SIZES,
    TUNED,
    apart,
    coverage_and_co,
    energy_distance,
    features_of,
    pick_maps,
    read_people,
)

RING = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]], np.int8)
EIGHT = np.array([[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]], np.int8)


@pytest.fixture(scope="module")
def sets():
    rng = np.random.default_rng(0)
    return rng.normal(size=(9, 3)), rng.normal(loc=0.7, size=(14, 3))


def test_the_energy_distance_is_its_definition(sets):
    def mean(one, other):
        return sum(np.sqrt(((a - b) ** 2).sum()) for a in one for b in other) / (len(one) * len(other))

    one, other = sets
    assert energy_distance(one, other) == pytest.approx(2 * mean(one, other) - mean(one, one) - mean(other, other))
    assert energy_distance(one, one) == pytest.approx(0)


def test_coverage_and_its_kin_are_their_definitions(sets):
    real, made = sets

    def reach(points):
        return [sorted(np.linalg.norm(points - point, axis=1))[5] for point in points]

    balls, made_balls = reach(real), reach(made)
    gap = [[np.linalg.norm(mine - theirs) for mine in made] for theirs in real]
    inside = [[gap[i][j] <= balls[i] for j in range(len(made))] for i in range(len(real))]
    found = coverage_and_co(real, made)
    assert found["precision"] == pytest.approx(np.mean([any(row[j] for row in inside) for j in range(len(made))]))
    assert found["coverage"] == pytest.approx(np.mean([any(row) for row in inside]))
    assert found["density"] == pytest.approx(sum(map(sum, inside)) / 5 / len(made))
    assert found["recall"] == pytest.approx(
        np.mean([any(row[j] <= made_balls[j] for j in range(len(made))) for row in gap])
    )
    same = coverage_and_co(real, real)
    assert same["precision"] == same["recall"] == same["coverage"] == 1


def test_classifiers_tell_what_differs_and_no_more():
    pytest.importorskip("sklearn")
    rng = np.random.default_rng(1)
    real, alike, other = rng.normal(size=(18, 2)), rng.normal(size=(40, 2)), rng.normal(loc=6, size=(40, 2))
    far, near = apart(real, other), apart(real, alike)
    assert all(far[name][0] > 0.98 for name in far)
    assert all(near[name][1] < 0.6 for name in near)


def test_features_are_those_of_the_town_wherever_it_lies():
    rows = features_of([RING, np.pad(RING, [(2, 1), (0, 3)]), EIGHT])
    np.testing.assert_array_equal(rows[0], rows[1])
    town = measure_town(EIGHT)
    found = dict(zip(FEATURES, rows[2], strict=True))
    assert found["mean_detour"] == int(town.mean_detour) / 1000 and found["longest_street"] == int(town.longest_street)
    assert found["turn_share"] == pytest.approx(4 / 13) and found["crowded_per_tile"] == 0


def test_peoples_maps_are_read_and_cut_and_each_comes_once(tmp_path):
    with refused("people", "none"):
        read_people(tmp_path)
    (tmp_path / "maps").mkdir()
    for name, grid in {"a": RING, "b": np.pad(RING, 1), "d": EIGHT}.items():
        (tmp_path / "maps" / f"{name}.yaml").write_text(to_duckietown(grid))
    found = read_people(tmp_path)
    assert list(found) == ["a", "d"]
    np.testing.assert_array_equal(found["d"], EIGHT)


def test_the_kept_features_are_peoples():
    kept = json.loads(PEOPLE.read_text())
    assert len(kept) == 18 and all(tuple(row) == FEATURES for row in kept.values())
    assert np.median([row["turn_share"] for row in kept.values()]) == pytest.approx(0.33, abs=0.01)
    assert set(TUNED) < set(FEATURES) and len(SIZES) == 18


def test_maps_of_a_size_with_fewer_come_more_than_once():
    class Pool:
        def __init__(self, size):
            self.found = [np.full(size, code, np.int8) for code in range(1, 4)]

        def maps(self, count):
            return [SimpleNamespace(codes=grid) for grid in self.found[:count]]

    picked = pick_maps({size: Pool(size) for size in SIZES}, 90)
    assert [sum(grid.shape == size for grid in picked) for size in ((3, 3), (5, 6), (10, 19))] == [5, 15, 10]
    assert [int(grid[0, 0]) for grid in picked[:5]] == [1, 2, 3, 1, 2] and len(picked) == 90


def test_the_styles_targets_are_peoples_features():
    people = json.loads(PEOPLE.read_text()).values()
    targets = {target.name: target.values for target in resolve(SearchSpec(style="town"), (6, 6)).settings.targets}
    assert set(targets) == set(TUNED) - {"unlinked_per_tile", "crowded_per_tile"}
    for name, values in targets.items():
        assert sorted(values) == pytest.approx(sorted(row[name] for row in people), abs=6e-4)
