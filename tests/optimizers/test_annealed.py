"""The presets `tuned`: how far they reach, and what they can be asked for.

Tests share sizes and settings where they can: each further one is a program more to compile.
"""

from functools import cache

import jax
import numpy as np
import pytest
from oracle import fitness as oracle_fitness
from oracle import measure as oracle

from elitelanes_jax import Weights, evolve, fitness, measure
from elitelanes_jax.optimizers import seed_keys
from elitelanes_jax.problem import tuned_axes

METHODS = ("ea", "map-elites", "pso", "gwo")

# The tuned EA and swarms differ in their mates alone: slow proofs.
every_method = pytest.mark.parametrize(
    "method", [pytest.param(method, marks=[] if method == "map-elites" else [pytest.mark.slow]) for method in METHODS]
)


@cache
def optimum(side, fill):
    """The lowest fitness of all networks on a square, found by trying every set of links."""
    links = [((r, c), (r, c + 1), 4, 1) for r in range(side) for c in range(side - 1)]
    links += [((r, c), (r + 1, c), 2, 8) for r in range(side - 1) for c in range(side)]
    made = np.zeros((len(links), side, side), np.int8)
    for number, (one, other, ahead, back) in enumerate(links):
        made[number][one], made[number][other] = ahead, back
    fitness_of = jax.jit(lambda codes: jax.vmap(lambda grid: fitness(measure(grid)))(codes))
    best = 2**31
    numbers = np.arange(2 ** len(links))
    for part in np.array_split(numbers, max(1, len(numbers) >> 16)):
        codes = np.zeros((len(part), side, side), np.int8)
        for number, layer in enumerate(made):
            codes |= np.where((part >> number & 1)[:, None, None] == 1, layer, 0).astype(np.int8)
        if fill:
            codes = codes[(np.vectorize(int.bit_count, otypes=[int])(np.arange(16))[codes] >= 2).all(axis=(1, 2))]
        if len(codes):
            best = min(best, int(fitness_of(codes).min()))
    return best


@pytest.mark.slow
@pytest.mark.parametrize("fill", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_the_optimum_of_small_grids_is_found_by_all(method, fill):
    result = evolve(seed_keys(0, 4), (3, 3), method=method, preset="tuned", evaluations=4000, fill=fill)
    assert result.history.best_fitness[:, -1].tolist() == [optimum(3, fill)] * 4


@pytest.mark.slow
@pytest.mark.parametrize("fill", [True, False])
def test_the_optimum_of_four_by_four_is_found(fill):
    result = evolve(seed_keys(0, 8), (4, 4), method="ea", preset="tuned", evaluations=30_000, fill=fill)
    assert result.history.best_fitness[:, -1].tolist() == [optimum(4, fill)] * 8


def test_the_tuned_ea_reaches_the_proven_optimum_of_six_by_six():
    result = evolve(seed_keys(3, 4), (6, 6), method="ea", preset="tuned", evaluations=30_000, fill=True)
    assert result.history.best_fitness[:, -1].tolist() == [-158] * 4
    best = np.asarray(result.best()[0])
    assert oracle_fitness(oracle(best)) == -158


def test_weights_steer():
    weights = Weights(straight_score=0, crossings=500)
    result = evolve(seed_keys(0, 4), (6, 6), method="ea", evaluations=9600, fill=True, weights=weights)
    for best in np.asarray(result.best()):
        assert oracle(best)["crossings"] <= 2


@pytest.mark.parametrize(
    "method", ["ea", pytest.param("pso", marks=pytest.mark.slow), pytest.param("gwo", marks=pytest.mark.slow)]
)
def test_tuned_is_better_than_paper(method):
    best = {
        preset: evolve(seed_keys(1, 4), (6, 6), method=method, preset=preset, evaluations=8000, fill=True).history
        for preset in ("paper", "tuned")
    }
    assert best["tuned"].best_fitness[:, -1].max() < best["paper"].best_fitness[:, -1].min()


@every_method
def test_what_is_asked_for_is_found_and_other_ranges_need_no_second_compilation(method):
    from conftest import compilations

    setting = {"method": method, "preset": "tuned", "fill": True}
    where = ["crossings=4..6", "cyclomatic=3..5", "straight_share=0.2..0.6"]
    result = evolve(seed_keys(0, 2), (6, 6), evaluations=9600, where=where, **setting)
    good = result.satisfies()
    assert good.any(axis=1).all()
    for seed, place in np.argwhere(good)[:10]:
        found = oracle(result.elites.grids[seed, place])
        assert 4 <= found["crossings"] <= 6
        assert 3 <= found["cyclomatic"] <= 5
        assert 0.2 * found["tiles"] <= found["straights"] <= 0.6 * found["tiles"]
        assert result.elites.fitness[seed, place] == oracle_fitness(found)
    with compilations() as compiled:
        evolve(seed_keys(0, 2), (6, 6), evaluations=320, where=["bridges=0", "turns=4..20"], **setting)
    assert not compiled


@pytest.mark.parametrize(
    ("method", "preset"),
    [
        ("ea", "tuned"),
        pytest.param("pso", "paper", marks=pytest.mark.slow),
        pytest.param("ea", "paper", marks=pytest.mark.slow),
        pytest.param("map-elites", "tuned", marks=pytest.mark.slow),
    ],
)
def test_given_cells_are_in_every_map(method, preset):
    fix = [[None] * 6 for _ in range(6)]
    fix[2][2] = fix[2][3] = fix[3][2] = fix[3][3] = 0
    fix[5][1:4] = [5, 5, 5]
    result = evolve(jax.random.key(1), (6, 6), method=method, preset=preset, evaluations=960, fill=True, fix=fix)
    grids = np.asarray(result.elites.grids)[np.asarray(result.elites.valid)]
    assert (grids[:, 2:4, 2:4] == 0).all()
    assert (grids[:, 5, 1:4] == 5).all()


@pytest.mark.slow
def test_chains_that_pursue_flawless_niches_fill_more_of_them():
    axes = tuned_axes((8, 8))
    shares = []
    for preset in ("standard", "tuned"):
        result = evolve(seed_keys(0, 3), (8, 8), preset=preset, axes=axes, evaluations=64_000, fill=True)
        flawless = np.asarray(result.elites.valid).reshape(3, 25, 16)[..., 0]
        shares.append(flawless.sum(axis=1))
    assert (shares[1] > shares[0]).all()
