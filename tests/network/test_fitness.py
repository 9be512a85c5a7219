"""Weights."""

import jax
import jax.numpy as jnp
import numpy as np
from refusals import refused

from elitelanes_jax import Metrics, Weights, fitness, measure
from elitelanes_jax.network.records import check_weights, largest_metrics


def some_metrics(count=50):
    grids = np.random.default_rng(4).integers(0, 16, (count, 5, 6)).astype(np.int8)
    return jax.vmap(lambda grid: measure(grid, [3, 5, 10]))(grids)


def test_each_weight_weighs_its_own_metric():
    metrics = some_metrics()
    nothing = Weights(*(0 for _ in Weights._fields))
    for name in Weights._fields:
        found = fitness(metrics, nothing._replace(**{name: 7}))
        if name == "constant":
            expected = np.full(50, 7)
        elif name == "components":
            expected = 7 * (np.asarray(metrics.components) - 1)
        else:
            expected = 7 * np.asarray(getattr(metrics, name))
        np.testing.assert_array_equal(found, expected, err_msg=name)
    assert set(Weights._fields) - {"constant"} == set(Metrics._fields) - {"coverage"}


def test_the_empty_grid_gets_no_bonus_for_having_no_component():
    assert fitness(measure(np.zeros((4, 4), np.int8))) == 0


def test_checked_weights():
    assert check_weights(Weights(bridges=np.int64(5)), (12, 12)) == Weights(bridges=5)
    for wrong, got in (
        (Weights(bridges=0.5), "bridges=0.5"),
        (Weights(tiles=float("nan")), "tiles=nan"),
        (Weights(tiles="many"), "tiles='many'"),
        (Weights(edges=True), "edges=True"),
        (Weights(dead_ends=2 * 10**7), "weights with which it might reach ..."),
        ({"bridges": 1}, "dict"),
    ):
        with refused("weights", got):
            check_weights(wrong, (12, 12))


def test_the_bound_on_the_fitness_holds():
    """No metric of any grid exceeds the bound that `check_weights` uses."""
    grids = np.random.default_rng(6).integers(0, 16, (300, 4, 9)).astype(np.int8)
    grids[0], grids[1], grids[2], grids[3] = 5, 10, 15, 1
    metrics = jax.vmap(lambda grid: measure(grid, [3]))(grids)
    nothing = Weights(*(0 for _ in Weights._fields))
    for name, bound in largest_metrics((4, 9)).items():
        values = np.asarray(getattr(metrics, name))
        assert 0 <= values.min() <= values.max() <= bound, name
        most = (2**31 - 1) // bound
        check_weights(nothing._replace(**{name: -most}), (4, 9))
        with refused("weights", "weights with which it might reach 2,147,483,..."):
            check_weights(nothing._replace(**{name: most + 1}), (4, 9))


def test_a_sum_over_32_bits_is_refused():
    metrics = some_metrics(3)
    tiles = np.asarray(metrics.tiles, int)
    assert fitness(metrics, Weights(tiles=2**20)).dtype == jnp.int32
    for weight in (2**30, -(2**30), np.array([1, 2, 2**30])):
        worst = (tiles * weight)[np.abs(tiles * weight) >= 2**31][0]
        with refused("weights", "...31,138,512,896") as error:
            fitness(metrics, Weights(**dict.fromkeys(Weights._fields, 0))._replace(tiles=weight))
        assert str(error.value).endswith(f"{worst:,}")


def test_weights_that_are_not_integers_are_refused():
    metrics = some_metrics(3)
    for weight in (2**40, np.int64(2**32), np.array([0, -(2**31) - 1, 0])):
        with refused("weights", "bridges=...", expected="32 bits"):
            fitness(metrics, Weights(bridges=weight))
    for weight in (0.5, np.float32(2), jnp.array(1.0), True, "many"):
        with refused("weights", "bridges of type ..."):
            fitness(metrics, Weights(bridges=weight))
    assert fitness(metrics, Weights(bridges=np.int8(3), edges=jnp.uint8(4))).dtype == jnp.int32
