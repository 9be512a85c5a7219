"""The maps of a dataset, and the split of each map."""

import json
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import lru_cache, partial
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jax import Array
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.threads import count_cores, start_thread
from elitelanes_jax.dataset.spec import DatasetSpec, maps_by_shape, maps_by_split
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.cluster import run_on
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.optimizers.loop import seed_keys
from elitelanes_jax.search.compile_cache import use_compile_cache
from elitelanes_jax.search.evolution import compile_search, evolve
from elitelanes_jax.search.selection import MIN_DIFFERENCE
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet

# Each round evolves 16 seeds and returns at most 512 maps, because maps of one seed are related. After a round with
# fewer than 8 maps, the maps of the next rounds may be more alike.
_SEEDS, _FROM_ROUND, _FEW = 16, 512, 8


class Maps:
    """Maps by index, kept in a file of JSON lines for each round; a few rounds are held in memory."""

    def __init__(self, rounds: Sequence[Path]) -> None:
        self.rounds = list(rounds)
        self._ends = list(accumulate(len(_lines(file)) for file in self.rounds))
        self._maps_of = lru_cache(maxsize=8)(_maps_of)  # not shared: other datasets may have files of the same names

    def __reduce__(self) -> tuple[type["Maps"], tuple[list[Path]]]:
        return Maps, (self.rounds,)

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[RoadMap]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, index: int) -> RoadMap:
        round_ = bisect_right(self._ends, index)
        return self._maps_of(self.rounds[round_])[index - (self._ends[round_ - 1] if round_ else 0)]


def evolve_maps(spec: DatasetSpec, search: SearchSpec, work: Path, executor: Executor | None = None) -> Maps:
    """Evolves the maps round by round, and writes a file after each round to the folder `work`.

    All are valid, and each differs from all others in `MIN_DIFFERENCE` of its tiles, however they are rotated or
    mirrored. If no more such maps are found, the next, smaller difference applies. The maps of a round are spread
    evenly over the niches. The workers of an executor search one size each. Raises `NotEnoughMapsError`.
    """
    sizes = [_Size(spec.seed, search, *item, work) for item in maps_by_shape(spec).items()]
    if executor is not None:
        jobs = {"maps of {} x {} tiles".format(*one.shape): (one._replace(work=work.absolute()),) for one in sizes}
        with Progress("evolving", len(jobs), "sizes") as bar:
            run_on(executor, _evolve_on_worker, jobs, lambda _: bar.count())
    rounds: list[Path] = []
    with Progress("evolving", spec.maps, "maps") as bar:
        compiled = None  # waits for the programs of the next size, which are compiled beside the search of this one
        for size, after in zip(sizes, [*sizes[1:], None], strict=True):
            if compiled is not None:
                compiled()
            compiled = after and after.compile_aside()
            for file, found in size.rounds():
                rounds.append(file)
                bar.count(found)
    return Maps(rounds)


class _Size(NamedTuple):
    """The search for the maps of one size. `search` is for maps that the tiles can draw, `work` the rounds' folder."""

    seed: int
    search: SearchSpec
    shape: tuple[int, int]
    wanted: int
    work: Path

    def rounds(self) -> Iterator[tuple[Path, int]]:
        """Yields the file of each round and the number of its maps; evolves missing rounds."""
        found: list[NDArray[np.int8]] = []
        number = level = 0
        while len(found) < self.wanted:
            file = self._file(number)
            if not file.exists():
                _keep(file, self._evolve(number, found, MIN_DIFFERENCE[level]))
            new = [road_map.codes for road_map in _maps_of(file)]
            # If few maps differ enough, the next ones may differ less.
            if len(new) < min(_FEW, self.wanted - len(found)):
                level += 1
            found += new
            if level == len(MIN_DIFFERENCE):
                raise NotEnoughMapsError(
                    f"found {len(found)} different ones of {self.wanted} maps of {self.shape[0]} x {self.shape[1]} "
                    "tiles; larger sizes, more evaluations or fewer maps"
                )
            number += 1
            yield file, len(new)

    def compile_aside(self) -> Callable[[], None] | None:
        """Compiles the first round's programs, if it was not made before; returns a function that waits."""
        if self._file(0).exists() or count_cores() == 1:
            return None
        return start_thread(partial(compile_search, self._keys(0), self.shape, self.search))

    def _file(self, number: int) -> Path:
        return self.work / "maps" / f"{self.shape[0]}x{self.shape[1]}-{number}.jsonl"

    def _keys(self, number: int) -> Array:
        return seed_keys(self.seed, range(number * _SEEDS, (number + 1) * _SEEDS))

    def _evolve(self, number: int, found: Sequence[NDArray[np.int8]], min_difference: float) -> list[RoadMap]:
        """Evolves the maps of a round, which differ from all earlier maps by at least `min_difference`."""
        result = evolve(self._keys(number), self.shape, spec=self.search)
        count = min(self.wanted - len(found), _FROM_ROUND)
        choice = result.choose(count, self.seed, exclude=found, min_difference=(min_difference,))
        if not choice.maps and not found:
            hint = choice.hint(self.search.method, self.shape)
            raise NotEnoughMapsError(choice.describe_shortage(self.wanted, hint, writable=False))
        first = number * _SEEDS
        return [replace(road_map, seed=(self.seed, first + (road_map.seed or (0, 0))[1])) for road_map in choice.maps]


def _evolve_on_worker(size: _Size) -> None:
    use_compile_cache()
    for _ in size.rounds():
        pass


def given_maps(maps: Sequence[RoadMap], work: Path) -> Maps:
    """Writes given maps to a file like evolved ones."""
    file = work / "maps" / "given.jsonl"
    _keep(file, maps)
    return Maps([file])


def split_maps(spec: DatasetSpec, maps: Maps, test_tiles: TileSet) -> NDArray[np.int_]:
    """Assigns each map to a split, an index in `SPLITS`, int ``[maps]``.

    Every split has its share of every size and every niche, as evenly as possible. The test has only maps that its
    tiles can draw; raises `InputError` if they are too few.
    """
    niches = [(*road_map.codes.shape, *(road_map.niche or ())) for road_map in maps]
    drawable = np.array([bool(np.isin(road_map.codes, list(test_tiles.rotations)).all()) for road_map in maps])
    order = np.array(sorted(range(len(niches)), key=lambda index: (niches[index], index)))
    splits = np.zeros(len(order), int)
    counts = maps_by_split(spec)
    for split in (2, 1):
        free = order[(splits[order] == 0) & (drawable[order] | (split != 2))]
        if len(free) < counts[split]:
            codes = {code for road_map in maps for code in road_map.codes.flat} - set(test_tiles.rotations)
            lacking = [kind for kind, members in KINDS.items() if codes & set(members)]
            expected = f"{pluralize(counts[split], 'map')} without {' and '.join(lacking)}, which have only one picture"
            raise InputError(
                f"hold_out_tiles: expected {expected}, for the {SPLITS[split]}, got {len(free)} of {len(order)}"
            )
        evenly = (np.arange(counts[split]) * 2 + 1) * len(free) // (2 * max(counts[split], 1))
        splits[free[evenly]] = split
    return splits


def _keep(file: Path, maps: Sequence[RoadMap]) -> None:
    lines = []
    for road_map in maps:
        objects = road_map.objects and [thing._asdict() for thing in road_map.objects]
        lines.append(vars(road_map) | {"codes": road_map.codes.tolist(), "drawn": None, "objects": objects})
    write_atomic(file, (f"{json.dumps(line)}\n".encode() for line in lines))


def _lines(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").splitlines()


def _maps_of(file: Path) -> list[RoadMap]:
    return [RoadMap(**json.loads(line)) for line in _lines(file)]
