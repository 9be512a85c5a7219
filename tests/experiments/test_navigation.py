"""The study of navigation: its statistics against slow ones, its maps, and that it runs."""

import json

import numpy as np
import pytest

navigation = pytest.importorskip("experiments.navigation.study", reason="matplotlib is not here", exc_type=ImportError)
pytest.importorskip("flax", reason="flax and optax are not here")
from elitelanes_jax.formats.duckietown import to_duckietown  # noqa: E402
from elitelanes_jax.network.symmetry import canonical_form  # noqa: E402
from experiments.navigation import maps as navigation_maps  # noqa: E402
from experiments.navigation import report as navigation_results  # noqa: E402
from experiments.navigation import tasks as navigation_tasks  # noqa: E402


def made_up_runs():
    rng = np.random.default_rng(0)
    runs = {}
    for condition, seeds in (("maps-1", range(8)), ("maps-1000", range(2, 12)), ("ea", range(2))):
        for seed in seeds:
            judged = {"success": rng.random(), "by_map": rng.random(20).tolist()}
            runs["map", condition, seed] = {"seen": judged, "held out": judged} if seed != 5 else {"seen": judged}
    return runs


def test_differences_pair_the_seeds_that_both_have():
    runs = made_up_runs()
    found = navigation_results.difference(runs, "map", ("maps-1", "held out"), ("maps-1000", "seen"))
    apart = [
        runs["map", "maps-1", seed]["held out"]["success"] - runs["map", "maps-1000", seed]["seen"]["success"]
        for seed in (2, 3, 4, 6, 7)
    ]
    assert found.seeds == 5 and found.mean == pytest.approx(np.mean(apart))
    every = [np.mean([apart[i] for i in picked]) for picked in np.ndindex(5, 5, 5, 5, 5)]
    low, high = np.percentile(every, [2.5, 97.5])  # of all resamples there are
    spread = max(apart) - min(apart)
    assert found.low == pytest.approx(low, abs=spread / 8) and found.high == pytest.approx(high, abs=spread / 8)
    nobody = navigation_results.difference(runs, "map", ("ea", "seen"), ("maps-1000", "seen"))
    assert nobody.seeds == 0 and np.isnan(nobody.mean)


def test_success_by_niche_is_that_of_a_slow_count(tmp_path):
    rng, runs, expected = np.random.default_rng(3), made_up_runs(), {}
    (tmp_path / "maps").mkdir()
    for _, condition, seed in runs:
        if condition != "maps-1000" or seed == 5:
            continue
        niches = {test: rng.integers(0, 10, (20, 2)).tolist() for test in ("seen", "held out")}
        (tmp_path / "maps" / f"{seed}.json").write_text(json.dumps({"niches": niches}))
        for test, bins in niches.items():
            for place, niche in enumerate(bins):
                expected.setdefault(tuple(niche), []).append(runs["map", condition, seed][test]["by_map"][place])
    del runs["map", "maps-1000", 5]
    means, count = navigation_results.success_by_niche(runs, tmp_path, "map", "maps-1000")
    for niche in np.ndindex(10, 10):
        assert count[niche] == len(expected.get(niche, []))
        assert (
            np.isnan(means[niche]) if niche not in expected else means[niche] == pytest.approx(np.mean(expected[niche]))
        )


def test_maps_made_by_hand_are_cut_to_their_roads(tmp_path):
    ring = np.array([[6, 5, 5, 5, 3], [10, 0, 0, 0, 10], [10, 0, 0, 0, 10], [12, 5, 5, 5, 9]], np.int8)
    for name, grid in {"a": np.pad(ring, [(2, 5), (6, 0)]), "b": ring, "c": ring[[0, 3]], "d": ring[[0, 1, 3]]}.items():
        (tmp_path / f"{name}.yaml").write_text(to_duckietown(grid))
    (tmp_path / "e.yaml").write_text("tiles: [[lava]]")
    (found,) = navigation_maps.human_maps(tmp_path)  # on the smaller rings no place is 12 tiles away
    assert found.shape == (8, 8) and (found[:4, :5] == ring).all()


@pytest.mark.slow
def test_no_test_has_a_map_or_a_niche_to_train_on_and_distances_are_matched():
    made = navigation_maps.make_maps(0, navigation._QUICK_MAPS)
    maps, niches = made["grids"], {name: set(map(tuple, bins)) for name, bins in made["niches"].items()}
    assert not niches["held out"] & (niches["seen"] | niches["map-elites"])
    forms = {name: {canonical_form(np.array(grid, np.int8)) for grid in grids} for name, grids in maps.items()}
    trained = set().union(*(forms[name] for name in ("map-elites", "ea", "wfc", "random")))
    assert not trained & set().union(*(forms[name] for name in ("seen", "held out", "test ea", "test wfc")))
    levels = navigation_maps.draw_levels(0, maps["map-elites"], 2 * 7 * len(maps["map-elites"]))
    wanted = np.arange(levels.shortest.size) // len(maps["map-elites"]) % 7 + 6
    assert (np.asarray(levels.shortest) == wanted).mean() > 0.95


@pytest.mark.slow
def test_a_driver_learns_to_drive_on_maps_that_it_has_not_seen():
    maps = navigation_maps.make_maps(0, navigation_maps.MapBudget())["grids"]
    grids = {part: np.array(maps[part], np.int8) for part in ("map-elites", "seen", "held out")}
    condition = navigation_tasks.CONDITIONS["maps-1000"]
    task, budget = navigation_tasks.TASKS["map"], navigation_tasks.TrainBudget(each=5)
    weights = navigation_tasks.train_driver(task, condition, 0, grids.pop("map-elites"), budget)
    for judged in navigation_tasks.test_driver(task, weights, grids, budget).values():
        assert judged["success"] >= 0.9
