"""Maps that a trained driver fails on, searched for: its failures are a feature of the search.

    python -m experiments.navigation.hard_maps results/navigation/drivers/map-maps-1000-0.msgpack --task map

MAP-Elites fills the niches of two features, the cyclomatic number and how ambiguous places are; first as always, then
on from there with the share of levels that the driver fails as a weight, so that each niche keeps its hardest map. Both
archives are then driven on levels that the search has not seen. The figure has the failure rates in each niche and the
hardest niches' maps.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Array, Int8, Int32
from numpy.typing import NDArray

from elitelanes_jax import InputError, Result, evolve
from elitelanes_jax.drive import ambiguity
from elitelanes_jax.problem import Axis, Kernel, niche_bins
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, Pytree, leave, require, run, save
from experiments.navigation.maps import DISTANCES, SIDE

__all__ = ["failure_feature", "main", "read_driver"]

_FIRST = 32  # maps that a run of the preset begins with
_AXES = (Axis("cyclomatic", 10, 2), Axis("ambiguity", 12, 100, start=200))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("hard_maps", __doc__)
    parser.add_argument("driver", type=Path, metavar="FILE", help="a driver that experiments.navigation.study trained")
    parser.add_argument("--task", choices=("map", "window"), default="map", help="that it was trained for")
    out = Path("results/hard-maps.png")
    parser.add_argument("--out", type=Path, default=out, metavar="FILE", help=f"the figure; default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to test the program")
    options = parser.parse_args(arguments)
    return run("hard_maps", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("a trained driver needs", "flax", "optax")
    from experiments.navigation.report import Archive, hard_niches

    use_compile_cache()
    weights = read_driver(options.driver, options.task)
    evaluations, harder, each = (200, 60, 7) if options.quick else (20_000, 6000, 14)
    features: dict[str, Kernel] = {"ambiguity": ambiguity}
    search = partial(evolve, 0, (SIDE, SIDE), seeds=1, preset="tuned", fill=True, axes=_AXES)
    usual = search(evaluations=evaluations, features=features)
    grids, bins, _ = _archive(usual)
    # A weight over all others: a map that fails one more level of 14 takes its niche.
    spread = np.linspace(0, len(grids) - 1, min(len(grids), _FIRST)).astype(int)
    features = features | {"failure": failure_feature(options.task, weights, each)}
    hard = search(evaluations=harder, features=features, weights={"failure": -100}, initial=list(grids[spread]))
    sought, niches, found_hard = _archive(hard)
    again = failure_feature(options.task, weights, 3 * each, seed=1)
    archives = [
        Archive("of a usual search", grids, bins, _measure(again, grids) / 1000),
        Archive("sought by its failures", sought, niches, _measure(again, sought) / 1000),
    ]
    # Chosen by the search's own levels: the levels that measure would flatter those that they choose.
    hardest = np.argsort(-found_hard["failure"], kind="stable")[:6]
    save(hard_niches(archives, hardest, _AXES), options.out)
    for one in archives:
        print(f"maps {one.words}: {len(one.grids)}, one a niche, {one.failures.mean():.1%} of levels failed")


def _archive(found: Result) -> tuple[NDArray[np.int8], NDArray[np.int_], dict[str, NDArray[np.int32]]]:
    """Returns the elites of one component of a run, their bins and their extra features."""
    elites = jax.tree.map(lambda part: np.asarray(part)[0], found.elites)
    whole = elites.valid & (elites.metrics.components == 1)
    bins = np.asarray(niche_bins(elites.descriptor[whole], found.axes))
    return elites.grids[whole], bins, {name: values[whole] for name, values in elites.features.items()}


def read_driver(file: Path, task: str) -> Pytree:
    """Reads a driver's weights.

    Raises:
      InputError: if the file has no driver for the task.
    """
    from flax.serialization import from_bytes

    from experiments.navigation.tasks import CONDITIONS, TASKS, TrainBudget, train_driver

    rings = np.zeros((1, SIDE, SIDE), np.int8)
    rings[0, [0, 0, -1, -1], [0, -1, 0, -1]] = 6, 3, 12, 9
    rings[0, [0, -1], 1:-1], rings[0, 1:-1, [0, -1]] = 5, 10
    empty = train_driver(TASKS[task], CONDITIONS["untrained"], 0, rings, TrainBudget(levels=1))
    try:
        weights = from_bytes(empty, file.read_bytes())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: expected a driver that experiments.navigation.study trained, got: {error}") from None
    if jax.tree.map(np.shape, weights) != jax.tree.map(np.shape, empty):
        raise InputError(f"{file}: expected a driver for the task {task}, got one for another")
    return weights


def failure_feature(task: str, weights: Pytree, each: int = 21, seed: int = 0) -> Kernel:
    """Makes a feature for `evolve`: the share of levels on a map that a driver fails, in thousandths, rounded down.

    Args:
      task: that the driver was trained for.
      weights: of the driver.
      each: levels on a map, always the same ones, of the distances of the study in turn.
      seed: of the levels and of the turns that are drawn from the policy.
    """
    import jax.numpy as jnp

    from elitelanes_jax.drive import random_level
    from experiments.navigation.ppo import drive_levels
    from experiments.navigation.tasks import TASKS

    about = TASKS[task]
    target = jnp.asarray([DISTANCES[number % len(DISTANCES)] for number in range(each)])

    def feature(grid: Int8[Array, "H W"]) -> Int32[Array, ""]:
        draw = partial(random_level, grid=grid)
        levels = jax.vmap(lambda key, away: draw(key, least=away, most=away))(
            jax.random.split(jax.random.key(2 * seed), each), target
        )
        info, _ = drive_levels(
            *(jax.random.key(2 * seed + 1), weights, levels, about.params(levels), about.environment, about.network),
            steps=about.steps,
            likeliest=about.likeliest,
        )
        return (1000 * (~about.succeeds(info)).sum() // each).astype(jnp.int32)

    return feature


def _measure(feature: Kernel, grids: NDArray[np.int8], batch: int = 64) -> NDArray[np.int_]:
    """Measures grids in batches of one size, which is compiled once."""
    many = jax.jit(jax.vmap(feature))
    padded = np.concatenate([grids, np.repeat(grids[:1], -len(grids) % batch, axis=0)])
    parts = [np.asarray(many(part)) for part in padded.reshape(-1, batch, SIDE, SIDE)]
    return np.concatenate(parts)[: len(grids)]


if __name__ == "__main__":
    leave(main())
