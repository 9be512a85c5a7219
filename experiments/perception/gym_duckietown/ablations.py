"""What of the data matters in gym-duckietown? The same training, with one variation less each time.

    python -m experiments.perception.gym_duckietown.ablations PICTURES --out FOLDER [--views N] [--steps N] [--seeds N]

PICTURES is a file of `pictures`, of development maps. FOLDER keeps each run: after an interruption, the same command
continues, and more seeds add runs. Each seed has its own maps, views, first weights and batches.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from elitelanes_jax import load_tiles
from elitelanes_jax.dataset import DatasetSpec, draw_sample
from elitelanes_jax.maps import furnish
from elitelanes_jax.tiles import load_objects
from experiments.common import Parser, kept, leave, open_results, run, table, whole, write
from experiments.perception.gym_duckietown.evaluate import errors_of
from experiments.perception.gym_duckietown.nets import find_poses
from experiments.perception.gym_duckietown.pictures import KINDS, Pictures, read_pictures
from experiments.perception.gym_duckietown.train import Views, train
from experiments.perception.gym_duckietown.world import our_towns

__all__ = ["CONDITIONS", "Condition", "draw_views", "main", "report"]

_MAPS, _SIZE, _EVALUATIONS, _BATCH = 40, 7, 2000, 32
_BASE = DatasetSpec().replace(transforms=["varied", "blur=0.5"], camera=["rows=120", "columns=160", "lines=0.07"])


class Condition(NamedTuple):
    """What differs from the base, and what we expected before the first run.

    Attributes:
      words: its description.
      expected: the change of the offset's median error, in all pictures unless it says otherwise.
      style: of the maps.
      maps: their number.
      pictures: of each kind of tile, at most.
      transforms: other values of `Transforms`.
      camera: other values of `Viewpoints`.
      furnish: the objects on the maps, see `elitelanes_jax.furnish`.
    """

    words: str
    expected: str
    style: str = "town"
    maps: int = _MAPS
    pictures: int = 99
    transforms: Mapping[str, float] = {}
    camera: Mapping[str, float] = {}
    furnish: Sequence[str] = ()


_LIGHT = ("light", "contrast", "colour", "shadow", "vignette", "gamma", "saturation", "warmth")
_LENS = ("blur", "noise", "motion", "compression")

CONDITIONS = {
    "base": Condition("all variations", ""),
    "map": Condition("1 map", "-5 to +5 %: all maps have the same tiles", maps=1),
    "paper": Condition("maps of the style paper", "0 to +10 %: they have fewer straight roads", style="paper"),
    "picture": Condition("1 picture of each kind of tile", "+5 to +15 %", pictures=1),
    "light": Condition("plain light", "+20 % or more", transforms=dict.fromkeys(_LIGHT, 0)),
    "background": Condition("plain background", "+10 % or more", transforms={"background": 0}),
    "lens": Condition(
        "no blur, noise and compression",
        "-5 to +5 %: gym-duckietown's pictures are sharp",
        transforms=dict.fromkeys(_LENS, 0),
    ),
    "wobble": Condition(
        "one height, pitch and field of view", "-10 to 0 %: they are exactly ours", camera={"wobble": 0}
    ),
    "lines": Condition("white lines at one place", "+10 to +30 %", camera={"lines": 0}),
    "objects": Condition(
        "towns with objects", "-10 to 0 %: 37 % of the pictures show maps with objects", furnish=["all"]
    ),
}
"""The conditions by name."""


@cache
def _maps(style: str, seed: int) -> list[NDArray[np.int8]]:
    return our_towns(_SIZE, _MAPS, seed, _EVALUATIONS, style=style)


def draw_views(condition: Condition, count: int, seed: int) -> Views:
    """Draws the views of a condition, as `elitelanes dataset --camera` does."""
    tiles, codes = load_tiles(), _maps(condition.style, seed)[: condition.maps]
    kinds = [tile.name.rpartition("_")[0] for tile in tiles.tiles]
    few = [tile for at, tile in enumerate(tiles.tiles) if kinds[:at].count(kinds[at]) < condition.pictures]
    drawn = replace(tiles, tiles=tuple(few))
    assert _BASE.camera is not None
    draw = partial(
        draw_sample,
        tiles=drawn,
        seed=seed,
        tile_px=96,
        transforms=_BASE.transforms.replace(**condition.transforms),
        camera=_BASE.camera.replace(**condition.camera),
        objects=load_objects(),
    )
    maps = [furnish(one, condition.furnish, seed=index) for index, one in enumerate(codes)]
    samples = [draw(maps[index % len(maps)], index=index) for index in range(count)]
    images, labels = (np.stack([one.layers[name] for one in samples]) for name in ("image", "labels"))
    lanes = [[one.record["nearest"][name] for name in ("d", "phi", "curvature")] for one in samples]
    return Views(images, labels.astype(np.uint8), np.array(lanes, np.float32))


def _measure(
    condition: Condition, pictures: Pictures, options: argparse.Namespace, seed: int
) -> dict[str, list[float]]:
    """Trains a network and returns the medians of its errors, in centimetres and radians, by kind of tile."""
    views, checkpoint = draw_views(condition, options.views, seed), options.out / "checkpoint"
    weights = train("pose", views, options.steps, seed, checkpoint, lambda _: None, batch=_BATCH)
    checkpoint.unlink()
    errors = errors_of(pictures, find_poses(jax.device_get(weights), pictures.images))
    parts = {"all": pictures.kinds >= 0} | {kind: pictures.kinds == index for index, kind in enumerate(KINDS)}
    return {part: np.median(errors[which], axis=0).tolist() for part, which in parts.items()}


def report(found: Mapping[str, Sequence[Mapping[str, Sequence[float]]]]) -> str:
    """Makes a table of the errors, and of their changes with 95 % intervals.

    Changes are between the runs of a condition and those of the base with the same seeds, in logarithms.

    Args:
      found: by condition, and in it by seed, the medians of the errors of the offset and the angle, by kind of tile.
    """
    rows = []
    for name, runs in found.items():
        medians = np.array([[one["all"][0], one["all"][1], one["curve"][0]] for one in runs])
        row = [CONDITIONS[name].words, str(len(runs)), *(f"{value:.3g}" for value in medians.mean(axis=0))]
        base = np.array([[one["all"][0], one["all"][1], one["curve"][0]] for one in found["base"]])
        if name == "base" or len(runs) < 2:
            rows.append([*row, "", "", "", CONDITIONS[name].expected])
            continue
        change = np.log(medians / base[: len(runs)])
        reach = t.ppf(0.975, len(runs) - 1) * change.std(axis=0, ddof=1) / np.sqrt(len(runs))
        mean, low, high = (
            np.exp(part) - 1 for part in (change.mean(axis=0), *(change.mean(axis=0) + s * reach for s in (-1, 1)))
        )
        shown = [f"{m:+.0%} ({a:+.0%} to {b:+.0%})" for m, a, b in zip(mean, low, high, strict=True)]
        rows.append([*row, *shown, CONDITIONS[name].expected])
    measures = ["offset, cm", "angle, rad", "offset on curves, cm"]
    return table(
        ["trained on", "runs", *measures, *(f"change: {one}" for one in ("offset", "angle", "on curves")), "expected"],
        rows,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("ablations", __doc__)
    parser.add_argument("pictures", type=Path, metavar="PICTURES")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="of runs and the table")
    parser.add_argument("--views", type=whole(1), default=600, metavar="N", help="of each run; default 600")
    parser.add_argument("--steps", type=whole(1), default=200, metavar="N", help="of each training; default 200")
    parser.add_argument("--seeds", type=whole(1), default=3, metavar="N", help="default 3")
    parser.add_argument("--conditions", nargs="+", choices=CONDITIONS, default=list(CONDITIONS), metavar="NAME")
    options = parser.parse_args(arguments)
    return run("ablations", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    open_results(options.out, {"views": options.views, "steps": options.steps, "pictures": options.pictures.name})
    pictures, found = read_pictures(options.pictures), dict[str, list[dict[str, list[float]]]]()
    for seed in range(options.seeds):
        for name in dict.fromkeys(["base", *options.conditions]):
            file = options.out / f"{name}-{seed}.json"
            one = kept(file, lambda: _measure(CONDITIONS[name], pictures, options, seed))  # noqa: B023, called at once
            found.setdefault(name, []).append(one)
            print(name, seed, one["all"], flush=True)
    text = report(found)
    print(text)
    write(options.out / "ablations.md", text)


if __name__ == "__main__":
    leave(main())
