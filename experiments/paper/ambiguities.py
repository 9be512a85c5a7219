"""Repeats the paper's tables under other readings of its text (see `readings.py`).

    python -m experiments.paper.ambiguities [--seeds N] [--generations N]

Each reading changes one thing. A table shows how far its results are from the paper's. For all results of one reading:
`python -m experiments.paper.compare --reading NAME --out results/NAME`.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from elitelanes_jax import InputError
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, open_results, run, table, write
from experiments.paper.arguments import add_arguments, check_arguments
from experiments.paper.published import METRICS, SHAPE, TABLE
from experiments.paper.readings import READINGS
from experiments.paper.runs import Row, kept_runs
from experiments.paper.tables import group_rows

# The metrics that distinguish readings: their values in the paper are neither 0 nor 1.
_TELLING = ("cyclomatic", "adjacent_crossing_score", "crossings", "straight_score", "adjacent_turns")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("ambiguities", __doc__)
    add_arguments(parser, sizes=[SHAPE], seeds=32, out="results/ambiguities")
    options = parser.parse_args(arguments)
    return run("ambiguities", lambda: _compare_readings(options))


def _compare_readings(options: argparse.Namespace) -> None:
    settings, command = check_arguments("ambiguities", options)
    if options.sizes != [SHAPE]:
        raise InputError(f"sizes: expected 12 x 12 alone, the size of the paper's tables, got {options.sizes}")
    if options.reading != "ours":
        raise InputError(f"reading: expected none, because all readings are run, got {options.reading!r}")
    if options.methods == ["wfc"]:
        raise InputError("methods: expected a search, because WFC is the same under all readings, got wfc alone")
    open_results(options.out, command)
    use_compile_cache()
    lines = []
    for name, reading in READINGS.items():
        for method in options.methods:
            if method == "wfc" or (reading.configs and method not in reading.configs):
                continue
            file = options.out / "runs" / f"{name}-{method}.json"
            rows = kept_runs(file, method, SHAPE, settings._replace(reading=reading)).rows
            lines += [[f"`{name}`", group, *_cells(held)] for group, held in group_rows(rows).items()]
        print(f"{name}: {reading.about}", flush=True)
    title = f"{SHAPE[0]} x {SHAPE[1]} tiles, {settings.seeds} seeds, {settings.generations} generations of 40"
    text = f"# {title}\n\n" + table(["reading", "", *METRICS.values(), "off the paper by"], lines)
    write(options.out / "ambiguities.md", text)
    print(f"{len(lines)} rows in {options.out / 'ambiguities.md'}")


def _cells(rows: Sequence[Row]) -> list[str]:
    """Returns the means, and their distance from the paper's: the mean of |ours / paper - 1| over `_TELLING`."""
    means = {metric: float(np.mean([row.values[metric] for row in rows])) for metric in METRICS}
    published = TABLE[rows[0].method]
    off = np.mean([abs(means[metric] / published[metric].mean - 1) for metric in _TELLING])
    return [*(f"{mean:.1f}" if mean >= 10 else f"{mean:.2f}" for mean in means.values()), f"{off:.0%}"]


if __name__ == "__main__":
    leave(main())
