"""PSO and GWO against their equations, in floats and one particle, tile and code at a time."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import Problem, gwo, pso, road_problem
from elitelanes_jax.network.bits import categorical, random_bits, random_bits16
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.optimizers import GwoConfig, PsoConfig, evaluate

SHAPE = (3, 4)
PROBLEM = road_problem(SHAPE)
K = len(ROAD_ALPHABET)


repaired = jax.jit(jax.vmap(lambda grid: PROBLEM.repair_raster(grid.astype(jnp.int8))))
evaluated = jax.jit(partial(evaluate, PROBLEM))
drawn_codes = jax.jit(jax.vmap(categorical))


@pytest.mark.parametrize(
    "config",
    [pytest.param(PsoConfig(particles=6), marks=pytest.mark.slow), PsoConfig(6, 0.4, 2.5, 0.5, 1.0, 3.0)],
    ids=["paper", "others"],
)
def test_particles_move_by_the_equations(config):
    optimizer = pso(PROBLEM, config)
    step, state = jax.jit(optimizer.step), jax.jit(optimizer.init)(jax.random.key(1))
    assert (abs(np.asarray(state.velocity) / 4096) <= config.start + 1 / 4096).all()
    assert np.std(state.velocity) / 4096 == pytest.approx(config.start / np.sqrt(3), rel=0.1)
    for generation in range(8):
        key = jax.random.key(generation)
        first, second = jax.random.split(key)
        luck = np.asarray(random_bits16(first, (2, 6, 1, 1, 1))) / 2**16
        bits = random_bits(second, (6, *SHAPE))
        position, velocity, best_position = (np.asarray(array) / 4096 for array in state[:3])
        best = best_position[np.argmin(state.best.fitness)]
        velocity = (
            config.inertia * velocity
            + config.cognitive * luck[0] * (best_position - position)
            + config.social * luck[1] * (best - position)
        )
        velocity = np.clip(velocity, -config.fastest, config.fastest)
        after, info = step(key, state)
        reach = abs(np.asarray(best_position - position)).max() + abs(best - position).max() + 4
        np.testing.assert_allclose(np.asarray(after.velocity) / 4096, velocity, atol=(reach + 4) / 4096)
        np.testing.assert_array_equal(after.position, state.position + after.velocity)

        drawn = np.array(ROAD_ALPHABET)[drawn_codes(bits, after.velocity)]
        found = jax.device_get(evaluated(repaired(drawn)))
        before, moved = jax.device_get((state, after))
        for particle in range(6):
            better = found.fitness[particle] < before.best.fitness[particle]
            source = found if better else before.best
            np.testing.assert_array_equal(moved.best.grids[particle], source.grids[particle])
            assert moved.best.fitness[particle] == source.fitness[particle]
            place = moved.position if better else before.best_position
            np.testing.assert_array_equal(moved.best_position[particle], place[particle])
        assert info.best_fitness == after.best.fitness.min()
        state = after


def test_among_equal_grids_a_particle_keeps_its_first():
    def all_equal(grids):
        return jnp.zeros(len(grids), jnp.int32), jnp.zeros((len(grids), 0), jnp.int32)

    optimizer = pso(Problem(SHAPE, all_equal), PsoConfig(particles=6))
    first = optimizer.init(jax.random.key(0))
    after, _ = jax.jit(optimizer.step)(jax.random.key(1), first)
    np.testing.assert_array_equal(after.best.grids, first.best.grids)
    np.testing.assert_array_equal(after.best_position, first.best_position)


@pytest.mark.parametrize("omega", ["own", pytest.param("worst", marks=pytest.mark.slow)])
def test_wolves_move_by_the_equation(omega):
    config = GwoConfig(wolves=7, perturbation=0.6, horizon=10, omega=omega)
    optimizer = gwo(PROBLEM, config)
    step, state = jax.jit(optimizer.step), jax.jit(optimizer.init)(jax.random.key(2))
    order = np.argsort(state.pack.fitness, kind="stable")[:2]
    np.testing.assert_array_equal(state.leaders.grids, state.pack.grids[order])
    alphabet = np.array(ROAD_ALPHABET)
    for generation in range(12):
        key = jax.random.key(generation)
        noise = np.asarray(random_bits16(key, (7, K, *SHAPE))) // 8 / 4096 - 1
        size = config.perturbation * max(1 - generation / 10, 0)
        one_hot = [
            np.asarray(grids)[:, None] == alphabet[:, None, None] for grids in (state.leaders.grids, state.pack.grids)
        ]
        follow = one_hot[1] if omega == "own" else one_hot[1][[np.argmax(state.pack.fitness)]]
        mean = (one_hot[0][0] + one_hot[0][1].astype(int) + follow) / 3
        after, info = step(key, state)
        moved = mean + size * noise
        ordered = np.sort(moved, axis=1)
        clear = ordered[:, -1] - ordered[:, -2] > 2 / 4096
        expected = alphabet[np.argmax(moved, axis=1)]
        compared = clear.all(axis=(1, 2)) | (generation >= 10)  # without a perturbation ties are exact in floats too
        np.testing.assert_array_equal(after.pack.grids[compared], repaired(expected)[compared])
        assert compared.sum() >= 5
        everyone = np.concatenate([state.leaders.fitness, after.pack.fitness])
        assert after.leaders.fitness.tolist() == sorted(everyone.tolist())[:2]
        assert info.best_fitness == after.leaders.fitness[0]
        assert after.steps == generation + 1
        state = after


def test_the_longest_horizon_with_the_largest_perturbation_stays_in_range():
    optimizer = gwo(PROBLEM, GwoConfig(wolves=3, perturbation=16.0, horizon=2**15 - 1))
    step, state = jax.jit(optimizer.step), jax.jit(optimizer.init)(jax.random.key(6))
    pack = [np.asarray(step(jax.random.key(number), state)[0].pack.grids) for number in range(20)]
    assert len({grid.tobytes() for grids in pack for grid in grids}) > 50, "so large a perturbation leaves no vote"


def test_the_defaults_are_the_papers():
    assert PsoConfig() == PsoConfig(40, 0.7, 1.5, 1.5, 4.0, 0.1)
    assert (GwoConfig().wolves, GwoConfig().horizon, GwoConfig().omega) == (40, 200, "own")


def test_a_pack_has_two_wolves_or_more():
    with refused("wolves", "1"):
        GwoConfig(wolves=1)
    assert gwo(PROBLEM, GwoConfig(wolves=2)).evaluations_per_step == 2
