"""Repeats the paper's study: all methods side by side, next to the paper's figures.

    python -m experiments.paper.compare [--methods ...] [--sizes 12 9x14 ...] [--seeds N | --paper] [--reading NAME]

A search evaluates 40 grids in each of 200 generations. All seeds of a method run in one compiled call. WFC makes one
grid for each seed. The folder of results keeps every finished run: after an interruption, the same command continues.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from elitelanes_jax import Result
from elitelanes_jax.explorer import collect_results, page_of
from elitelanes_jax.formats import RoadMap, map_to_json, table_to_csv
from elitelanes_jax.network import Metrics
from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import load_tiles, render, write_picture
from experiments.common import Parser, leave, open_results, run, save, write
from experiments.paper.arguments import add_arguments, check_arguments
from experiments.paper.figures import plot_comparison
from experiments.paper.runs import Row, Runs, Settings, kept_runs
from experiments.paper.tables import make_tables, timing_table

_PICTURED = (14, 14)
_MOST_BYTES = 8 * 2**20  # of the explorer's page


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("compare", __doc__)
    add_arguments(parser, sizes=[(12, 12)], seeds=32, out="results/compare")
    parser.add_argument("--no-maps", action="store_true", help="draw no 14 x 14 maps")
    options = parser.parse_args(arguments)
    return run("compare", lambda: _compare(options))


def _compare(options: argparse.Namespace) -> None:
    settings, command = check_arguments("compare", options)
    open_results(options.out, command | {"maps": not options.no_maps})
    use_compile_cache()
    began = time.perf_counter()
    rows: list[Row] = []
    shown: dict[str, Result | list[RoadMap]] = {}
    tables, times = [], []
    for shape in options.sizes:
        size = f"{shape[0]}x{shape[1]}"
        of_size, timings = [], {}
        for method in options.methods:
            file = options.out / "runs" / f"{method}-{size}.json"
            found = kept_runs(file, method, shape, settings, alone=True)
            of_size += found.rows
            archive = file.with_suffix(".npz")
            shown[f"{method} {size}"] = Result.load(archive) if archive.exists() else _best_maps(found, settings.seed)
            timings[method] = found.timing
            succeeded = sum(row.elite == "best" for row in found.rows)
            print(
                f"{method} {size}: {succeeded} of {settings.seeds} runs succeeded, {found.timing['all seeds']:.2f} s",
                flush=True,
            )
        title = f"{shape[0]} x {shape[1]} tiles, {settings.seeds} seeds, {settings.generations} generations of 40"
        suffix = "" if len(options.sizes) == 1 else f"_{size}"
        for kind in ("pdf", "png"):
            save(plot_comparison(of_size, title), options.out / f"comparison{suffix}.{kind}")
        tables.append(make_tables(of_size, title))
        times.append(timing_table(timings, title, settings.seeds))
        rows += of_size
    write(options.out / "results.csv", table_to_csv([row.flat() for row in rows]))
    write(options.out / "tables.md", "\n".join(tables))
    write(options.out / "timing.md", "\n".join(times))
    if not options.no_maps:
        _draw_maps(options.methods, settings, options.out)
    print(f"{len(rows)} rows in {options.out / 'results.csv'}, {time.perf_counter() - began:.0f} s")
    if shown := {name: one for name, one in shown.items() if one}:
        print(_write_page(shown, settings.seeds, options.out / "explore.html"))


def _write_page(shown: Mapping[str, Result | Sequence[RoadMap]], seeds: int, page: Path) -> str:
    """Writes the explorer's page with the archives of as many seeds as fit; returns what it shows."""
    content = page_of(collect_results(shown)).encode()
    count = seeds
    while len(content) > _MOST_BYTES and count > 1:
        count //= 2
        content = page_of(collect_results(shown, seeds=count)).encode()
    write(page, content)
    fewer = "" if count == seeds else " of the first seed" if count == 1 else f" of the first {count} seeds"
    return f"{page} shows all maps{fewer}"


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
            write_picture(folder, render(road_map, tiles, tile_px=64, seed=settings.seed))
            write(folder / "map.json", map_to_json(road_map))


if __name__ == "__main__":
    leave(main())
