"""The file ``archive.npz``, which `Result.save` writes: all that a search found, to choose maps from."""

import json
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from elitelanes_jax._util.errors import InputError, reason, short
from elitelanes_jax._util.npz import DAMAGES, open_arrays
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.counts import Metrics
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, parse_axes
from elitelanes_jax.problem.features import extra_names, join_counts
from elitelanes_jax.result import MeasuredElites
from elitelanes_jax.spec import SearchSpec

__all__ = ["Archive", "read_archive"]


class Archive(NamedTuple):
    """Finds of a search.

    Attributes:
      elites: of all runs, as `evolve` returns them for an array of keys, as arrays of NumPy.
      axes: of the search's niches.
      spec: of the search.
      seed: of its random numbers.
    """

    elites: MeasuredElites
    axes: tuple[Axis, ...]
    spec: SearchSpec
    seed: int

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the maps."""
        height, width = self.elites.grids.shape[2:]
        return height, width


def read_archive(file: Path) -> Archive:
    """Reads an archive; nothing in it is executed.

    Raises:
      InputError: if it cannot be read, or is no archive of this package; the message names the file.
    """
    try:
        arrays = _read_arrays(file)
        settings = json.loads(str(arrays["settings"]))
        spec, seed = SearchSpec(**settings["search"]), settings["seed"]
        axes = parse_axes(settings["axes"], spec.features)
        elites = _elites(arrays, axes, spec.extras)
        if not isinstance(seed, int):
            raise InputError(f"seed: expected a whole number, got {seed!r}")
    except OSError as error:
        raise InputError(f"{file}: expected an archive.npz of generate, got: {reason(error)}") from None
    except KeyError as error:
        raise InputError(f"{file}: expected an archive.npz of generate, got settings without {error}") from None
    except zipfile.BadZipFile:
        raise InputError(f"{file}: expected an archive.npz of generate, got a file that is no archive") from None
    except DAMAGES as error:
        words = short(str(error).splitlines()[0] if str(error) else type(error).__name__, 120)
        raise InputError(f"{file}: expected an archive.npz of generate, got: {words}") from None
    return Archive(elites, axes, spec, seed)


def _read_arrays(file: Path) -> dict[str, Any]:
    wanted = ["settings", "grids", "fitness", "valid", *(f"metrics.{name}" for name in Metrics._fields)]
    with open_arrays(file) as stored:
        wanted += [name for name in stored.files if name.startswith("features.")]
        missing = [name for name in wanted if name not in stored.files]
        if missing:
            raise InputError(f"one without {missing[0]!r}")
        return {name: stored[name] for name in wanted}


def _elites(arrays: dict[str, Any], axes: tuple[Axis, ...], extras: tuple[str, ...]) -> MeasuredElites:
    grids = arrays["grids"]
    if grids.ndim != 4 or grids.dtype != np.int8 or grids.size == 0 or grids.min() < 0 or grids.max() > 15:
        raise InputError("expected grids of tile codes 0 to 15, int8 [S, N, H, W], got others")
    check_shape(grids.shape[2:])
    metrics = Metrics(*(arrays[f"metrics.{name}"] for name in Metrics._fields))
    features = {name: arrays[f"features.{name}"] for name in extras}
    for name, values in (metrics._asdict() | features | {key: arrays[key] for key in ("fitness", "valid")}).items():
        kind = {"coverage": "f", "valid": "b"}.get(name, "i")
        if values.shape != grids.shape[:2] or values.dtype.kind != kind or values.dtype.itemsize > 8:
            raise InputError(f"expected {name} of shape {grids.shape[:2]}, got {values.dtype} of {values.shape}")
    measures = metrics._asdict() | features
    descriptor = compute_descriptor(join_counts(measures, extra_names(axis.metric for axis in axes)), axes)
    return MeasuredElites(grids, arrays["fitness"], descriptor, arrays["valid"], metrics, features)
