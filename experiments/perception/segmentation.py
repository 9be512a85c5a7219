"""Segmentation with generated maps: whether a network learns to see roads from them, and more from diverse ones.

    python -m experiments.perception.segmentation [--conditions ...] [--seeds N] [--steps N] [--photographs DIR] [--quick]

A small U-Net is trained on datasets that differ only in the number and the source of their maps. All have the same
number of steps and crops, the same tile pictures, and views of the same kind. The tests have maps that are in no
dataset, drawn with the pictures of the training, with pictures that were held out, and with photographs. The folder of
results keeps every finished run: after an interruption, the same command continues from there.
"""

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from elitelanes_jax import InputError, __version__
from elitelanes_jax._util.checks import path, whole
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.formats import table_to_csv
from elitelanes_jax.network import canonical_form
from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import LABELS, load_tiles
from experiments.common import kept, open_results, save
from experiments.perception.report import figure, tables
from experiments.perception.training_sets import (
    CONDITIONS,
    SOURCES,
    Pictures,
    draw_maps,
    make_maps,
    patterns,
    split_tiles,
    training_set,
)

Row = dict[str, Any]

_PHOTOGRAPHS = Path(__file__).parents[3] / "shared" / "real_tiles"


class Budget(NamedTuple):
    """The amount of work.

    Attributes:
      steps: steps of a training, each on `batch` crops.
      batch: crops a step.
      most: the largest number of maps and of drawings of a condition.
      evaluations: of each run that makes maps.
      test_maps: maps of each source in the tests.
    """

    steps: int = 500
    batch: int = 8
    most: int = 1000
    evaluations: int = 20_000
    test_maps: int = 16


_FULL, _QUICK = Budget(), Budget(steps=3, batch=2, most=4, evaluations=2000, test_maps=2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="segmentation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = ", ".join(CONDITIONS)
    parser.add_argument("--conditions", nargs="+", default=list(CONDITIONS), metavar="NAME", help=f"of {names}")
    parser.add_argument(
        "--seeds", type=checked_by(whole(1, 1000)), default=3, metavar="N", help="runs of each; by default 3"
    )
    parser.add_argument(
        "--steps", type=checked_by(whole(1)), metavar="N", help=f"of training; by default {_FULL.steps}"
    )
    parser.add_argument("--photographs", type=checked_by(path), metavar="DIR", help="a tile set to test on as well")
    out = "results/segmentation"
    parser.add_argument("--out", type=checked_by(path), default=Path(out), metavar="DIR", help=f"by default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to see that it runs")
    options = parser.parse_args(arguments)
    return guarded("segmentation", lambda: _run(options), interrupted="what is done is kept; start again to continue")


def _run(options: argparse.Namespace) -> int:
    for package in ("flax", "optax"):
        import_optional(package, "training needs flax and optax", "flax optax")
    for name in options.conditions:
        if name not in CONDITIONS:
            raise InputError(f"conditions: expected some of {', '.join(CONDITIONS)}, got {name!r}")
    conditions = [name for name in CONDITIONS if name in options.conditions]
    photographs = options.photographs or (_PHOTOGRAPHS if _PHOTOGRAPHS.is_dir() else None)
    photographed = load_tiles(photographs) if photographs else None
    budget = _QUICK if options.quick else _FULL
    budget = budget._replace(steps=options.steps or budget.steps)
    about = {"program": "segmentation", "version": __version__, "conditions": conditions, "seeds": options.seeds}
    open_results(options.out, about | budget._asdict() | {"photographs": photographed and photographed.name})
    use_compile_cache()
    began, rows = time.perf_counter(), list[Row]()
    for seed in range(options.seeds):
        file = options.out / "maps" / f"{seed}.json"
        maps = {name: np.array(grids, np.int8) for name, grids in kept(file, partial(_maps, seed, budget)).items()}
        seen, held_out = split_tiles(seed)
        tests = {
            "seen": (maps["test"], seen),
            "held out": (maps["test"], held_out),
            "four-way": (maps["four-way"], seen),
        }
        if photographed is not None:
            tests["photographs"] = (maps["test"], photographed)
        pictures = {test: draw_maps(grids, tiles, 1000 + seed) for test, (grids, tiles) in tests.items()}
        for name in conditions:
            file = options.out / "runs" / f"{name}-{seed}.json"
            run = kept(file, partial(_train, name, seed, maps, pictures, budget))
            rows += run
            say(f"{name}, seed {seed}: mean IoU " + ", ".join(f"{row['test']} {row['mean']:.3f}" for row in run))
    write_atomic(options.out / "segmentation.csv", table_to_csv(rows).encode())
    training = f"{budget.steps} steps of {budget.batch} crops"
    write_atomic(options.out / "segmentation.md", tables(rows, training).encode())
    save(figure(rows), options.out / "segmentation.png")
    say(f"{len(rows)} rows in {options.out / 'segmentation.csv'}, {time.perf_counter() - began:.0f} s")
    return 0


def _maps(seed: int, budget: Budget) -> dict[str, Any]:
    """Makes the maps to train on, by source, and the maps of the tests, which differ from all of these.

    The maps of "test" come from all sources in equal numbers and can be drawn with the held-out tiles. Those of
    "four-way" have a four-way crossing, which the held-out tiles cannot draw and the best networks lack.
    """
    seen, held_out = split_tiles(seed)
    maps: dict[str, Any] = {}
    test, crossed = list[Any](), list[Any]()
    for source in SOURCES:
        wanted = max(condition.maps for condition in CONDITIONS.values() if condition.source == source)
        maps[source] = make_maps(source, min(wanted, budget.most), 2 * seed, seen.alphabet, budget.evaluations)
        # The EA's runs end early: longer ones would all find the same few best networks.
        evaluations = budget.evaluations // (10 if source == "ea" else 1)
        test += [*make_maps(source, budget.test_maps, 2 * seed + 1, held_out.alphabet, evaluations)]
        crossed += [*make_maps(source, 2 * budget.test_maps, 2 * seed + 1, seen.alphabet, evaluations)]
    trained_on = {canonical_form(grid) for grids in maps.values() for grid in grids}
    maps["test"] = [grid for grid in test if canonical_form(grid) not in trained_on]
    maps["four-way"] = [grid for grid in crossed if (grid == 15).any() and canonical_form(grid) not in trained_on]
    return {name: np.array(grids).tolist() for name, grids in maps.items()}


def _train(name: str, seed: int, maps: dict[str, Any], tests: dict[str, Pictures], budget: Budget) -> list[Row]:
    """Trains on one condition; returns a row for each test."""
    from experiments.perception.unet import confusion, ious, predict, train

    condition = CONDITIONS[name]
    condition = condition._replace(maps=min(condition.maps, budget.most), drawings=min(condition.drawings, budget.most))
    grids = maps[condition.source][: condition.maps]
    images, labels = training_set(condition, grids, seed)
    weights = train(images, labels, len(LABELS), seed, steps=budget.steps, batch=budget.batch)
    known, wanted = patterns(grids), patterns(maps["test"])
    about = {
        "condition": name,
        "seed": seed,
        "different": len({canonical_form(grid) for grid in grids}),
        "patterns": len(known),
        "met": len(known & wanted) / len(wanted),
    }
    rows = []
    for test, (shown, labelled) in tests.items():
        found = ious(confusion(labelled, predict(weights, shown, len(LABELS)), len(LABELS)))
        rows.append(
            about | {"test": test} | dict(zip(LABELS, found.tolist(), strict=True)) | {"mean": float(found.mean())}
        )
    return rows


if __name__ == "__main__":
    leave(main)
