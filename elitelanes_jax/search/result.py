"""The result of a search, and the file that it is saved in."""

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
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.npz import pack, unpack
from elitelanes_jax._util.packages import __version__
from elitelanes_jax._util.types import AnyArray, Plain, UserValue
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.checks import LONGEST_SIDE
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.optimizers.presets import Config, config_from_plain, config_to_plain, find_preset
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.problem.descriptor import Axis, parse_axes
from elitelanes_jax.problem.kernels import with_town_features
from elitelanes_jax.problem.ranges import parse_ranges, satisfies
from elitelanes_jax.search.elites import MeasuredElites, in_short
from elitelanes_jax.search.selection import MIN_DIFFERENCE, Choice, choose_maps
from elitelanes_jax.search.spec import CUSTOM, METHODS, SearchSpec

_FORMAT = "elitelanes result, version 1"

# The arrays of a file: the dtype (or the allowed dtypes) and the axes. S is the axis of seeds, which the result of one
# key lacks, N of the elites' slots, H and W of rows and columns, D of the descriptor's axes, G of generations.
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
_METRICS = {f"metrics.{name}": ("float32" if name == "coverage" else "int32", "SN") for name in Metrics._fields}
_ARRAYS = _ELITES | _METRICS | {f"history.{name}": kind for name, kind in _HISTORY.items()}
# Optional arrays: measured speeds, which differ between equal searches, and counts that are all 0.
_SPEED, _REFUSED = "history.evaluations_per_second", "history.refused"
_STATE, _EXTRA = "state.", "features."
_OF_EXTRA = ("int32", "SN")


class History(NamedTuple):
    """A run by generation, as NumPy arrays.

    Attributes:
      generation: int ``[G]``, counted from 1.
      evaluations: int ``[G]``, grids that one seed's steps have evaluated so far.
      best_fitness: int32 or float32 ``[G]``, the lowest among the elites.
      elite_count: int32 ``[G]``, the number of elites: filled niches, or the grids that the method keeps.
      evaluations_per_second: float ``[G]``, of all seeds together, measured.
      refused: int32 ``[G]``, the number of grids of the generation that were refused, see `road_problem`.
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
        start = self.evaluations[:1] * (1 - 1 / self.generation[:1])  # of the first generation, also of a continued run
        return float((np.diff(self.evaluations, prepend=start) * seeds / self.evaluations_per_second).sum())

    @classmethod
    def empty(cls, *seeds: int) -> "History":
        """Returns a history without generations: of one key alone, or of `seeds` seeds."""
        none, counts = np.arange(0), np.zeros((*seeds, 0), np.int32)
        return cls(none, none, counts, counts, np.zeros(0), counts)

    @classmethod
    def joined(cls, parts: "Sequence[History]") -> "History":
        """Joins histories along the generations."""
        return cls(*(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)))


class RunState(NamedTuple):
    """The state that a run continues from, beside its key and options; arrays only.

    Attributes:
      generation: int32, the number of generations so far.
      inner: the arrays of the optimiser's state, in the order of `jax.tree.leaves`; with a leading axis of seeds if the
        result has one.
      fingerprint: uint32, of the key and the options, so that a run with others cannot continue by mistake.
    """

    generation: Int32[Array | np.ndarray, ""]
    inner: tuple[Array | np.ndarray, ...]
    fingerprint: UInt32[Array | np.ndarray, ""]

    def __repr__(self) -> str:
        """Returns types and shapes in a line."""
        return in_short(self)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Result:
    """The result of `evolve`; a pytree.

    Attributes:
      elites: the grids found, with their metrics.
      history: of the generations of this call.
      state: to continue from.
      spec: the search. Its method and preset say what made the result; `custom` is your own configuration or optimiser.
      axes: of the descriptor.
      config: the configuration of the method; None for your own optimiser.
      functions: names and digests of your own functions, which tell edited functions apart.
    """

    elites: MeasuredElites
    history: History
    state: RunState
    spec: SearchSpec = field(metadata={"static": True})
    axes: tuple[Axis, ...] = field(metadata={"static": True})
    config: Config | None = field(default=None, metadata={"static": True})
    functions: tuple[tuple[str, str], ...] = field(default=(), metadata={"static": True})

    def best(self) -> Int8[Array, "*S H W"]:
        """Returns the grid of lowest fitness, int8 ``[H, W]``; among equal ones the first."""
        ranked = jnp.where(self.elites.valid, self.elites.fitness, vacant_fitness(self.elites.fitness.dtype))
        index = jnp.argmin(ranked, axis=-1)[..., None, None, None]
        return jnp.take_along_axis(self.elites.grids, index, axis=-3)[..., 0, :, :]

    def satisfies(self) -> Bool[np.ndarray, "*S N"]:
        """Returns which elites are in all ranges of the specification, exactly."""
        return np.asarray(self.elites.valid) & satisfies(self.elites.by_name(), self.spec.where)

    def maps(self, count: int = 16, *, where: UserValue = ()) -> list[RoadMap]:
        """Chooses maps that are valid, different and spread over the niches, as the command ``generate`` does.

        Args:
          count: the largest number of maps; there may be fewer.
          where: ranges as in `evolve`, added to those of the search. They override the search's range of the same
            feature.

        Returns:
          Maps with their metrics, sorted by niche, and within a niche by fitness.

        Raises:
          InputError: for a bad count or range.
        """
        ranges = {item.name: item for item in (*self.spec.where, *parse_ranges(where, self.spec.features))}
        elites = self.elites
        features: dict[str, AnyArray] = dict(with_town_features(elites.features, ranges, elites.grids, "where"))
        elites = elites._replace(features=features)
        result = replace(self, elites=elites, spec=self.spec.replace(where=ranges.values()))
        return result.choose(check_named("count", whole(1), count)).maps

    def write(self, folder: str | Path, maps: int = 16, *, force: bool = False, **options: UserValue) -> list[RoadMap]:
        """Writes the folder that `generate` writes: chosen maps with pictures and masks, a sheet, and the archive.

        Args:
          folder: new or empty.
          maps: the number of maps.
          force: whether the folder is replaced, if an earlier run wrote all files in it.
          **options: more fields of `PickSpec`, such as `where`, `at_most`, `tiles`, `tile_px` and `seed`.

        Returns:
          The maps, as they were written.

        Raises:
          InputError: for a bad option, or a folder with other files.
          NotEnoughMapsError: if there are fewer valid and different maps than requested.
          OSError: if the folder cannot be written.
        """
        from elitelanes_jax.maps.picking import pick
        from elitelanes_jax.maps.spec import PickSpec

        return pick(PickSpec().replace(maps=maps, **options), self, folder, force=force)

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
            self.elites, self.spec, self.axes, count, seed, exclude=exclude, min_difference=min_difference
        )

    def __repr__(self) -> str:
        """Returns the search and its elites, in a few lines."""
        fitness, (height, width) = self.elites.fitness, self.elites.grids.shape[-2:]
        if not hasattr(fitness, "__array__") or isinstance(fitness, jax.core.Tracer):
            return f"Result(elites={self.elites!r}, spec={self.spec!r})"
        valid, seeds = np.asarray(self.elites.valid), 1 if fitness.ndim == 1 else len(fitness)
        best = f"the best with fitness {np.asarray(fitness)[valid].min()}" if valid.any() else "none valid"
        spent = self.history.evaluations[-1] if len(self.history.evaluations) else 0
        axes = " ".join(f"{axis.metric}:{axis.bins}:{axis.width}" for axis in self.axes)
        where = " ".join(map(str, self.spec.where))
        preset = f", preset {self.spec.preset}" if self.spec.method in METHODS else ""
        return "\n".join(
            [
                f"Result of {self.spec.optimizer}{preset}: {height} x {width} tiles, "
                f"{seeds} {'seed' if seeds == 1 else 'seeds'}, {spent:,} evaluations each",
                f"  elites   {valid.sum():,} in {valid.size:,} slots, {best}",
                f"  axes     {axes}",
                *([f"  where    {where}"] if where else []),
                *([f"  config   {self.config}"] if self.config is not None and self.spec.preset == CUSTOM else []),
                "  fields   elites, history, state, spec, axes, config",
                "  methods  best(): the fittest grid; maps(count, where=...): chosen maps; write(folder); save(path)",
            ]
        )

    def save(self, path: str | Path, *, state: bool = True, seed: int | None = None) -> None:
        """Writes the result to a file, whole or not at all: arrays as NumPy's ``.npz``, options as JSON in it.

        Args:
          path: the file, ``.npz`` or without a suffix; an existing file is replaced.
          state: whether to write the state and the measured speeds too. Without them equal searches give equal bytes.
          seed: that the keys were made from, to be noted in the file.

        Raises:
          InputError: if the name has the suffix of another format, such as .json, or your own optimiser's state has
            leaves that are not arrays of numbers.
          OSError: that names the file, if it cannot be written.
        """
        file = check_named("path", file_named(".npz"), path)
        seed = check_named("seed", none_or(SEED), seed)
        elites = self.elites._asdict()
        arrays = {f"metrics.{name}": values for name, values in elites.pop("metrics")._asdict().items()}
        arrays |= {f"{_EXTRA}{name}": values for name, values in elites.pop("features").items()} | elites
        arrays |= {f"history.{name}": values for name, values in self.history._asdict().items()}
        for name, values in arrays.items():
            kind = _ARRAYS.get(name, _OF_EXTRA)[0]
            arrays[name] = np.asarray(values, kind if isinstance(kind, str) else None)
        if not arrays[_REFUSED].any():
            del arrays[_REFUSED]
        arrays["axes"] = np.array([axis.metric for axis in self.axes])
        if state:
            arrays |= {f"{_STATE}{name}": array for name, array in _state_arrays(self.state).items()}
        else:
            del arrays[_SPEED]
        axes = [axis._asdict() for axis in self.axes]
        settings: dict[str, Plain] = {"format": _FORMAT, "version": __version__, "seed": seed, "axes": axes}
        settings |= {"search": self.spec.to_plain(), "config": self.config and config_to_plain(self.config)}
        if self.functions:
            settings["functions"] = dict(self.functions)
        write_atomic(file, pack(arrays, settings))

    @classmethod
    def load(cls, path: str | Path) -> "Result":
        """Reads a result that `save` wrote, or the ``archive.npz`` of `elitelanes generate`.

        A result that was saved without state has NaN for the speeds, and cannot be continued.

        Raises:
          InputError: if the file cannot be read, is no result, is damaged or has another version.
        """
        return load_with_seed(path)[0]


def load_with_seed(path: str | Path) -> tuple[Result, int | None]:
    """Returns what `Result.load` returns, and the seed that is noted in the file, or None."""
    settings, arrays = unpack(check_named("path", checked_path, path))
    try:
        spec, config, axes, seed = _read_settings(settings)
        functions = _read_functions(settings)
        state = _read_state(arrays)
        arrays.setdefault(_SPEED, np.full(arrays.get("history.generation", np.empty(0)).shape, np.nan))
        arrays.setdefault(_REFUSED, np.zeros_like(arrays.get("history.elite_count", np.empty(0, np.int32))))
        _check_arrays(arrays, len(axes), spec.measured)
    except InputError as error:
        raise InputError(f"{path}: expected a result, of generate or Result.save, got {error}") from None
    metrics = Metrics(*(jnp.asarray(arrays[f"metrics.{name}"]) for name in Metrics._fields))
    features = {name: jnp.asarray(arrays[f"{_EXTRA}{name}"]) for name in spec.measured}
    elites = MeasuredElites(**{name: jnp.asarray(arrays[name]) for name in _ELITES}, metrics=metrics, features=features)
    history = History(**{name: arrays[f"history.{name}"] for name in _HISTORY})
    return Result(elites, history, state, spec, axes, config, functions), seed


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


def check_can_save(state: Iterable[AnyArray | jax.ShapeDtypeStruct]) -> None:
    """Checks that an optimiser's state can be saved; raises `InputError` for keys, for instance."""
    for leaf in state:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.extended) or leaf.dtype.kind not in "biufc":
            raise InputError(f"state: expected arrays of NumPy's numbers, to be saved, got {leaf.dtype}")


def _state_arrays(state: RunState) -> dict[str, np.ndarray]:
    check_can_save(state.inner)
    inner = {f"inner.{index}": np.asarray(leaf) for index, leaf in enumerate(state.inner)}
    generation, fingerprint = np.asarray(state.generation, np.int32), np.asarray(state.fingerprint, np.uint32)
    return {"generation": generation, "fingerprint": fingerprint} | inner


def _read_settings(settings: Plain) -> tuple[SearchSpec, Config | None, tuple[Axis, ...], int | None]:
    """Reads the specification, the configuration, the axes and the seed; error messages continue "got"."""
    if not isinstance(settings, dict) or "format" not in settings:
        raise InputError("a file without options")
    if settings["format"] != _FORMAT:
        raise InputError(f"one of the format {shorten(repr(settings['format']))}, not {_FORMAT!r}")
    try:
        spec = SearchSpec.from_plain(settings["search"])
        config = None if spec.method == CUSTOM else config_from_plain(settings["config"])
        if config is not None and find_preset(config)[0] != spec.method:
            raise InputError(f"config: expected one of {spec.method}, got {type(config).__name__}")
        axes, seed = parse_axes(settings["axes"], spec.features), settings["seed"]
        if seed is not None and not is_whole(seed):
            raise InputError(f"seed: expected a whole number, got {seed!r}")
    except (InputError, KeyError, TypeError) as error:
        raise InputError(f"a file with wrong options: {error}") from None
    return spec, config, axes, seed


def _read_functions(settings: dict[str, Plain]) -> tuple[tuple[str, str], ...]:
    """Reads the digests of the user's functions; error messages continue "got"."""
    digests = settings.get("functions", {})
    if not isinstance(digests, dict) or not all(isinstance(text, str) for text in digests.values()):
        raise InputError(
            f"a file with wrong options: functions: expected digests by name, got {shorten(repr(digests))}"
        )
    return tuple(digests.items())


def _read_state(arrays: dict[str, np.ndarray]) -> RunState:
    """Takes the state out of the arrays of a file; without a state, returns one that fits no search."""
    kept = {name.removeprefix(_STATE): arrays.pop(name) for name in list(arrays) if name.startswith(_STATE)}
    arrays.pop("axes", None)
    inner = tuple(kept[name] for index in range(len(kept) - 2) if (name := f"inner.{index}") in kept)
    generation, fingerprint = (
        kept.get(name, np.zeros((), dtype)) for name, dtype in (("generation", np.int32), ("fingerprint", np.uint32))
    )
    if len(inner) < len(kept) - 2 or generation.shape or fingerprint.shape:
        raise InputError("a file with an incomplete state")
    return RunState(generation, inner, fingerprint)


def _check_arrays(arrays: Mapping[str, np.ndarray], axes: int, measured: Sequence[str]) -> None:
    """Checks names, dtypes and shapes against each other; error messages continue "got"."""
    sizes = {"D": axes}
    seeds = arrays.get("grids", np.empty(0)).ndim == 4
    kinds = _ARRAYS | {f"{_EXTRA}{name}": _OF_EXTRA for name in measured}
    for name, (dtype, letters) in kinds.items():
        letters = letters if seeds else letters.replace("S", "")
        array = arrays.get(name)
        if array is None:
            raise InputError(f"a file without {name}")
        fits = array.dtype in ([dtype] if isinstance(dtype, str) else dtype) and array.ndim == len(letters)
        if not fits or any(
            sizes.setdefault(letter, size) != size for letter, size in zip(letters, array.shape, strict=True)
        ):
            raise InputError(f"{name} of {array.dtype} {array.shape}, which does not fit the other arrays")
    if unknown := set(arrays) - set(kinds):
        raise InputError(f"a file with {min(unknown)}, which no result has")
    grids = arrays["grids"]
    if not grids.size or not 0 <= grids.min() <= grids.max() <= 15 or max(grids.shape[-2:]) > LONGEST_SIDE:
        raise InputError(f"grids that are not of tile codes 0 to 15, of shape {grids.shape}")
