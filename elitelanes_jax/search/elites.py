"""The elites of a search, with all features that were measured."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Int8, Int32, Real

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Pytree
from elitelanes_jax.network.plain_metrics import count_tiles
from elitelanes_jax.network.records import Metrics

# The grids that are measured at once: 10 MB of 12 x 12 tiles.
_CHECKED_AT_ONCE = 2**16


class MeasuredElites(NamedTuple):
    """The grids that a run has found, in N slots, some of which may be vacant.

    Of MAP-Elites, slot n is niche n: ``numpy.unravel_index(n, bins)`` has its bin on each axis,
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
                raise InputError(f"expected metrics of its grids, got {got}")


def in_short(record: Pytree) -> str:
    """Returns the name, type and shape of each field of a record of arrays, in a line."""
    fields = (
        f"{name} {value.dtype}{list(value.shape)}"
        if hasattr(value, "dtype")
        else f"{name} {type(value).__name__}"
        for name, value in record._asdict().items()
    )
    return f"{type(record).__name__}({', '.join(fields)})"
