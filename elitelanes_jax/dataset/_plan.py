"""The maps of a dataset, and the split that each belongs to."""

import json
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import lru_cache
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset.spec import SPLITS, DatasetSpec, maps_by_shape, maps_by_split
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.cluster import run_on
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.optimizers.loop import seed_keys
from elitelanes_jax.search.compile_cache import use_compile_cache
from elitelanes_jax.search.evolution import evolve
from elitelanes_jax.search.selection import MIN_DIFFERENCE
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet

# A round evolves so many seeds, and gives at most so many maps, as maps of one seed are related. If it gives fewer than
# the last figure, the next ones may be more alike.
_SEEDS, _FROM_ROUND, _FEW = 16, 512, 8


class Maps:
    """Maps by number, kept in files of a round each; a few rounds are held in memory.

    Args:
      rounds: the files, JSON lines.
    """

    def __init__(self, rounds: Sequence[Path]) -> None:
        self.rounds = list(rounds)
        self._ends = list(accumulate(len(_lines(file)) for file in self.rounds))
        self._maps_of = lru_cache(maxsize=8)(_maps_of)  # its own, as other datasets may have files of the same names

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[RoadMap]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, number: int) -> RoadMap:
        place = bisect_right(self._ends, number)
        return self._maps_of(self.rounds[place])[number - (self._ends[place - 1] if place else 0)]


def evolve_maps(spec: DatasetSpec, search: SearchSpec, work: Path, executor: Executor | None = None) -> Maps:
    """Evolves the maps round by round, each round kept in a file as soon as it is done.

    All are valid, and no two alike when rotated or mirrored: each differs from all others in `MIN_DIFFERENCE` of its
    tiles, in less where no more such maps are found. Within a round the niches give as equally as they can.

    Args:
      spec: of the dataset.
      search: its search, of maps that its tiles can draw.
      work: folder for the rounds.
      executor: whose workers search, one size each, and share the disk.

    Raises:
      NotEnoughMapsError: if the searches give too few maps.
      OSError: if a file cannot be written, or a worker fails.
    """
    wanted = maps_by_shape(spec)
    if executor is not None:
        jobs = {
            "maps of {} x {} tiles".format(*shape): (spec.seed, search, shape, count, work.absolute())
            for shape, count in wanted.items()
        }
        with Progress("evolving", len(jobs), "sizes") as bar:
            run_on(executor, _evolve_on_worker, jobs, lambda _: bar.count())
    rounds: list[Path] = []
    with Progress("evolving", spec.maps, "maps") as bar:
        for shape, count in wanted.items():
            for file, found in _rounds(spec.seed, search, shape, count, work):
                rounds.append(file)
                bar.count(found)
    return Maps(rounds)


def _evolve_on_worker(seed: int, search: SearchSpec, shape: tuple[int, int], wanted: int, work: Path) -> None:
    """Keeps all rounds of one size."""
    use_compile_cache()
    for _ in _rounds(seed, search, shape, wanted, work):
        pass


def _rounds(
    seed: int, search: SearchSpec, shape: tuple[int, int], wanted: int, work: Path
) -> Iterator[tuple[Path, int]]:
    """Yields the file of each round of one size and the number of its maps; evolves those that are not there."""
    found: list[NDArray[np.int8]] = []
    number = level = 0
    while len(found) < wanted:
        file = work / "maps" / f"{shape[0]}x{shape[1]}-{number}.jsonl"
        if not file.exists():
            _keep(file, _evolve_round(seed, search, shape, number, wanted, found, MIN_DIFFERENCE[level]))
        new = [road_map.codes for road_map in _maps_of(file)]
        # Where few maps differ as much as they should, the next ones may differ less.
        if len(new) < min(_FEW, wanted - len(found)):
            level += 1
        found += new
        if level == len(MIN_DIFFERENCE):
            raise NotEnoughMapsError(
                f"found {len(found)} different ones of {wanted} maps of {shape[0]} x {shape[1]} tiles; larger sizes, "
                "more evaluations or fewer maps"
            )
        number += 1
        yield file, len(new)


def given_maps(maps: Sequence[RoadMap], work: Path) -> Maps:
    """Keeps given maps like evolved ones."""
    file = work / "maps" / "given.jsonl"
    _keep(file, maps)
    return Maps([file])


def _evolve_round(
    seed: int,
    search: SearchSpec,
    shape: tuple[int, int],
    number: int,
    wanted: int,
    found: Sequence[NDArray[np.int8]],
    min_difference: float,
) -> list[RoadMap]:
    """Evolves the maps of one round, each unlike all before in so large a share of its tiles."""
    first = number * _SEEDS
    result = evolve(seed_keys(seed, range(first, first + _SEEDS)), shape, spec=search)
    count = min(wanted - len(found), _FROM_ROUND)
    choice = result.choose(count, seed, exclude=found, min_difference=(min_difference,))
    if not choice.maps and not found:
        hint = choice.hint(search.method, shape)
        raise NotEnoughMapsError(choice.describe_shortage(wanted, hint, writable=False))
    return [replace(road_map, seed=(seed, first + (road_map.seed or (0, 0))[1])) for road_map in choice.maps]


def split_maps(spec: DatasetSpec, maps: Maps, test_tiles: TileSet) -> NDArray[np.int_]:
    """Assigns each map to a split, a place in `SPLITS`, int ``[maps]``.

    Every split has its share of every size and every niche, as evenly as can be; the test only maps that its tiles
    can draw.

    Raises:
      InputError: if its tiles can draw too few.
    """
    niches = [(*road_map.codes.shape, *(road_map.niche or ())) for road_map in maps]
    drawable = np.array([bool(np.isin(road_map.codes, list(test_tiles.rotations)).all()) for road_map in maps])
    order = np.array(sorted(range(len(niches)), key=lambda number: (niches[number], number)))
    splits = np.zeros(len(order), int)
    counts = maps_by_split(spec)
    for place in (2, 1):
        free = order[(splits[order] == 0) & (drawable[order] | (place != 2))]
        if len(free) < counts[place]:
            codes = {code for road_map in maps for code in road_map.codes.flat} - set(test_tiles.rotations)
            lacking = [kind for kind, members in KINDS.items() if codes & set(members)]
            expected = (
                f"{pluralize(counts[place], 'map')} without {' and '.join(lacking)}, of which there is one picture only"
            )
            raise InputError(
                f"hold_out_tiles: expected {expected}, for the {SPLITS[place]}, got {len(free)} of {len(order)}"
            )
        splits[free[_evenly(len(free), counts[place])]] = place
    return splits


def _evenly(count: int, wanted: int) -> NDArray[np.int_]:
    """Returns so many places out of a row, as evenly spaced as can be."""
    return ((np.arange(wanted) * 2 + 1) * count) // (2 * max(wanted, 1))


def _keep(file: Path, maps: Sequence[RoadMap]) -> None:
    lines = (json.dumps(_record(road_map)) for road_map in maps)
    write_atomic(file, "".join(f"{line}\n" for line in lines).encode())


def _record(road_map: RoadMap) -> dict[str, Plain]:
    objects = road_map.objects and [thing._asdict() for thing in road_map.objects]
    return vars(road_map) | {"codes": road_map.codes.tolist(), "drawn": None, "objects": objects}


def _lines(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").splitlines()


def _maps_of(file: Path) -> list[RoadMap]:
    records = map(json.loads, _lines(file))
    return [RoadMap(**record) for record in records]
