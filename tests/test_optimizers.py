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

from elitelanes_jax import measure
from elitelanes_jax.archive import niche_of, paper_axes
from elitelanes_jax.evolution import EvolutionConfig
from elitelanes_jax.optimizers import MapElitesConfig, ea, map_elites
from elitelanes_jax.problem import road_problem
from elitelanes_jax.run import advance, start

SHAPE = (5, 6)
AXES = paper_axes(SHAPE)
PROBLEMS = {fill: road_problem(SHAPE, AXES, fill=fill) for fill in (False, True)}
MAKERS = {
    "ea": ea,
    "map-elites": map_elites,
    "map-elites, parents from the archive": partial(map_elites, config=MapElitesConfig(parents="archive")),
}
KEYS = jax.random.split(jax.random.key(11), 3)
GENERATIONS = 30

every_optimizer = pytest.mark.parametrize("name", MAKERS)


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
        assert info.elites == elites.valid.sum()
        best = info.best_fitness


@every_optimizer
def test_elites_are_worth_what_they_are_said_to_be(name):
    optimizer = MAKERS[name](PROBLEMS[False])
    states, _ = runner(optimizer)(KEYS, start(optimizer, KEYS), 1, 10, most=10)
    elites = jax.vmap(optimizer.elites)(states)
    chex.assert_type([elites.grids, elites.fitness, elites.descriptor, elites.valid], [jnp.int8, int, int, bool])
    for seed, place in np.argwhere(elites.valid):
        found = oracle(elites.grids[seed, place])
        assert elites.fitness[seed, place] == oracle_fitness(found)
        assert elites.descriptor[seed, place].tolist() == [found[axis.metric] for axis in AXES]


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


@every_optimizer
def test_searching_finds_better_than_chance(name):
    optimizer = MAKERS[name](PROBLEMS[False])
    _, infos = runner(optimizer)(KEYS, start(optimizer, KEYS), 1, 100, most=100)
    chance = PROBLEMS[False].evaluate(PROBLEMS[False].random(jax.random.key(0), 100 * optimizer.offspring))
    assert (infos.best_fitness[-1] < chance.fitness.min()).all()


def test_an_archive_holds_each_elite_in_its_niche():
    optimizer = map_elites(PROBLEMS[False])
    states, infos = runner(optimizer)(KEYS, start(optimizer, KEYS), 1, GENERATIONS, most=GENERATIONS)
    elites = jax.vmap(optimizer.elites)(states)
    niches = jnp.broadcast_to(jnp.arange(elites.valid.shape[1]), elites.valid.shape)
    np.testing.assert_array_equal(niche_of(elites.descriptor, AXES)[elites.valid], niches[elites.valid])
    assert (jnp.diff(infos.elites, axis=0) >= 0).all()


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
