"""Tables in Markdown: the paper's beside ours, intervals, differences, times."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from paper import METHODS, METRICS, TABLE, is_of_the_papers_size
from significance import bootstrap_interval, compare_all

__all__ = ["label", "selections", "table", "tables", "timing_tables"]

Row = dict[str, Any]

_MORE = {"bridges": "bridges", "fitness": "fitness"}

_BESIDE = """\
Mean (standard deviation); at the paper's size its own below ours, with ✓ where it lies within two standard deviations
of our mean. CO components, DE dead ends, CY cyclomatic number, BV boundary violations, ACV adjacent crossing score, CV
coverage, CR crossings, SR straight score, AT adjacent turns. The paper does not say which elite of MAP-Elites it
tabulates: the tables have the best one and one drawn at random, both beside the same row.
"""
_INTERVALS = """\
## 95 % intervals of the means

Bootstrap, bias-corrected and accelerated, 9999 resamples.
"""
_ARCHIVES = """\
## The archives of MAP-Elites

Means over the seeds. The QD score adds up, over all elites, how far the fitness lies below 480 a tile, that of dead
ends alone.
"""
_DIFFERENCES = """\
## Differences between methods

Rank-biserial correlation: 1 where every run of the first method lies over every run of the second, -1 where below, 0
where neither. In bold where Mann-Whitney's U, two-sided, is significant at 5 % after Holm's correction for all pairs of
a metric. MAP-Elites is represented by a random elite of each run. It shares keys and loop with the EA, so these two
are not independent, although the test assumes it.
"""


def label(method: str, elite: str = "best") -> str:
    """Returns the name of a group of rows in tables and plots."""
    if method != "map-elites":
        return METHODS[method]
    return "MAP-Elites, random elite" if elite == "random" else "MAP-Elites, best elite"


def selections(rows: Sequence[Row]) -> dict[str, tuple[str, list[Row]]]:
    """Groups rows by label, with their method: the best of each run, and a random elite of MAP-Elites."""
    found: dict[str, tuple[str, list[Row]]] = {}
    for row in rows:
        if row["elite"] != "archive":
            found.setdefault(label(row["method"], row["elite"]), (row["method"], []))[1].append(row)
    return found


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Makes a Markdown table; all columns but the first are aligned to the right."""
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def tables(rows: Sequence[Row], title: str) -> str:
    """Makes all tables of the runs of one size."""
    groups = selections(rows)
    parts = [f"# {title}\n"]
    for about, content in (
        (_BESIDE, _beside_the_papers(groups)),
        (_INTERVALS, _intervals(groups)),
        (_ARCHIVES, _archives(rows)),
        (_DIFFERENCES, _differences(groups)),
    ):
        parts += [about, content]
    return "\n".join(parts)


def _beside_the_papers(groups: dict[str, tuple[str, list[Row]]]) -> str:
    lines = []
    for name, (method, rows) in groups.items():
        ours, papers = [name], ["*paper*"]
        for metric in (*METRICS, *_MORE):
            values = np.array([row[metric] for row in rows])
            ours.append(f"{_short(values.mean())} ({_short(values.std(ddof=min(1, values.size - 1)))})")
            if metric in METRICS:
                paper = TABLE[method][metric]
                within = abs(paper.mean - values.mean()) <= 2 * values.std(ddof=min(1, values.size - 1)) + 1e-9
                papers.append(f"{_short(paper.mean)} ({_short(paper.sigma)}){' ✓' if within else ''}")
            else:
                papers.append("")
        lines += [ours, papers] if is_of_the_papers_size(rows[0]) else [ours]
    return table(["", *METRICS.values(), *_MORE.values()], lines)


def _intervals(groups: dict[str, tuple[str, list[Row]]]) -> str:
    lines = []
    for name, (_, rows) in groups.items():
        ends = (bootstrap_interval([row[metric] for row in rows]) for metric in (*METRICS, *_MORE))
        lines.append([name, *(f"{_short(low)} to {_short(high)}" if low < high else _short(low) for low, high in ends)])
    return table(["", *METRICS.values(), *_MORE.values()], lines)


def _archives(rows: Sequence[Row]) -> str:
    held = [row for row in rows if row["elite"] == "archive"]
    if not held:
        return "No runs of MAP-Elites.\n"
    names = {"niches": "niches of 400", "qd_score": "QD score", "fitness": "mean fitness of the elites"} | METRICS
    return table(list(names.values()), [[_short(float(np.mean([row[name] for row in held]))) for name in names]])


def _differences(groups: dict[str, tuple[str, list[Row]]]) -> str:
    # The best elite of MAP-Elites is the EA's best grid: counting it would correct for comparisons of equal samples.
    groups = {name: group for name, group in groups.items() if len(group[1]) > 1 and name != label("map-elites")}
    if len(groups) < 2:
        return "Too few runs to compare.\n"
    columns = {
        metric: compare_all({name: [row[metric] for row in rows] for name, (_, rows) in groups.items()})
        for metric in (*METRICS, *_MORE)
    }
    lines = []
    for one, other in next(iter(columns.values())):
        line = [f"{one} over {other}"]
        for comparisons in columns.values():
            effect, p = comparisons[one, other]
            line.append(f"**{effect:.2f}**" if p < 0.05 else f"{effect:.2f}")
        lines.append(line)
    return table(["", *METRICS.values(), *_MORE.values()], lines)


def timing_tables(timings: dict[str, dict[str, float]], title: str, seeds: int) -> str:
    """Makes a table of the seconds of each method, and their ratio to WFC's."""
    unit = timings.get("wfc", {}).get("a seed alone")
    lines = []
    for method, timing in sorted(timings.items(), key=lambda item: item[1]["a seed alone"]):
        alone = timing["a seed alone"]
        lines.append(
            [
                METHODS[method],
                f"{alone:.4f}",
                f"{alone / unit:.1f}" if unit else "",
                f"{timing['a seed among them']:.4f}",
                f"{timing['all seeds']:.3f}",
                f"{timing['first call, compiling']:.2f}" if "first call, compiling" in timing else "",
            ]
        )
    head = [
        "",
        "a seed alone, s",
        "times WFC's",
        f"a seed among {seeds}, s",
        f"all {seeds} seeds, s",
        "with compiling, s",
    ]
    return f"# {title}\n\nA run of a search is 40 grids a generation; one of WFC is one grid.\n\n" + table(head, lines)


def _short(value: float) -> str:
    if value == round(value):
        return f"{value:.0f}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"
