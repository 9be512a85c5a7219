"""The paper's study: all methods side by side, and the paper's figures beside ours.

    python experiments/compare.py [--methods ...] [--sizes 12 9x14 ...] [--seeds N | --paper] [--reading NAME]

Each search has 200 generations of 40 grids, and all seeds of a method run in one compiled call. WFC makes one grid for
each seed. The folder of results keeps every finished run: after an interruption, the same command continues from there.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from figures import comparison, save
from readings import READINGS
from report import tables, timing_tables
from results_folder import open_results
from runs import kept_runs
from settings import add_settings, checked_settings

from elitelanes_jax import Result
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax.cli.arguments import Parser
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.explorer import collect_results, page_of
from elitelanes_jax.formats import RoadMap, map_to_json, table_to_csv
from elitelanes_jax.network import Metrics
from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import load_tiles, render, write_picture

_PICTURED = (14, 14)
_MOST_BYTES = 8 * 2**20  # of the page to explore


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="compare", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_settings(parser, sizes=[(12, 12)], seeds=32, out="results/compare")
    parser.add_argument("--no-maps", action="store_true", help="leave out the pictures of 14 x 14 tiles")
    options = parser.parse_args(arguments)
    return guarded("compare", lambda: _compare(options), interrupted="what is done is kept; start again to continue")


def _compare(options: argparse.Namespace) -> int:
    open_results(options.out, checked_settings("compare", options) | {"maps": not options.no_maps})
    use_compile_cache()
    began = time.perf_counter()
    rows: list[dict[str, Any]] = []
    shown: dict[str, Result | list[RoadMap]] = {}
    texts, times = [], []
    for shape in options.sizes:
        name = f"{shape[0]}x{shape[1]}"
        here, timings = [], {}
        for method in options.methods:
            file = options.out / "runs" / f"{method}-{name}.json"
            found = kept_runs(file, method, shape, options, READINGS[options.reading], alone=True)
            here += found["rows"]
            archive = file.with_suffix(".npz")
            shown[f"{method} {name}"] = Result.load(archive) if archive.exists() else _best_maps(found, options.seed)
            timings[method] = found["timing"]
            succeeded = sum(row["elite"] == "best" for row in found["rows"])
            say(f"{method} {name}: {succeeded} of {options.seeds} runs succeeded, {found['timing']['all seeds']:.2f} s")
        title = f"{shape[0]} x {shape[1]} tiles, {options.seeds} seeds, {options.generations} generations of 40"
        last = "" if len(options.sizes) == 1 else f"_{name}"
        for kind in ("pdf", "png"):
            save(comparison(here, title), options.out / f"comparison{last}.{kind}")
        texts.append(tables(here, title))
        times.append(timing_tables(timings, title, options.seeds))
        rows += here
    write_atomic(options.out / "results.csv", table_to_csv(rows).encode())
    write_atomic(options.out / "tables.md", "\n".join(texts).encode())
    write_atomic(options.out / "timing.md", "\n".join(times).encode())
    if not options.no_maps:
        _draw_maps(options)
    say(f"{len(rows)} rows in {options.out / 'results.csv'}, {time.perf_counter() - began:.0f} s")
    if shown := {name: one for name, one in shown.items() if one}:
        say(_write_page(shown, options.seeds, options.out / "explore.html"))
    return 0


def _write_page(shown: Mapping[str, Result | Sequence[RoadMap]], seeds: int, page: Path) -> str:
    """Writes the page of all archives, of as many seeds as fit; returns what it shows."""
    content = page_of(collect_results(shown)).encode()
    count = seeds
    while len(content) > _MOST_BYTES and count > 1:
        count //= 2
        content = page_of(collect_results(shown, seeds=count)).encode()
    write_atomic(page, content)
    fewer = "" if count == seeds else " of the first seed" if count == 1 else f" of the first {count} seeds"
    return f"{page} shows all maps{fewer}"


def _best_maps(found: dict[str, Any], seed: int) -> list[RoadMap]:
    """Returns the best map of each run of a method that succeeded, with its metrics."""
    maps = []
    for row in found["rows"]:
        if row["elite"] == "best":
            codes = np.array(found["best"][row["seed"]], np.int8)
            figures = {name: value for name, value in row.items() if name in Metrics._fields}
            maps.append(RoadMap(codes, figures, round(row["fitness"]), seed=(seed, row["seed"])))
    return maps


def _draw_maps(options: argparse.Namespace) -> None:
    """Draws the best map of each method at 14 x 14. Repair fills, because no tile picture shows a dead end."""
    tiles, reading = load_tiles(), READINGS[options.reading]._replace(fill=True)
    for method in options.methods:
        runs = kept_runs(options.out / "runs" / f"{method}-pictured.json", method, _PICTURED, options, reading)
        best = _best_maps(runs, options.seed)
        if not best:
            continue
        road_map = min(best, key=lambda one: one.fitness or 0)
        place = options.out / f"maps_{_PICTURED[0]}x{_PICTURED[1]}" / method
        place.mkdir(parents=True, exist_ok=True)
        write_picture(place, render(road_map, tiles, tile_px=64, seed=options.seed))
        write_atomic(place / "map.json", map_to_json(road_map).encode())


if __name__ == "__main__":
    leave(main)
