"""Which maps a dataset has, and which split each belongs to."""

import json
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.codes import KINDS
from elitelanes_jax.dataset.formats import SPLITS
from elitelanes_jax.dataset.settings import Settings, maps_by_side, maps_by_split
from elitelanes_jax.errors import InputError, NotEnoughMapsError
from elitelanes_jax.folders import write_whole
from elitelanes_jax.progress import counter
from elitelanes_jax.roadmap import RoadMap
from elitelanes_jax.search import seed_keys
from elitelanes_jax.selection import LEAST_DIFFERENT, choose_maps, shortage
from elitelanes_jax.tilesets import TileSet
from elitelanes_jax.wishes import search

__all__ = ["Maps", "evolve_maps", "given_maps", "split_maps"]

# A round evolves so many seeds, and gives at most so many maps: of what is akin not too much. If it gives fewer than
# the last figure, the next ones may be more alike.
_SEEDS, _FROM_ROUND, _FEW = 16, 512, 8


class Maps:
    """Maps by number, kept in files of a round each; a few rounds are held in memory.

    Args:
      rounds: the files, JSON lines.
    """

    def __init__(self, rounds: Sequence[Path]) -> None:
        self._rounds = list(rounds)
        self._ends = list(accumulate(len(_lines(file)) for file in self._rounds))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[RoadMap]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, number: int) -> RoadMap:
        place = bisect_right(self._ends, number)
        return _maps_of(self._rounds[place])[number - (self._ends[place - 1] if place else 0)]


def evolve_maps(settings: Settings, tiles: TileSet, work: Path) -> Maps:
    """Evolves the maps round by round, each round kept in a file as soon as it is done.

    All are valid, and no two alike when turned or mirrored: each differs from all others in `LEAST_DIFFERENT` of its
    tiles, in less where no more such maps are found. Within a round the niches give as equally as they can.

    Args:
      settings: what is wanted.
      tiles: that can draw them.
      work: folder for the rounds.

    Raises:
      InputError: for settings out of their range.
      NotEnoughMapsError: if the searches give too few maps.
    """
    rounds: list[Path] = []
    with counter("evolving", settings.maps, "maps") as bar:
        for side, wanted in maps_by_side(settings).items():
            found: list[NDArray[np.int8]] = []
            number = level = 0
            while len(found) < wanted:
                file = work / "maps" / f"{side}-{number}.jsonl"
                if not file.exists():
                    maps = _round(settings, tiles, side, number, wanted, found, LEAST_DIFFERENT[level])
                    _keep(file, maps)
                new = [road_map.codes for road_map in _maps_of(file)]
                # Where few maps differ as much as they should, less has to do.
                if len(new) < min(_FEW, wanted - len(found)):
                    level += 1
                found += new
                if level == len(LEAST_DIFFERENT):
                    raise NotEnoughMapsError(
                        f"found {len(found)} different ones of {wanted} maps of {side} x {side} tiles; larger sizes, "
                        "more evaluations or fewer maps"
                    )
                rounds.append(file)
                number += 1
                bar.update(len(new))
    return Maps(rounds)


def given_maps(maps: Sequence[RoadMap], work: Path) -> Maps:
    """Maps that are there already, kept like evolved ones."""
    file = work / "maps" / "given.jsonl"
    _keep(file, maps)
    return Maps([file])


def _round(
    settings: Settings,
    tiles: TileSet,
    side: int,
    number: int,
    wanted: int,
    found: Sequence[NDArray[np.int8]],
    least: float,
) -> list[RoadMap]:
    """The maps of one round, each unlike all before in so large a share of its tiles."""
    first = number * _SEEDS
    keys = seed_keys(settings.seed, first + _SEEDS)[first:]
    result = search(settings.wishes, keys, (side, side), tiles.alphabet, progress=False)
    count = min(wanted - len(found), _FROM_ROUND)
    choice = choose_maps(result, count, settings.seed, known=found, least=(least,))
    if not choice.maps and not found:
        raise NotEnoughMapsError(shortage(choice, wanted, settings.wishes.method, (side, side)))
    return [road_map._replace(seed=(settings.seed, first + (road_map.seed or (0, 0))[1])) for road_map in choice.maps]


def split_maps(settings: Settings, maps: Maps, test_tiles: TileSet) -> NDArray[np.int_]:
    """The split of each map, a place in `SPLITS`, int ``[maps]``.

    Every split has its share of every size and every niche, as evenly as can be; the test only maps that its tiles
    can draw.

    Raises:
      InputError: if its tiles can draw too few.
    """
    niches = [(len(road_map.codes), *(road_map.niche or ())) for road_map in maps]
    drawable = np.array([bool(np.isin(road_map.codes, list(test_tiles.turned)).all()) for road_map in maps])
    order = np.array(sorted(range(len(niches)), key=lambda number: (niches[number], number)))
    splits = np.zeros(len(order), int)
    counts = maps_by_split(settings)
    for place in (2, 1):
        free = order[(splits[order] == 0) & (drawable[order] | (place != 2))]
        if len(free) < counts[place]:
            codes = {code for road_map in maps for code in road_map.codes.flat} - set(test_tiles.turned)
            lacking = [kind for kind, members in KINDS.items() if codes & set(members)]
            raise InputError(
                f"hold_out_tiles: expected {counts[place]} maps without {' and '.join(lacking)}, of which there is one "
                f"picture only, for the {SPLITS[place]}, got {len(free)} of {len(order)}"
            )
        splits[free[_evenly(len(free), counts[place])]] = place
    return splits


def _evenly(count: int, wanted: int) -> NDArray[np.int_]:
    """So many places out of a row, as evenly spaced as can be."""
    return ((np.arange(wanted) * 2 + 1) * count) // (2 * max(wanted, 1))


def _keep(file: Path, maps: Sequence[RoadMap]) -> None:
    lines = (json.dumps(road_map._asdict() | {"codes": road_map.codes.tolist()}) for road_map in maps)
    write_whole(file, "".join(f"{line}\n" for line in lines).encode())


def _lines(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").splitlines()


@lru_cache(maxsize=8)
def _maps_of(file: Path) -> list[RoadMap]:
    records = map(json.loads, _lines(file))
    return [RoadMap(**record | {"codes": np.array(record["codes"], np.int8)}) for record in records]
