"""The contract of all optimisers: each promise of the convention, tested on each alike.

Each optimiser is compiled once: a step for one seed, and a run for several.
"""

from dataclasses import replace
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import better_than_certified
from oracle import fitness as oracle_fitness
from oracle import measure as oracle

from elitelanes_jax.network.metrics import measure
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.optimizers._annealed import (
    AnnealedGwoConfig,
    AnnealedPsoConfig,
    AnnealedState,
    annealed_ea,
    annealed_gwo,
    annealed_pso,
)
from elitelanes_jax.optimizers._annealed_map_elites import AnnealedMapElitesConfig, annealed_map_elites
from elitelanes_jax.optimizers._annealing import AnnealingConfig
from elitelanes_jax.optimizers._gwo import GwoConfig, gwo
from elitelanes_jax.optimizers._map_elites import MapElitesConfig, map_elites
from elitelanes_jax.optimizers._moves import MoveWeights
from elitelanes_jax.optimizers._population import EvolutionConfig, ea
from elitelanes_jax.optimizers._pso import PsoConfig, pso
from elitelanes_jax.optimizers.base import Optimizer
from elitelanes_jax.optimizers.loop import advance, run, start
from elitelanes_jax.problem.archive import VACANT
from elitelanes_jax.problem.descriptor import compute_descriptor, niche_index, paper_axes
from elitelanes_jax.problem.road import road_problem

SHAPE = (5, 6)
AXES = paper_axes(SHAPE)
PROBLEMS = {fill: road_problem(SHAPE, fill=fill) for fill in (False, True)}
FILLS = {"ea, tuned"}  # the other optimizers fill in slow proofs alone
# Cycles so short that several start within the tests.
TUNED = AnnealingConfig(population=12, chains=4, cycle=7)
MAKERS = {
    "ea": ea,
    "map-elites": map_elites,
    "map-elites, parents from the archive": partial(map_elites, config=MapElitesConfig(parents="archive")),
    "pso": pso,
    "gwo": partial(gwo, config=GwoConfig(horizon=100)),
    "ea, tuned": partial(annealed_ea, config=TUNED),
    "map-elites, tuned": partial(annealed_map_elites, config=AnnealedMapElitesConfig(TUNED)),
    "map-elites, irregular": partial(
        annealed_map_elites, config=AnnealedMapElitesConfig(TUNED, accept_equal=True, require_feasible=True)
    ),
    "pso, tuned": partial(annealed_pso, config=AnnealedPsoConfig(TUNED)),
    "gwo, tuned": partial(annealed_gwo, config=AnnealedGwoConfig(TUNED)),
    "gwo, the worst as omega": partial(gwo, config=GwoConfig(horizon=100, omega="worst")),
}
KEYS = jax.random.split(jax.random.key(11), 3)
GENERATIONS = 30

# The tuned swarms are the tuned EA with other mates, GWO is a swarm as PSO is, and the others differ from theirs in a
# choice: slow proofs.
SLOW = {
    "gwo",
    "map-elites, irregular",
    "pso, tuned",
    "gwo, tuned",
    "map-elites, parents from the archive",
    "gwo, the worst as omega",
}


def optimizers(*, slow=SLOW, without=()):
    """Parametrizes a test by optimiser; the module's scope lets all tests of one follow each other."""
    names = [
        pytest.param(name, marks=[pytest.mark.slow] if name in slow else []) for name in MAKERS if name not in without
    ]
    return pytest.mark.parametrize("name", names, scope="module")


every_optimizer = optimizers()


class Compiled(NamedTuple):
    optimizer: Optimizer
    first: Any  # the states of generation 0, seeds in front
    elites: Any  # from states, seeds in front, to their elites
    run: Any  # from states, and the first and the last generation, to states and reports
    step: Any


@lru_cache(maxsize=2)  # no more at once: all of them take over a gigabyte
def compiled(name, other_repair=False, /):
    optimizer = MAKERS[name](PROBLEMS[(name in FILLS) != other_repair])
    init = jax.jit(optimizer.init)
    first = [init(jax.random.fold_in(key, 0)) for key in KEYS]
    moving = jax.jit(partial(advance, optimizer, most=GENERATIONS))
    return Compiled(
        optimizer,
        jax.tree.map(lambda *parts: jnp.stack(parts), *first),
        jax.jit(jax.vmap(optimizer.elites)),
        lambda states, begin, end: moving(KEYS, states, begin, end),
        jax.jit(optimizer.step),
    )


@lru_cache(maxsize=2)
def whole_run(name):
    """A run of all generations: states and reports."""
    one = compiled(name)
    return one.run(one.first, 1, GENERATIONS)


@jax.jit
@jax.vmap
@jax.vmap
def measured(grid):
    return measure(grid)


def shapes(tree):
    return jax.tree.map(lambda array: (array.shape, array.dtype), tree)


@every_optimizer
def test_each_step_leaves_valid_grids_and_a_best_that_never_gets_worse(name):
    check_steps(compiled(name), fill=name in FILLS)


@pytest.mark.slow
@every_optimizer
def test_each_step_does_so_with_the_other_repair(name):
    check_steps(compiled(name, True), fill=name not in FILLS)


def check_steps(one, *, fill):
    states, best = one.first, one.elites(one.first).fitness.min(axis=1)
    for generation in range(1, 16):
        before = states
        states, infos = one.run(states, generation, generation)
        assert shapes(states) == shapes(before)
        if isinstance(states, AnnealedState):  # what was best in the cycle before is forgotten
            known = jnp.where(before.cooling.begins[:, None], VACANT, before.cycle_best.fitness)
            np.testing.assert_array_equal(states.cycle_best.fitness, jnp.minimum(states.chains.fitness, known))
        elites = one.elites(states)
        metrics = measured(elites.grids)
        for bad in (metrics.mismatches, metrics.boundary_violations, *([metrics.dead_ends] if fill else [])):
            assert not (np.asarray(bad) * np.asarray(elites.valid)).any()
        lowest = np.where(elites.valid, elites.fitness, np.iinfo(np.int32).max).min(axis=1)
        np.testing.assert_array_equal(infos.best_fitness[0], lowest)
        assert (lowest <= best).all()
        np.testing.assert_array_equal(infos.elite_count[0], elites.valid.sum(axis=1))
        best = lowest
    assert not better_than_certified(SimpleNamespace(grids=elites.grids, valid=elites.valid, metrics=metrics))


@every_optimizer
def test_elites_have_the_fitness_and_the_metrics_of_their_grids(name):
    elites = compiled(name).elites(whole_run(name)[0])
    chex.assert_type([elites.grids, elites.fitness, elites.features, elites.valid], [jnp.int8, int, int, bool])
    grids, fitness, counts = (np.asarray(array) for array in elites[:3])
    for place in map(tuple, np.argwhere(elites.valid)[::3]):
        found = oracle(grids[place])
        assert fitness[place] == oracle_fitness(found)
        assert counts[place].tolist() == [found[name] for name in METRIC_NAMES]


@every_optimizer
def test_a_run_in_parts_is_the_whole_run(name):
    one = compiled(name)
    whole, infos = whole_run(name)
    states, rows = one.first, []
    for begin, end in ((1, 1), (2, 13), (14, 13), (14, GENERATIONS)):
        states, info = one.run(states, begin, end)
        rows.append(jax.tree.map(lambda row, count=end - begin + 1: row[:count], info))
    chex.assert_trees_all_equal(states, whole)
    chex.assert_trees_all_equal(jax.tree.map(lambda *parts: jnp.concatenate(parts), *rows), infos)


@optimizers(slow=SLOW | {"ea", "pso", "gwo"})  # each is one program of a batch; the archives differ most from that
def test_many_seeds_are_each_seed_alone(name):
    one = compiled(name)
    whole, infos = whole_run(name)
    for number, key in enumerate(KEYS):
        state = jax.tree.map(lambda array, number=number: array[number], one.first)
        for generation in range(1, GENERATIONS + 1):
            state, info = one.step(jax.random.fold_in(key, generation), state)
            assert info.best_fitness == infos.best_fitness[generation - 1, number]
        chex.assert_trees_all_equal(state, jax.tree.map(lambda array, number=number: array[number], whole))


@optimizers(slow=set(MAKERS) - {"map-elites"})  # whose population is the paper's EA
def test_compiled_or_not_it_is_the_same(name):
    one = compiled(name)
    key, state = jax.random.key(6), jax.tree.map(lambda array: array[0], whole_run(name)[0])
    chex.assert_trees_all_equal(one.optimizer.step(key, state), one.step(key, state))


@every_optimizer
def test_one_compilation_serves_every_call(name):
    one, traces = compiled(name), []

    @jax.jit
    def traced(keys, states, begin, end):
        traces.append(None)
        return advance(one.optimizer, keys, states, begin, end, most=5)

    kept = traced.eval_shape(KEYS, one.first, 1, 5)[0]
    assert shapes(kept) == shapes(one.first), "a state goes in as it came out"
    traced.eval_shape(jax.random.split(jax.random.key(1), 3), kept, 6, 7)
    assert len(traces) == 1


@optimizers(without=["pso"])
def test_searching_finds_better_than_chance(name):
    """The paper's PSO does not: it draws nearly at random from its velocities (see the experiments)."""
    evaluations = GENERATIONS * compiled(name).optimizer.evaluations_per_step
    problem = PROBLEMS[name in FILLS]
    chance = jax.jit(jax.vmap(lambda key: problem.evaluate(problem.random(key, evaluations)).fitness.min()))
    assert whole_run(name)[1].best_fitness[-1].mean() < chance(jax.random.split(jax.random.key(0), 8)).mean()


def test_a_run_is_a_start_and_all_its_generations():
    """The first population has number 0, generation i number i: this keeps results the same for ever."""
    one = compiled("ea")
    chex.assert_trees_all_equal(jax.jit(partial(start, one.optimizer))(KEYS), one.first)
    whole = jax.jit(partial(run, one.optimizer, generations=3))(KEYS)
    states, infos = one.run(one.first, 1, 3)
    chex.assert_trees_all_equal(whole, (states, jax.tree.map(lambda rows: rows[:3], infos)))


def test_an_archive_holds_each_elite_in_its_niche():
    states, infos = whole_run("map-elites")
    elites = compiled("map-elites").elites(states)
    niches = jnp.broadcast_to(jnp.arange(elites.valid.shape[1]), elites.valid.shape)
    found = niche_index(compute_descriptor(elites.features, METRIC_NAMES, AXES), AXES)
    np.testing.assert_array_equal(found[elites.valid], niches[elites.valid])
    assert (jnp.diff(infos.elite_count, axis=0) >= 0).all()


def test_an_archive_changes_nothing_about_the_population():
    """The paper's MAP-Elites is its evolutionary algorithm with an archive beside it."""
    chex.assert_trees_all_equal(whole_run("ea")[0], whole_run("map-elites")[0].population)


@pytest.mark.parametrize(
    ("factory", "config", "field", "values"),
    [
        pytest.param(ea, EvolutionConfig(), "tile_rate", (0.0, 0.7), marks=pytest.mark.slow),
        (gwo, GwoConfig(), "horizon", (3, 200)),
        pytest.param(pso, PsoConfig(), "inertia", (0.2, 0.7), marks=pytest.mark.slow),
        pytest.param(annealed_ea, TUNED, "cycle", (3, 7), marks=pytest.mark.slow),
        pytest.param(annealed_ea, TUNED, "moves", (MoveWeights(transplant=0), MoveWeights()), marks=pytest.mark.slow),
        pytest.param(annealed_gwo, AnnealedGwoConfig(TUNED), "leaders", (1, 3), marks=pytest.mark.slow),
        pytest.param(
            annealed_map_elites, AnnealedMapElitesConfig(TUNED), "bin_penalty", (1, 400), marks=pytest.mark.slow
        ),
    ],
)
def test_numbers_of_a_configuration_can_be_swept(factory, config, field, values):
    """Whole or not: one program serves them all, and vmap runs over them."""

    chex.clear_trace_counter()

    @chex.assert_max_traces(n=1)
    def search(config):
        return run(factory(PROBLEMS[False], config), KEYS, 12)[1].best_fitness

    configs = [replace(config, **{field: value}) for value in values]
    program = jax.jit(search)
    alone = [program(one) for one in configs]
    assert (alone[0] != alone[1]).any()
    chex.clear_trace_counter()
    together = jax.jit(jax.vmap(search))(jax.tree.map(lambda *numbers: jnp.stack(numbers), *configs))
    np.testing.assert_array_equal(together, alone)


def test_parents_from_the_archive_come_from_every_filled_niche_alike():
    """With no mutation the offspring are the parents: 20,000 of them, from an archive of a few."""
    loop = EvolutionConfig(population=12, offspring=20_000, tile_rate=0.0, crossing_rate=0.0)
    config = MapElitesConfig(loop, parents="archive")
    state = jax.jit(map_elites(PROBLEMS[False], config).init)(jax.random.key(3))
    grids = np.asarray(state.archive.grids)[np.asarray(state.archive.valid)]
    drawn = []
    spy = replace(
        PROBLEMS[False],
        evaluate=lambda grids: jax.debug.callback(drawn.append, grids) or PROBLEMS[False].evaluate(grids),
    )
    jax.block_until_ready(jax.jit(map_elites(spy, config).step)(jax.random.key(4), state))
    jax.effects_barrier()
    found = np.asarray(drawn[0])
    counts = [(found == grid).all(axis=(1, 2)).sum() for grid in grids]
    assert sum(counts) == 20_000
    expected = 20_000 / len(grids)
    assert (abs(np.array(counts) - expected) < 5 * np.sqrt(expected)).all()


def test_a_run_of_no_generation_is_its_start():
    optimizer = MAKERS["ea"](PROBLEMS[False])
    states, info = jax.jit(partial(run, optimizer, generations=0))(KEYS)
    chex.assert_trees_all_equal(states, jax.jit(partial(start, optimizer))(KEYS))
    assert info.best_fitness.shape == (0, len(KEYS))


@every_optimizer
def test_generations_are_the_rounds_of_a_scan(name):
    optimizer = compiled(name).optimizer
    keys = jax.random.split(jax.random.key(0), 2)
    jaxpr = jax.make_jaxpr(lambda keys: run(optimizer, keys, 7))(keys)
    scans = [equation for equation in jaxpr.jaxpr.eqns if equation.primitive.name == "scan"]
    rounds = 7 + 1 - optimizer.first_generation
    assert rounds in [equation.params["length"] for equation in scans]
