"""The arrays of a result: the elites, the history of the generations, and the state."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8, Int32, Real, UInt32

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import AnyArray, Pytree
from elitelanes_jax.network.plain_metrics import count_tiles
from elitelanes_jax.network.records import Metrics

# The grids that are measured at once: 10 MB of 12 x 12 tiles.
_CHECKED_AT_ONCE = 2**16


class MeasuredElites(NamedTuple):
    """The grids that a run has found, in N slots, some of which may be vacant.

    For MAP-Elites, slot n is niche n: ``numpy.unravel_index(n, bins)`` has its bin on each axis,
    with ``bins = [axis.bins for axis in result.search.axes]``. Arrays of several seeds have an axis
    of seeds in front, ``[S, N, ...]``.

    Attributes:
      grids: int8 ``[N, H, W]``.
      fitness: int32 ``[N]``, or float32 for a float fitness of the user; lower is better. In a
        vacant slot the largest int32, or infinity.
      descriptor: int32 ``[N, D]``, the values of the axes' features.
      valid: bool ``[N]``, which slots are filled. The other values of a vacant slot have no
        meaning.
      metrics: `Metrics` of arrays ``[N]``.
      features: int32 ``[N]`` by name: the other features that the search measured. Parts of 1 and
        ratios are in thousandths.
    """

    grids: Int8[Array, "*S N H W"]
    fitness: Real[Array, "*S N"]
    descriptor: Int32[Array, "*S N D"]
    valid: Bool[Array, "*S N"]
    metrics: Metrics
    features: dict[str, Int32[Array, "*S N"]]

    def __repr__(self) -> str:
        """Returns types and shapes in a line."""
        return in_short(self)

    def by_name(self) -> dict[str, np.ndarray]:
        """Returns the metrics and the other features by name, as arrays of NumPy."""
        return {
            name: np.asarray(values)
            for name, values in (self.metrics._asdict() | self.features).items()
        }


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
        seeds = len(np.atleast_2d(self.best_fitness))
        # A continued run begins at a later generation than 1.
        evaluations_before = self.evaluations[:1] * (1 - 1 / self.generation[:1])
        evaluations = np.diff(self.evaluations, prepend=evaluations_before) * seeds
        return float((evaluations / self.evaluations_per_second).sum())

    @classmethod
    def empty(cls, seeds: int) -> "History":
        """Returns a history without generations."""
        no_numbers = np.arange(0)
        no_counts = np.zeros((seeds, 0), np.int32)
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


def check_metrics(elites: MeasuredElites) -> None:
    """Checks that metrics are those of the grids, which may have been changed since.

    Compares what NumPy counts at once: measuring a million grids whole takes minutes without JAX,
    and compiles with it.
    """
    valid = np.flatnonzero(elites.valid)
    grids = np.asarray(elites.grids)
    grids = grids.reshape(-1, *grids.shape[-2:])
    metrics = {name: np.ravel(values) for name, values in elites.metrics._asdict().items()}
    for start in range(0, valid.size, _CHECKED_AT_ONCE):
        indices = valid[start : start + _CHECKED_AT_ONCE]
        for name, counts in count_tiles(grids[indices]).items():
            stored = metrics[name][indices]
            wrong = np.flatnonzero(stored != counts)
            if wrong.size:
                index = wrong[0]
                got = f"{name} {stored[index]} instead of {counts[index]}"
                raise InputError("", "metrics of its grids", got)


def in_short(record: Pytree) -> str:
    """Returns the name, type and shape of each field of a record of arrays, in a line."""
    fields = (
        f"{name} {value.dtype}{list(value.shape)}"
        if hasattr(value, "dtype")
        else f"{name} {type(value).__name__}"
        for name, value in record._asdict().items()
    )
    return f"{type(record).__name__}({', '.join(fields)})"


def to_numpy(array: AnyArray) -> AnyArray:
    """Returns an array of NumPy, whose indexing compiles nothing.

    An array of keys stays one of JAX, because NumPy has no such arrays.
    """
    return array if is_key(array) else np.asarray(array)


def is_key(array: AnyArray) -> bool:
    return jnp.issubdtype(array.dtype, jax.dtypes.prng_key)
