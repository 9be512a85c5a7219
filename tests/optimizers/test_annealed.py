"""The presets `tuned`: how far they reach, and what they can be asked for.

Tests share sizes and settings where they can: each further one is a program more to compile.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import certificates, evolve
from compiled_programs import compilations
from oracle import fitness as oracle_fitness
from oracle import measure as oracle

from elitelanes_jax import Optimizer, annealed_ea, annealed_gwo, annealed_pso, road_problem
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.optimizers import AnnealedGwoConfig, AnnealedPsoConfig, AnnealingConfig, _annealed, seed_keys
from elitelanes_jax.optimizers._annealed import AnnealedState
from elitelanes_jax.optimizers._annealing import Cooling, StepBits
from elitelanes_jax.problem.archive import Population

METHODS = ("ea", "map-elites", "pso", "gwo")

# The tuned EA and swarms differ in their mates alone: slow proofs.
every_method = pytest.mark.parametrize(
    "method", [pytest.param(method, marks=[] if method == "map-elites" else [pytest.mark.slow]) for method in METHODS]
)


def test_chains_copy_from_whom_their_options_say(monkeypatch):
    """Two islands of four chains: their grids are 0 to 7, and their best ones 10 to 17."""
    monkeypatch.setattr(_annealed, "_make_optimizer", lambda problem, config, mates: Optimizer(mates, None, None, 0))
    fitness, none = jnp.array([5, 3, 1, 7, 2, 9, 4, 6], jnp.int32), jnp.zeros((8, 0), jnp.int32)
    own, best = (
        Population(jnp.arange(first, first + 8, dtype=jnp.int8)[:, None, None], fitness, none) for first in (0, 10)
    )

    def shares(method, config):
        mates, bits = method(road_problem((9, 9)), config).init, random_bits(jax.random.key(0), (6000, 8))
        state = AnnealedState(own, best, best, Cooling.first(AnnealingConfig(), (9, 9)))
        drawn = jax.vmap(lambda mate: mates(StepBits(mate, mate, mate, mate[:, None], mate[:, None]), state))(bits)
        return [dict(zip(*np.unique(drawn[:, chain], return_counts=True), strict=True)) for chain in (0, 5)]

    for method, config, expected in (
        (annealed_ea, AnnealingConfig(), [{first + n: 0.25 for n in range(4)} for first in (0, 4)]),
        (
            annealed_pso,
            AnnealedPsoConfig(cognitive=0.3, social=0.5),
            ({10: 0.3, 12: 0.5, 0: 0.2}, {15: 0.3, 14: 0.5, 5: 0.2}),
        ),
        (annealed_gwo, AnnealedGwoConfig(leaders=2), ({12: 0.5, 11: 0.5}, {14: 0.5, 16: 0.5})),
        (annealed_gwo, AnnealedGwoConfig(leaders=9), [{first + n: 0.25 for n in range(4)} for first in (10, 14)]),
    ):
        for found, wanted in zip(shares(method, config), expected, strict=True):
            assert found == pytest.approx({number: 6000 * share for number, share in wanted.items()}, abs=200)


@pytest.mark.slow
@pytest.mark.parametrize("fill", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_the_optimum_of_small_grids_is_found_by_all(method, fill):
    result = evolve(seed_keys(0, 4), (3, 3), method=method, preset="tuned", evaluations=4000, fill=fill)
    assert result.history.best_fitness[:, -1].tolist() == [min(certificates()[3, 3, fill].values())] * 4


@pytest.mark.slow
@pytest.mark.parametrize("fill", [True, False])
def test_the_optimum_of_four_by_four_is_found(fill):
    result = evolve(seed_keys(0, 8), (4, 4), method="ea", preset="tuned", evaluations=10_000, fill=fill)
    assert result.history.best_fitness[:, -1].tolist() == [min(certificates()[4, 4, fill].values())] * 8


@pytest.mark.slow
def test_the_tuned_ea_reaches_the_proven_optimum_of_six_by_six():
    result = evolve(seed_keys(3, 4), (6, 6), method="ea", preset="tuned", evaluations=30_000, fill=True)
    assert result.history.best_fitness[:, -1].tolist() == [-158] * 4
    best = np.asarray(result.best()[0])
    assert oracle_fitness(oracle(best)) == -158


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ea", "pso", "gwo"])
def test_tuned_is_better_than_paper(method):
    best = {
        preset: evolve(seed_keys(1, 4), (6, 6), method=method, preset=preset, evaluations=8000, fill=True).history
        for preset in ("paper", "tuned")
    }
    assert best["tuned"].best_fitness[:, -1].max() < best["paper"].best_fitness[:, -1].min()


@pytest.mark.slow
@every_method
def test_what_is_asked_for_is_found_and_other_ranges_need_no_second_compilation(method):
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
