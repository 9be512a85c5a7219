"""`evolve`: one call from a key to road networks."""

import re
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from types import SimpleNamespace

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import evolve, same
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax import Axis, GenerateSpec, Optimizer, SearchSpec, Weights, ea, fitness
from elitelanes_jax.optimizers import PRESETS, EvolutionConfig, Info, MapElitesConfig, seed_keys
from elitelanes_jax.search.records import RunState
from elitelanes_jax.search.resolve import resolve
from elitelanes_jax.search.running import _check_memory
from elitelanes_jax.search.settings import METHODS

SHAPE = (5, 6)
KEY = jax.random.key(3)

# The paper's settings, of which the archive compiles soonest; the tuned ones have tests of their own.
search = partial(evolve, preset="paper", fill=False)


# The other methods keep the same promises by the same code: slow proofs.
every_method = pytest.mark.parametrize(
    "method", [pytest.param(method, marks=[] if method == "map-elites" else [pytest.mark.slow]) for method in METHODS]
)


def check_shapes_and_types(method, alone, many):
    places = {"ea": 20, "map-elites": 400, "pso": 40, "gwo": 42}[method]
    for result, seeds in ((alone, ()), (many, (3,))):
        elites, history = result.elites, result.history
        chex.assert_shape(elites.grids, (*seeds, places, *SHAPE))
        chex.assert_shape([elites.fitness, elites.valid, *elites.metrics], (*seeds, places))
        chex.assert_shape(elites.descriptor, (*seeds, places, 5))
        chex.assert_type([elites.grids, elites.fitness, elites.valid], [jnp.int8, int, bool])
        assert history.generation.tolist() == list(range(1, 51))
        assert history.evaluations.tolist() == [40 * generation for generation in range(1, 51)]
        assert history.best_fitness.shape == history.elite_count.shape == (*seeds, 50)
        assert (history.evaluations_per_second > 0).all()
        assert (history.best_fitness[..., -1] == elites.fitness.min(axis=-1)).all()
        assert result.best().shape == (*seeds, *SHAPE)
        assert result.state.generation == 50


@every_method
def test_stopped_and_continued_is_the_whole_run_and_a_seed_is_the_same_alone(method):
    keys = jax.random.split(KEY, 3)
    whole = search(keys, SHAPE, method=method, generations=50)
    half = search(keys, SHAPE, method=method, generations=20)
    rest = search(keys, SHAPE, method=method, generations=30, state=half.state)
    same(replace(rest, history=whole.history), whole)
    assert rest.history.generation[0] == 21
    assert rest.history.evaluations[0] == 21 * 40
    for name in ("best_fitness", "elite_count"):
        parts = [getattr(part.history, name) for part in (half, rest)]
        np.testing.assert_array_equal(np.concatenate(parts, axis=1), getattr(whole.history, name))
    alone = search(keys[2], SHAPE, method=method, generations=50)
    chex.assert_trees_all_equal(jax.tree.map(lambda array: array[2], whole.elites), alone.elites)
    np.testing.assert_array_equal(whole.history.best_fitness[2], alone.history.best_fitness)
    np.testing.assert_array_equal(whole.best()[2], alone.best())
    check_shapes_and_types(method, alone, whole)


def test_metrics_are_those_of_the_grids():
    elites = search(KEY, SHAPE, generations=20).elites
    np.testing.assert_array_equal(fitness(elites.metrics)[elites.valid], elites.fitness[elites.valid])
    for place in np.flatnonzero(elites.valid):
        expected = oracle(elites.grids[place])
        assert {name: values[place].item() for name, values in elites.metrics._asdict().items()} == expected


def test_other_seeds_weights_rates_ranges_and_lengths_take_the_same_program():
    seen = []

    def traced(problem):
        seen.append(None)
        return ea(problem)

    run = partial(evolve, shape=(4, 7), optimizer=traced, fill=False, where=["bridges=0.."])
    results = [run(jax.random.key(77), generations=20)]
    count = len(seen)
    changes = ({"weights": Weights(bridges=0, dead_ends=3)}, {"where": {"crossings": (2, 3), "tiles": 9}})
    for change in changes:
        results.append(run(jax.random.key(77), generations=31, **change))
        assert len(seen) == count
    assert len({int(result.elites.fitness.min()) for result in results}) == 3


def test_other_numbers_of_a_configuration_take_the_same_program():
    configs = [MapElitesConfig(EvolutionConfig(tile_rate=rate)) for rate in (0.7, 0.1)]
    one, other = (evolve(KEY, SHAPE, config=config, generations=20, fill=False) for config in configs)
    assert (one.search.settings.preset, other.search.settings.preset) == ("paper", "custom")
    assert (one.elites.fitness != other.elites.fitness).any()
    same(one, search(KEY, SHAPE, generations=20))


@pytest.mark.slow
def test_a_smaller_alphabet_is_steered_to():
    """Without a four-way crossing in the set, the best grids found have none."""
    alphabet = [3, 5, 6, 7, 9, 10, 11, 12, 13, 14]
    bound, lured = (
        search(
            KEY, (8, 8), method="ea", fill=True, generations=150, alphabet=alphabet, weights={"off_alphabet": weight}
        )
        for weight in (480, -480)
    )
    assert not (bound.best() == 15).any()
    assert bound.elites.metrics.off_alphabet.mean() < lured.elites.metrics.off_alphabet.mean()
    np.testing.assert_array_equal(lured.elites.metrics.off_alphabet, (lured.elites.grids == 15).sum(axis=(1, 2)))


def test_axes_of_ones_own():
    axes = ["crossings:8:2", Axis("straight_score", 5, width=20, start=10)]
    result = search(KEY, SHAPE, generations=30, axes=axes)
    assert result.search.axes == (Axis("crossings", 8, 2), axes[1])
    elites = result.elites
    assert elites.grids.shape == (40, *SHAPE)
    for niche in np.flatnonzero(elites.valid):
        found = oracle(elites.grids[niche])
        assert elites.descriptor[niche].tolist() == [found["crossings"], found["straight_score"]]
        assert niche == min(found["crossings"] // 2, 7) * 5 + min(max((found["straight_score"] - 10) // 20, 0), 4)


def test_every_preset_has_a_configuration():
    assert list(PRESETS) == [(method, preset) for method, presets in METHODS.items() for preset in presets]
    assert PRESETS["map-elites", "standard"] == MapElitesConfig(parents="archive")


def test_an_optimizer_of_ones_own():
    """Random search: a factory from a problem to an `Optimizer` is all it takes."""

    def random_search(problem):
        inner = ea(problem, EvolutionConfig(population=4, offspring=4))

        def step(key, state):
            state = inner.init(key)
            return state, inner.step(key, state)[1]

        return Optimizer(inner.init, step, inner.elites, evaluations_per_step=4)

    keys = jax.random.split(KEY, 2)
    result = evolve(keys, (3, 4), optimizer=random_search, evaluations=40)
    assert result.elites.grids.shape == (2, 4, 3, 4)
    assert result.history.evaluations.tolist() == list(range(4, 44, 4))
    rest = evolve(keys, (3, 4), optimizer=random_search, evaluations=40, state=result.state)
    assert rest.state.generation == 20


@pytest.mark.parametrize(
    ("change", "subject", "got", "expected"),
    [
        ({"init": lambda key: ()}, "optimizer", "()", ""),
        ({"step": lambda key, state: (state, (3, 4))}, "optimizer", "(Population, tuple)", ""),
        ({"step": lambda key, state: None}, "optimizer", "None", ""),
        (
            {"step": lambda key, state: ((state.grids,), Info(3, 4))},
            "optimizer: ...",
            "Error in tree structs...",
            "",
        ),
        (
            {"step": lambda key, state: (state._replace(grids=state.grids[1:]), Info(3, 4))},
            "optimizer: ...",
            "Trees 0 and 1 differ in leaves 'grids'...",
            "",
        ),
        ({"step": lambda key, state: (state, Info(state.fitness, 4))}, "optimizer", "best_fitness of shape (4,)", ""),
        ({"elites": lambda state: state.grids}, "optimizer: elites", None, "Population"),
        (
            {"elites": lambda state: state._replace(features=state.features[:, :5])},
            "optimizer: elites: features",
            "int32 [4, 5]",
            "",
        ),
        (
            {"elites": lambda state: state._replace(fitness=state.fitness.astype(jnp.float16))},
            "optimizer: elites: fitness",
            "float16 [4]",
            "",
        ),
    ],
)
def test_a_wrong_part_of_ones_own_optimizer_is_named(change, subject, got, expected):
    def make(problem):
        return ea(problem, EvolutionConfig(population=4, offspring=4))._replace(init_unevaluated=None, **change)

    for key in (KEY, jax.random.split(KEY, 2)):
        with refused(subject, got, expected):
            evolve(key, (3, 4), optimizer=make, evaluations=40)


def test_an_optimizer_may_report_a_fitness_of_another_type(tmp_path):
    def make(problem):
        inner = ea(problem, EvolutionConfig(population=4, offspring=4))

        def step(key, state):
            state, info = inner.step(key, state)
            return state, info._replace(best_fitness=info.best_fitness.astype(jnp.float32))

        return inner._replace(step=step)

    search = partial(evolve, 0, (3, 4), seeds=1, optimizer=make, checkpoint=tmp_path)  # its Info has a float
    search(generations=2)
    assert search(generations=4).history.best_fitness.dtype == np.int32


def test_the_time_of_a_continued_run_is_its_own():
    run = partial(search, 0, SHAPE, seeds=2, method="ea")
    history = run(generations=2, state=run(generations=20).state).history
    np.testing.assert_allclose(history.seconds, (40 * 2 / history.evaluations_per_second).sum())


def test_functions_need_a_hash():
    @dataclass
    class Scaled:
        factor: int = 2

        def __call__(self, usual):
            return usual * self.factor

    with refused("fitness", "...Scaled(factor=2)"):
        evolve(0, (3, 4), generations=1, fitness=Scaled())


def test_the_defaults_are_those_of_the_specification():
    result = evolve(KEY, (3, 3), evaluations=64)
    assert result.search == resolve(SearchSpec(evaluations=64), (3, 3))
    assert (result.elites.metrics.dead_ends == 0).all(), "repair fills"
    assert result.history.evaluations[-1] == 64
    same(evolve(KEY, (3, 3), spec=SearchSpec(evaluations=64)), result)


def test_evaluations_are_rounded_up_to_generations():
    assert [resolve(SearchSpec(evaluations=evaluations), (3, 3)).steps(40) for evaluations in (0, 1, 40, 41)] == [
        0,
        1,
        1,
        2,
    ]


@pytest.mark.parametrize("preset", ["paper", pytest.param("tuned", marks=pytest.mark.slow)])
def test_a_result_is_a_pytree_of_arrays(preset):
    keys = jax.random.split(KEY, 3)
    result = search(keys, SHAPE, preset=preset, generations=0)
    for copy in (jax.jit(lambda result: result)(result), jax.device_put(result)):
        assert copy.search == result.search
        same(copy, result)
        rest = search(keys, SHAPE, preset=preset, generations=1, state=copy.state)
        assert rest.state.generation == 1


def test_a_whole_number_is_the_commands_seed():
    asked = {"generations": 0, "where": "cyclomatic=0..20 bridges=0..30", "weights": "bridges=90 turns=1"}
    short = evolve(5, SHAPE, seeds=2, axes="cyclomatic:4 turns:3:2", preset="paper", **asked)
    asked["where"] = {"cyclomatic": (0, 20), "bridges": (0, 30)}
    asked["weights"] = {"bridges": 90, "turns": 1}
    axes = {"cyclomatic": 4, "turns": (3, 2)}
    same(short, evolve(seed_keys(5, 2), SHAPE, axes=axes, preset="paper", **asked))
    defaults = signature(evolve).parameters
    assert (defaults["key"].default, defaults["shape"].default) == (GenerateSpec().seed, GenerateSpec().size)


@pytest.mark.parametrize("kind", ["threefry2x32", "rbg"])
def test_seeds_have_the_usual_keys_of_jax_whatever_kind_is_set(kind):
    with jax.default_prng_impl(kind):
        for seed in (0, 7, 2**31, 2**32 - 1):
            keys = seed_keys(seed, [0, 1, 12, 2**31])
            base = jax.random.key(np.uint32(seed), impl="threefry2x32")
            for key, index in zip(keys, [0, 1, 12, 2**31], strict=True):
                assert key == jax.random.fold_in(base, np.uint32(index))
        found = search(7, SHAPE, seeds=2, generations=3, method="ea")
    chex.assert_trees_all_equal(found.elites, search(seed_keys(7, 2), SHAPE, generations=3, method="ea").elites)
    assert seed_keys(3, 0).shape == (0,)
    for indices in (jnp.array([0, 1, 2]), np.array(3), range(3)):
        assert (seed_keys(3, indices) == seed_keys(3, 3)).all()


def test_results_are_printed_in_a_few_lines():
    result = search(jax.random.split(KEY, 2), SHAPE, generations=3, where="bridges=0..40")
    said = repr(result)
    assert 5 <= len(said.splitlines()) <= 10 and max(map(len, said.splitlines())) <= 120
    best = np.asarray(result.elites.fitness)[np.asarray(result.elites.valid)].min()
    for words in ("5 x 6 tiles, 2 seeds, 120 evaluations each", f"with fitness {best}\n", "where    bridges=0..40"):
        assert words in said
    for record in (result.elites, result.history, result.state):
        assert len(repr(record).splitlines()) == 1 and len(repr(record)) < 300
    assert repr(jax.jit(lambda result: (repr(result), result)[1])(result)) == said
    assert repr(jax.eval_shape(lambda: result)).startswith("Result(elites=MeasuredElites(grids int8")


def test_the_best_of_equals_is_the_first_and_never_a_vacant_slot():
    result = search(KEY, SHAPE, generations=3)
    spoilt = replace(result, elites=result.elites._replace(fitness=jnp.where(result.elites.valid, 5, -9)))
    place = int(np.flatnonzero(result.elites.valid)[0])
    np.testing.assert_array_equal(spoilt.best(), result.elites.grids[place])


@pytest.mark.slow
@pytest.mark.parametrize(("method", "preset"), [("ea", "paper"), ("map-elites", "tuned")])
def test_with_64_bit_numbers_allowed_it_is_the_same(method, preset):
    options = {"method": method, "preset": preset, "generations": 12}
    usual = search(KEY, SHAPE, **options)
    jax.config.update("jax_enable_x64", True)
    try:
        wide = search(jax.random.key(3), SHAPE, **options)
        assert fitness(wide.elites.metrics).dtype == jnp.int32
    finally:
        jax.config.update("jax_enable_x64", False)
    chex.assert_trees_all_equal(usual.elites, wide.elites)
    chex.assert_trees_all_equal_dtypes(usual.elites, wide.elites)
    chex.assert_trees_all_equal_dtypes(usual.state.inner, wide.state.inner)


def test_progress_is_shown_when_asked_for(capsys):
    search(KEY, SHAPE, generations=10)
    assert not capsys.readouterr().err
    search(KEY, SHAPE, generations=10, progress=True)
    shown = capsys.readouterr().err
    assert re.search(r"map-elites 5x6 10/10 generations, best -?[\d,]+, \d+ elites, [\d,]+ evaluations/s\n", shown)


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_a_search_inside_a_transformation_is_refused_with_what_to_do(transform):
    keys = jax.random.split(KEY, 2)
    with refused("key", "a traced one"):
        transform(lambda key: evolve(key, SHAPE, generations=1).best())(keys)


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize(
    ("change", "subject", "got", "expected"),
    [
        ({"key": "3"}, "key", "'3'", ""),
        ({"key": [0] * 1000}, "key", "[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0...", ""),
        ({"devices": [0] * 1000}, "devices", "[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0...", ""),
        ({"size": (5, 6)}, "size", "size=", "shape=(5, 6)"),
        ({"seed": 3}, "seed", "seed=", "key=3"),
        ({"key": 1, "seeds": 0}, "seeds", "0", ""),
        ({"seeds": 2}, "seeds", "2", "none"),
        ({"key": jnp.zeros(3)}, "key", None, "a jax.random.key"),
        ({"key": jax.random.split(KEY, (2, 2))}, "key", "shape (2, 2)", ""),
        ({"presets": "paper"}, "presets", "'presets'", ""),
        (
            {"method": "map-elites", "config": EvolutionConfig()},
            "config",
            "EvolutionConfig",
            "",
        ),
        ({"method": np.array([1, 2])}, "method", "array([1, 2])", ""),
        ({"preset": "nonsense", "config": EvolutionConfig()}, "preset", "'nonsense'", "none"),
        ({"config": 3}, "config", "int", ""),
        ({"generations": 2.5}, "generations", "2.5", ""),
        ({"weights": Weights(bridges=0.1)}, "weights bridges", "0.1", ""),
        ({"axes": [Axis(np.array([1, 2]), 3)]}, "axes array([1, 2])", "array([1, 2])", ""),
        ({"weights": [(np.array([1, 2]), 3)]}, "weights", "array([1, 2])", ""),
        ({"rules": "duckietown", "fill": True}, "fill", "True", ""),
        ({"weights": {"bridges": 2**30}}, "weights", "weights with which it might reach ...", "5 x 6"),
        (
            {"weights": {"bridges": 73 * 10**6}, "where": "crossings=2"},
            "weights",
            "weights with which it might reach ...",
            "5 x 6",
        ),
        (
            {"config": MapElitesConfig(EvolutionConfig(tile_rate=np.zeros(2)))},
            "config",
            "an array, .loop.tile_rate",
            "",
        ),
    ],
)
def test_bad_arguments_are_named(change, subject, got, expected):
    arguments = {"key": KEY, "shape": SHAPE, "generations": 1, "preset": "paper"} | change
    with refused(subject, got, expected):
        evolve(**arguments)


def test_keys_that_come_twice_are_a_warning():
    keys = jax.random.split(KEY, 3)[np.array([0, 1, 0])]
    with pytest.warns(UserWarning, match="^key: expected keys that differ, got 1 of 3 again"):
        search(keys, SHAPE, generations=1)


@pytest.mark.usefixtures("any_types")
def test_a_state_of_another_run_is_refused():
    state = search(KEY, SHAPE, generations=0).state
    other = "one of a run with another key, other options or functions"
    for change, got, expected in (
        ({"state": 3}, "int", "the state of a result"),
        ({"shape": (6, 6)}, other, "6 x 6, seeds: 1"),
        ({"method": "ea"}, other, "this run"),
        ({"state": RunState(state.generation, (1, 2), state.fingerprint)}, other, "this run"),
        ({"weights": Weights(bridges=3)}, other, "this run"),
        ({"preset": "standard"}, other, "this run"),
        ({"key": jax.random.key(4)}, other, "this run"),
        ({"key": jax.random.split(KEY, 2)}, other, "seeds: 2"),
    ):
        arguments = {"key": KEY, "shape": SHAPE, "generations": 1, "preset": "paper", "fill": False, "state": state}
        with refused("state", got, expected):
            evolve(**arguments | change)


def test_a_search_that_cannot_fit_is_refused_before_it_is_compiled(monkeypatch):
    monkeypatch.setattr("elitelanes_jax.search.running.free_memory", lambda: 202_000_000)
    monkeypatch.setattr("elitelanes_jax.search._programs.Programs.prepare", None)
    took = (
        r"not enough memory: 40 seeds of 6 x 7 tiles take 0\.2 GB or more, and 0\.2 GB are free; [0-9]+ seeds? at most"
    )
    with pytest.raises(MemoryError, match=f"{took} would fit$"):
        evolve(0, (6, 7), seeds=40, generations=1)
    monkeypatch.setattr("elitelanes_jax.search.running.free_memory", lambda: 200_000_010)
    with pytest.raises(MemoryError, match="smaller maps or fewer niches would fit$"):
        evolve(0, (6, 7), seeds=40, generations=1)
    # A step has the states before and after it.
    programs = SimpleNamespace(memory=5)
    run = SimpleNamespace(search=SimpleNamespace(shape=(6, 7)), seeds=5, programs=programs)
    _check_memory(run)
    programs.memory = 6
    with pytest.raises(MemoryError, match="5 seeds of 6 x 7 .*; 4 seeds at most would fit$"):
        _check_memory(run)
