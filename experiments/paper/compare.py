"""Repeats the paper's study: all methods side by side, next to the paper's figures.

    python -m experiments.paper.compare [--methods ...] [--sizes 12 9x14 ...] [--seeds N | --paper] [--reading NAME]

A search evaluates 40 grids in each of 200 generations. All seeds of a method run in one compiled call. WFC makes one
grid for each seed. The folder of results keeps every finished run: after an interruption, the same command continues.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elitelanes_jax import __version__
from elitelanes_jax.formats import RoadMap
from elitelanes_jax.network import Metrics
from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import load_tiles, render
from experiments.common import Parser, add_cores, leave, open_results, run, save, to_csv, whole, write
from experiments.paper.figures import plot_comparison
from experiments.paper.published import SHAPE
from experiments.paper.readings import READINGS
from experiments.paper.runs import METHODS, Row, Runs, Settings, kept_runs
from experiments.paper.tables import make_tables, timing_table

_PICTURED = (14, 14)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("compare", __doc__)
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS, help="default all")
    parser.add_argument("--sizes", nargs="+", type=_size, default=[SHAPE], metavar="SIZE", help="such as 12 or 9x14")
    runs = parser.add_mutually_exclusive_group()
    seeds = "runs of each method; default 32"
    runs.add_argument("--seeds", type=whole(1, 2**20), default=32, metavar="N", help=seeds)
    runs.add_argument("--paper", action="store_const", dest="seeds", const=4, help="4 runs, as in the paper")
    parser.add_argument("--seed", type=whole(0, 2**32 - 1), default=0, metavar="N", help="random seed; default 0")
    generations = "generations of 40 grids; default 200"
    parser.add_argument("--generations", type=whole(1), default=200, metavar="N", help=generations)
    parser.add_argument("--reading", default="ours", choices=READINGS, help="of the paper's text; default ours")
    add_cores(parser)
    out = Path("results/compare")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    parser.add_argument("--no-maps", action="store_true", help="draw no 14 x 14 maps")
    options = parser.parse_args(arguments)
    return run("compare", lambda: _compare(options))


def _size(text: str) -> tuple[int, int]:
    try:
        sides = [int(side) for side in text.split("x")]
        height, width = sides * 2 if len(sides) == 1 else sides
        if not 2 <= min(sides) <= max(sides) <= 1024:
            raise ValueError
        return height, width
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a size, 12 or 9x14, sides from 2 to 1024, got {text!r}") from None


def _compare(options: argparse.Namespace) -> None:
    options.methods = [method for method in METHODS if method in options.methods]
    options.sizes = list(dict.fromkeys(options.sizes))
    settings = Settings(options.seeds, options.seed, options.generations, READINGS[options.reading])
    names = ("methods", "sizes", "seeds", "seed", "generations", "reading")
    command = {"program": "compare", "version": __version__} | {name: getattr(options, name) for name in names}
    open_results(options.out, command | {"maps": not options.no_maps})
    use_compile_cache()
    began = time.perf_counter()
    rows: list[Row] = []
    tables, times = [], []
    for shape in options.sizes:
        size = f"{shape[0]}x{shape[1]}"
        of_size, timings = [], {}
        for method in options.methods:
            file = options.out / "runs" / f"{method}-{size}.json"
            found = kept_runs(file, method, shape, settings, alone=True)
            of_size += found.rows
            timings[method] = found.timing
            succeeded = sum(row.elite == "best" for row in found.rows)
            print(
                f"{method} {size}: {succeeded} of {settings.seeds} runs succeeded, {found.timing['all seeds']:.2f} s",
                flush=True,
            )
        title = f"{shape[0]} x {shape[1]} tiles, {settings.seeds} seeds, {settings.generations} generations of 40"
        suffix = "" if len(options.sizes) == 1 else f"_{size}"
        save(plot_comparison(of_size, title), options.out / f"comparison{suffix}.png")
        tables.append(make_tables(of_size, title))
        times.append(timing_table(timings, title, settings.seeds))
        rows += of_size
    write(options.out / "results.csv", to_csv([row.flat() for row in rows]))
    write(options.out / "tables.md", "\n".join(tables))
    write(options.out / "timing.md", "\n".join(times))
    if not options.no_maps:
        _draw_maps(options.methods, settings, options.out)
    print(f"{len(rows)} rows in {options.out / 'results.csv'}, {time.perf_counter() - began:.0f} s")


def _best_maps(found: Runs, seed: int) -> list[RoadMap]:
    """Returns the best map of each run that succeeded, with its metrics."""
    maps = []
    for row in found.rows:
        if row.elite == "best":
            codes = np.array(found.best[row.seed], np.int8)
            metrics = {name: value for name, value in row.values.items() if name in Metrics._fields}
            maps.append(RoadMap(codes, metrics, round(row.values["fitness"]), seed=(seed, row.seed)))
    return maps


def _draw_maps(methods: Sequence[str], settings: Settings, out: Path) -> None:
    """Draws the best 14 x 14 map of each method. Repair fills, because no tile picture shows a dead end."""
    tiles = load_tiles()
    settings = settings._replace(reading=settings.reading._replace(fill=True))
    for method in methods:
        found = kept_runs(out / "runs" / f"{method}-pictured.json", method, _PICTURED, settings)
        if best := _best_maps(found, settings.seed):
            road_map = min(best, key=lambda one: one.fitness or 0)
            folder = out / f"maps_{_PICTURED[0]}x{_PICTURED[1]}" / method
            folder.mkdir(parents=True, exist_ok=True)
            render(road_map, tiles, tile_px=64, seed=settings.seed).save(folder)
            write(folder / "map.json", road_map.to_json())


if __name__ == "__main__":
    leave(main())
