"""`evolve`: one call from a key to road networks."""

import io
from dataclasses import replace

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import compilations
from oracle import measure as oracle

from elitelanes_jax import InputError, Weights, evolve, fitness
from elitelanes_jax.archive import Axis
from elitelanes_jax.codes import ROAD_ALPHABET
from elitelanes_jax.optimizers import EvolutionConfig, MapElitesConfig
from elitelanes_jax.search import RunState, preset_config

SHAPE = (5, 6)
KEY = jax.random.key(3)
METHODS = ("ea", "map-elites", "pso", "gwo")


def same(one, other):
    """All but the clock's part is the same."""
    chex.assert_trees_all_equal(one.elites, other.elites)
    chex.assert_trees_all_equal(one.state, other.state)
    chex.assert_trees_all_equal(one.history[:4], other.history[:4])


@pytest.mark.parametrize("method", METHODS)
def test_shapes_and_types(method):
    places = {"ea": 20, "map-elites": 400, "pso": 40, "gwo": 42}[method]
    alone = evolve(KEY, SHAPE, method=method, generations=7)
    many = evolve(jax.random.split(KEY, 3), SHAPE, method=method, generations=7)
    for result, seeds in ((alone, ()), (many, (3,))):
        elites, history = result.elites, result.history
        chex.assert_shape(elites.grids, (*seeds, places, *SHAPE))
        chex.assert_shape([elites.fitness, elites.valid, *elites.metrics], (*seeds, places))
        chex.assert_shape(elites.descriptor, (*seeds, places, 5))
        chex.assert_type([elites.grids, elites.fitness, elites.valid], [jnp.int8, int, bool])
        assert history.generation.tolist() == list(range(1, 8))
        assert history.evaluations.tolist() == [40 * generation for generation in range(1, 8)]
        assert history.best_fitness.shape == history.elite_count.shape == (*seeds, 7)
        assert (history.evaluations_per_second > 0).all()
        assert (history.best_fitness[..., -1] == elites.fitness.min(axis=-1)).all()
        assert result.best().shape == (*seeds, *SHAPE)
        assert result.state.generation == 7


@pytest.mark.parametrize("method", METHODS)
def test_stopped_and_gone_on_is_the_whole_run(method):
    whole = evolve(KEY, SHAPE, method=method, generations=200)
    half = evolve(KEY, SHAPE, method=method, generations=100)
    rest = evolve(KEY, SHAPE, method=method, generations=100, state=half.state)
    same(replace(rest, history=whole.history), whole)
    assert rest.history.generation[0] == 101
    parts = [np.concatenate(pair) for pair in zip(half.history[:4], rest.history[:4], strict=True)]
    chex.assert_trees_all_equal(tuple(parts), tuple(whole.history[:4]))


def test_a_state_survives_a_file():
    keys = jax.random.split(KEY, 2)
    half = evolve(keys, SHAPE, generations=30)
    file = io.BytesIO()
    leaves, tree = jax.tree.flatten(half.state)
    np.savez(file, *leaves)
    file.seek(0)
    state = jax.tree.unflatten(tree, list(np.load(file).values()))
    whole = evolve(keys, SHAPE, generations=50)
    same(replace(evolve(keys, SHAPE, generations=20, state=state), history=whole.history), whole)


@pytest.mark.parametrize("method", METHODS)
def test_a_seed_among_many_is_the_seed_alone(method):
    keys = jax.random.split(KEY, 4)
    many = evolve(keys, SHAPE, method=method, generations=40)
    for number in (0, 3):
        alone = evolve(keys[number], SHAPE, method=method, generations=40)
        chex.assert_trees_all_equal(jax.tree.map(lambda array, number=number: array[number], many.elites), alone.elites)
        np.testing.assert_array_equal(many.history.best_fitness[number], alone.history.best_fitness)
        np.testing.assert_array_equal(many.best()[number], alone.best())


def test_old_style_keys_are_keys():
    same(evolve(jax.random.PRNGKey(3), SHAPE, generations=3), evolve(KEY, SHAPE, generations=3))
    many = evolve(jax.random.key_data(jax.random.split(KEY, 2)), SHAPE, generations=3)
    same(many, evolve(jax.random.split(KEY, 2), SHAPE, generations=3))


def test_metrics_are_those_of_the_grids():
    elites = evolve(KEY, SHAPE, generations=20).elites
    np.testing.assert_array_equal(fitness(elites.metrics)[elites.valid], elites.fitness[elites.valid])
    for place in np.flatnonzero(elites.valid):
        expected = oracle(elites.grids[place])
        assert {name: values[place].item() for name, values in elites.metrics._asdict().items()} == expected


def test_the_best_of_equals_is_the_first():
    result = evolve(KEY, SHAPE, generations=20)
    place = np.flatnonzero(result.elites.fitness == result.elites.fitness.min())[0]
    np.testing.assert_array_equal(result.best(), result.elites.grids[place])


def test_no_generations_are_the_first_population():
    result = evolve(KEY, SHAPE, method="ea", generations=0)
    assert result.history.generation.shape == result.history.best_fitness.shape == (0,)
    assert (np.diff(result.elites.fitness) >= 0).all()


def test_other_seeds_weights_rates_and_lengths_need_no_other_compilation():
    evolve(KEY, (4, 7), generations=20)
    config = MapElitesConfig(EvolutionConfig(tile_rate=0.1))
    with compilations() as compiled:
        one = evolve(jax.random.key(77), (4, 7), generations=31)
        other = evolve(jax.random.key(77), (4, 7), generations=31, weights=Weights(bridges=0, dead_ends=3))
        third = evolve(jax.random.key(77), (4, 7), generations=31, config=config)
        assert not [event for event in compiled if event], "programs were compiled again"
    assert one.elites.fitness.min() != other.elites.fitness.min()
    assert (one.elites.fitness != third.elites.fitness).any()


def test_filled_grids_have_pictures_for_all_tiles():
    elites = evolve(KEY, SHAPE, fill=True, generations=20).elites
    metrics = jax.tree.map(lambda values: values[elites.valid], elites.metrics)
    assert not metrics.dead_ends.any()
    assert not metrics.off_alphabet.any()
    assert (metrics.coverage == 1).all()


def test_a_smaller_alphabet_is_steered_to():
    """Without a four-way crossing in the set, the best grids found have none."""
    alphabet = [3, 5, 6, 7, 9, 10, 11, 12, 13, 14]
    free = evolve(KEY, (8, 8), fill=True, generations=150)
    bound = evolve(KEY, (8, 8), fill=True, generations=150, alphabet=alphabet)
    assert (free.elites.grids[free.elites.valid] == 15).any()
    unsteered = evolve(KEY, (8, 8), fill=True, generations=150, alphabet=alphabet, weights=Weights(off_alphabet=0))
    shares = [(run.elites.grids == 15).any(axis=(1, 2)).sum() / run.elites.valid.sum() for run in (bound, unsteered)]
    assert shares[0] < 0.7 * shares[1]
    best = bound.elites.fitness.argmin()
    assert bound.elites.metrics.off_alphabet[best] == 0
    assert not (bound.best() == 15).any()
    counted = bound.elites.metrics.off_alphabet
    np.testing.assert_array_equal(counted, (bound.elites.grids == 15).sum(axis=(1, 2)))


def test_the_whole_alphabet_is_the_default():
    same(evolve(KEY, SHAPE, generations=9), evolve(KEY, SHAPE, generations=9, alphabet=ROAD_ALPHABET))


def test_axes_of_ones_own():
    axes = [Axis("crossings", 8, width=2), Axis("straight_score", 5, width=20, start=10)]
    result = evolve(KEY, SHAPE, generations=30, axes=axes)
    assert result.axes == tuple(axes)
    elites = result.elites
    assert elites.grids.shape == (40, *SHAPE)
    for niche in np.flatnonzero(elites.valid):
        found = oracle(elites.grids[niche])
        assert elites.descriptor[niche].tolist() == [found["crossings"], found["straight_score"]]
        assert niche == min(found["crossings"] // 2, 7) * 5 + min(max((found["straight_score"] - 10) // 20, 0), 4)


def test_presets():
    standard = MapElitesConfig(parents="archive")
    assert preset_config("map-elites", "paper") == MapElitesConfig()
    assert preset_config("map-elites", "standard") == standard
    same(evolve(KEY, SHAPE, generations=9, preset="standard"), evolve(KEY, SHAPE, generations=9, config=standard))


def test_whole_rates_are_rates():
    one = evolve(KEY, SHAPE, method="ea", generations=9, config=EvolutionConfig(tile_rate=1))
    same(one, evolve(KEY, SHAPE, method="ea", generations=9, config=EvolutionConfig(tile_rate=1.0)))


def test_a_result_is_a_pytree():
    result = evolve(jax.random.split(KEY, 2), SHAPE, generations=3)
    copy = jax.tree.map(lambda array: array, result)
    assert copy.axes == result.axes
    same(copy, result)


def test_vacant_places_are_never_the_best():
    result = evolve(KEY, SHAPE, generations=3)
    spoilt = replace(result, elites=result.elites._replace(fitness=jnp.where(result.elites.valid, 5, -9)))
    place = int(np.flatnonzero(result.elites.valid)[0])
    np.testing.assert_array_equal(spoilt.best(), result.elites.grids[place])


def test_with_64_bit_numbers_allowed_it_is_the_same():
    usual = evolve(KEY, (4, 5), generations=12)
    with jax.enable_x64(True):
        wide = evolve(jax.random.key(3), (4, 5), generations=12)
        assert fitness(wide.elites.metrics).dtype == jnp.int32
    chex.assert_trees_all_equal(usual.elites, wide.elites)
    chex.assert_trees_all_equal_dtypes(usual.elites, wide.elites)
    chex.assert_trees_all_equal_dtypes(usual.state.inner, wide.state.inner)


def test_evaluations_per_second_are_what_the_clock_says(monkeypatch):
    ticks = iter(range(1000))
    monkeypatch.setattr("elitelanes_jax.search.time.perf_counter", lambda: 0.5 * next(ticks))
    history = evolve(jax.random.split(KEY, 2), SHAPE, generations=10).history
    assert history.evaluations_per_second[0] in {2 * 40 * count / 0.5 for count in range(1, 11)}


def test_progress_is_shown_when_asked_for(capsys):
    evolve(KEY, SHAPE, generations=10)
    assert not capsys.readouterr().err
    evolve(KEY, SHAPE, generations=10, progress=True)
    shown = capsys.readouterr().err
    for words in ("map-elites 5x6 10/10, best ", " elites, ", " evals/s, ", " left |"):
        assert words in shown


STATE = evolve(KEY, SHAPE, generations=0).state


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"key": 3}, "key: expected a jax.random.key or an array of them, got 3"),
        ({"key": jnp.zeros(3)}, "key: expected a jax.random.key"),
        ({"key": jax.random.split(KEY, (2, 2))}, r"key: expected one key or keys \[S\]"),
        ({"shape": (1, 5)}, "shape: expected sides from 2 to 1024, got 1 x 5"),
        ({"method": "annealing"}, "method: expected one of ea, map-elites, pso, gwo, got 'annealing'"),
        ({"preset": "best"}, "preset: expected one of paper, standard, tuned for map-elites, got 'best'"),
        (
            {"config": EvolutionConfig()},
            "config: expected MapElitesConfig or AimedMapElitesConfig for map-elites, got",
        ),
        ({"generations": -1}, "generations: expected a whole number, 0 or more, got -1"),
        ({"generations": 2.5}, "generations: expected a whole number, 0 or more, got 2.5"),
        ({"alphabet": [3, 99]}, "alphabet: expected tile codes, whole numbers 0 to 15, got 99"),
        ({"alphabet": [3, 5]}, "alphabet: expected at least one crossing"),
        ({"weights": Weights(bridges=0.1)}, "weights: expected whole numbers, got bridges=0.1"),
        ({"state": 3}, "state: expected the state of a result of evolve, got int"),
        ({"state": STATE, "shape": (6, 6)}, r"state: expected one of the run .*\(map-elites on 6 x 6, seeds: 1\)"),
        ({"state": STATE, "method": "ea"}, r"state: .* \(ea on 5 x 6, seeds: 1\), got one of a run"),
        ({"state": RunState(0, (1, 2), STATE.fingerprint)}, "state: expected one of the run to go on with"),
        ({"state": STATE, "weights": Weights(bridges=3)}, "got one of a run with another key or other settings"),
        ({"state": STATE, "preset": "standard"}, "got one of a run with another key or other settings"),
        ({"state": STATE, "key": jax.random.key(4)}, "got one of a run with another key or other settings"),
        ({"axes": [Axis("luck", 2)]}, "axes: expected a metric, or a share"),
        ({"config": MapElitesConfig(EvolutionConfig(tile_rate=2))}, "config: expected tile_rate to be a number"),
        ({"config": MapElitesConfig(EvolutionConfig(tile_rate=np.zeros(2)))}, "config: expected plain numbers, got an"),
        ({"state": STATE, "key": jax.random.split(KEY, 2)}, r"state: expected .* seeds: 2\)"),
    ],
)
def test_bad_arguments_are_named(change, message):
    arguments = {"key": KEY, "shape": SHAPE, "generations": 1} | change
    with pytest.raises(InputError, match=message):
        evolve(**arguments)
