"""Tables in Markdown: our results next to the paper's, intervals, times."""

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.common import bootstrap_interval, table
from experiments.paper.published import METHODS, METRICS, SHAPE, TABLE
from experiments.paper.runs import Row

__all__ = ["group_rows", "make_tables", "timing_table"]

_COLUMNS = METRICS | {"bridges": "bridges", "fitness": "fitness"}

_MEANS = """\
Mean (standard deviation). At the paper's size, the paper's values are below ours. A ✓ marks a mean of the paper within
two standard deviations of ours. CO components, DE dead ends, CY cyclomatic number, BV boundary violations, ACV adjacent
crossing score, CV coverage, CR crossings, SR straight score, AT adjacent turns. The paper does not say which elite of
MAP-Elites it tabulates. Both the best one and one drawn at random are compared with the paper's row.
"""
_INTERVALS = """\
## 95 % intervals of the means

Bootstrap, bias-corrected and accelerated, 9999 resamples.
"""
_ARCHIVES = """\
## The archives of MAP-Elites

Means over the seeds. The QD score is a sum over all elites: 480 per tile, the fitness of a grid of dead ends, minus the
elite's fitness.
"""


def group_rows(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Groups rows by their name in tables: the best of each run, and a random elite of MAP-Elites."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        if row.elite != "archive":
            name = METHODS[row.method] + (f", {row.elite} elite" if row.method == "map-elites" else "")
            groups.setdefault(name, []).append(row)
    return groups


def make_tables(rows: Sequence[Row], title: str) -> str:
    """Makes all tables of the runs of one size."""
    groups = group_rows(rows)
    return "\n".join(
        [
            f"# {title}\n",
            *(_MEANS, _means(groups)),
            *(_INTERVALS, _intervals(groups)),
            *(_ARCHIVES, _archives(rows)),
        ]
    )


def _means(groups: Mapping[str, Sequence[Row]]) -> str:
    lines = []
    for name, rows in groups.items():
        ours, papers = [name], ["*paper*"]
        for metric in _COLUMNS:
            values = np.array([row.values[metric] for row in rows])
            mean, deviation = values.mean(), values.std(ddof=min(1, values.size - 1))
            ours.append(f"{_rounded(mean)} ({_rounded(deviation)})")
            published = TABLE[rows[0].method].get(metric)
            if published is not None:
                mark = " ✓" if abs(published.mean - mean) <= 2 * deviation + 1e-9 else ""
                papers.append(f"{_rounded(published.mean)} ({_rounded(published.sigma)}){mark}")
            else:
                papers.append("")
        lines += [ours, papers] if (rows[0].height, rows[0].width) == SHAPE else [ours]
    return table(["", *_COLUMNS.values()], lines)


def _intervals(groups: Mapping[str, Sequence[Row]]) -> str:
    lines = []
    for name, rows in groups.items():
        ends = (bootstrap_interval([row.values[metric] for row in rows]) for metric in _COLUMNS)
        texts = (f"{_rounded(low)} to {_rounded(high)}" if low < high else _rounded(low) for low, high in ends)
        lines.append([name, *texts])
    return table(["", *_COLUMNS.values()], lines)


def _archives(rows: Sequence[Row]) -> str:
    archives = [row.values for row in rows if row.elite == "archive"]
    if not archives:
        return "No runs of MAP-Elites.\n"
    names = {"niches": "niches of 400", "qd_score": "QD score", "fitness": "mean fitness of the elites"} | METRICS
    means = [_rounded(float(np.mean([values[name] for values in archives]))) for name in names]
    return table(list(names.values()), [means])


def timing_table(timings: Mapping[str, Mapping[str, float]], title: str, seeds: int) -> str:
    """Makes a table of the seconds of each method, and their ratio to WFC's."""
    unit = timings.get("wfc", {}).get("a seed alone")
    lines = []
    for method, timing in sorted(timings.items(), key=lambda item: item[1]["a seed alone"]):
        alone, compiling = timing["a seed alone"], timing.get("first call, compiling")
        ratio = f"{alone / unit:.1f}" if unit else ""
        cells = [f"{alone:.4f}", ratio, f"{timing['a seed among them']:.4f}", f"{timing['all seeds']:.3f}"]
        lines.append([METHODS[method], *cells, f"{compiling:.2f}" if compiling else ""])
    head = ["", "a seed alone, s", "times WFC's", f"a seed among {seeds}, s", f"all {seeds} seeds, s"]
    about = "A run of a search evaluates 40 grids in each generation. A run of WFC makes one grid."
    return f"# {title}\n\n{about}\n\n" + table([*head, "with compiling, s"], lines)


def _rounded(value: float) -> str:
    if value == round(value):
        return f"{value:.0f}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"
