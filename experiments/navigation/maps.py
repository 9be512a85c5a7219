"""The study's maps: where they come from, which niches are held out, and levels whose distances are matched."""

from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Int8, Key
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax import InputError, evolve, random_grids, repair
from elitelanes_jax.drive import UNREACHABLE, LaneNode, Level, distances, random_level
from elitelanes_jax.formats import read_map, without_dead_ends
from elitelanes_jax.network import canonical_form
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.optimizers import seed_keys

__all__ = ["SIDE", "Grids", "MapBudget", "Maps", "draw_levels", "human_maps", "make_maps"]

SIDE = 8

AXES = "cyclomatic:10:2 straight_share:10:80"
"""The archive: loops in bins of 2, the share of straights in bins of 8 %."""

DISTANCES = range(6, 13)
"""Tiles from start to goal; each is as frequent as the others on every set of maps."""

_search = partial(evolve, shape=(SIDE, SIDE), preset="tuned", fill=True, progress=False)

_ROUND = 1024  # levels are drawn by multiples of it, so that few numbers are compiled for
_TRIES = 4  # goals drawn for each level, of which the first with a start at the distance is taken


Grids: TypeAlias = list[list[list[int]]]
"""Codes ``[N][H][W]``."""


class Maps(TypedDict):
    """All maps of a seed.

    Attributes:
      grids: codes by name, see `make_maps`.
      niches: bins ``[N][2]`` of the maps of MAP-Elites, by the same names.
    """

    grids: dict[str, Grids]
    niches: dict[str, list[list[int]]]


class MapBudget(NamedTuple):
    """The amount of maps.

    Attributes:
      most: maps to train on, of MAP-Elites.
      others: maps to train on, of each other source.
      tests: maps in a test of MAP-Elites.
      other_tests: maps in a test of each other source.
      runs: of MAP-Elites.
      evaluations: of each run that makes maps.
    """

    most: int = 1000
    others: int = 100
    tests: int = 100
    other_tests: int = 50
    runs: int = 64
    evaluations: int = 5000


def make_maps(seed: int, budget: MapBudget) -> Maps:
    """Makes all maps of a seed, 8 x 8 without empty cells. No test has a map that is trained on.

    Maps to train on are named "map-elites", "ea", "wfc" and "random". The first few of MAP-Elites are spread over the
    niches too. Tests are named "test ea", "test wfc", "test random", "seen" and "held out". The last two are of
    MAP-Elites: "held out" from a quarter of the niches, drawn by the seed, and "seen" from the others.
    """
    rng = np.random.default_rng(seed)
    grids, bins = _archive(seed, budget)
    niche = bins[:, 0] * 10 + bins[:, 1]
    every = np.unique(niche)
    held = np.isin(niche, rng.permutation(every)[: len(every) // 4])
    seen = _spread(rng, niche, ~held)
    first, rest = seen[: budget.most], seen[budget.most :]
    if len(rest) < budget.tests:
        first, rest = seen[: -budget.tests], seen[-budget.tests :]
    chosen = {"map-elites": first, "seen": rest[: budget.tests], "held out": _spread(rng, niche, held)[: budget.tests]}
    maps = {name: grids[which] for name, which in chosen.items()}
    known = {canonical_form(grid) for grid in maps["map-elites"]}
    for source in ("ea", "wfc", "random"):
        made = _others(source, 2 * budget.others + budget.other_tests, 2 * seed, budget)
        maps[source] = made[: budget.others]
        known |= {canonical_form(grid) for grid in maps[source]}
        unknown = [grid for grid in made[budget.others :] if canonical_form(grid) not in known]
        maps[f"test {source}"] = np.array(unknown[: budget.other_tests], np.int8).reshape(-1, SIDE, SIDE)
    return {
        "grids": {name: made.tolist() for name, made in maps.items()},
        "niches": {name: bins[which].tolist() for name, which in chosen.items()},
    }


def _archive(seed: int, budget: MapBudget) -> tuple[NDArray[np.int8], NDArray[np.int_]]:
    """Returns different elites of one component, of many runs, and their bins ``[N, 2]``."""
    keys = seed_keys(seed, budget.runs)
    found = _search(keys, evaluations=budget.evaluations, axes=AXES)
    whole = np.asarray(found.elites.valid) & (np.asarray(found.elites.metrics.components) == 1)
    grids = np.asarray(found.elites.grids)[whole]
    _, niches = np.nonzero(whole)
    bins = np.stack(np.unravel_index(niches, [axis.bins for axis in found.search.axes]), axis=-1)
    different = {canonical_form(grid): number for number, grid in reversed(list(enumerate(grids)))}
    order = sorted(different.values())
    return grids[order], bins[order]


def _spread(rng: np.random.Generator, niche: NDArray[np.int_], among: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Orders elites at random so that every niche gives one before any gives a second."""
    order = rng.permutation(np.flatnonzero(among))
    turn, given = np.zeros(len(order), int), dict[int, int]()
    for place, number in enumerate(order):
        turn[place] = given[niche[number]] = given.get(niche[number], -1) + 1
    return order[np.argsort(turn, kind="stable")]


def _others(source: str, count: int, seed: int, budget: MapBudget) -> NDArray[np.int8]:
    """Makes maps of another source: the best of as many runs, collapsed and filled, or random and filled."""
    shape = (SIDE, SIDE)
    if source == "ea":
        # Few evaluations: longer runs would all find the same few best networks.
        return np.asarray(_search(seed_keys(seed, count), evaluations=budget.evaluations, method="ea").best())
    if source == "wfc":
        grids = jnp.asarray(generate_batch(np.random.default_rng(seed), count, shape, border="closed").grid)
    else:
        grids = random_grids(jax.random.key(seed), count, shape)
    return np.asarray(_filled(grids))


@jax.jit
@jax.vmap
def _filled(grid: Int8[Array, "H W"]) -> Int8[Array, "H W"]:
    return repair(grid, fill=True)


def human_maps(folder: Path) -> NDArray[np.int8]:
    """Reads the maps in a folder of Duckietown's YAML files that fit on 8 x 8 tiles, int8 ``[N, 8, 8]``.

    Roads that lead nowhere are removed, and empty rows and columns around the rest; maps that are equal when rotated or
    mirrored count once. Files that are no map, or have no node 12 tiles from another, are left out.
    """
    found: dict[bytes, NDArray[np.int8]] = {}
    for file in sorted(folder.glob("*.yaml")):
        try:
            roads = without_dead_ends(read_map(file).codes)
        except InputError:
            continue
        rows, columns = np.flatnonzero(roads.any(axis=1)), np.flatnonzero(roads.any(axis=0))
        if not rows.size or max(np.ptp(rows), np.ptp(columns)) >= SIDE:
            continue
        cut = roads[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        grid = np.zeros((SIDE, SIDE), np.int8)
        grid[: cut.shape[0], : cut.shape[1]] = cut
        found.setdefault(canonical_form(grid), grid)
    grids = np.array(list(found.values()), np.int8).reshape(-1, SIDE, SIDE)
    return grids[[_furthest(grid) >= DISTANCES[-1] for grid in grids]] if len(grids) else grids


def _furthest(grid: NDArray[np.int8]) -> int:
    """Returns the largest distance from one node to another."""
    goals = LaneNode(*(jnp.asarray(part.ravel()) for part in np.indices((SIDE, SIDE, 4))))
    away = np.asarray(jax.vmap(lambda goal: distances(jnp.asarray(grid), goal))(goals))
    return int(away[away < UNREACHABLE].max(initial=0))


def draw_levels(seed: int, grids: ArrayLike, count: int) -> Level:
    """Draws levels, N of them, with matched distances: level i is on map i modulo M, its distance the next in turn.

    A goal without a start at the distance is drawn again, some times; then the nearest distance beyond is taken, or the
    furthest of all.

    Args:
      seed: of all that is random.
      grids: codes ``[M, H, W]``.
      count: N.
    """
    listed = np.asarray(grids, np.int8)
    drawn = _drawn(seed, listed.tobytes(), listed.shape, -(-count // _ROUND) * _ROUND)
    return jax.tree.map(lambda part: part[:count], drawn)


@lru_cache(maxsize=16)
def _drawn(seed: int, packed: bytes, shape: tuple[int, ...], count: int) -> Level:
    """Draws levels as `draw_levels` does, and keeps them: the drivers of a seed drive on the same ones."""
    grids, number = np.frombuffer(packed, np.int8).reshape(shape), np.arange(count)
    target = jnp.asarray(np.asarray(DISTANCES)[number // len(grids) % len(DISTANCES)], jnp.int32)
    return _draw_levels(jax.random.split(jax.random.key(seed), count), jnp.asarray(grids[number % len(grids)]), target)


@jax.jit
def _draw_levels(keys: Key[Array, " N"], grids: Int8[Array, "N H W"], targets: Int[Array, " N"]) -> Level:
    def draw_level(of: tuple[Array, Array, Array]) -> Level:
        key, grid, target = of
        draw = partial(random_level, grid=grid, least=target, most=target)
        tried = jax.vmap(draw)(jax.random.split(key, _TRIES))
        best = jnp.argmax(tried.shortest == target)
        return jax.tree.map(lambda part: part[best], tried)

    # Parts of this size stay in a core's cache.
    return jax.lax.map(draw_level, (keys, grids, targets), batch_size=32)
