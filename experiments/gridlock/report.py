"""Tables and figures of the study, from its runs."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypedDict

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from scipy.stats import rankdata

from elitelanes_jax.network import gridlock_gamma, gridlock_number, gridlock_potential, measure, measure_town
from elitelanes_jax.plots import road_map
from experiments.common import save, table, to_csv, write
from experiments.gridlock.jams import SETTINGS, Car, Setting

__all__ = ["Jam", "Predicted", "Runs", "Summary", "draw_jam", "predict", "summarize", "write_report"]

Runs: TypeAlias = dict[str, list[list[float]]]
"""Runs by kind; of each the number of cars, and the fields of `Run`."""

PREDICTORS = {
    "potential": "gridlock potential",
    "gamma": "-gamma",
    "girth": "-girth",
    "shortest_street": "-shortest street",
    "crossings": "crossings",
    "cyclomatic": "cyclomatic number",
}
"""What may tell which towns jam, with words for it. A minus is of what falls where jams are more frequent."""

FEW_CARS = {
    "below": "gamma - 1, usual routes",
    "below_loop": "gamma - 1, routes around the loop",
    "above_loop": "2 x gamma, routes around the loop",
}
"""The kinds of runs with few cars, with words for them."""

RESAMPLES = 9999


class Predicted(NamedTuple):
    """What the streets of a town predict. The shortest street and the girth are in tiles."""

    potential: float
    gamma: int
    girth: int
    shortest_street: int
    crossings: int
    cyclomatic: int


class Jam(TypedDict):
    """The end of a run that jammed: its cars, and a loop of full streets; no streets if there is none."""

    loop: list[str]
    cars: list[Car]


class Correlation(TypedDict):
    """Spearman's correlations of a predictor with the share of jammed runs and the mean speed.

    The intervals are of 95 %. The second one is that of the potential's correlation minus this one.
    """

    jams: float
    interval: list[float]
    potential_minus_it: list[float]
    speed: float


class Summary(TypedDict):
    """The figures of a setting.

    `halves` is the correlation of the shares in the first and in the last half of the runs. `few_cars` counts runs, and
    those that jammed. `full_loops` counts jams that were looked at, and those with a loop of full streets.
    """

    towns: int
    runs: int
    jammed: float
    towns_that_jam: int
    halves: float
    predictors: dict[str, Correlation]
    few_cars: dict[str, list[int]]
    full_loops: list[int]


def predict(codes: NDArray[np.int8], cars: int, setting: Setting) -> Predicted:
    """Computes what may tell how often a town jams."""
    metrics = measure(codes)
    return Predicted(
        potential=float(gridlock_potential(codes, cars, tile_size=setting.tile_size)),
        gamma=int(gridlock_gamma(codes, tile_size=setting.tile_size)),
        girth=int(gridlock_number(codes)) + 1,
        shortest_street=int(measure_town(codes).shortest_street),
        crossings=int(metrics.crossings),
        cyclomatic=int(metrics.cyclomatic),
    )


def _rank_correlations(values: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns Spearman's correlation of rows ``[B, N]`` of values with rows of others, 0 if one is constant."""
    first, second = (rankdata(rows, axis=1) - (rows.shape[1] + 1) / 2 for rows in (values, others))
    size = np.sqrt((first**2).sum(axis=1) * (second**2).sum(axis=1))
    return np.divide((first * second).sum(axis=1), size, out=np.zeros(len(size)), where=size > 0)


def summarize(towns: Sequence[Predicted], runs: Sequence[Runs], jams: Sequence[Jam]) -> Summary:
    """Correlates what streets predict with what happened in the runs of a setting.

    The intervals are of percentile bootstraps over towns. Those of differences have both correlations from the same
    towns.
    """
    jammed = np.array([[run[1] for run in town["usual"]] for town in runs], float)
    speed = np.array([np.mean([run[3] for run in town["usual"]]) for town in runs])
    share, half = jammed.mean(axis=1), jammed.shape[1] // 2
    drawn = np.random.default_rng(0).integers(0, len(share), (RESAMPLES, len(share)))

    def correlate(values: NDArray[np.float64], others: NDArray[np.float64]) -> float:
        return float(_rank_correlations(values[None], others[None])[0])

    def interval(sample: NDArray[np.float64]) -> list[float]:
        return np.quantile(sample, [0.025, 0.975]).tolist()

    columns, samples = {}, {}
    for name, words in PREDICTORS.items():
        column = np.array([getattr(town, name) for town in towns], float)
        columns[name] = -column if words.startswith("-") else column
        samples[name] = _rank_correlations(columns[name][drawn], share[drawn])
    return Summary(
        towns=len(share),
        runs=jammed.size,
        jammed=float(share.mean()),
        towns_that_jam=int(np.count_nonzero(share)),
        halves=correlate(jammed[:, :half].mean(axis=1), jammed[:, half:].mean(axis=1)),
        predictors={
            name: Correlation(
                jams=correlate(column, share),
                interval=interval(samples[name]),
                potential_minus_it=interval(samples["potential"] - samples[name]),
                speed=correlate(column, speed),
            )
            for name, column in columns.items()
        },
        few_cars={
            kind: [sum(len(town[kind]) for town in runs), sum(int(run[1]) for town in runs for run in town[kind])]
            for kind in FEW_CARS
        },
        full_loops=[len(jams), sum(bool(jam["loop"]) for jam in jams)],
    )


def to_tables(summaries: Mapping[str, Summary]) -> str:
    """Writes the tables of the page."""
    text = ""
    for kind, summary in summaries.items():
        setting = SETTINGS[kind]
        text += (
            f"**{kind.replace('_', ' ')}, tiles of {setting.tile_size:g} m, {setting.cars_per_link:g} cars a link**: "
            f"{summary['towns']} towns, {summary['runs']} runs, {100 * summary['jammed']:.0f} % jammed, "
            f"in {summary['towns_that_jam']} towns. The halves of the runs correlate by {summary['halves']:.2f}.\n\n"
        )
        rows = []
        for name, correlation in summary["predictors"].items():
            difference = "" if name == "potential" else _range(correlation["potential_minus_it"])
            jams, speed = f"{correlation['jams']:+.2f}", f"{correlation['speed']:+.2f}"
            rows.append([PREDICTORS[name], jams, _range(correlation["interval"]), difference, speed])
        head = ("predictor", "jammed runs", "95 %", "potential minus it, 95 %", "mean speed")
        text += table(head, rows) + "\n"
    rows = []
    for kind, words in FEW_CARS.items():
        counts = [summary["few_cars"][kind] for summary in summaries.values()]
        rows.append([words, *(f"{jammed} of {runs}" for runs, jammed in counts)])
    text += table(("runs that jammed, by cars", *(kind.replace("_", " ") for kind in summaries)), rows) + "\n"
    looked, full = np.sum([summary["full_loops"] for summary in summaries.values()], axis=0)
    return text + f"{full} of {looked} jams have a loop of full streets.\n"


def _range(interval: Sequence[float]) -> str:
    return "{:+.2f} to {:+.2f}".format(*interval)


def write_report(
    out: Path,
    grids: Mapping[str, NDArray[np.int8]],
    runs: Mapping[tuple[str, str], Runs],
    jams: Mapping[tuple[str, str], Jam],
) -> None:
    """Writes tables and figures into a folder.

    Args:
      out: the folder.
      grids: the codes of the towns, by name.
      runs: the runs, by the town's name and the setting's.
      jams: the jams to look at, by the same. The picture is of the first one with a loop of full streets.
    """
    rows, summaries = [], {}
    predicted = {
        (name, kind): predict(grids[name], int(town["usual"][0][0]), SETTINGS[kind])
        for (name, kind), town in runs.items()
    }
    for kind in SETTINGS:
        keys = [key for key in runs if key[1] == kind]
        summaries[kind] = summarize(
            [predicted[key] for key in keys],
            [runs[key] for key in keys],
            [jam for key, jam in jams.items() if key[1] == kind],
        )
    for (name, kind), town in runs.items():
        usual = np.array(town["usual"], float)
        values = predicted[name, kind]._asdict() | {"potential": f"{predicted[name, kind].potential:.4g}"}
        row = {"town": name, "setting": kind, "cars": int(usual[0, 0]), **values}
        rows.append({**row, "jammed": int(usual[:, 1].sum()), "speed": f"{usual[:, 3].mean():.3f}"})
    write(out / "gridlock.csv", to_csv(rows))
    write(out / "gridlock.json", json.dumps(summaries, indent=1) + "\n")
    write(out / "gridlock.md", to_tables(summaries))
    _draw_correlations(predicted, runs, out / "correlations.png")
    for (name, kind), jam in jams.items():
        if jam["loop"]:
            draw_jam(grids[name], jam, SETTINGS[kind].tile_size, out / "jam.png")
            break


def _draw_correlations(
    predicted: Mapping[tuple[str, str], Predicted], runs: Mapping[tuple[str, str], Runs], file: Path
) -> None:
    """Draws the share of jammed runs against the potential and against gamma, for each setting."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    rng = np.random.default_rng(0)
    for axes, kind in zip(figure.subplots(len(SETTINGS), 2), SETTINGS, strict=True):
        keys = [key for key in predicted if key[1] == kind]
        # Shares are multiples of an eighth, so points are moved a little.
        shares = [np.mean([run[1] for run in runs[key]["usual"]]) + rng.uniform(-0.02, 0.02) for key in keys]
        # Below 1e-9 the potential is drawn as 1e-9, because the axis has logarithms.
        values = {
            "gridlock potential": [max(predicted[key].potential, 1e-9) for key in keys],
            "gamma, cars": [predicted[key].gamma for key in keys],
        }
        for ax, (label, column) in zip(axes, values.items(), strict=True):
            ax.plot(column, shares, "o", ms=5, alpha=0.5, mew=0)
            ax.set(xlabel=label, ylabel="jammed runs, share", title=kind.replace("_", " "))
        axes[0].set_xscale("log")
    save(figure, file)


def draw_jam(codes: NDArray[np.int8], jam: Jam, tile_size: float, file: Path) -> None:
    """Draws a town with the cars that stand on it, those on a loop of full streets in orange."""
    height, width = codes.shape
    figure = Figure(figsize=(0.9 * width, 0.9 * height), layout="constrained")
    ax = road_map(codes, width=0.4, ax=figure.subplots())
    # Metres of SUMO to tiles: a car is 5 m long and 1.8 m wide. Its place is the middle of its front.
    outline = np.array([(0, -0.9), (0, 0.9), (-5, 0.9), (-5, -0.9)])
    for car in (Car(*car) for car in jam["cars"]):
        angle = np.deg2rad(car.angle)
        ahead = np.array([np.sin(angle), np.cos(angle)])
        corners = (car.x, car.y) + outline @ np.array([ahead, (ahead[1], -ahead[0])])
        colour = "#ff8c42" if car.street in jam["loop"] else "#ffffff"
        place = np.column_stack([corners[:, 0] / tile_size, height - corners[:, 1] / tile_size])
        ax.add_patch(Polygon(place, facecolor=colour, edgecolor="#000000", lw=0.4, zorder=9))
    save(figure, file)
