"""The tuned MAP-Elites: who knows which elites, and how cycles go."""

from functools import cache
from itertools import pairwise

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import evolve

from elitelanes_jax import Axis, Weights, annealed_map_elites, fitness, measure, repair, road_problem
from elitelanes_jax.network import random_grids
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.optimizers import AnnealedMapElitesConfig, AnnealingConfig
from elitelanes_jax.optimizers._cycles import Cycle, CycleBits, Groups
from elitelanes_jax.problem.archive import VACANT
from elitelanes_jax.problem.descriptor import tuned_axes
from elitelanes_jax.problem.rules import RULES

KEY = jax.random.key(0)
SHAPE, CHAINS, CYCLE, STEPS = (5, 5), 16, 4, 250


@cache
def search(axes, restart, **more):
    """The states of a search with short cycles, from the first on."""
    problem = road_problem(SHAPE, axes, fill=True)
    annealing = AnnealingConfig(population=CHAINS, chains=1, cycle=CYCLE)
    config = AnnealedMapElitesConfig(annealing, restart=restart, restart_length=2, **more)
    optimizer = annealed_map_elites(problem, config)
    step, state = jax.jit(optimizer.step), jax.jit(optimizer.init)(jax.random.key(0))
    states = [state]
    for number in range(STEPS):
        state, _ = step(jax.random.fold_in(jax.random.key(0), number), state)
        states.append(state)
    return problem, optimizer, jax.tree.map(np.asarray, states)


def usual():
    return search(tuned_axes(SHAPE), 0.5)


@pytest.mark.slow
def test_the_last_archive_holds_the_best_of_all_and_is_the_result():
    problem, optimizer, states = usual()
    archives = states[-1].archives.fitness.reshape(-1, 400)
    np.testing.assert_array_equal(archives[-1], archives.min(axis=0))
    elites = optimizer.elites(jax.tree.map(jnp.asarray, states[-1]))
    np.testing.assert_array_equal(elites.fitness, archives[-1])
    evaluation = problem.evaluate(elites.grids)
    np.testing.assert_array_equal(evaluation.fitness[elites.valid], elites.fitness[elites.valid])


@pytest.mark.slow
def test_each_group_keeps_what_its_own_chains_found_and_nothing_else():
    problem, _, states = usual()
    groups = len(states[0].archives.fitness) // 400 - 1
    isolated = CHAINS // 2
    expected = np.full((groups, 400), VACANT)
    find_niches = jax.jit(problem.niche)
    for state in states:  # a chain's grid is one of those evaluated; rejected ones may have entered the archive too
        niche = np.asarray(find_niches(state.chains.features))
        for chain in range(isolated):
            group = chain * groups // isolated
            expected[group, niche[chain]] = min(expected[group, niche[chain]], state.chains.fitness[chain])
    found = states[-1].archives.fitness.reshape(-1, 400)[:-1]
    assert (found <= expected).all()
    assert (found != states[-1].archives.fitness.reshape(-1, 400)[-1]).any(axis=1).all()


def test_a_cycle_keeps_its_target_and_only_isolated_chains_restart():
    _, _, states = usual()
    isolated = np.arange(CHAINS) < CHAINS // 2
    lengths = set()
    for before, after in pairwise(states):
        goes_on = before.cooling.step > 0
        np.testing.assert_array_equal(after.cycles.goal[goes_on], before.cycles.goal[goes_on])
        np.testing.assert_array_equal(after.cycles.restarts[goes_on], before.cycles.restarts[goes_on])
        length = after.cooling.length
        assert (length[~isolated] == CYCLE).all()
        assert (length[after.cycles.restarts] == 2 * CYCLE).all()
        assert not (after.cycles.restarts & ~isolated).any()
        assert (after.cycles.goal[:, 1:] == 0).all(), "wanted niches"
        lengths |= set(length[isolated].tolist())
    assert lengths == {CYCLE, 2 * CYCLE}


@pytest.mark.slow
def test_a_cycle_draws_its_penalty_and_starts_from_the_best_elite_by_it():
    _, _, states = search(tuned_axes(SHAPE), 0)
    bins = np.indices([axis.bins for axis in tuned_axes(SHAPE)]).reshape(len(tuned_axes(SHAPE)), -1).T
    group = np.append(np.arange(CHAINS // 2) * 4 // (CHAINS // 2), np.full(CHAINS // 2, 4))
    drawn = []
    for before, after in pairwise(states):
        begins, cycles = before.cooling.step == 0, after.cycles
        np.testing.assert_array_equal(cycles.penalty[~begins], before.cycles.penalty[~begins])
        for chain in np.flatnonzero(begins):
            archive = before.archives.fitness.reshape(-1, 400)[cycles.start[chain] // 400].astype(np.int64)
            penalised = archive + np.abs(bins - cycles.goal[chain]).sum(axis=1) * cycles.penalty[chain]
            assert cycles.start[chain] == 400 * group[chain] + penalised.argmin(), "an elite that it knows"
            np.testing.assert_array_equal(after.chains.grids[chain], before.archives.grids[cycles.start[chain]])
        drawn += cycles.penalty[begins].tolist()
    assert 0 <= min(drawn) < 10 and 390 < max(drawn) < 400
    assert abs(np.mean(drawn) - 199.5) < 15  # standard error 4


@pytest.mark.slow
def test_niches_with_flawed_elites_are_pursued_as_vacant_ones():
    problem, _, states = search(
        (Axis("cyclomatic", 6, 2),), 0, require_feasible=True, accept_equal=True, vacant_probability=1.0
    )
    pursued = set()
    assert (states[-1].cycles.penalty == 400).all()
    for before, after in pairwise(states):
        fitness, features = before.archives.fitness[-6:], before.archives.features[-6:]
        done = (fitness < VACANT) & (np.asarray(problem.penalties(jnp.asarray(features))) == 0)
        beside = np.convolve(done, [1, 1, 1], "same") > 0
        for chain in np.arange(CHAINS // 2, CHAINS)[before.cooling.step[CHAINS // 2 :] == 0]:
            target = int(after.cycles.goal[chain, 0])
            if (beside & ~done).any():
                assert beside[target] and not done[target]
                pursued.add(bool(fitness[target] < VACANT))
    assert True in pursued


def test_a_vacant_niche_gives_no_mate():
    problem, config = road_problem(SHAPE), AnnealedMapElitesConfig(elite_mate=1.0)
    archives, zero = problem.empty_archive(copies=5), jnp.zeros(CHAINS, jnp.int32)
    cycle = Cycle(jnp.zeros((CHAINS, len(problem.axes)), jnp.int32), zero > 0, zero, zero)
    bits = CycleBits.of(random_bits(KEY, (CHAINS, 12)))
    others = random_grids(KEY, CHAINS, SHAPE)
    mates = Groups.of(problem, CHAINS, False).draw_mates(bits, cycle, archives, others, elite_mate=config.elite_mate)
    np.testing.assert_array_equal(mates, others)


@pytest.mark.slow
def test_penalties_are_the_fitness_without_rewards():
    grids = np.random.default_rng(5).integers(0, 16, (40, 5, 6)).astype(np.int8)
    weights = Weights(turns=-7, tiles=3, constant=11)
    problem = road_problem((5, 6), tuned_axes((5, 6)), weights=weights, where="crossings=2..4")
    rewards = Weights(*(0 for _ in Weights._fields))
    rewards = rewards._replace(turns=-7, cyclomatic=-2, straight_score=-2, constant=11)
    evaluation = jax.jit(problem.evaluate)(jnp.asarray(grids))
    expected = evaluation.fitness - fitness(jax.vmap(measure)(jnp.asarray(grids)), rewards)
    np.testing.assert_array_equal(problem.penalties(evaluation.features), expected)
    more = road_problem((5, 6), measured=("signable", "crossings3"), feature_weights=np.array([-5, 3]))
    features = jax.jit(more.evaluate)(jnp.asarray(grids)).features
    added = more.penalties(features) - road_problem((5, 6)).penalties(features[:, :-2])
    np.testing.assert_array_equal(added, 3 * features[:, -1])


@pytest.mark.slow
def test_a_step_from_grids_that_are_not_evaluated_is_generation_0():
    given = np.random.default_rng(3).integers(0, 16, (2, *SHAPE)).astype(np.int8)  # their links do not match
    problem = road_problem(SHAPE, initial=given, fill=True)
    optimizer = annealed_map_elites(problem, AnnealedMapElitesConfig(AnnealingConfig(CHAINS, chains=1)))
    start, step, (key, other) = jax.jit(optimizer.init_unevaluated), jax.jit(optimizer.step), jax.random.split(KEY)
    assert not optimizer.elites(start(key)).valid.any()
    state, _ = step(other, start(key))
    chex.assert_trees_all_equal(state, jax.jit(optimizer.init)(key))
    drawn = random_grids(key, CHAINS, SHAPE)
    grids = [repair(grid, fill=True) for grid in given] + [repair(grid, raster=True, fill=True) for grid in drawn[2:]]
    np.testing.assert_array_equal(state.chains.grids, np.array(grids))
    fitness, features = jax.jit(problem.evaluate)(jnp.array(grids))
    np.testing.assert_array_equal(state.chains.fitness, fitness)
    expected = np.full(problem.niches, VACANT)
    np.minimum.at(expected, np.asarray(problem.niche(features)), fitness)
    np.testing.assert_array_equal(optimizer.elites(state).fitness, expected)
    assert state.cooling.begins.all()


@pytest.mark.slow
def test_it_runs_with_one_chain():
    annealing = AnnealingConfig(population=1, chains=1)
    result = evolve(jax.random.key(0), (3, 3), config=AnnealedMapElitesConfig(annealing), evaluations=300, fill=True)
    assert result.history.best_fitness[-1] == -10, "the optimum"


@pytest.mark.slow
def test_larger_grids_begin_with_grown_towns_and_given_grids():
    ring = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [10, 0, 0, 10], [12, 5, 5, 9]], np.int8)[None]
    problem = road_problem((4, 4), "cyclomatic:4", weights=RULES["duckietown"].weights, initial=ring)

    def flawed(cells):
        optimizer = annealed_map_elites(problem, AnnealedMapElitesConfig(initial_towns_from=cells))
        chains = jax.jit(optimizer.init, compiler_options={"xla_backend_optimization_level": 0})(
            jax.random.key(0)
        ).chains
        np.testing.assert_array_equal(chains.grids[0], ring[0])
        return (np.asarray(problem.penalties(chains.features)) > 0).sum()

    assert flawed(16) == 0 and flawed(17) > 16
