"""Elites compared with the certificates, `evolve` with that check, and results compared with each other."""

import json
from functools import cache, wraps

import jax
import numpy as np
from oracle import CERTIFICATES

import elitelanes_jax
from elitelanes_jax import Weights

FLAWS = ("dead_ends", "boundary_violations", "mismatches", "adjacent_crossings", "adjacent_turns")


@cache
def certificates():
    records = json.loads(CERTIFICATES.read_text())["certificates"]
    return {
        (*sides, record["fill"]): {niche["cyclomatic"]: niche["optimum"] for niche in record["niches"]}
        for record in records
        for sides in {(record["height"], record["width"]), (record["width"], record["height"])}
    }


def better_than_certified(elites):
    """The (cyclomatic number, fitness) of flawless networks that are better than certified, or certified not to be."""
    metrics = {name: np.asarray(values) for name, values in elites.metrics._asdict().items()}
    flawless = np.asarray(elites.valid) & (metrics["components"] == 1) & (sum(metrics[name] for name in FLAWS) == 0)
    filled = metrics["empty_cells"] == 0
    counts = metrics | {"components": metrics["components"] - 1}
    fitness = sum(weight * counts[name] for name, weight in Weights()._asdict().items() if name != "constant")
    found = set()
    for fill, there in ((False, flawless), (True, flawless & filled)):
        certified = certificates().get((*elites.grids.shape[-2:], fill))
        if certified is not None:
            pairs = zip(metrics["cyclomatic"][there].tolist(), fitness[there].tolist(), strict=True)
            found |= {pair for pair in pairs if pair[1] < certified.get(pair[0], np.inf)}
    return sorted(found)


@wraps(elitelanes_jax.evolve)
def evolve(*arguments, **options):
    """Whatever a test searches for, no elite is better than its certificate."""
    result = elitelanes_jax.evolve(*arguments, **options)
    assert not better_than_certified(result.elites)
    return result


def same(one, other):
    """All of two results but the measured speeds is the same."""
    for part in ("elites", "state"):
        for array, expected in zip(*(jax.tree.leaves(getattr(result, part)) for result in (one, other)), strict=True):
            np.testing.assert_array_equal(array, expected)
    for array, expected in zip(one.history[:4], other.history[:4], strict=True):
        np.testing.assert_array_equal(array, expected)
    assert one.history.evaluations_per_second.shape == other.history.evaluations_per_second.shape
