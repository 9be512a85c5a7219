"""The result of a search."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int8

from elitelanes_jax._util.checks import SEED, check_named, file_named, none_or, whole
from elitelanes_jax._util.checks import path as checked_path
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import pluralize, warn_user
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Pytree, Untyped, UserValue
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.optimizers.presets import Config
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.problem.kernels import with_town_features
from elitelanes_jax.problem.ranges import Range, parse_ranges, satisfies
from elitelanes_jax.search._result_file import ResultFields, read_result, write_result
from elitelanes_jax.search.records import (
    History,
    MeasuredElites,
    RunState,
    check_metrics,
    to_numpy,
)
from elitelanes_jax.search.resolve import Search, with_ranges
from elitelanes_jax.search.selection import MIN_DIFFERENCE, Choice, choose_maps, without_flaws
from elitelanes_jax.search.settings import CUSTOM, METHODS


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Result:
    """The result of `evolve`; a pytree.

    Attributes:
      elites: the grids found, with their metrics.
      history: the history of the generations of this call.
      state: the state to continue from.
      search: the search with all its settings. Its method and preset say what made the result;
        `custom` is your own configuration or optimiser.
      config: the configuration of the method; None for your own optimiser.
      functions: names and digests of your own functions, which tell edited functions apart.
    """

    elites: MeasuredElites
    history: History
    state: RunState
    search: Search = field(metadata={"static": True})
    config: Config | None = field(default=None, metadata={"static": True})
    functions: tuple[tuple[str, str], ...] = field(default=(), metadata={"static": True})

    def __post_init__(self) -> None:
        """Copies arrays of NumPy, see `frozen_copy`."""
        for name in ("elites", "history", "state"):
            object.__setattr__(self, name, jax.tree.map(frozen_copy, getattr(self, name)))

    @property
    def seeds(self) -> int:
        """The number of seeds."""
        return 1 if self.elites.fitness.ndim == 1 else len(self.elites.fitness)

    def with_seed_axis(self) -> "Result":
        """Returns the result with an axis of seeds in front, which the result of one key lacks."""
        if self.elites.fitness.ndim > 1:
            return self
        return self._map_seeded(lambda array: array[None])

    def without_seed_axis(self) -> "Result":
        """Returns the result of a single seed without the axis of seeds."""
        return self._map_seeded(lambda array: array[0])

    @jax.transfer_guard("allow")
    def _map_seeded(self, change: Callable[[Pytree], Pytree]) -> "Result":
        """Changes all arrays that have an axis of seeds if there are several."""
        history = self.history
        best_fitness, elite_count, refused = map(
            change, (history.best_fitness, history.elite_count, history.refused)
        )
        # An index in NumPy compiles nothing.
        elites, inner = jax.tree.map(
            lambda array: jax.device_put(change(to_numpy(array))), (self.elites, self.state.inner)
        )
        return replace(
            self,
            elites=elites,
            history=history._replace(
                best_fitness=best_fitness, elite_count=elite_count, refused=refused
            ),
            state=self.state._replace(inner=inner),
        )

    @runs_jax
    def best(self) -> Int8[Array, "*S H W"]:
        """Returns the grid of lowest fitness, int8 ``[H, W]``; among equal ones the first."""
        ranked = jnp.where(
            self.elites.valid, self.elites.fitness, vacant_fitness(self.elites.fitness.dtype)
        )
        index = jnp.argmin(ranked, axis=-1)[..., None, None, None]
        return jnp.take_along_axis(self.elites.grids, index, axis=-3)[..., 0, :, :]

    @jax.transfer_guard("allow")
    def satisfies(self) -> Bool[np.ndarray, "*S N"]:
        """Returns which elites are in all ranges of the search, exactly."""
        return np.asarray(self.elites.valid) & satisfies(self.elites.by_name(), self.search.ranges)

    def without_flaws(self) -> tuple[Bool[np.ndarray, "*S N"], Counter[str]]:
        """Returns which elites `maps` may choose, and the number of the others in all ranges by reason.

        An elite is rejected for a flaw, such as a dead end, or if it breaks a rule or a fixed cell
        of the search.
        """
        return without_flaws(self.satisfies(), self.elites, self.search)

    @jax.transfer_guard("allow")
    def maps(self, count: int = 16, *, where: UserValue = ()) -> list[RoadMap]:
        """Chooses maps that are valid, different and spread over the niches.

        The command ``generate`` chooses in the same way. If there are fewer maps than `count`, a
        warning says how many there are, and why the other elites were rejected.

        Args:
          count: the number of maps.
          where: ranges as in `evolve`, added to those of the search. They override the search's
            range of the same feature.

        Returns:
          Maps with their metrics, sorted by niche, and within a niche by fitness.

        Raises:
          InputError: for a bad count or range, or if the grids of the result were changed, so that
            its metrics are not theirs.
        """
        count = check_named("count", whole(1), count)
        with jax.transfer_guard("allow"):
            check_named("elites", check_metrics, self.elites)
        result = self.with_ranges(parse_ranges(where, self.search.settings.features))
        choice = result.choose(count)
        if len(choice.maps) < count:
            hint = choice.hint(result.search)
            warn_user(choice.describe_shortage(count, hint, writable=False))
        return choice.maps

    def with_ranges(self, ranges: Sequence[Range]) -> "Result":
        """Returns the result with more ranges.

        New ranges override those of the same feature. Features that they need are measured.

        Raises:
          InputError: for a feature of the user that the search has not measured.
        """
        if not ranges:
            return self
        # A range may name a feature that the search did not measure.
        search = with_ranges(self.search, ranges)
        elites = self.elites
        names = [item.name for item in search.ranges]
        features: dict[str, Untyped] = dict(
            with_town_features(elites.features, names, elites.grids, "where")
        )
        return replace(self, elites=elites._replace(features=features), search=search)

    @jax.transfer_guard("allow")
    def choose(
        self,
        count: int,
        seed: int = 0,
        *,
        exclude: Sequence[Int8[np.ndarray, "_ _"]] = (),
        min_difference: Sequence[float] = MIN_DIFFERENCE,
    ) -> Choice:
        """Chooses maps as `maps` does, and says why the others were rejected."""
        elites = self.with_seed_axis().elites
        return choose_maps(
            elites, self.search, count, seed, exclude=exclude, min_difference=min_difference
        )

    @jax.transfer_guard("allow")
    def __repr__(self) -> str:
        """Returns the search and its elites, in a few lines."""
        fitness = self.elites.fitness
        # While JAX traces or maps over a result, its leaves have no numbers to show.
        if not hasattr(fitness, "__array__") or isinstance(fitness, jax.core.Tracer):
            return f"Result(elites={self.elites!r}, search={self.search!r})"
        valid = np.asarray(self.elites.valid)
        best = "none valid"
        if valid.any():
            best = f"the best with fitness {np.asarray(fitness)[valid].min()}"
        axes = [f"{axis.metric}:{axis.bins}:{axis.width}" for axis in self.search.axes]
        lines = [
            self._describe_search(),
            f"  elites   {valid.sum():,} in {valid.size:,} slots, {best}",
            "  axes     " + " ".join(axes),
        ]
        if self.search.ranges:
            lines.append("  where    " + " ".join(map(str, self.search.ranges)))
        if self.config is not None and self.search.settings.preset == CUSTOM:
            lines.append(f"  config   {self.config}")
        lines.append("  fields   elites, history, state, search, config")
        lines.append(
            "  methods  best(): the fittest grid; maps(count, where=...): chosen maps; save(path)"
        )
        return "\n".join(lines)

    def _describe_search(self) -> str:
        """Returns the method, the size and the budget in a line."""
        settings = self.search.settings
        method = f"{self.search.optimizer}"
        if settings.method in METHODS:
            method += f", preset {settings.preset}"
        height, width = self.search.shape
        evaluations = 0
        if len(self.history.evaluations):
            evaluations = self.history.evaluations[-1]
        budget = f"{pluralize(self.seeds, 'seed')}, {evaluations:,} evaluations each"
        return f"Result of {method}: {height} x {width} tiles, {budget}"

    @jax.transfer_guard("allow")
    def save(self, path: str | Path, *, state: bool = True, seed: int | None = None) -> None:
        """Writes the result to a file, whole or not at all.

        The file has arrays as NumPy's ``.npz``, and options as JSON in it.

        Args:
          path: the file, ``.npz``; an existing file is replaced.
          state: whether to write the state and the measured speeds too. Without them equal searches
            give equal bytes.
          seed: the seed that the keys were made from, to be noted in the file.

        Raises:
          InputError: if the name does not end in .npz, or your own
            optimiser's state has leaves that are not arrays of numbers.
          OSError: that names the file, if it cannot be written.
        """
        file = check_named("path", file_named(".npz"), path)
        seed = check_named("seed", none_or(SEED), seed)
        write_result(file, ResultFields(**vars(self)), state=state, seed=seed)

    @classmethod
    def load(cls, path: str | Path) -> "Result":
        """Reads a result that `save` wrote, or the ``archive.npz`` of `elitelanes generate`.

        A result that was saved without state has NaN for the speeds, and cannot be continued.

        Raises:
          InputError: if the file cannot be read, is no result, is damaged, has another version, or
            has metrics that are not those of its grids.
        """
        return load_with_seed(path)[0]


@runs_jax
def load_with_seed(path: str | Path) -> tuple[Result, int | None]:
    """Returns what `Result.load` returns, and the seed that is noted in the file, or None."""
    fields, seed = read_result(check_named("path", checked_path, path))
    return Result(*fields), seed


class SearchInterrupted(KeyboardInterrupt):
    """An interruption of `evolve` by Ctrl-C: a `KeyboardInterrupt` with the result so far.

    Args:
      message: what was done.
      make: makes the result.
    """

    def __init__(self, message: str, make: Callable[[], Result]) -> None:
        super().__init__(message)
        self._make = make

    @cached_property
    def result(self) -> Result:
        """The result so far, from whose state the search continues."""
        return self._make()

    def __reduce__(self) -> tuple[Callable[..., "SearchInterrupted"], tuple[str, Result]]:
        """Returns what `pickle` stores: the message and the result.

        The result is made here, so that the interruption of a worker process reaches its parent
        with it.
        """
        return _interrupted, (str(self), self.result)


def _interrupted(message: str, result: Result) -> SearchInterrupted:
    return SearchInterrupted(message, lambda: result)
