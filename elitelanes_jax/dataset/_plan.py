"""The maps of a dataset, evolved round by round."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.engine import Pool
from elitelanes_jax._util.errors import NotEnoughMapsError
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.sums import read_sealed_lines, sealed_line
from elitelanes_jax._util.threads import count_cores, start_thread
from elitelanes_jax._util.types import OptionValue
from elitelanes_jax.dataset.planning import PlannedDataset
from elitelanes_jax.dataset.spec import maps_by_shape
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.search.keys import SearchKeys, keys_of_seeds
from elitelanes_jax.search.parts import evolve_each
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.running import compile_search, evolve_search
from elitelanes_jax.search.selection import MIN_DIFFERENCE

# The seeds that a round evolves. A round returns a part of their maps, because maps of one seed are
# related.
_SEEDS = 16
# The most maps of a round.
_FROM_ROUND = 512
# After a round with fewer maps than this, the maps of the next rounds may be more alike.
_FEW = 8
# The number of sizes whose programs are compiled beside the search of another one: one is traced
# while the other compiles.
_AHEAD = 2


def evolve_maps(plan: PlannedDataset, work: Path, pool: Pool | None = None) -> list[RoadMap]:
    """Evolves the maps round by round, and writes a file after each round to the folder `work`.

    The workers of a pool evolve the rounds that are needed at least, side by side.

    All are valid, and the `difference` of each from all others, of any size, is the first of
    `MIN_DIFFERENCE` or more. If no more such maps of a size are found, the next, smaller difference
    applies. The maps of a round are spread evenly over the niches. Raises `NotEnoughMapsError`.
    """
    # Each size has a search of its own, because a program is compiled for one size.
    sizes: list[_Size] = []
    for shape, count in maps_by_shape(plan.spec).items():
        sizes.append(_Size(plan.spec.seed, plan.searches[shape], count, work))
    # Workers search the rounds that are certain to be needed. The loop below reads their results.
    if pool is not None:
        _evolve_ahead(sizes, pool)
    maps: list[RoadMap] = []
    with Progress("evolving", plan.spec.maps, "maps") as bar:
        # Each function waits for the programs of a size, which are compiled beside the searches of
        # the sizes before it. The first size compiles its own.
        compiled: list[Callable[[], None]] = [lambda: None]
        for index, size in enumerate(sizes):
            for next_size in sizes[len(compiled) : index + 1 + _AHEAD]:
                compiled.append(next_size.compile_aside())
            wait_for_programs = compiled[index]
            wait_for_programs()
            # A map may also be like one of another size, so all earlier maps are compared.
            for maps_of_round in size.rounds([road_map.codes for road_map in maps]):
                maps += maps_of_round
                bar.count(len(maps_of_round))
    return maps


def _evolve_ahead(sizes: "Sequence[_Size]", pool: Pool) -> None:
    """Evolves the first rounds of all sizes on workers, and keeps the results.

    The number of rounds is the least that the maps need.
    """
    rounds = []
    for size in sizes:
        for number in range(-(-size.wanted // _FROM_ROUND)):
            # An earlier run may have left the maps of a round, or its result.
            if not size.file(number).exists() and not size.result_file(number).exists():
                rounds.append((size, number))
    # Results return in any order, and `rounds` tells which one a result is of.
    tasks = [(size.search, size.keys(number)) for size, number in rounds]
    with Progress("searching", len(rounds), "searches") as bar:
        for index, part in evolve_each(tasks, pool):
            size, number = rounds[index]
            size.result_file(number).parent.mkdir(exist_ok=True)
            # The state of the optimiser is left out, because no round is continued.
            part.result.save(size.result_file(number), state=False)
            bar.count()


def _read_round(file: Path) -> list[dict[str, OptionValue]] | None:
    """Reads the maps of a round. Returns None without a file, or if the file is damaged."""
    if not file.exists():
        return None
    lines = [*read_sealed_lines(file.read_bytes())]
    return json.loads(lines[0]) if lines else None


class _Size(NamedTuple):
    """The search for the maps of one size.

    Attributes:
      seed: the seed of the dataset.
      search: the search, for maps that the tiles can draw.
      wanted: the number of maps.
      work: the folder of the rounds' files.
    """

    seed: int
    search: Search
    wanted: int
    work: Path

    @property
    def shape(self) -> tuple[int, int]:
        return self.search.shape

    def rounds(self, others: Sequence[NDArray[np.int8]]) -> Iterator[list[RoadMap]]:
        """Yields the maps of each round; evolves missing rounds.

        The maps differ from `others`, of any sizes.
        """
        # The maps of this size from earlier rounds.
        earlier: list[NDArray[np.int8]] = []
        number = 0
        # The level is the index in `MIN_DIFFERENCE`. Rounds that an earlier run has written are read,
        # so that it becomes the same again.
        level = 0
        while len(earlier) < self.wanted:
            file = self.file(number)
            maps = _read_round(file)
            if maps is None:
                chosen = self._evolve(number, earlier, others, level)
                # The file is written before the maps are used, so that a killed run reads the same
                # maps again.
                maps = [vars(road_map) | {"codes": road_map.codes.tolist()} for road_map in chosen]
                write_atomic(file, sealed_line(json.dumps(maps).encode()))
            new = [RoadMap(**road_map) for road_map in maps]
            # If few maps differ enough, the next ones may differ less.
            if len(new) < min(_FEW, self.wanted - len(earlier)):
                level += 1
            earlier += [road_map.codes for road_map in new]
            # No smaller difference is left to try.
            if level == len(MIN_DIFFERENCE):
                raise NotEnoughMapsError(
                    f"found {len(earlier)} different ones of {self.wanted} maps of {self.shape[0]} "
                    f"x {self.shape[1]} "
                    "tiles; larger sizes, more evaluations or fewer maps"
                )
            number += 1
            yield new

    def compile_aside(self) -> Callable[[], None]:
        """Compiles the first round's programs, if the round was not made before.

        Returns a function that waits for the programs.
        """
        # With one core, compiling beside a search would only slow the search down.
        if self.file(0).exists() or self.result_file(0).exists() or count_cores() == 1:
            return lambda: None
        return start_thread(partial(compile_search, self.search, self.keys(0)))

    def file(self, number: int) -> Path:
        """Returns the file of the maps of a round."""
        return self.work / "maps" / f"{self.shape[0]}x{self.shape[1]}-{number}.jsonl"

    def result_file(self, number: int) -> Path:
        """Returns the file of the result of a round that a worker evolved."""
        return self.work / "searches" / f"{self.shape[0]}x{self.shape[1]}-{number}.npz"

    def keys(self, number: int) -> SearchKeys:
        """Returns the keys of a round."""
        # Each round has the next seeds, so no two rounds search alike.
        return keys_of_seeds(self.seed, range(number * _SEEDS, (number + 1) * _SEEDS))

    def _evolve(
        self,
        number: int,
        earlier: Sequence[NDArray[np.int8]],
        others: Sequence[NDArray[np.int8]],
        level: int,
    ) -> list[RoadMap]:
        """Evolves the maps of a round.

        They differ from all earlier maps by at least `MIN_DIFFERENCE[level]`.
        """
        # A worker may have evolved this round already.
        if self.result_file(number).exists():
            result = Result.load(self.result_file(number))
        else:
            result = evolve_search(self.search, self.keys(number))
        count = min(self.wanted - len(earlier), _FROM_ROUND)
        exclude = [*others, *earlier]
        choice = result.choose(
            count, self.seed, exclude=exclude, min_difference=(MIN_DIFFERENCE[level],)
        )
        # If no elite is usable, the constraints are the reason. Usable elites may still be like
        # maps of another size, and later rounds may differ less.
        usable = choice.found - sum(choice.rejected.values())
        if not usable and not earlier:
            hint = choice.hint(self.search)
            raise NotEnoughMapsError(choice.describe_shortage(self.wanted, hint, writable=False))
        # The search counts its seeds from 0 in each round, and the dataset counts them over all
        # rounds.
        first = number * _SEEDS
        maps = []
        for road_map in choice.maps:
            _, index = road_map.seed or (0, 0)
            maps.append(replace(road_map, seed=(self.seed, first + index)))
        return maps
