"""The maps of a dataset, and the split of each map."""

import json
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import lru_cache, partial
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.threads import count_cores, start_thread
from elitelanes_jax._util.types import Plain
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
    """Maps by index, kept in a file for each round; a few rounds are held in memory.

    Args:
      rounds: the files, JSON lines.
    """

    def __init__(self, rounds: Sequence[Path]) -> None:
        self.rounds = list(rounds)
        self._ends = list(accumulate(len(_lines(file)) for file in self.rounds))
        self._maps_of = lru_cache(maxsize=8)(_maps_of)  # not shared: other datasets may have files of the same names

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[RoadMap]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, index: int) -> RoadMap:
        round_ = bisect_right(self._ends, index)
        return self._maps_of(self.rounds[round_])[index - (self._ends[round_ - 1] if round_ else 0)]


def evolve_maps(spec: DatasetSpec, search: SearchSpec, work: Path, executor: Executor | None = None) -> Maps:
    """Evolves the maps round by round, and writes a file after each round.

    All are valid, and each differs from all others in `MIN_DIFFERENCE` of its tiles, however they are rotated or
    mirrored. If no more such maps are found, the next, smaller difference applies. The maps of a round are spread
    evenly over the niches.

    Args:
      spec: of the dataset.
      search: its search, of maps that its tiles can draw.
      work: folder for the rounds.
      executor: whose workers search, one size each, and share the disk.

    Raises:
      NotEnoughMapsError: if the searches find too few maps.
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
        compiled = None  # waits for the programs of the next size, which are compiled beside the search of this one
        for (shape, count), after in zip(wanted.items(), [*list(wanted)[1:], None], strict=True):
            if compiled is not None:
                compiled()
            compiled = _compile_aside(spec.seed, search, after, work)
            for file, found in _rounds(spec.seed, search, shape, count, work):
                rounds.append(file)
                bar.count(found)
    return Maps(rounds)


def _compile_aside(
    seed: int, search: SearchSpec, shape: tuple[int, int] | None, work: Path
) -> Callable[[], None] | None:
    """Compiles the programs of a size's first round, if it was not made before; returns a function that waits."""
    if shape is None or _round_file(work, shape, 0).exists() or count_cores() == 1:
        return None
    return start_thread(partial(compile_search, seed_keys(seed, range(_SEEDS)), shape, search))


def _evolve_on_worker(seed: int, search: SearchSpec, shape: tuple[int, int], wanted: int, work: Path) -> None:
    use_compile_cache()
    for _ in _rounds(seed, search, shape, wanted, work):
        pass


def _rounds(
    seed: int, search: SearchSpec, shape: tuple[int, int], wanted: int, work: Path
) -> Iterator[tuple[Path, int]]:
    """Yields the file of each round of one size and the number of its maps; evolves missing rounds."""
    found: list[NDArray[np.int8]] = []
    round_ = level = 0
    while len(found) < wanted:
        file = _round_file(work, shape, round_)
        if not file.exists():
            _keep(file, _evolve_round(seed, search, shape, round_, wanted, found, MIN_DIFFERENCE[level]))
        new = [road_map.codes for road_map in _maps_of(file)]
        # If few maps differ enough, the next ones may differ less.
        if len(new) < min(_FEW, wanted - len(found)):
            level += 1
        found += new
        if level == len(MIN_DIFFERENCE):
            raise NotEnoughMapsError(
                f"found {len(found)} different ones of {wanted} maps of {shape[0]} x {shape[1]} tiles; larger sizes, "
                "more evaluations or fewer maps"
            )
        round_ += 1
        yield file, len(new)


def _round_file(work: Path, shape: tuple[int, int], number: int) -> Path:
    return work / "maps" / f"{shape[0]}x{shape[1]}-{number}.jsonl"


def given_maps(maps: Sequence[RoadMap], work: Path) -> Maps:
    """Writes given maps to a file like evolved ones."""
    file = work / "maps" / "given.jsonl"
    _keep(file, maps)
    return Maps([file])


def _evolve_round(
    seed: int,
    search: SearchSpec,
    shape: tuple[int, int],
    round_: int,
    wanted: int,
    found: Sequence[NDArray[np.int8]],
    min_difference: float,
) -> list[RoadMap]:
    """Evolves the maps of one round, which differ from all earlier maps by at least `min_difference`."""
    first = round_ * _SEEDS
    result = evolve(seed_keys(seed, range(first, first + _SEEDS)), shape, spec=search)
    count = min(wanted - len(found), _FROM_ROUND)
    choice = result.choose(count, seed, exclude=found, min_difference=(min_difference,))
    if not choice.maps and not found:
        hint = choice.hint(search.method, shape)
        raise NotEnoughMapsError(choice.describe_shortage(wanted, hint, writable=False))
    return [replace(road_map, seed=(seed, first + (road_map.seed or (0, 0))[1])) for road_map in choice.maps]


def split_maps(spec: DatasetSpec, maps: Maps, test_tiles: TileSet) -> NDArray[np.int_]:
    """Assigns each map to a split, an index in `SPLITS`, int ``[maps]``.

    Every split has its share of every size and every niche, as evenly as possible. The test has only maps that its
    tiles can draw.

    Raises:
      InputError: if its tiles can draw too few.
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
        splits[free[_evenly(len(free), counts[split])]] = split
    return splits


def _evenly(count: int, wanted: int) -> NDArray[np.int_]:
    """Returns `wanted` indices from 0 to `count` - 1, evenly spaced."""
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
