"""The tables and the picture of all finished rows in a folder of results."""

import json
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from experiments.common import Untyped, bootstrap_interval, save, table, write

__all__ = ["at_end", "with_interval", "write_report"]

_FIGURES = {"mean": "mean", "cvar5": "worst 5 %", "cvar1": "worst 1 %", "worst": "worst", "success": "success"}


def write_report(out: Path) -> bool:
    """Writes ued.md and ued.png; returns whether there is a finished row."""
    rows: dict[str, list[Untyped]] = {}
    for file in sorted((out / "rows").glob("*.json")):
        rows.setdefault(file.name.split(".")[0].replace("-", " "), []).append(json.loads(file.read_text("utf-8")))
    if not rows:
        return False
    parts = ["# RoadUED", _table(rows), _greedy_and_unseen(rows), _loops(rows)]
    stages = [json.loads(file.read_text("utf-8")) for file in sorted((out / "scores").glob("*.json"))]
    if stages:
        parts.append(_scores(stages))
    write(out / "ued.md", "\n".join(part.rstrip() + "\n" for part in parts))
    save(_picture(rows), out / "ued.png")
    return True


def with_interval(values: list[float], digits: int = 4) -> str:
    """Returns the mean, and its 95 % interval over seeds where there are three or more."""
    mean = f"{np.mean(values):.{digits}f}"
    if len(values) < 3:
        return mean
    low, high = bootstrap_interval(values)
    return f"{mean} ({low:.{digits}f} to {high:.{digits}f})"


def at_end(row: Untyped) -> Untyped:
    """Returns the figures of a row at the end of its training."""
    return list(row["curve"].values())[-1]


def _table(rows: dict[str, list[Untyped]]) -> str:
    lines = [
        [
            method,
            str(len(runs)),
            *(with_interval([at_end(row)[figure] for row in runs]) for figure in _FIGURES),
            f"{np.mean([row['seconds']['training'] for row in runs]):.0f}",
        ]
        for method, runs in rows.items()
    ]
    head = ["method", "seeds", *_FIGURES.values(), "seconds"]
    return "Regret of the sampled policy on all levels, and 95 % intervals over seeds.\n\n" + table(head, lines)


def _greedy_and_unseen(rows: dict[str, list[Untyped]]) -> str:
    names = sorted({name for runs in rows.values() for row in runs for name in row["unseen"]})
    head = ["method", "greedy, mean", "greedy, worst 1 %", *names]
    lines = []
    for method, runs in rows.items():
        unseen = [[row["unseen"][name]["mean"] for row in runs if name in row["unseen"]] for name in names]
        greedy = [with_interval([row["greedy"][figure] for row in runs]) for figure in ("mean", "cvar1")]
        lines.append([method, *greedy, *(with_interval(values) if values else "" for values in unseen)])
    return "Regret of the greedy policy, and mean regret of the sampled one on unseen maps.\n\n" + table(head, lines)


def _loops(rows: dict[str, list[Untyped]]) -> str:
    numbers = list(at_end(next(iter(rows.values()))[0])["by_loops"])
    lines = [
        [method, *(with_interval([at_end(row)["by_loops"][number] for row in runs]) for number in numbers)]
        for method, runs in rows.items()
    ]
    return "Mean regret by cyclomatic number.\n\n" + table(["method", *numbers], lines)


def _scores(studies: list[list[Untyped]]) -> str:
    names = list(studies[0][0]["correlation"])
    lines = []
    for stages in zip(*studies, strict=True):
        regret = with_interval([stage["mean_regret"] for stage in stages])
        values = ([stage["correlation"][name] for stage in stages] for name in names)
        lines.append([str(stages[0]["rounds"]), regret, *(with_interval(of, 2) for of in values)])
    head = ["rounds", "mean regret", *(name.replace("_", " ") for name in names)]
    return f"Rank correlation of scores with regret, all levels, {len(studies)} seeds.\n\n" + table(head, lines)


def _picture(rows: dict[str, list[Untyped]]) -> Figure:
    plot, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for method, runs in rows.items():
        rounds = [int(number) for number in runs[0]["curve"]]
        means = np.mean([[stage["mean"] for stage in row["curve"].values()] for row in runs], axis=0)
        (line,) = left.plot(rounds, means, marker="o", markersize=3, label=method)
        quantiles = np.mean([row["quantiles"] for row in runs], axis=0)
        right.plot(quantiles, np.linspace(0, 1, len(quantiles)), color=line.get_color())
    left.set(xlabel="rounds of driving", ylabel="mean regret of all levels")
    right.set(xlabel="regret", ylabel="share of levels", ylim=(0.5, 1.005))
    left.legend(fontsize=8)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return plot
