"""Does a network learn to see roads from generated maps, and more from diverse ones?

    python -m experiments.perception.segmentation [--conditions ...] [--seeds N] [--steps N] [--photographs DIR]

A small U-Net is trained on datasets that differ only in the number and the source of their maps. All have the same
number of steps and crops, the same tile pictures, and views of the same kind. The tests have maps that are in no
dataset, drawn with the training's pictures, with pictures that were held out, and with photographs. The folder of
results keeps every finished run: after an interruption, the same command continues.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import __version__
from elitelanes_jax.network import canonical_form
from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import LABELS, load_tiles
from experiments.common import Parser, kept, leave, open_results, require, run, save, to_csv, whole, write
from experiments.perception.report import Row, make_tables, plot
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

__all__ = ["PHOTOGRAPHS", "main"]

PHOTOGRAPHS = Path(__file__).parents[3] / "shared" / "real_tiles"
"""The folder of the photographs, where it is there."""


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
    parser = Parser("segmentation", __doc__)
    parser.add_argument("--conditions", nargs="+", default=list(CONDITIONS), choices=CONDITIONS, help="default all")
    parser.add_argument("--seeds", type=whole(1, 1000), default=3, metavar="N", help="runs of each; default 3")
    parser.add_argument("--steps", type=whole(1), metavar="N", help=f"of a training; default {_FULL.steps}")
    parser.add_argument("--photographs", type=Path, metavar="DIR", help="a tile set to test on as well")
    out = Path("results/segmentation")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to test the program")
    options = parser.parse_args(arguments)
    return run("segmentation", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax")
    conditions = [name for name in CONDITIONS if name in options.conditions]
    photographs = options.photographs or (PHOTOGRAPHS if PHOTOGRAPHS.is_dir() else None)
    photographed = load_tiles(photographs) if photographs else None
    budget = _QUICK if options.quick else _FULL
    budget = budget._replace(steps=options.steps or budget.steps)
    settings = {"program": "segmentation", "version": __version__, "conditions": conditions, "seeds": options.seeds}
    settings |= budget._asdict() | {"photographs": photographed and photographed.name}
    open_results(options.out, settings)
    use_compile_cache()
    began, rows = time.perf_counter(), list[Row]()
    for seed in range(options.seeds):
        lists = kept(options.out / "maps" / f"{seed}.json", partial(_make_all_maps, seed, budget))
        maps = {name: np.array(grids, np.int8) for name, grids in lists.items()}
        seen, held_out = split_tiles(seed)
        tests = {"seen": ("test", seen), "held out": ("test", held_out), "four-way": ("four-way", seen)}
        if photographed is not None:
            tests["photographs"] = ("test", photographed)
        pictures = {test: draw_maps(maps[name], [tiles], 1000 + seed) for test, (name, tiles) in tests.items()}
        for name in conditions:
            file = options.out / "runs" / f"{name}-{seed}.json"
            found = [Row(*row) for row in kept(file, partial(_train, name, seed, maps, pictures, budget))]
            rows += found
            print(f"{name}, seed {seed}: mean IoU", *(f"{row.test} {row.mean:.3f}" for row in found), flush=True)
    write(options.out / "segmentation.csv", to_csv([row.flat() for row in rows]))
    write(options.out / "segmentation.md", make_tables(rows, f"{budget.steps} steps of {budget.batch} crops"))
    save(plot(rows), options.out / "segmentation.png")
    print(f"{len(rows)} rows in {options.out / 'segmentation.csv'}, {time.perf_counter() - began:.0f} s")


def _make_all_maps(seed: int, budget: Budget) -> dict[str, list[list[list[int]]]]:
    """Makes the maps to train on, by source, and the maps of the tests, which differ from all of these.

    The maps of "test" come from all sources in equal numbers and can be drawn with the held-out tiles. Those of
    "four-way" have a four-way crossing, which the held-out tiles cannot draw and the best networks lack.
    """
    seen, held_out = split_tiles(seed)
    maps, test, crossed = {}, list[NDArray[np.int8]](), list[NDArray[np.int8]]()
    for source in SOURCES:
        count = max(condition.maps for condition in CONDITIONS.values() if condition.source == source)
        maps[source] = make_maps(source, min(count, budget.most), 2 * seed, seen.alphabet, budget.evaluations)
        # The EA's runs end early: longer ones would all find the same few best networks.
        evaluations = min(budget.evaluations, 2000) if source == "ea" else budget.evaluations
        test += [*make_maps(source, budget.test_maps, 2 * seed + 1, held_out.alphabet, evaluations)]
        crossed += [*make_maps(source, 2 * budget.test_maps, 2 * seed + 1, seen.alphabet, evaluations)]
    trained_on = {canonical_form(grid) for grids in maps.values() for grid in grids}
    maps["test"] = np.array([grid for grid in test if canonical_form(grid) not in trained_on])
    four_way = [grid for grid in crossed if (grid == 15).any() and canonical_form(grid) not in trained_on]
    maps["four-way"] = np.array(four_way)
    return {name: grids.tolist() for name, grids in maps.items()}


def _train(
    name: str, seed: int, maps: Mapping[str, NDArray[np.int8]], tests: Mapping[str, Pictures], budget: Budget
) -> list[Row]:
    """Trains on one condition; returns a row for each test."""
    from experiments.perception.unet import confusion, ious, predict, train

    condition = CONDITIONS[name]
    condition = condition._replace(maps=min(condition.maps, budget.most), drawings=min(condition.drawings, budget.most))
    grids = maps[condition.source][: condition.maps]
    images, labels = training_set(condition, grids, seed)
    weights = train(images, labels, len(LABELS), seed, steps=budget.steps, batch=budget.batch)
    trained, tested = patterns(grids), patterns(maps["test"])
    different, shared = len({canonical_form(grid) for grid in grids}), len(trained & tested) / len(tested)
    rows = []
    for test, (shown, labelled) in tests.items():
        found = ious(confusion(labelled, predict(weights, shown, len(LABELS)), len(LABELS)))
        by_label = dict(zip(LABELS, found.tolist(), strict=True))
        rows.append(Row(name, seed, different, len(trained), shared, test, by_label, float(found.mean())))
    return rows


if __name__ == "__main__":
    leave(main())
