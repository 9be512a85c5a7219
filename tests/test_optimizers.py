"""The contract of all optimisers: what the convention promises, tested on each alike."""

from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import compilations
from oracle import fitness as oracle_fitness
from oracle import measure as oracle

from elitelanes_jax import InputError, measure
from elitelanes_jax.archive import describe, niche_of, paper_axes
from elitelanes_jax.metrics import COUNTED
from elitelanes_jax.optimizers import (
    AimedMapElitesConfig,
    AnnealingConfig,
    DiscreteGwoConfig,
    DiscretePsoConfig,
    EvolutionConfig,
    GwoConfig,
    MapElitesConfig,
    aimed_map_elites,
    annealed_ea,
    discrete_gwo,
    discrete_pso,
    ea,
    gwo,
    map_elites,
    pso,
)
from elitelanes_jax.problem import road_problem
from elitelanes_jax.run import advance, start

SHAPE = (5, 6)
AXES = paper_axes(SHAPE)
PROBLEMS = {fill: road_problem(SHAPE, AXES, fill=fill) for fill in (False, True)}
# Cycles so short that several begin anew within the tests.
TUNED = AnnealingConfig(population=12, chains=4, cycle=7)
MAKERS = {
    "ea": ea,
    "map-elites": map_elites,
    "map-elites, parents from the archive": partial(map_elites, config=MapElitesConfig(parents="archive")),
    "pso": pso,
    "gwo": partial(gwo, config=GwoConfig(horizon=100)),
    "ea, tuned": partial(annealed_ea, config=TUNED),
    "map-elites, tuned": partial(aimed_map_elites, config=AimedMapElitesConfig(TUNED)),
    "pso, tuned": partial(discrete_pso, config=DiscretePsoConfig(TUNED)),
    "gwo, tuned": partial(discrete_gwo, config=DiscreteGwoConfig(TUNED)),
    "gwo, the worst as omega": partial(gwo, config=GwoConfig(horizon=100, omega="worst")),
}
KEYS = jax.random.split(jax.random.key(11), 3)
GENERATIONS = 30

# The tuned swarms are the tuned EA with other mates, and two others differ from theirs in a choice; whether they keep
# the contract too is a slow proof.
SLOW = {"pso, tuned", "gwo, tuned", "map-elites, parents from the archive", "gwo, the worst as omega"}
every_optimizer = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in MAKERS]
)


def runner(optimizer):
    return jax.jit(partial(advance, optimizer), static_argnames="most")


@every_optimizer
@pytest.mark.parametrize("fill", [False, True])
def test_each_step_leaves_valid_grids_and_a_best_that_never_gets_worse(name, fill):
    optimizer = MAKERS[name](PROBLEMS[fill])
    step = jax.jit(optimizer.step)
    state = optimizer.init(jax.random.key(4))
    best = optimizer.elites(state).fitness.min()
    for generation in range(15):
        before = jax.tree.map(lambda array: (array.shape, array.dtype), state)
        state, info = step(jax.random.fold_in(jax.random.key(9), generation), state)
        assert jax.tree.map(lambda array: (array.shape, array.dtype), state) == before
        elites = optimizer.elites(state)
        grids = elites.grids[elites.valid]
        metrics = jax.vmap(measure)(grids)
        assert not metrics.mismatches.any()
        assert not metrics.boundary_violations.any()
        assert not (fill and metrics.dead_ends.any())
        assert info.best_fitness == elites.fitness[elites.valid].min() <= best
        assert info.elite_count == elites.valid.sum()
        best = info.best_fitness


@every_optimizer
def test_elites_are_worth_what_they_are_said_to_be(name):
    optimizer = MAKERS[name](PROBLEMS[False])
    states, _ = runner(optimizer)(KEYS, start(optimizer, KEYS), 1, 10, most=10)
    elites = jax.vmap(optimizer.elites)(states)
    chex.assert_type([elites.grids, elites.fitness, elites.counts, elites.valid], [jnp.int8, int, int, bool])
    for seed, place in np.argwhere(elites.valid):
        found = oracle(elites.grids[seed, place])
        assert elites.fitness[seed, place] == oracle_fitness(found)
        assert elites.counts[seed, place].tolist() == [found[name] for name in COUNTED]


@every_optimizer
def test_a_run_in_parts_is_the_whole_run(name):
    optimizer = MAKERS[name](PROBLEMS[False])
    run, first = runner(optimizer), start(optimizer, KEYS)
    whole, infos = run(KEYS, first, 1, GENERATIONS, most=GENERATIONS)
    states, rows = first, []
    for begin, end in ((1, 1), (2, 13), (14, 13), (14, GENERATIONS)):
        states, info = run(KEYS, states, begin, end, most=GENERATIONS)
        rows.append(jax.tree.map(lambda row, count=end - begin + 1: row[:count], info))
    chex.assert_trees_all_equal(states, whole)
    chex.assert_trees_all_equal(jax.tree.map(lambda *parts: jnp.concatenate(parts), *rows), infos)


@every_optimizer
def test_many_seeds_are_each_seed_alone(name):
    optimizer = MAKERS[name](PROBLEMS[False])
    run = runner(optimizer)
    together, infos = run(KEYS, start(optimizer, KEYS), 1, GENERATIONS, most=GENERATIONS)
    for number in range(len(KEYS)):
        key = KEYS[number : number + 1]
        alone, info = run(key, start(optimizer, key), 1, GENERATIONS, most=GENERATIONS)
        mine = jax.tree.map(lambda array, number=number: array[number], together)
        chex.assert_trees_all_equal(jax.tree.map(lambda array: array[0], alone), mine)
        chex.assert_trees_all_equal(info.best_fitness[:, 0], infos.best_fitness[:, number])


@every_optimizer
def test_compiled_or_not_it_is_the_same(name):
    optimizer = MAKERS[name](PROBLEMS[False])
    key, state = jax.random.key(6), optimizer.init(jax.random.key(5))
    chex.assert_trees_all_equal(optimizer.step(key, state), jax.jit(optimizer.step)(key, state))


@every_optimizer
def test_one_compilation_serves_every_call(name):
    optimizer = MAKERS[name](PROBLEMS[False])
    run, states = runner(optimizer), start(optimizer, KEYS)
    others = jax.random.split(jax.random.key(1), 3)
    with compilations() as compiled:
        run(KEYS, states, 1, 5, most=5)
        assert compiled
    with compilations() as compiled:
        states, _ = run(KEYS, states, 6, 7, most=5)
        run(others, states, 8, 8, most=5)
        assert not compiled


@pytest.mark.parametrize("name", sorted(set(MAKERS) - {"pso"}))
def test_searching_finds_better_than_chance(name):
    """The paper's PSO does not: what it draws from its velocities is nearly random (see the experiments)."""
    problem = road_problem((8, 8), paper_axes((8, 8)))
    optimizer = MAKERS[name](problem)
    _, infos = runner(optimizer)(KEYS, start(optimizer, KEYS), 1, 100, most=100)
    chance = problem.evaluate(problem.random(jax.random.key(0), 100 * optimizer.evaluations_per_step))
    assert infos.best_fitness[-1].mean() < chance.fitness.min()


def test_an_archive_holds_each_elite_in_its_niche():
    optimizer = map_elites(PROBLEMS[False])
    states, infos = runner(optimizer)(KEYS, start(optimizer, KEYS), 1, GENERATIONS, most=GENERATIONS)
    elites = jax.vmap(optimizer.elites)(states)
    niches = jnp.broadcast_to(jnp.arange(elites.valid.shape[1]), elites.valid.shape)
    found = niche_of(describe(elites.counts, AXES), AXES)
    np.testing.assert_array_equal(found[elites.valid], niches[elites.valid])
    assert (jnp.diff(infos.elite_count, axis=0) >= 0).all()


def test_an_archive_changes_nothing_about_the_population():
    """The paper's MAP-Elites is its evolutionary algorithm with an archive beside it."""
    states = []
    for maker in (ea, map_elites):
        optimizer = maker(PROBLEMS[False])
        states.append(runner(optimizer)(KEYS, start(optimizer, KEYS), 1, GENERATIONS, most=GENERATIONS)[0])
    chex.assert_trees_all_equal(states[0], states[1].population)


def test_comma_selection_may_lose_the_best_and_goes_on():
    optimizer = ea(PROBLEMS[False], EvolutionConfig(survivors="comma"))
    _, infos = runner(optimizer)(KEYS, start(optimizer, KEYS), 1, 100, most=100)
    assert (jnp.diff(infos.best_fitness, axis=0) > 0).any()


def test_settings_can_be_swept():
    """Rates and weights are numbers like any other: vmap runs over them, in one compiled call."""

    @jax.jit
    @jax.vmap
    def best(rate):
        optimizer = ea(PROBLEMS[False], EvolutionConfig(tile_rate=rate))
        return advance(optimizer, KEYS, start(optimizer, KEYS), 1, 20, most=20)[1].best_fitness[-1]

    rates = jnp.array([0.0, 0.7])
    assert best(rates)[1].tolist() == best(jnp.array([0.7]))[0].tolist() != best(rates)[0].tolist()


def test_parents_from_the_archive_come_from_every_filled_niche_alike():
    """With no mutation the offspring are the parents: 20,000 of them, from an archive of a few."""
    loop = EvolutionConfig(population=12, offspring=20_000, tile_rate=0.0, crossing_rate=0.0)
    optimizer = map_elites(PROBLEMS[False], MapElitesConfig(loop, parents="archive"))
    state = optimizer.init(jax.random.key(3))
    grids = np.asarray(state.archive.grids[state.archive.filled])
    drawn = []
    spy = PROBLEMS[False]._replace(evaluate=lambda grids: drawn.append(grids) or PROBLEMS[False].evaluate(grids))
    map_elites(spy, MapElitesConfig(loop, parents="archive")).step(jax.random.key(4), state)
    found = np.asarray(drawn[0])
    counts = [(found == grid).all(axis=(1, 2)).sum() for grid in grids]
    assert sum(counts) == 20_000
    expected = 20_000 / len(grids)
    assert (abs(np.array(counts) - expected) < 5 * np.sqrt(expected)).all()


def test_parents_from_the_archive_leave_the_first_population_as_it_is():
    optimizer = map_elites(PROBLEMS[False], MapElitesConfig(parents="archive"))
    first = start(optimizer, KEYS)
    states, _ = runner(optimizer)(KEYS, first, 1, 3, most=3)
    chex.assert_trees_all_equal(states.population, first.population)


def test_the_numbers_that_generations_fold_into_their_key():
    """The first population is number 0, generation i is number i: what makes results the same for ever."""
    optimizer = ea(PROBLEMS[False])
    state = jax.vmap(optimizer.init)(jax.vmap(lambda key: jax.random.fold_in(key, 0))(KEYS))
    chex.assert_trees_all_equal(start(optimizer, KEYS), state)
    for generation in (1, 2):
        keys = jax.vmap(lambda key, generation=generation: jax.random.fold_in(key, generation))(KEYS)
        state, _ = jax.vmap(optimizer.step)(keys, state)
    chex.assert_trees_all_equal(runner(optimizer)(KEYS, start(optimizer, KEYS), 1, 2, most=2)[0], state)


def test_settings_are_checked_when_an_optimizer_is_made():
    with pytest.raises(InputError, match="config: expected population"):
        ea(PROBLEMS[False], EvolutionConfig(population=0))
    with pytest.raises(InputError, match="config: expected parents to be 'population' or 'archive', got 'none'"):
        map_elites(PROBLEMS[False], MapElitesConfig(parents="none"))
    with pytest.raises(InputError, match="config: expected tournament"):
        map_elites(PROBLEMS[False], MapElitesConfig(EvolutionConfig(tournament=0)))
