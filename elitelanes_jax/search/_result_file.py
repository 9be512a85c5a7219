"""The file of a result: arrays as NumPy's ``.npz``, and options as JSON in it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.checks import check_named, is_whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.npz import npz_bytes, read_npz
from elitelanes_jax._util.packages import __version__
from elitelanes_jax._util.types import AnyArray, Plain
from elitelanes_jax.network.checks import LONGEST_SIDE
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.optimizers.presets import (
    Config,
    config_from_plain,
    config_to_plain,
    find_preset,
)
from elitelanes_jax.problem.descriptor import parse_axes
from elitelanes_jax.search.records import (
    NO_STATE,
    History,
    MeasuredElites,
    RunState,
    check_metrics,
)
from elitelanes_jax.search.resolve import Search, search_from_plain
from elitelanes_jax.search.settings import CUSTOM

_FORMAT = "elitelanes result, version 1"

# The arrays of a file: the dtype (or the allowed dtypes) and the axes. S is the axis of seeds,
# which the result of one key lacks. N is the axis of the elites' slots, H of rows, W of columns, D
# of the descriptor's axes, G of generations.
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


class ResultFields(NamedTuple):
    """The fields of `Result`."""

    elites: MeasuredElites
    history: History
    state: RunState
    search: Search
    config: Config | None
    functions: tuple[tuple[str, str], ...]


def write_result(file: Path, result: ResultFields, *, state: bool, seed: int | None) -> None:
    """Writes a result, whole or not at all.

    `state` says whether also its state and its speeds, and `seed` is noted.
    """
    arrays = _arrays_of(result.elites, result.history)
    # Only functions of the user make grids that are refused. `read_result` adds zeros.
    if not arrays[_REFUSED].any():
        del arrays[_REFUSED]
    # `read_result` reads the axes from the settings. These names are for readers that know NumPy
    # alone.
    arrays["axes"] = np.array([axis.metric for axis in result.search.axes])
    if state:
        arrays |= _state_arrays(result.state)
    else:
        del arrays[_SPEED]
    settings: dict[str, Plain] = {
        "format": _FORMAT,
        "version": __version__,
        "seed": seed,
        "axes": [axis._asdict() for axis in result.search.axes],
        "search": result.search.to_plain(),
        "config": result.config and config_to_plain(result.config),
    }
    if result.functions:
        settings["functions"] = dict(result.functions)
    write_atomic(file, npz_bytes(arrays, settings))


def read_result(path: str | Path) -> tuple[ResultFields, int | None]:
    """Reads a result and its seed, as `write_result` wrote them.

    See `Result.load` for the errors.
    """
    settings, arrays = read_npz(path)
    # The errors of these steps say only what the file is. The file is named once, here.
    try:
        search, config, functions, seed = _read_settings(settings, arrays)
        state = _read_state(arrays)
        generations = arrays.get("history.generation", np.empty(0))
        arrays.setdefault(_SPEED, np.full(generations.shape, np.nan))
        counts = arrays.get("history.elite_count", np.empty(0, np.int32))
        arrays.setdefault(_REFUSED, np.zeros_like(counts))
        # The state is taken out before, because only its optimiser knows the shapes of its arrays.
        _check_arrays(arrays, search)
    except InputError as error:
        raise InputError(path, "a result, of generate or Result.save", error) from None
    metrics = {name: jnp.asarray(arrays[f"metrics.{name}"]) for name in Metrics._fields}
    elites = MeasuredElites(
        **{name: jnp.asarray(arrays[name]) for name in _ELITES},
        metrics=Metrics(**metrics),
        features={name: jnp.asarray(arrays[f"{_FEATURE}{name}"]) for name in search.measured},
    )
    check_named(str(path), check_metrics, elites)
    history = History(**{name: arrays[f"history.{name}"] for name in _HISTORY})
    return ResultFields(elites, history, state, search, config, functions), seed


def check_can_save(state: Iterable[AnyArray | jax.ShapeDtypeStruct]) -> None:
    """Checks that an optimiser's state can be saved; raises `InputError` for keys, for instance."""
    for leaf in state:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.extended) or leaf.dtype.kind not in "biufc":
            raise InputError("state", "arrays of NumPy's numbers, to be saved", leaf.dtype)


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
    stored: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        dtype, _ = _ARRAYS.get(name, _FEATURE_KIND)
        # A fitness has one of several dtypes, and is stored as it is.
        stored[name] = np.asarray(values, dtype if isinstance(dtype, str) else None)
    return stored


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


def _read_settings(
    settings: Plain, arrays: Mapping[str, np.ndarray]
) -> tuple[Search, Config | None, tuple[tuple[str, str], ...], int | None]:
    """Reads the search, configuration, functions and seed; errors say what the file is."""
    if not isinstance(settings, dict) or "format" not in settings:
        raise InputError("", "", "a file without options")
    if settings["format"] != _FORMAT:
        raise InputError("", "", f"one of the format {quote(settings['format'])}, not {_FORMAT!r}")
    grids = arrays.get("grids", np.empty(0))
    if grids.ndim < 3 or not grids.size:
        raise InputError("", "", "a file without grids")
    try:
        return _parse_settings(settings, (grids.shape[-2], grids.shape[-1]))
    except (InputError, KeyError, TypeError) as error:
        raise InputError("", "", f"a file with wrong options: {error}") from None


def _parse_settings(
    settings: dict[str, Plain], shape: tuple[int, int]
) -> tuple[Search, Config | None, tuple[tuple[str, str], ...], int | None]:
    search = search_from_plain(settings["search"], shape)
    # The file has the axes of its niches, whatever axes the preset has in this version.
    axes = parse_axes(settings["axes"], search.settings.features)
    config = None
    if search.settings.method != CUSTOM:
        config = config_from_plain(settings["config"])
    if config is not None and find_preset(config)[0] != search.settings.method:
        raise InputError("config", f"one of {search.settings.method}", type(config).__name__)
    seed = settings["seed"]
    if seed is None or is_whole(seed):
        return replace(search, axes=axes), config, _read_functions(settings), seed
    raise InputError("seed", "a whole number", repr(seed))


def _read_functions(settings: dict[str, Plain]) -> tuple[tuple[str, str], ...]:
    """Reads the digests of the user's functions."""
    digests = settings.get("functions", {})
    if not isinstance(digests, dict) or not all(isinstance(text, str) for text in digests.values()):
        raise InputError("functions", "digests by name", quote(digests))
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
        raise InputError("", "", "a file with an incomplete state")
    generation, fingerprint = state_arrays["generation"], state_arrays["fingerprint"]
    for number in (generation, fingerprint):
        if number.shape or number.dtype.kind not in "iu":
            raise InputError("", "", "a file with an incomplete state")
    leaves = [state_arrays[name] for name in leaf_names]
    return RunState(generation, tuple(leaves), fingerprint)


def _check_arrays(arrays: Mapping[str, np.ndarray], search: Search) -> None:
    """Checks names, dtypes and shapes of arrays against each other and a search.

    Errors say what the file is.
    """
    # The first array with an axis determines its size, and all later arrays have to agree.
    sizes = {"D": len(search.axes)}
    has_seeds = arrays.get("grids", np.empty(0)).ndim == 4
    kinds = _ARRAYS | {f"{_FEATURE}{name}": _FEATURE_KIND for name in search.measured}
    for name, (dtype, letters) in kinds.items():
        if name not in arrays:
            raise InputError("", "", f"a file without {name}")
        array = arrays[name]
        dtypes = (dtype,) if isinstance(dtype, str) else dtype
        if not has_seeds:
            letters = letters.replace("S", "")
        if array.dtype not in dtypes or not _fits_sizes(array.shape, letters, sizes):
            got = f"{name} of {array.dtype} {array.shape}"
            raise InputError("", "", f"{got}, which does not fit the other arrays")
    unknown = set(arrays) - set(kinds)
    if unknown:
        raise InputError("", "", f"a file with {min(unknown)}, which no result has")
    # In a table of JAX, a wrong code would find another tile without an error.
    grids = arrays["grids"]
    has_codes = 0 <= grids.min() <= grids.max() <= 15
    if not has_codes or max(grids.shape[-2:]) > LONGEST_SIDE:
        raise InputError(
            "", "", f"grids that are not of tile codes 0 to 15, of shape {grids.shape}"
        )


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
