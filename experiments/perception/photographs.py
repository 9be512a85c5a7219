"""How well does a network that was trained on drawn tiles label photographs of real tiles from above?

    python -m experiments.perception.photographs [--photographs DIR] [--seed N] [--recipes NAME ...]

The recipes differ in views, length, resolution and decision. The tests have other maps, drawn with held-out tile
pictures, and with photographs. Nothing is chosen by photographs. The folder of results keeps finished recipes: after an
interruption, the same command continues.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError, __version__
from elitelanes_jax.dataset import STANDARD, DatasetSpec, Transforms
from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import LABEL_COLOURS, LABELS, TileSet, load_tiles
from experiments.common import Parser, kept, leave, open_results, require, run, table, whole, write
from experiments.perception.segmentation import PHOTOGRAPHS
from experiments.perception.training_sets import draw_maps, make_maps, shift_lines, split_tiles

__all__ = ["RECIPES", "main"]

VARIED = DatasetSpec(transforms="varied").transforms  # type: ignore[arg-type]
_SHIFTS = tuple(np.linspace(-0.07, 0.07, 8).tolist())


class Recipe(NamedTuple):
    """A training.

    Attributes:
      words: its description in the table.
      tile_px: side of a tile in pixels.
      steps: of the training.
      drawings: to train on, each of another map.
      views: the ranges of views; pictures take turns.
      shifts: of the white lines, in tiles; pairs of pictures take turns. Every second shift has blended tiles.
    """

    words: str
    tile_px: int = 32
    steps: int = 500
    drawings: int = 1000
    views: tuple[Transforms, ...] = (STANDARD,)
    shifts: tuple[float, ...] = (0.0,)


RECIPES = {
    "before": Recipe("32 px, 500 steps, as in the study above"),
    "views": Recipe("32 px, 800 steps, varied views and lines", 32, 800, 400, (VARIED, STANDARD), _SHIFTS),
    "finer": Recipe("64 px, 1,500 steps, varied views and lines", 64, 1500, 300, (VARIED, STANDARD), _SHIFTS),
}
"""The recipes by name."""

DECISIONS = {"as trained": None, "lines thinner": 0.75}
"""What `unet.predict` takes as `unweighted`, by words. The number was chosen on held-out tile pictures."""

_TESTED = 32  # maps of a test


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("photographs", __doc__)
    parser.add_argument("--recipes", nargs="+", default=list(RECIPES), metavar="NAME", help=f"of {', '.join(RECIPES)}")
    parser.add_argument("--photographs", type=Path, default=PHOTOGRAPHS, metavar="DIR", help="the tile set to test on")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="of everything random; default 0")
    out = Path("results/photographs")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to test the program")
    options = parser.parse_args(arguments)
    return run("photographs", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax")
    if unknown := [name for name in options.recipes if name not in RECIPES]:
        raise InputError(f"recipes: expected some of {', '.join(RECIPES)}, got {unknown[0]!r}")
    tests = {"held out": split_tiles(options.seed)[1], "photographs": load_tiles(options.photographs)}
    settings = {"program": "photographs", "version": __version__, "seed": options.seed, "quick": options.quick}
    open_results(options.out, settings | {"photographs": tests["photographs"].name})
    use_compile_cache()
    rows = []
    for name in options.recipes:
        recipe = RECIPES[name]
        if options.quick:
            recipe = recipe._replace(steps=2, drawings=4)
        found = kept(options.out / f"{name}.json", partial(_measure, recipe, options.seed, tests, options.out / name))
        for ways, ious in found.items():
            cells = [f"{iou:.3f}" for iou in ious]
            rows.append([recipe.words, *ways.split(", "), *cells, f"**{np.mean(ious[1:]):.3f}**"])
        text = table(["trained with", "decision", "test", *LABELS, "mean without background"], rows, left=3)
        print(text, flush=True)
    write(options.out / "photographs.md", text)


def _measure(recipe: Recipe, seed: int, tests: dict[str, TileSet], sheet: Path) -> dict[str, list[float]]:
    """Trains by a recipe; returns the IoU of each class by decision and test, and writes a picture of labels found."""
    from experiments.perception.unet import confusion, ious, predict, train

    seen = split_tiles(seed)[0]
    sets = [replace(shift_lines(seen, shift), blend=bool(index % 2)) for index, shift in enumerate(recipe.shifts)]
    pictures = draw_maps(_maps(recipe.drawings, 2 * seed, seen), sets, seed, recipe.tile_px, recipe.views)
    weights = train(*pictures, len(LABELS), seed, steps=recipe.steps)
    shares = np.bincount(pictures.labels.ravel(), minlength=len(LABELS)) / pictures.labels.size
    found, shown = {}, []
    for test, tiles in tests.items():
        grids = _maps(_TESTED, 2 * seed + 1, tests["held out"])
        true = draw_maps(grids, [tiles], 1000 + seed, recipe.tile_px)
        for words, unweighted in DECISIONS.items():
            labels = predict(weights, true.image, len(LABELS), shares=shares, unweighted=unweighted)
            found[f"{words}, {test}"] = ious(confusion(true.labels, labels, len(LABELS))).tolist()
        colours = np.array(LABEL_COLOURS, np.uint8)
        shown.append(np.hstack([true.image[0], colours[true.labels[0]], colours[labels[0]]]))
    cv2.imwrite(str(sheet.with_suffix(".png")), np.vstack(shown)[..., ::-1])
    return found


def _maps(count: int, seed: int, tiles: TileSet) -> NDArray[np.int8]:
    return make_maps("wfc", count, seed, tiles.alphabet, 0)


if __name__ == "__main__":
    leave(main())
