"""How like people's maps ours are: features of both, and measures of how far two sets of them lie apart.

    python -m experiments.realism.study [--maps N] [--evaluations N] [--styles NAME ...] [--people FOLDER] [--out DIR]

People's maps are those in the package duckietown-world-daffy 6.4.3, cut to their roads. Their features are kept in
results/people.json; `--people` takes the folder of the unpacked package and writes that file again. Ours have the
sizes of people's, equally many of each; where there are fewer towns of a size, these are taken more than once.

The measures are taken on standardised features: energy distance (Székely and Rizzo, 2013); precision, recall, density
and coverage (Naeem et al., 2020); and how well a logistic regression and a random forest tell the two sets apart, as
the area under the ROC curve on maps that they were not fitted to. The first half of the features is the one that the
style `town` was tuned on.
"""

import argparse
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32
from numpy.typing import NDArray

from elitelanes_jax import InputError, Result, SearchSpec, evolve
from elitelanes_jax.formats import read_map
from elitelanes_jax.network import canonical_form, measure_town, plain_measure
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, require, run, whole, write

__all__ = ["FEATURES", "TUNED", "apart", "coverage_and_co", "cut", "energy_distance", "features_of", "read_people"]

TUNED = (
    *("box_fill", "straight_share", "turn_share", "crossing_share", "loops_per_tile", "adjacent_turns_per_tile"),
    *("unlinked_per_tile", "crowded_per_tile", "symmetry"),
)
"""The features that the style was tuned on."""

FEATURES = (
    *TUNED,
    *("border_share", "repetition", "mean_block", "block_spread", "small_blocks", "mean_street", "longest_street"),
    *("shortest_street", "mean_detour"),
)
"""All features, sizes left out: these are given."""


SIZES = (
    *((3, 3), (3, 5), (4, 4), (4, 5), (5, 5), (4, 6), (5, 6), (5, 6), (5, 6), (5, 9), (6, 7), (4, 10), (6, 10), (7, 7)),
    *((7, 7), (3, 27), (10, 19), (10, 19)),
)
"""The sizes of people's maps, shorter side first."""

STYLES = {
    "paper": SearchSpec(),
    "duckietown": SearchSpec(rules="duckietown"),
    "irregular": SearchSpec(rules="duckietown", preset="irregular"),
    # People's maps have rings among them, which the style alone leaves out.
    "town": SearchSpec(style="town", where="crossings=0.."),
}
"""Searches by name."""

Figures: TypeAlias = dict[str, object]
"""The figures of a comparison, to be written as JSON."""

PEOPLE = Path(__file__).parent / "results" / "people.json"

_NEIGHBOURS, _FOLDS, _REPEATS = 5, 6, 5


def cut(grid: NDArray[np.int8]) -> NDArray[np.int8]:
    """Cuts a grid to its roads."""
    rows, columns = np.flatnonzero(grid.any(axis=1)), np.flatnonzero(grid.any(axis=0))
    return grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def read_people(folder: Path) -> dict[str, NDArray[np.int8]]:
    """Reads the maps in a folder of duckietown-world: the distinct ones of at least 2 x 2 roads, by name."""
    found: dict[bytes, tuple[str, NDArray[np.int8]]] = {}
    for file in sorted(folder.rglob("maps/*.yaml")):
        grid = np.asarray(read_map(file).codes)
        if min(grid.shape) >= 2 and grid.any() and min(cut(grid).shape) >= 2:
            found.setdefault(canonical_form(cut(grid)), (file.stem, cut(grid)))
    if not found:
        raise InputError("people", f"maps/*.yaml in {folder}", "none")
    return dict(found.values())


@jax.jit
def _measure(grids: Int8[Array, "N H W"]) -> dict[str, Int32[Array, " N"]]:
    return jax.lax.map(measure_town, grids)._asdict()


def features_of(grids: Sequence[NDArray[np.int8]]) -> NDArray[np.float64]:
    """Measures maps of any sizes up to 28 x 28; returns their features ``[N, F]`` in the order of `FEATURES`."""
    maps = [cut(grid) for grid in grids]
    towns: dict[int, dict[str, float]] = {}
    for side in (12, 28):  # few sizes, because each is compiled
        chosen = [index for index, grid in enumerate(maps) if index not in towns and max(grid.shape) <= side]
        if chosen:
            padded = [np.pad(maps[index], [(0, side - length) for length in maps[index].shape]) for index in chosen]
            measured = _measure(jnp.asarray(np.stack(padded)))
            values = {name: np.asarray(column).tolist() for name, column in measured.items()}
            towns |= {index: {name: values[name][at] for name in values} for at, index in enumerate(chosen)}
    rows = []
    for index, grid in enumerate(maps):
        metrics = plain_measure(grid)
        shares = {
            "straight_share": metrics["straights"],
            "turn_share": metrics["turns"],
            "crossing_share": metrics["crossings"],
            "unlinked_per_tile": metrics["unlinked_neighbours"],
            "crowded_per_tile": metrics["crowded_crossings"],
        }
        known = towns[index] | {name: 1000 * value / metrics["tiles"] for name, value in shares.items()}
        rows.append([known[name] / (1 if name in ("longest_street", "shortest_street") else 1000) for name in FEATURES])
    return np.array(rows, float)


def _distances(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(one[:, None] - other, axis=2)


def energy_distance(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Returns twice the mean distance between two sets ``[N, F]`` less the mean distances within them."""
    return float(2 * _distances(one, other).mean() - _distances(one, one).mean() - _distances(other, other).mean())


def coverage_and_co(real: NDArray[np.float64], made: NDArray[np.float64]) -> dict[str, float]:
    """Returns precision, recall, density and coverage of made maps ``[N, F]`` among real ones (Naeem et al., 2020)."""
    neighbours = min(_NEIGHBOURS, len(real) - 1, len(made) - 1)
    radius_real, radius_made = (np.sort(_distances(one, one), axis=1)[:, neighbours] for one in (real, made))
    between = _distances(real, made)
    within = between <= radius_real[:, None]
    return {
        "precision": float(within.any(axis=0).mean()),
        "recall": float((between <= radius_made).any(axis=1).mean()),
        "density": float(within.sum(axis=0).mean() / neighbours),
        "coverage": float((between.min(axis=1) <= radius_real).mean()),
    }


def apart(real: NDArray[np.float64], made: NDArray[np.float64], repeats: int = _REPEATS) -> dict[str, list[float]]:
    """Returns the area under the ROC curve by classifier, with the ends of its 90 % bootstrap interval over maps.

    Each map is scored by classifiers that were fitted without it, one for each of `repeats` random splits, and its
    scores are summed. The entry "CLASSIFIER by parting" has the mean, lowest and highest area of single splits.
    """
    require("telling maps apart needs", "scikit-learn")
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.metrics import roc_auc_score
    from sklearn.model_selection import StratifiedKFold, cross_val_predict
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    samples, labels = np.concatenate([real, made]), np.repeat([1, 0], [len(real), len(made)])
    makers = {
        "logistic": lambda: make_pipeline(StandardScaler(), LogisticRegression(class_weight="balanced", max_iter=2000)),
        "forest": lambda: RandomForestClassifier(200, class_weight="balanced", min_samples_leaf=2, random_state=0),
    }
    found: dict[str, list[float]] = {}
    rng = np.random.default_rng(0)
    for name, make in makers.items():
        each = []
        for repeat in range(repeats):
            folds = StratifiedKFold(_FOLDS, shuffle=True, random_state=repeat)
            each.append(cross_val_predict(make(), samples, labels, cv=folds, method="predict_proba")[:, 1])
        scores = np.sum(each, axis=0)
        areas = []
        for _ in range(200):
            drawn = np.concatenate([rng.choice(np.flatnonzero(labels == one), (labels == one).sum()) for one in (1, 0)])
            areas.append(roc_auc_score(labels[drawn], scores[drawn]))
        found[name] = [float(roc_auc_score(labels, scores)), *np.quantile(areas, [0.05, 0.95]).tolist()]
        alone = [roc_auc_score(labels, one) for one in each]
        found[f"{name} by parting"] = [float(np.mean(alone)), float(np.min(alone)), float(np.max(alone))]
    return found


def apart_by_chance(real: NDArray[np.float64], made: NDArray[np.float64], draws: int = 10) -> dict[str, list[float]]:
    """Returns the mean, lowest and highest area under the ROC curve of random draws from one set.

    The sets are two halves of people's maps, or as many of ours as people have and the rest of ours.
    """
    rng = np.random.default_rng(0)
    found: dict[str, list[float]] = {}
    for words, among, part in (("people's halves", real, len(real) // 2), ("ours among ours", made, len(real))):
        each = []
        for _ in range(draws):
            order = rng.permutation(len(among))
            each.append(apart(among[order[:part]], among[order[part:]], repeats=1))
        for name in ("logistic", "forest"):
            areas = [one[name][0] for one in each]
            found[f"{words}, {name}"] = [float(np.mean(areas)), float(np.min(areas)), float(np.max(areas))]
    return found


def halves(real: NDArray[np.float64], count: int = 200) -> dict[str, float]:
    """Returns the mean energy distance of random halves of people's maps, and the mean precision of single maps."""
    rng = np.random.default_rng(0)
    orders = [rng.permutation(len(real)) for _ in range(count)]
    middle = len(real) // 2
    energies = [energy_distance(real[order[:middle]], real[order[middle:]]) for order in orders]
    alone = [coverage_and_co(np.delete(real, index, axis=0), real[[index, index]]) for index in range(len(real))]
    return {"energy": float(np.mean(energies)), "precision": float(np.mean([one["precision"] for one in alone]))}


def make_pools(style: str, evaluations: int) -> dict[tuple[int, int], Result]:
    """Searches for maps of each size."""
    pools = {}
    for size in dict.fromkeys(SIZES):
        pools[size] = evolve(0, size, seeds=4, evaluations=evaluations, spec=STYLES[style])
        print(f"{style} {size[0]} x {size[1]}: searched")
    return pools


def pick_maps(pools: dict[tuple[int, int], Result], count: int) -> list[NDArray[np.int8]]:
    """Picks the same number of maps for each of people's maps. If a size has fewer maps, they are repeated."""
    picked: list[NDArray[np.int8]] = []
    ends = [0, *np.cumsum(list(Counter(SIZES).values()))]
    parts = np.diff([round(count * end / len(SIZES)) for end in ends]).tolist()
    for size, part in zip(Counter(SIZES), parts, strict=True):
        found = [road_map.codes for road_map in pools[size].maps(part)]
        picked += [found[index % len(found)] for index in range(part if found else 0)]
    return picked


def draw_sheet(file: Path, rows: Mapping[str, Sequence[NDArray[np.int8]]]) -> None:
    """Draws maps in rows of six, kind by kind."""
    from matplotlib.figure import Figure

    from elitelanes_jax.plots import road_map

    lines = [(name, grids[first : first + 6]) for name, grids in rows.items() for first in range(0, len(grids), 6)]
    figure = Figure(figsize=(9, 1.5 * len(lines)), layout="constrained")
    axes = figure.subplots(len(lines), 6)
    for ax in axes.ravel():
        ax.axis("off")
    for row, (name, grids) in zip(axes, lines, strict=True):
        row[0].set_title(name, fontsize=8, loc="left")
        for ax, grid in zip(row, grids, strict=False):
            road_map(cut(grid), lanes=False, width=0.4, ax=ax)
    figure.savefig(file, dpi=80, metadata={"Software": None})


def standardised(
    real: NDArray[np.float64], made: NDArray[np.float64], columns: Sequence[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns some of the features of people's and of made maps, in standard deviations from people's mean."""
    chosen = [FEATURES.index(name) for name in columns]
    mean, scale = real[:, chosen].mean(axis=0), real[:, chosen].std(axis=0)
    scale = np.where(scale > 0, scale, 1)
    return (real[:, chosen] - mean) / scale, (made[:, chosen] - mean) / scale


def report(real: NDArray[np.float64], made: NDArray[np.float64], columns: Sequence[str]) -> Figures:
    """Compares made maps with people's by some of the features."""
    theirs, mine = standardised(real, made, columns)
    return {
        "energy": energy_distance(theirs, mine),
        "people": halves(theirs),
        **coverage_and_co(theirs, mine),
        **apart(theirs, mine),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("realism", __doc__)
    parser.add_argument("--maps", type=whole(8), default=200, metavar="N", help="of each style; default 200")
    parser.add_argument("--evaluations", type=whole(1), default=100_000, metavar="N", help="of a run; default 100000")
    styles = f"some of {', '.join(STYLES)}; default all"
    parser.add_argument("--styles", nargs="+", default=list(STYLES), choices=STYLES, metavar="NAME", help=styles)
    parser.add_argument("--people", type=Path, metavar="FOLDER", help="read people's maps again, from this folder")
    out = Path("results/realism")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    options = parser.parse_args(arguments)
    return run("realism", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    use_compile_cache()
    maps: dict[str, NDArray[np.int8]] = {}
    options.out.mkdir(parents=True, exist_ok=True)
    if options.people:
        maps = read_people(options.people)
        rows = features_of(list(maps.values()))
        people = {name: dict(zip(FEATURES, row.tolist(), strict=True)) for name, row in zip(maps, rows, strict=True)}
        write(PEOPLE, json.dumps(people, indent=1) + "\n")
    known = json.loads(PEOPLE.read_text(encoding="utf-8"))
    real = np.array([[row[name] for name in FEATURES] for row in known.values()])
    found: dict[str, Figures] = {}
    for style in options.styles:
        grids = pick_maps(make_pools(style, options.evaluations), options.maps)
        if not grids:
            print(f"{style}: no maps")
            continue
        np.savez_compressed(options.out / f"{style}.npz", *grids)
        if style == "town" and maps:
            order = np.random.default_rng(0).permutation(len(grids))
            shown = list({canonical_form(grids[index]): grids[index] for index in order}.values())
            sheet = {"made by people": list(maps.values()), "--style town": shown[:24]}
            draw_sheet(options.out / "towns-and-people.png", sheet)
        made = features_of(grids)
        medians = {
            name: [np.quantile(rows[:, column], [0.1, 0.5, 0.9]).tolist() for rows in (made, real)]
            for column, name in enumerate(FEATURES)
        }
        held_out = [name for name in FEATURES if name not in TUNED]
        sets = {"tuned on": TUNED, "held out": held_out, "all": FEATURES}
        distinct = len({canonical_form(grid) for grid in grids})
        found[style] = {"maps": len(made), "distinct": distinct, "features": medians} | {
            name: report(real, made, columns) for name, columns in sets.items()
        }
        if style == "town":
            found[style]["by chance"] = apart_by_chance(*standardised(real, made, FEATURES))
        print(json.dumps({key: value for key, value in found[style].items() if key != "features"}, indent=1))
        write(options.out / "realism.json", json.dumps(found, indent=1) + "\n")
        jax.clear_caches()  # the programs of several styles together are more than a process may map


if __name__ == "__main__":
    leave(main())
