"""Whatever the user sets in JAX, all kernels, methods and environments run, and their results are the same."""

from contextlib import ExitStack, contextmanager

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from batches import GROUPS, batches, plain
from certified import same
from refusals import refused

from elitelanes_jax import Optimizer, RoadMap, ea, evolve, fitness, measure, random_grids, repair, rotate
from elitelanes_jax.drive import RoadNav, RoadNavParams, make_levels
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive._batch_programs import SAME_STEP
from elitelanes_jax.network import measure_town
from elitelanes_jax.optimizers import EvolutionConfig, seed_keys

pytestmark = pytest.mark.usefixtures("any_types")

STRICT = {
    "jax_numpy_rank_promotion": "raise",
    "jax_numpy_dtype_promotion": "strict",
    "jax_transfer_guard": "disallow",
}

# Of settings that take other values than True and False.
OTHER = {
    "jax_default_matmul_precision": "bfloat16",
    "jax_default_prng_impl": "rbg",
    "jax_error_checking_behavior_divide": "raise",
    "jax_error_checking_behavior_nan": "raise",
    "jax_error_checking_behavior_oob": "raise",
    "jax_exec_time_optimization_effort": -1.0,
    "jax_legacy_prng_key": "error",
    "jax_memory_fitting_effort": -1.0,
    "jax_memory_fitting_level": "O0",
    "jax_numpy_dtype_promotion": "strict",
    "jax_numpy_rank_promotion": "raise",
    "jax_optimization_level": "O3",
    "jax_random_seed_offset": 5,
    "jax_transfer_guard": "disallow",
}

# The settings that change what `jax.random` and `jax.numpy` return.
NUMBERS = {
    "jax_default_matmul_precision": "bfloat16",
    "jax_default_prng_impl": "rbg",
    "jax_enable_x64": True,
    "jax_random_seed_offset": 5,
    "jax_threefry_partitionable": False,
}

# With these, JAX computes nothing or refuses to use a key twice, as `fold_in` does.
NOT_TRIED = {"jax_no_execution", "jax_no_tracing", "jax_debug_key_reuse"}


@contextmanager
def settings(**values):
    """Settings of the whole process, because a context manager of JAX sets them for one thread."""
    before = {name: getattr(jax.config, name) for name in values}
    with ExitStack() as stack:
        for name, value in values.items():
            stack.callback(jax.config.update, name, before[name])
            jax.config.update(name, value)
        yield


# Each problem evaluates grids and draws some. One with ranges has most of what the others have.
SLOW_KERNELS = {
    f"{action}, {problem}" for action in ("problem", "random") for problem in ("plain", "towns", "own", "float")
}
# Each of their programs takes seconds to compile.
SLOW = ("methods", "environments")


@pytest.mark.parametrize(
    ("group", "without"),
    [(name, SLOW_KERNELS if name == "kernels" else set()) for name in GROUPS if name not in SLOW]
    + [pytest.param(name, set(), marks=pytest.mark.slow) for name in (*SLOW, "kernels")],
)
def test_all_run_under_strict_settings(group, without):
    """Compiled, with arguments that are on the device. The rooms' own tests run with these settings too, but for
    transfers."""
    for name, batch in list(batches(group)):
        if name in without:
            continue
        with settings(**STRICT):
            try:
                jax.block_until_ready(jax.jit(batch.function)(*batch.arguments))
            except Exception as error:
                raise AssertionError(name) from error


@pytest.mark.slow
def test_arrays_of_numpy_and_numbers_may_be_arguments_where_transfers_are_forbidden():
    road_map = RoadMap(np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8))
    key = seed_keys(0, 1)[0]
    with settings(**STRICT):
        seed_keys(0, 1)
        params = RoadNavParams(make_levels(key, [road_map], 2))
        _, state = RoadNav.reset(key, params)
        RoadNav.step(key, state, 1, params)
        measure(road_map.codes), measure_town(road_map.codes), repair(rotate(road_map.codes, 2))
        together = Batch(RoadNav, params, 2, SAME_STEP)
        together.reset([1, 2])
        together.step([0, 1])
        assert len(together.states("render")) == 2


def test_a_fitness_is_the_same_with_64_bits_and_strict_promotion_together():
    def compute(key):
        grids = jax.vmap(repair)(random_grids(key, 8, (5, 6)))
        return fitness(jax.vmap(measure)(grids))

    key = seed_keys(0, 1)[0]
    expected = jax.jit(compute)(key)
    with settings(**STRICT, jax_enable_x64=True):
        chex.assert_trees_all_equal(jax.jit(compute)(key), expected)


def draw(grid):
    """A feature of the user, whose value is random."""
    key = jax.random.wrap_key_data(jnp.array([0, 7], jnp.uint32), impl="threefry2x32")
    return jax.random.randint(jax.random.split(key)[1], (), 0, 9, jnp.int32) + (grid == 5).sum(dtype=jnp.int32)


def search(generations=2, **options):
    """A search whose method splits keys, see `bits.split`."""
    options = {"method": "pso", "preset": "paper", "seeds": 2, "features": {"drawn": draw}, "axes": "drawn:4"} | options
    return evolve(3, (4, 5), generations=generations, **options)


# Each setting is another program to compile.
QUICK = ("jax_default_prng_impl",)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in NUMBERS]
)
def test_a_search_is_the_same_whatever_is_set(name, tmp_path):
    """Also if it is continued under another setting."""
    # The user's functions may compute other numbers with 64 bits. Then the search is another one.
    options = {"features": None, "axes": None} if name == "jax_enable_x64" else {}
    expected = search(checkpoint=tmp_path, **options)
    with settings(**{name: NUMBERS[name]}):
        same(search(**options), expected)
        continued = search(3, checkpoint=tmp_path, **options)
        if options:
            search(checkpoint=tmp_path / "own")
    same(continued, search(3, **options))
    if options:
        with refused(tmp_path / "own", "results with ...", expected="functions drawn"):
            search(checkpoint=tmp_path / "own")


@pytest.mark.slow
def test_an_optimiser_is_traced_anew_under_other_settings():
    """It may compute other numbers with 64 bits. Then its search is another one."""

    def weighing(problem):
        inner = ea(problem, EvolutionConfig(population=4, offspring=4))

        def step(key, state):
            population, info = inner.step(key, state[0])
            return (population, state[1]), info

        def init(key):
            return inner.init(key), jnp.ones(2)

        return Optimizer(init, step, lambda state: inner.elites(state[0]), inner.evaluations_per_step)

    digests = []
    for wide in (False, True, False):
        with settings(jax_enable_x64=wide):
            digests.append(evolve(3, (3, 4), optimizer=weighing, seeds=1, generations=1).functions)
    assert digests[0] == digests[2] != digests[1]


@pytest.mark.slow
def test_no_setting_of_jax_changes_a_search():
    expected = search()
    tried = {name: not value for name, value in jax.config.values.items() if isinstance(value, bool)} | OTHER
    for name in tried.keys() - NOT_TRIED:
        try:
            with settings(**{name: tried[name]}):
                pass
        except (AttributeError, RuntimeError):
            continue  # only at the start of a process, and read by JAX's own parts alone
        with settings(**{name: tried[name]}):
            try:
                found = search()
                # A setting may change the text of the user's feature. The search is then another one to a checkpoint.
                chex.assert_trees_all_equal(found.elites, expected.elites)
                chex.assert_trees_all_equal(found.state.inner, expected.state.inner)
            except Exception as error:
                raise AssertionError(name) from error


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_kernels_and_environments_are_the_same_whatever_is_set(group):
    for name, batch in batches(group):
        expected = plain(jax.jit(batch.function)(*batch.arguments))
        for setting in ("jax_threefry_partitionable", "jax_default_prng_impl", "jax_random_seed_offset"):
            with settings(**{setting: NUMBERS[setting]}):
                found = plain(jax.jit(batch.function)(*batch.arguments))
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_array_equal(one, other, err_msg=f"{name}, {setting}")
