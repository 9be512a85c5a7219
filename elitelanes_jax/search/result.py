"""The result of a search, and the file that it is saved in."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8, Int32, Real, UInt32

from elitelanes_jax._util.checks import SEED, check_named, file_named, is_whole, none_or, whole
from elitelanes_jax._util.checks import path as checked_path
from elitelanes_jax._util.errors import InputError, pluralize, shorten, warn_user
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.npz import npz_bytes, read_npz
from elitelanes_jax._util.packages import __version__
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, Plain, UserValue
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.checks import LONGEST_SIDE
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.optimizers.presets import (
    Config,
    config_from_plain,
    config_to_plain,
    find_preset,
)
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.problem.descriptor import parse_axes
from elitelanes_jax.problem.kernels import with_town_features
from elitelanes_jax.problem.ranges import Range, parse_ranges, satisfies
from elitelanes_jax.search.elites import MeasuredElites, check_metrics, in_short
from elitelanes_jax.search.resolve import Search, search_from_plain, with_ranges
from elitelanes_jax.search.selection import MIN_DIFFERENCE, Choice, choose_maps, without_flaws
from elitelanes_jax.search.settings import CUSTOM, METHODS

_FORMAT = "elitelanes result, version 1"

# The arrays of a file: the dtype (or the allowed dtypes) and the axes. S is the axis of seeds,
# which the result of one key lacks, N of the elites' slots, H and W of rows and columns, D of the
# descriptor's axes, G of generations.
_FITNESS = ("int32", "float32")
_ELITES: dict[str, tuple[str | tuple[str, ...], str]] = {
    "grids": ("int8", "SNHW"),
    "fitness": (_FITNESS, "SN"),
    "descriptor": ("int32", "SND"),
    "valid": ("bool", "SN"),
}
_HISTORY: dict[str, tuple[str | tuple[str, ...], str]] = {
    "generation": ("int64", "G"),
    "evaluations": ("int64", "G"),
    "best_fitness": (_FITNESS, "SG"),
    "elite_count": ("int32", "SG"),
    "evaluations_per_second": ("float64", "G"),
    "refused": ("int32", "SG"),
}
_METRICS = {f"metrics.{name}": ("int32", "SN") for name in Metrics._fields}
_METRICS["metrics.coverage"] = ("float32", "SN")
_ARRAYS = _ELITES | _METRICS | {f"history.{name}": kind for name, kind in _HISTORY.items()}
# Optional arrays: measured speeds, which differ between equal searches, and counts that are all 0.
_SPEED, _REFUSED = "history.evaluations_per_second", "history.refused"
# The prefixes of the arrays of a state, and of features that are not metrics.
_STATE, _FEATURE = "state.", "features."
_FEATURE_KIND = ("int32", "SN")


class History(NamedTuple):
    """A run by generation, as NumPy arrays.

    Attributes:
      generation: int ``[G]``, counted from 1.
      evaluations: int ``[G]``, grids that one seed's steps have evaluated so far.
      best_fitness: int32 or float32 ``[G]``, the lowest among the elites.
      elite_count: int32 ``[G]``, the number of elites: filled niches, or the grids that the method
        keeps.
      evaluations_per_second: float ``[G]``, of all seeds together, measured.
      refused: int32 ``[G]``, the number of grids of the generation that were refused, see
        `road_problem`.
    """

    generation: Int[np.ndarray, " G"]
    evaluations: Int[np.ndarray, " G"]
    best_fitness: Real[np.ndarray, "*S G"]
    elite_count: Int32[np.ndarray, "*S G"]
    evaluations_per_second: Float[np.ndarray, " G"]
    refused: Int32[np.ndarray, "*S G"]

    def __repr__(self) -> str:
        """Returns types and shapes in a line."""
        return in_short(self)

    @property
    def seconds(self) -> float:
        """The time of the generations in seconds, of all seeds together, without compilation."""
        seeds = 1 if self.best_fitness.ndim == 1 else len(self.best_fitness)
        # A continued run begins at a later generation than 1.
        evaluations_before = self.evaluations[:1] * (1 - 1 / self.generation[:1])
        evaluations = np.diff(self.evaluations, prepend=evaluations_before) * seeds
        return float((evaluations / self.evaluations_per_second).sum())

    @classmethod
    def empty(cls, *seeds: int) -> "History":
        """Returns a history without generations: of one key alone, or of `seeds` seeds."""
        no_numbers = np.arange(0)
        no_counts = np.zeros((*seeds, 0), np.int32)
        return cls(
            generation=no_numbers,
            evaluations=no_numbers,
            best_fitness=no_counts,
            elite_count=no_counts,
            evaluations_per_second=np.zeros(0),
            refused=no_counts,
        )

    @classmethod
    def joined(cls, histories: "Sequence[History]") -> "History":
        """Joins histories along the generations."""
        fields = []
        for arrays in zip(*histories, strict=True):
            fields.append(np.concatenate(arrays, axis=-1))
        return cls._make(fields)


class RunState(NamedTuple):
    """The state that a run continues from, beside its key and options; arrays only.

    Attributes:
      generation: int32, the number of generations so far.
      inner: the arrays of the optimiser's state, in the order of `jax.tree.leaves`; with a leading
        axis of seeds if the result has one.
      fingerprint: uint32, of the key and the options, so that a run with others cannot continue by
        mistake.
    """

    generation: Int32[Array | np.ndarray, ""]
    inner: tuple[Array | np.ndarray, ...]
    fingerprint: UInt32[Array | np.ndarray, ""]

    def __repr__(self) -> str:
        """Returns types and shapes in a line."""
        return in_short(self)


NO_STATE = RunState(np.zeros((), np.int32), (), np.zeros((), np.uint32))
"""The state of a result that was joined or saved without its state. No search continues from it."""


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
        return without_flaws(self.satisfies(), self.elites.by_name(), self.search)

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
        features: dict[str, AnyArray] = dict(
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
        return choose_maps(
            self.elites, self.search, count, seed, exclude=exclude, min_difference=min_difference
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
        seeds = 1 if self.elites.fitness.ndim == 1 else len(self.elites.fitness)
        evaluations = 0
        if len(self.history.evaluations):
            evaluations = self.history.evaluations[-1]
        budget = f"{pluralize(seeds, 'seed')}, {evaluations:,} evaluations each"
        return f"Result of {method}: {height} x {width} tiles, {budget}"

    @jax.transfer_guard("allow")
    def save(self, path: str | Path, *, state: bool = True, seed: int | None = None) -> None:
        """Writes the result to a file, whole or not at all.

        The file has arrays as NumPy's ``.npz``, and options as JSON in it.

        Args:
          path: the file, ``.npz`` or without a suffix; an existing file is replaced.
          state: whether to write the state and the measured speeds too. Without them equal searches
            give equal bytes.
          seed: the seed that the keys were made from, to be noted in the file.

        Raises:
          InputError: if the name has the suffix of another format, such as .json, or your own
            optimiser's state has leaves that are not arrays of numbers.
          OSError: that names the file, if it cannot be written.
        """
        file = check_named("path", file_named(".npz"), path)
        seed = check_named("seed", none_or(SEED), seed)
        arrays = _arrays_of(self.elites, self.history)
        # Only functions of the user make grids that are refused. `load_with_seed` adds zeros.
        if not arrays[_REFUSED].any():
            del arrays[_REFUSED]
        # `load` reads the axes from the settings. These names are for readers that know NumPy
        # alone.
        arrays["axes"] = np.array([axis.metric for axis in self.search.axes])
        if state:
            arrays |= _state_arrays(self.state)
        else:
            del arrays[_SPEED]
        write_atomic(file, npz_bytes(arrays, self._settings(seed)))

    def _settings(self, seed: int | None) -> dict[str, Plain]:
        """Returns the settings that the file of the result has."""
        settings: dict[str, Plain] = {
            "format": _FORMAT,
            "version": __version__,
            "seed": seed,
            "axes": [axis._asdict() for axis in self.search.axes],
            "search": self.search.to_plain(),
            "config": self.config and config_to_plain(self.config),
        }
        if self.functions:
            settings["functions"] = dict(self.functions)
        return settings

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
    settings, arrays = read_npz(check_named("path", checked_path, path))
    # Each step continues the message with what is wrong, so that the file is named once.
    try:
        stored = _read_settings(settings, arrays)
        state = _read_state(arrays)
        generations = arrays.get("history.generation", np.empty(0))
        arrays.setdefault(_SPEED, np.full(generations.shape, np.nan))
        arrays.setdefault(
            _REFUSED, np.zeros_like(arrays.get("history.elite_count", np.empty(0, np.int32)))
        )
        # The state is taken out before, because only its optimiser knows the shapes of its arrays.
        _check_arrays(arrays, stored.search)
    except InputError as error:
        raise InputError(
            f"{path}: expected a result, of generate or Result.save, got {error}"
        ) from None
    elites = _elites_from(arrays, stored.search.measured)
    check_named(str(path), check_metrics, elites)
    history = History(**{name: arrays[f"history.{name}"] for name in _HISTORY})
    result = Result(elites, history, state, stored.search, stored.config, stored.functions)
    return result, stored.seed


def _elites_from(arrays: Mapping[str, np.ndarray], measured: Iterable[str]) -> MeasuredElites:
    """Returns the elites that the checked arrays of a file contain."""
    metrics = {name: jnp.asarray(arrays[f"metrics.{name}"]) for name in Metrics._fields}
    features = {name: jnp.asarray(arrays[f"{_FEATURE}{name}"]) for name in measured}
    return MeasuredElites(
        grids=jnp.asarray(arrays["grids"]),
        fitness=jnp.asarray(arrays["fitness"]),
        descriptor=jnp.asarray(arrays["descriptor"]),
        valid=jnp.asarray(arrays["valid"]),
        metrics=Metrics(**metrics),
        features=features,
    )


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


def check_can_save(state: Iterable[AnyArray | jax.ShapeDtypeStruct]) -> None:
    """Checks that an optimiser's state can be saved; raises `InputError` for keys, for instance."""
    for leaf in state:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.extended) or leaf.dtype.kind not in "biufc":
            raise InputError(
                f"state: expected arrays of NumPy's numbers, to be saved, got {leaf.dtype}"
            )


def _arrays_of(elites: MeasuredElites, history: History) -> dict[str, np.ndarray]:
    """Returns the arrays of elites and their history by their names in a file."""
    arrays: dict[str, AnyArray] = {}
    for name, values in elites.metrics._asdict().items():
        arrays[f"metrics.{name}"] = values
    for name, values in elites.features.items():
        arrays[f"{_FEATURE}{name}"] = values
    for name in _ELITES:
        arrays[name] = getattr(elites, name)
    for name, values in history._asdict().items():
        arrays[f"history.{name}"] = values
    for name, values in arrays.items():
        dtype, _ = _ARRAYS.get(name, _FEATURE_KIND)
        # A fitness has one of several dtypes, and is stored as it is.
        arrays[name] = np.asarray(values, dtype if isinstance(dtype, str) else None)
    return arrays


def _state_arrays(state: RunState) -> dict[str, np.ndarray]:
    """Returns the arrays of a state by their names in a file."""
    check_can_save(state.inner)
    arrays = {
        f"{_STATE}generation": np.asarray(state.generation, np.int32),
        f"{_STATE}fingerprint": np.asarray(state.fingerprint, np.uint32),
    }
    for index, leaf in enumerate(state.inner):
        arrays[f"{_STATE}inner.{index}"] = np.asarray(leaf)
    return arrays


class _Stored(NamedTuple):
    """The settings in a file."""

    search: Search
    config: Config | None
    functions: tuple[tuple[str, str], ...]
    seed: int | None


def _read_settings(settings: Plain, arrays: Mapping[str, np.ndarray]) -> _Stored:
    """Reads the settings of a file with some arrays; error messages continue "got"."""
    if not isinstance(settings, dict) or "format" not in settings:
        raise InputError("a file without options")
    if settings["format"] != _FORMAT:
        raise InputError(f"one of the format {shorten(repr(settings['format']))}, not {_FORMAT!r}")
    grids = arrays.get("grids", np.empty(0))
    if grids.ndim < 3 or not grids.size:
        raise InputError("a file without grids")
    try:
        return _parse_settings(settings, (grids.shape[-2], grids.shape[-1]))
    except (InputError, KeyError, TypeError) as error:
        raise InputError(f"a file with wrong options: {error}") from None


def _parse_settings(settings: Plain, shape: tuple[int, int]) -> _Stored:
    search = search_from_plain(settings["search"], shape)
    # The file has the axes of its niches, whatever axes the preset has in this version.
    axes = parse_axes(settings["axes"], search.settings.features)
    config = None
    if search.settings.method != CUSTOM:
        config = config_from_plain(settings["config"])
    if config is not None and find_preset(config)[0] != search.settings.method:
        raise InputError(
            f"config: expected one of {search.settings.method}, got {type(config).__name__}"
        )
    seed = settings["seed"]
    if seed is not None and not is_whole(seed):
        raise InputError(f"seed: expected a whole number, got {seed!r}")
    return _Stored(replace(search, axes=axes), config, _read_functions(settings), seed)


def _read_functions(settings: dict[str, Plain]) -> tuple[tuple[str, str], ...]:
    """Reads the digests of the user's functions; error messages continue "got"."""
    digests = settings.get("functions", {})
    if not isinstance(digests, dict) or not all(isinstance(text, str) for text in digests.values()):
        raise InputError(f"functions: expected digests by name, got {shorten(repr(digests))}")
    return tuple(digests.items())


def _read_state(arrays: dict[str, np.ndarray]) -> RunState:
    """Takes the state out of the arrays of a file.

    If they have no state, returns one that fits no search.
    """
    arrays.pop("axes", None)
    state_arrays = {}
    for name in list(arrays):
        if name.startswith(_STATE):
            state_arrays[name.removeprefix(_STATE)] = arrays.pop(name)
    if not state_arrays:
        return NO_STATE
    # Two of the arrays are no leaves. The leaves are read by their index, because a file may have
    # its arrays in any order.
    leaf_names = [f"inner.{index}" for index in range(len(state_arrays) - 2)]
    if set(state_arrays) != {"generation", "fingerprint", *leaf_names}:
        raise InputError("a file with an incomplete state")
    generation, fingerprint = state_arrays["generation"], state_arrays["fingerprint"]
    for number in (generation, fingerprint):
        if number.shape or number.dtype.kind not in "iu":
            raise InputError("a file with an incomplete state")
    leaves = [state_arrays[name] for name in leaf_names]
    return RunState(generation, tuple(leaves), fingerprint)


def _check_arrays(arrays: Mapping[str, np.ndarray], search: Search) -> None:
    """Checks names, dtypes and shapes of arrays against each other and a search.

    Error messages continue "got".
    """
    # The first array with an axis determines its size, and all later arrays have to agree.
    sizes = {"D": len(search.axes)}
    has_seeds = arrays.get("grids", np.empty(0)).ndim == 4
    kinds = _ARRAYS | {f"{_FEATURE}{name}": _FEATURE_KIND for name in search.measured}
    for name, (dtype, letters) in kinds.items():
        if name not in arrays:
            raise InputError(f"a file without {name}")
        array = arrays[name]
        dtypes = (dtype,) if isinstance(dtype, str) else dtype
        if not has_seeds:
            letters = letters.replace("S", "")
        if array.dtype not in dtypes or not _fits_sizes(array.shape, letters, sizes):
            got = f"{name} of {array.dtype} {array.shape}"
            raise InputError(f"{got}, which does not fit the other arrays")
    unknown = set(arrays) - set(kinds)
    if unknown:
        raise InputError(f"a file with {min(unknown)}, which no result has")
    # In a table of JAX, a wrong code would find another tile without an error.
    grids = arrays["grids"]
    has_codes = 0 <= grids.min() <= grids.max() <= 15
    if not has_codes or max(grids.shape[-2:]) > LONGEST_SIDE:
        raise InputError(f"grids that are not of tile codes 0 to 15, of shape {grids.shape}")


def _fits_sizes(shape: Sequence[int], letters: str, sizes: dict[str, int]) -> bool:
    """Returns whether an array has the sizes of the axes so far.

    Adds the sizes of new axes to `sizes`.
    """
    if len(shape) != len(letters):
        return False
    for letter, size in zip(letters, shape, strict=True):
        if sizes.setdefault(letter, size) != size:
            return False
    return True
