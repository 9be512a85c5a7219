"""All methods on larger maps with the same budget: quality a tile, and time.

    python experiments/scaling.py [--methods ...] [--sizes 8 12 ...] [--seeds N] [--generations N]

Finished runs are kept as `compare.py` keeps them.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from figures import save, scaling
from paper import METHODS
from readings import READINGS
from report import table
from results_folder import open_results
from runs import kept_runs
from settings import add_settings, checked_settings

from elitelanes_jax._util.files import write_atomic
from elitelanes_jax.cli.arguments import Parser
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.formats import table_to_csv
from elitelanes_jax.search import use_compile_cache

_SIZES = [(side, side) for side in (8, 12, 16, 24, 32, 48, 64)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="scaling", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_settings(parser, sizes=_SIZES, seeds=8, out="results/scaling")
    options = parser.parse_args(arguments)
    return guarded("scaling", lambda: _scale(options), interrupted="what is done is kept; start again to continue")


def _scale(options: argparse.Namespace) -> int:
    open_results(options.out, checked_settings("scaling", options))
    use_compile_cache()
    rows: list[dict[str, Any]] = []
    for shape in options.sizes:
        for method in options.methods:
            name = f"{method}-{shape[0]}x{shape[1]}"
            file = options.out / "runs" / f"{name}.json"
            found = kept_runs(file, method, shape, options, READINGS[options.reading])
            rows += [row for row in found["rows"] if row["elite"] == "best"]
            say(f"{name}: {options.seeds} runs, {found['timing']['all seeds']:.2f} s")
    write_atomic(options.out / "scaling.csv", table_to_csv(rows).encode())
    title = f"{options.seeds} seeds, {options.generations} generations of 40"
    save(scaling(rows, title), options.out / "scaling.png")
    write_atomic(options.out / "scaling.md", _table(rows, title).encode())
    say(f"{len(rows)} rows in {options.out / 'scaling.csv'}")
    return 0


_COLUMNS = ("fitness", "dead_ends", "components", "cyclomatic", "crossings", "adjacent_turns", "straight_score")


def _table(rows: Sequence[dict[str, Any]], title: str) -> str:
    lines = []
    for method, height, width in dict.fromkeys((row["method"], row["height"], row["width"]) for row in rows):
        held = [row for row in rows if (row["method"], row["height"], row["width"]) == (method, height, width)]
        shares = [np.mean([row[name] for row in held]) / (height * width) for name in _COLUMNS]
        seconds = float(np.median([row["seconds"] for row in held]))
        cells = [f"{share:.1f}" if abs(share) >= 10 else f"{share:.3f}" for share in shares]
        lines.append([METHODS[method], f"{height} x {width}", *cells, f"{seconds:.4f}"])
    head = ["", "size", *(f"{name.replace('_', ' ')} a tile" for name in _COLUMNS), "seconds a run"]
    return f"# {title}\n\nMeans of the best grids; seconds of one run among {title.split()[0]}.\n\n" + table(
        head, lines
    )


if __name__ == "__main__":
    leave(main)
