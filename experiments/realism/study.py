"""How like people's maps ours are: features of both, and measures of how far two sets of them lie apart.

    python -m experiments.realism.study [--maps N] [--evaluations N] [--styles NAME ...] [--people FOLDER] [--splits N]
                                  [--sides N ...] [--map-utils FOLDER] [--out DIR]

People's maps are those in the package duckietown-world-daffy 6.4.3, cut to their roads. Their features are kept in
results/people.json; `--people` takes the folder of the unpacked package and writes that file again. Ours have the
sizes of people's, equally many of each; where there are fewer towns of a size, these are taken more than once.

The measures are taken on standardised features: energy distance (Székely and Rizzo, 2013); precision, recall, density
and coverage (Naeem et al., 2020); and how well a logistic regression and a random forest tell the two sets apart, as
the area under the ROC curve on maps that they were not fitted to. The first half of the features is the one that the
style `town` was tuned on. `--splits` picks the towns again, by a random half of the features each time, and tells both
sets apart by the other half. `--sides` compares blocks, streets and turns of larger square towns, of which people made
hardly any, with the lowest and the highest tenth of people's maps of their own sizes.

Other generators are named as styles are: netgenerate-grid, netgenerate-rand (pip install '.[sumo]') and map-utils, of
which `--map-utils` takes a copy of the repository.
"""

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32
from numpy.typing import NDArray

from elitelanes_jax import InputError, Result, SearchSpec, evolve
from elitelanes_jax.formats import read_map
from elitelanes_jax.network import EAST, SOUTH, canonical_form, measure_town, plain_measure
from elitelanes_jax.problem import with_town_features
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, require, run, whole, write
from experiments.realism.references import REFERENCES, Counts, use_map_utils

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

LARGER = ("mean_block", "mean_street", "turn_share")
"""What is compared of larger maps."""

SIZES = (
    *((3, 3), (3, 5), (4, 4), (4, 5), (5, 5), (4, 6), (5, 6), (5, 6), (5, 6), (5, 9), (6, 7), (4, 10), (6, 10), (7, 7)),
    *((7, 7), (3, 27), (10, 19), (10, 19)),
)
"""The sizes of people's maps, shorter side first."""

STYLES = {
    "paper": SearchSpec(),
    "duckietown": SearchSpec(rules="duckietown"),
    "irregular": SearchSpec(rules="duckietown", preset="irregular"),
    "town": SearchSpec(style="town"),
}
"""Searches by name."""

Figures: TypeAlias = dict[str, object]
"""The figures of a comparison, to be written as JSON."""

PEOPLE = Path(__file__).parent / "results" / "people.json"

_NAMES = [*STYLES, *REFERENCES, "map-utils"]
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
        raise InputError(f"people: expected maps/*.yaml in {folder}, got none")
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


def shares(count: int) -> Counts:
    """Divides a number of maps among people's sizes, equally for each of people's maps."""
    ends = [0, *np.cumsum(list(Counter(SIZES).values()))]
    parts = np.diff([round(count * end / len(SIZES)) for end in ends])
    return dict(zip(Counter(SIZES), parts.tolist(), strict=True))


def pick_maps(pools: dict[tuple[int, int], Result], count: int) -> list[NDArray[np.int8]]:
    """Picks the same number of maps for each of people's maps. If a size has fewer maps, they are repeated."""
    picked: list[NDArray[np.int8]] = []
    for size, part in shares(count).items():
        found = [road_map.codes for road_map in pools[size].maps(part)]
        picked += [found[index % len(found)] for index in range(part if found else 0)]
    return picked


def with_targets(pool: Result, rows: NDArray[np.float64], columns: Sequence[str]) -> Result:
    """Returns the search with other targets for its maps: people's values of some features."""
    targets = {}
    for name in columns:
        values = rows[:, FEATURES.index(name)]
        if name in ("unlinked_per_tile", "crowded_per_tile"):  # the rules keep both at 0
            continue
        targets[name] = values.tolist()
    spec = pool.spec.replace(targets=targets)
    measured = with_town_features(pool.elites.features, spec.measured, pool.elites.grids)
    features = {name: jnp.asarray(values) for name, values in measured.items()}
    return replace(pool, spec=spec, elites=pool.elites._replace(features=features))


def line_drawing(grid: NDArray[np.int8], side: int = 120) -> str:
    """Draws a map's links as an SVG picture of `side` x `side` pixels."""
    codes = cut(grid)
    height, width = codes.shape
    lines = []
    for row, column in np.argwhere(codes > 0).tolist():
        code = int(codes[row, column])
        lines += [f"M{column} {row}h1"] * (code & EAST > 0) + [f"M{column} {row}v1"] * (code & SOUTH > 0)
    long = max(height, width)
    return (
        f'<svg width="{side}" height="{side}" viewBox="-1 -1 {long + 1} {long + 1}"><path d="{"".join(lines)}" '
        'fill="none" stroke="#345" stroke-width="0.45" stroke-linecap="round"/></svg>'
    )


def blind_page(people: Sequence[NDArray[np.int8]], made: Sequence[NDArray[np.int8]]) -> str:
    """Makes a page with people's and made maps in random order, as many of each, and the answers at its end."""
    rng = np.random.default_rng(0)
    count = min(len(people), len(made))
    kinds = rng.permutation([0] * count + [1] * count)
    piles = [list(rng.permutation(len(pile))[:count]) for pile in (people, made)]
    drawn = [line_drawing((people, made)[kind][piles[kind].pop()]) for kind in kinds]
    figures = "".join(
        f"<figure>{picture}<figcaption>{number}</figcaption></figure>" for number, picture in enumerate(drawn, start=1)
    )
    by_people = ", ".join(str(number) for number, kind in enumerate(kinds, start=1) if kind == 0)
    return f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>Which towns did people make?</title>
<style>
body {{ font: 16px sans-serif; max-width: 60em; margin: 2em auto; }}
div {{ display: flex; flex-wrap: wrap; gap: 1em; }}
figure {{ margin: 0; text-align: center; }}
</style>
<h1>Which towns did people make?</h1>
<p>Half of these {2 * count} maps were made by people for Duckietown, half by <code>--style town</code>. Note the
numbers of those that you think people made. By guessing, half of them are right.</p>
<div>{figures}</div>
<details><summary>Answers</summary><p>People made {by_people}.</p></details>
</html>
"""


def draw_sheet(file: Path, rows: dict[str, Sequence[NDArray[np.int8]]]) -> None:
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


def split(
    pools: dict[tuple[int, int], Result], real: NDArray[np.float64], count: int, seed: int
) -> dict[str, list[float]]:
    """Picks maps by a random half of the features, and tells them apart from people's by the other half."""
    order = np.random.default_rng(seed).permutation(FEATURES).tolist()
    chosen, others = order[: len(FEATURES) // 2], order[len(FEATURES) // 2 :]
    aimed = {size: with_targets(pool, real, chosen) for size, pool in pools.items()}
    return apart(*standardised(real, features_of(pick_maps(aimed, count)), others))


def larger(style: str, side: int, evaluations: int, real: NDArray[np.float64]) -> Figures:
    """Measures 24 square maps: quantiles of each of `LARGER`, and the share of maps between people's tenths."""
    pool = evolve(0, (side, side), seeds=4, evaluations=evaluations, spec=STYLES[style])
    rows = features_of([road_map.codes for road_map in pool.maps(24)])
    found: Figures = {"found": len(pool.maps(10_000)), "maps": len(rows)}
    inside = np.ones(len(rows), bool)
    for name in LARGER if len(rows) else ():
        column = FEATURES.index(name)
        low, high = np.quantile(real[:, column], [0.1, 0.9])
        between = (rows[:, column] >= low) & (rows[:, column] <= high)
        inside &= between
        found[name] = {
            "people": [low, high],
            "maps": np.quantile(rows[:, column], [0.1, 0.5, 0.9]).tolist(),
            "inside": between.mean(),
        }
    return found | {"all inside": inside.mean() if len(rows) else 0.0}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("realism", __doc__)
    parser.add_argument("--maps", type=whole(8), default=200, metavar="N", help="of each style; default 200")
    parser.add_argument("--evaluations", type=whole(1), default=100_000, metavar="N", help="of a run; default 100000")
    styles = f"some of {', '.join(_NAMES)}; default {' '.join(STYLES)}"
    parser.add_argument("--styles", nargs="+", default=list(STYLES), choices=_NAMES, metavar="NAME", help=styles)
    parser.add_argument("--people", type=Path, metavar="FOLDER", help="read people's maps again, from this folder")
    parser.add_argument("--splits", type=whole(0), default=0, metavar="N", help="random halves of features; default 0")
    parser.add_argument("--sides", nargs="+", type=whole(8), metavar="N", help="compare larger towns only, of N x N")
    parser.add_argument("--map-utils", type=Path, metavar="FOLDER", help="a copy of duckietown/map-utils")
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
    others = REFERENCES | ({"map-utils": use_map_utils(options.map_utils)} if "map-utils" in options.styles else {})
    if options.sides and not others.keys().isdisjoint(options.styles):
        raise InputError(f"--sides: expected styles among {', '.join(STYLES)}, got {' '.join(options.styles)}")
    known = json.loads(PEOPLE.read_text(encoding="utf-8"))
    real = np.array([[row[name] for name in FEATURES] for row in known.values()])
    found: dict[str, Figures] = {}
    for style in options.styles if options.sides else ():
        found[style] = {str(side): larger(style, side, options.evaluations, real) for side in options.sides}
        print(f"{style}: {json.dumps(found[style], indent=1)}")
    for style in () if options.sides else options.styles:
        pools = {} if style in others else make_pools(style, options.evaluations)
        grids = others[style](shares(options.maps)) if style in others else pick_maps(pools, options.maps)
        if not grids:
            print(f"{style}: no maps")
            continue
        np.savez_compressed(options.out / f"{style}.npz", *grids)
        if style == "town" and maps:
            order = np.random.default_rng(0).permutation(len(grids))
            shown = list({canonical_form(grids[index]): grids[index] for index in order}.values())
            theirs = list(maps.values())
            draw_sheet(options.out / "towns-and-people.png", {"made by people": theirs, "--style town": shown[:24]})
            write(options.out / "blind-test.html", blind_page(theirs, shown))
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
            found[style]["splits"] = [split(pools, real, options.maps, seed) for seed in range(options.splits)]
        print(json.dumps({key: value for key, value in found[style].items() if key != "features"}, indent=1))
        write(options.out / "realism.json", json.dumps(found, indent=1) + "\n")
        jax.clear_caches()  # the programs of several styles together are more than a process may map
    if options.sides:
        write(options.out / "larger.json", json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    leave(main())
