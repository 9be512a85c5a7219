"""Runs all methods on larger maps with the same budget, and measures quality per tile and time.

    python -m experiments.paper.scaling [--methods ...] [--sizes 8 12 ...] [--seeds N] [--generations N]

The folder of results keeps every finished run, as `compare` does.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from elitelanes_jax.formats import table_to_csv
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, open_results, run, save, table, write
from experiments.paper.arguments import add_arguments, check_arguments
from experiments.paper.figures import plot_scaling
from experiments.paper.published import METHODS
from experiments.paper.runs import Row, kept_runs

_SIZES = [(side, side) for side in (8, 12, 16, 24, 32, 48, 64)]

_COLUMNS = ("fitness", "dead_ends", "components", "cyclomatic", "crossings", "adjacent_turns", "straight_score")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("scaling", __doc__)
    add_arguments(parser, sizes=_SIZES, seeds=8, out="results/scaling")
    options = parser.parse_args(arguments)
    return run("scaling", lambda: _scale(options))


def _scale(options: argparse.Namespace) -> None:
    settings, command = check_arguments("scaling", options)
    open_results(options.out, command)
    use_compile_cache()
    rows: list[Row] = []
    for shape in options.sizes:
        for method in options.methods:
            name = f"{method}-{shape[0]}x{shape[1]}"
            found = kept_runs(options.out / "runs" / f"{name}.json", method, shape, settings)
            rows += [row for row in found.rows if row.elite == "best"]
            print(f"{name}: {settings.seeds} runs, {found.timing['all seeds']:.2f} s", flush=True)
    write(options.out / "scaling.csv", table_to_csv([row.flat() for row in rows]))
    title = f"{settings.seeds} seeds, {settings.generations} generations of 40"
    save(plot_scaling(rows, title), options.out / "scaling.png")
    about = f"Means of the best grids; seconds of one run among {settings.seeds}."
    write(options.out / "scaling.md", f"# {title}\n\n{about}\n\n{_table(rows)}")
    print(f"{len(rows)} rows in {options.out / 'scaling.csv'}")


def _table(rows: Sequence[Row]) -> str:
    lines = []
    for group in dict.fromkeys((row.method, row.height, row.width) for row in rows):
        method, height, width = group
        held = [row.values for row in rows if (row.method, row.height, row.width) == group]
        values = [float(np.mean([one[name] for one in held])) / (height * width) for name in _COLUMNS]
        seconds = float(np.median([one["seconds"] for one in held]))
        cells = [f"{value:.1f}" if abs(value) >= 10 else f"{value:.3f}" for value in values]
        lines.append([METHODS[method], f"{height} x {width}", *cells, f"{seconds:.4f}"])
    return table(["", "size", *(f"{name.replace('_', ' ')} a tile" for name in _COLUMNS), "seconds a run"], lines)


if __name__ == "__main__":
    leave(main())
