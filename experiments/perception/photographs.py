"""How well does a network that was trained on drawn tiles label photographs of real tiles from above?

    python -m experiments.perception.photographs [--photographs DIR] [--seed N] [--out DIR]

The tests have other maps than the training, drawn with held-out tile pictures, and with photographs. Nothing is chosen
by photographs. Each is labelled as trained, and with thinner lines.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import LABEL_COLOURS, LABELS, TileSet, load_tiles
from experiments.common import Parser, leave, require, run, table, whole, write
from experiments.perception.segmentation import PHOTOGRAPHS
from experiments.perception.training_sets import draw_maps, make_maps, shift_lines, split_tiles

__all__ = ["main"]

_TILE_PX, _STEPS, _DRAWINGS, _TESTED = 64, 1500, 300, 32

_VIEWS = ("varied", "standard")
_SHIFTS = np.linspace(-0.07, 0.07, 8).tolist()  # of the white lines, in tiles; every second set has blended tiles

DECISIONS = {"as trained": None, "lines thinner": 0.75}
"""What `unet.predict` takes as `unweighted`, by words. The number was chosen on held-out tile pictures."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("photographs", __doc__)
    parser.add_argument("--photographs", type=Path, default=PHOTOGRAPHS, metavar="DIR", help="the tile set to test on")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="of everything random; default 0")
    out = Path("results/photographs")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to test the program")
    options = parser.parse_args(arguments)
    return run("photographs", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax")
    from experiments.perception.unet import confusion, ious, predict, train

    seed, (steps, drawings) = options.seed, (2, 4) if options.quick else (_STEPS, _DRAWINGS)
    seen, held_out = split_tiles(seed)
    tests = {"held out": held_out, "photographs": load_tiles(options.photographs)}
    use_compile_cache()
    sets = [replace(shift_lines(seen, shift), blend=bool(index % 2)) for index, shift in enumerate(_SHIFTS)]
    pictures = draw_maps(_maps(drawings, 2 * seed, seen), sets, seed, _TILE_PX, _VIEWS)
    weights = train(*pictures, len(LABELS), seed, steps=steps)
    shares = np.bincount(pictures.labels.ravel(), minlength=len(LABELS)) / pictures.labels.size
    rows, shown, colours = [], [], np.array(LABEL_COLOURS, np.uint8)
    for test, tiles in tests.items():
        true = draw_maps(_maps(_TESTED, 2 * seed + 1, held_out), [tiles], 1000 + seed, _TILE_PX)
        for words, unweighted in DECISIONS.items():
            labels = predict(weights, true.image, len(LABELS), shares=shares, unweighted=unweighted)
            found = ious(confusion(true.labels, labels, len(LABELS)))
            rows.append([words, test, *(f"{iou:.3f}" for iou in found), f"**{np.mean(found[1:]):.3f}**"])
        shown.append(np.hstack([true.image[0], colours[true.labels[0]], colours[labels[0]]]))
    text = table(["decision", "test", *LABELS, "mean without background"], rows, left=2)
    print(text)
    write(options.out / "photographs.md", text)
    cv2.imwrite(str(options.out / "photographs.png"), np.vstack(shown)[..., ::-1])


def _maps(count: int, seed: int, tiles: TileSet) -> NDArray[np.int8]:
    return make_maps("wfc", count, seed, tiles.alphabet, 0)


if __name__ == "__main__":
    leave(main())
