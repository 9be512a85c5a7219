"""Annealing: acceptance, cooling, and the random grids that a cycle begins with."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.network.bits import exponential, random_bits
from elitelanes_jax.network.xla import UNIT
from elitelanes_jax.optimizers._annealing import AnnealingConfig, Cooling, metropolis_accepts, random_grid
from elitelanes_jax.problem.archive import VACANT
from elitelanes_jax.problem.descriptor import tuned_axes
from elitelanes_jax.problem.road import road_problem


def test_worse_grids_are_accepted_as_metropolis_says():
    bits = random_bits(jax.random.key(0), (200_000,))
    for temperature, worse in ((16 * 60, 30), (16 * 60, 100), (16 * 18, 18), (16 * 4000, 4000)):
        share = np.asarray(metropolis_accepts(bits, jnp.int32(temperature), jnp.int32(0), jnp.int32(worse))).mean()
        assert share == pytest.approx(np.exp(-worse / (temperature / 16)), abs=0.01)
    assert metropolis_accepts(bits, jnp.int32(1), jnp.int32(7), jnp.int32(7)).all()


@pytest.mark.parametrize("refused", [jnp.int32(VACANT), jnp.float32(jnp.inf)])
def test_a_refused_grid_gives_way_to_any_and_is_accepted_instead_of_another_alone(refused):
    bits, hot = random_bits(jax.random.key(0), (100,)), jnp.int32(16 * 4000)
    for other in (-(2**29), -5, 7, 2**29):
        value = jnp.asarray(other, refused.dtype)
        assert metropolis_accepts(bits, hot, refused, value).all()
        assert not metropolis_accepts(bits, hot, value, refused).any()
    assert metropolis_accepts(bits, hot, refused, refused).all()


def test_exponential_numbers_have_their_quantiles():
    drawn = np.asarray(exponential(random_bits(jax.random.key(1), (200_000,)))) / UNIT
    assert drawn.min() >= 0
    for quantile in (0.1, 0.5, 0.9, 0.99):
        assert np.quantile(drawn, quantile) == pytest.approx(-np.log(1 - quantile), rel=0.03, abs=0.002)


def test_cycles_cool_and_grow():
    config = AnnealingConfig(cycle=10)
    place = Cooling.first(config, (12, 12))
    temperatures, starts = [], []
    for step in range(1, 60):
        temperatures.append(int(place.temperature(config.hottest, config.coldest, (12, 12))))
        place = place.after(grows=True)
        if place.begins:
            starts.append(step + 1)
    assert starts == [10, 25, 47]  # cycles of 10, 15, 22 and 33
    assert temperatures[0] > temperatures[8] == min(temperatures[:9])
    assert 16 * 18 <= temperatures[8] <= 16 * 25
    assert temperatures[9] == 16 * 60
    assert Cooling.first(config, (6, 24)).temperature(60, 18, (6, 24)) == 2 * temperatures[0], "by the longer side"


def test_a_cycle_begins_with_random_grids_of_the_alphabet():
    problem = road_problem((9, 7), tuned_axes((9, 7)), alphabet=(3, 5, 10, 15))
    bits = random_bits(jax.random.key(2), (4000,))
    codes = np.asarray(jax.vmap(lambda bits: random_grid(problem, bits))(bits))
    assert set(np.unique(codes)) == {3, 5, 10, 15}
    share = (codes == 5).mean(axis=0)
    assert abs(share - 0.25).max() < 0.05
    pairs = (codes[:, 0, 0] == codes[:, 0, 1]).mean(), (codes[:-1, 0, 0] == codes[1:, 0, 0]).mean()
    assert pairs == pytest.approx((0.25, 0.25), abs=0.05)
