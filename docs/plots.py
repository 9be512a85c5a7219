"""Draws the pictures of docs/plots.md.

python docs/plots.py
"""

from pathlib import Path

import jax
import matplotlib as mpl
from matplotlib.figure import Figure

from elitelanes_jax import Result, evolve, random_grids, repair
from elitelanes_jax.optimizers import make_move
from elitelanes_jax.plots import archive_map, history, road_map

HERE = Path(__file__).parent


def main() -> None:
    keys = jax.random.split(jax.random.key(0), 4)
    found = {preset: evolve(keys, method="ea", preset=preset, evaluations=20_000) for preset in ("paper", "tuned")}
    maps(found["tuned"])
    archive(evolve(keys, preset="paper", fill=False, evaluations=20_000))
    runs(found)


def maps(result: Result) -> None:
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    grid = random_grids(jax.random.key(2), 1, (8, 8))[0]
    road_map(grid, ax=left)
    move = make_move("outline")
    varied = move.apply(jax.random.bits(jax.random.key(1), (move.bits,), "uint32"), repair(grid))
    road_map(repair(*varied), marked=varied.dirty, ax=middle)
    road_map(result.best()[0], ax=right)
    save(figure, "maps")


def archive(result: Result) -> None:
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    archive_map(result.elites.fitness, result.search.axes, vmax=20_000, ax=figure.subplots())
    save(figure, "archive")


def runs(results: dict[str, Result]) -> None:
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    best, cyclomatic, straight = figure.subplots(1, 3)
    for name, result in results.items():
        history(result.history, label=name, ax=best)
    best.set_ylim(top=4000)
    best.legend()
    for ax, metric in ((cyclomatic, "cyclomatic"), (straight, "straight_score")):
        values = [getattr(result.elites.metrics, metric)[result.elites.valid] for result in results.values()]
        ax.boxplot(values, widths=0.55, tick_labels=list(results))
        ax.set_title(metric.replace("_", " "))
    save(figure, "runs")


def save(figure: Figure, name: str) -> None:
    with mpl.rc_context({"savefig.dpi": 90}):
        figure.savefig(HERE / f"plots-{name}.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
