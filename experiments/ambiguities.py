"""The paper's tables under other readings of its text (see `readings.py`).

    python experiments/ambiguities.py [--seeds N] [--generations N]

Each reading changes one thing; a table shows how far its results are from the paper's. All results of a single reading:
`python experiments/compare.py --reading NAME --out results/NAME`.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from paper import METRICS, TABLE
from readings import READINGS
from report import selections, table
from results_folder import open_results
from runs import kept_runs
from settings import add_settings, checked_settings

from elitelanes_jax import InputError
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax.cli.arguments import Parser
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.search import use_compile_cache

# The metrics that distinguish readings: those whose values in the paper are neither 0 nor 1.
_TELLING = ("cyclomatic", "adjacent_crossing_score", "crossings", "straight_score", "adjacent_turns")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="ambiguities", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_settings(parser, sizes=[(12, 12)], seeds=32, out="results/ambiguities")
    options = parser.parse_args(arguments)
    return guarded("ambiguities", lambda: _read(options), interrupted="what is done is kept; start again to continue")


def _read(options: argparse.Namespace) -> int:
    settings = checked_settings("ambiguities", options)
    if len(options.sizes) > 1 or options.sizes[0] != (12, 12):
        raise InputError(f"sizes: expected 12 x 12 alone, the size of the paper's tables, got {options.sizes}")
    if options.reading != "ours":
        raise InputError(f"reading: expected none, as all are run, got {options.reading!r}")
    if set(options.methods) == {"wfc"}:
        raise InputError("methods: expected a search, as WFC is the same under all readings, got wfc alone")
    open_results(options.out, settings)
    use_compile_cache()
    (shape,) = options.sizes
    lines = []
    for name, reading in READINGS.items():
        for method in options.methods:
            if method == "wfc" or (reading.configs and method not in reading.configs):
                continue
            file = options.out / "runs" / f"{name}-{method}.json"
            rows = kept_runs(file, method, shape, options, reading)["rows"]
            lines += [[f"`{name}`", group, *_cells(held)] for group, (_, held) in selections(rows).items()]
        say(f"{name}: {reading.about}")
    title = f"{shape[0]} x {shape[1]} tiles, {options.seeds} seeds, {options.generations} generations of 40"
    text = f"# {title}\n\n" + table(["reading", "", *METRICS.values(), "off the paper by"], lines)
    write_atomic(options.out / "ambiguities.md", text.encode())
    say(f"{len(lines)} rows in {options.out / 'ambiguities.md'}")
    return 0


def _cells(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Returns the means, and their distance from the paper's: the mean of |ours / paper - 1| over `_TELLING`."""
    means = {metric: float(np.mean([row[metric] for row in rows])) for metric in METRICS}
    papers = TABLE[rows[0]["method"]]
    off = np.mean([abs(means[metric] / papers[metric].mean - 1) for metric in _TELLING])
    return [*(f"{mean:.1f}" if mean >= 10 else f"{mean:.2f}" for mean in means.values()), f"{off:.0%}"]


if __name__ == "__main__":
    leave(main)
