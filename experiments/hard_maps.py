"""Which maps are hard for a trained driver: an archive of loops and ambiguity, coloured by the driver's failures.

    python experiments/hard_maps.py results/navigation/drivers/map-maps-1000-0.msgpack --task map

MAP-Elites fills the niches of two features, the cyclomatic number and how ambiguous places are. The driver, trained by
`navigation.py`, drives on the elites. The figure has its failure rate in each niche and the hardest niches' maps.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from navigation_maps import DISTANCES, SIDE
from numpy.typing import NDArray

from elitelanes_jax import evolve
from elitelanes_jax._util.checks import path
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.optional_imports import import_optional
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.compile_cache import use_compile_cache
from elitelanes_jax.drive.localization import ambiguity
from elitelanes_jax.optimizers.run import seed_keys
from elitelanes_jax.problem.descriptor import Axis, niche_bins

__all__ = ["failure_feature", "main", "read_driver"]

_AXES = (Axis("cyclomatic", 10, 2), Axis("ambiguity", 12, 100, start=200))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="hard_maps", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("driver", type=checked_by(path), metavar="FILE", help="of a driver that navigation.py trained")
    parser.add_argument("--task", choices=("map", "window"), default="map", help="that it was trained for")
    out = "results/hard-maps.png"
    parser.add_argument("--out", type=checked_by(path), default=Path(out), metavar="FILE", help=f"by default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to see that it runs")
    options = parser.parse_args(arguments)
    return guarded("hard_maps", lambda: _run(options), interrupted="nothing is written")


def _run(options: argparse.Namespace) -> int:
    for package in ("flax", "optax"):
        import_optional(package, "a trained driver needs flax and optax", "flax optax")
    from figures import save
    from navigation_report import hard_niches

    use_compile_cache()
    weights = read_driver(options.driver, options.task)
    runs, evaluations, each = (1, 200, 7) if options.quick else (12, 4000, 21)
    settings: dict[str, Any] = {"preset": "tuned", "fill": True, "axes": _AXES, "progress": False}
    keys = seed_keys(0, runs)
    found = evolve(keys, (SIDE, SIDE), evaluations=evaluations, features={"ambiguity": ambiguity}, **settings)
    whole = np.asarray(found.elites.valid) & (np.asarray(found.elites.metrics.components) == 1)
    grids = np.asarray(found.elites.grids)[whole]
    bins = np.asarray(niche_bins(np.asarray(found.elites.descriptor)[whole], found.axes))
    failures = _measure(failure_feature(options.task, weights, each), grids)
    save(hard_niches(grids, bins, failures / 1000, _AXES), options.out)
    niches = len(np.unique(bins, axis=0))
    say(f"{options.out}: {len(grids)} maps in {niches} niches, {failures.mean() / 10:.1f} % of levels failed")
    return 0


def read_driver(file: Path, task: str) -> Any:
    """Reads a driver's weights.

    Raises:
      InputError: if the file is none of a driver for the task.
    """
    import jax
    from flax.serialization import from_bytes
    from navigation_tasks import CONDITIONS, TASKS, TrainBudget, train_driver

    rings = np.zeros((1, SIDE, SIDE), np.int8)
    rings[0, [0, 0, -1, -1], [0, -1, 0, -1]] = 6, 3, 12, 9
    rings[0, [0, -1], 1:-1], rings[0, 1:-1, [0, -1]] = 5, 10
    empty = train_driver(TASKS[task], CONDITIONS["untrained"], 0, rings, TrainBudget(levels=1))
    try:
        weights = from_bytes(empty, file.read_bytes())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: expected a driver that navigation.py trained, got: {error}") from None
    if jax.tree.map(np.shape, weights) != jax.tree.map(np.shape, empty):
        raise InputError(f"{file}: expected a driver for the task {task}, got one for another")
    return weights


def failure_feature(task: str, weights: Any, each: int = 21) -> Callable[[Any], Any]:
    """Makes a feature for `evolve`: the share of levels on a map that a driver fails, in thousandths, rounded down.

    Args:
      task: that the driver was trained for.
      weights: of the driver.
      each: levels on a map, always the same ones, of the distances of the study in turn.
    """
    import jax
    import jax.numpy as jnp
    from navigation_tasks import TASKS
    from ppo import drive_levels

    from elitelanes_jax.drive.levels import random_level

    about = TASKS[task]
    target = jnp.asarray([DISTANCES[number % len(DISTANCES)] for number in range(each)])

    def feature(grid: Any) -> Any:
        draw = partial(random_level, grid=grid)
        levels = jax.vmap(lambda key, away: draw(key, least=away, most=away))(
            jax.random.split(jax.random.key(0), each), target
        )
        info, _ = drive_levels(
            *(jax.random.key(1), weights, levels, about.params(levels), about.environment, about.network),
            steps=about.steps,
            likeliest=about.likeliest,
        )
        return (1000 * (~about.succeeds(info)).sum() // each).astype(jnp.int32)

    return feature


def _measure(feature: Callable[[Any], Any], grids: NDArray[np.int8], batch: int = 64) -> NDArray[np.int_]:
    """Measures grids, some at a time."""
    import jax

    many = jax.jit(jax.vmap(feature))
    padded = np.concatenate([grids, np.repeat(grids[:1], -len(grids) % batch, axis=0)])
    parts = [np.asarray(many(part)) for part in padded.reshape(-1, batch, SIDE, SIDE)]
    return np.concatenate(parts)[: len(grids)]


if __name__ == "__main__":
    leave(main)
