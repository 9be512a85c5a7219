"""Arrays of compiled functions as arrays of NumPy, few and without copies."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef
from jaxtyping import Array

from elitelanes_jax._util.types import AnyArray, Pytree

Packed = tuple[Mapping[str, AnyArray], Sequence[AnyArray]]


class Layout(NamedTuple):
    """How the leaves of a pytree become few arrays.

    Each array that a compiled function returns takes 2 us.

    Attributes:
      structure: the structure of the pytree.
      rows: the dtype of each leaf ``[N]``, and its row in the stack of all such leaves of this
        dtype; None for another leaf.
    """

    structure: PyTreeDef
    rows: list[tuple[str, int] | None]

    @classmethod
    def of(cls, tree: Pytree) -> "Layout":
        """Returns the layout of a pytree of arrays, or of their shapes and dtypes."""
        counts: Counter[str] = Counter()
        rows: list[tuple[str, int] | None] = []
        for leaf in jax.tree.leaves(tree):
            if leaf.ndim != 1:
                rows.append(None)
                continue
            dtype = leaf.dtype.name
            rows.append((dtype, counts[dtype]))
            counts[dtype] += 1
        return cls(jax.tree.structure(tree), rows)

    def pack(self, tree: Pytree) -> Packed:
        """Returns the stacks by dtype, and all other leaves."""
        leaves_by_dtype: dict[str, list[AnyArray]] = {}
        others = []
        for row, leaf in zip(self.rows, jax.tree.leaves(tree), strict=True):
            if row is None:
                others.append(leaf)
            else:
                dtype, _ = row
                leaves_by_dtype.setdefault(dtype, []).append(leaf)
        stacks = {dtype: jnp.stack(leaves) for dtype, leaves in leaves_by_dtype.items()}
        return stacks, others

    def unpack(self, packed: Packed) -> Pytree:
        """Returns the pytree of packed arrays of JAX or NumPy."""
        stacks, others = packed
        remaining = iter(others)
        leaves = []
        for row in self.rows:
            if row is None:
                leaves.append(next(remaining))
            else:
                dtype, index = row
                leaves.append(stacks[dtype][index])
        return self.structure.unflatten(leaves)


class _Memory:
    """Shows NumPy the memory of an array that nothing else reads, as memory to read and write."""

    def __init__(self, array: np.ndarray) -> None:
        # Keeps the memory, which the interface alone would not.
        self._array = array
        address, _ = array.__array_interface__["data"]
        self.__array_interface__ = array.__array_interface__ | {"data": (address, False)}


def writable(array: Array) -> np.ndarray:
    """Returns an array of a compiled function as one of NumPy that can be written to.

    The array of the compiled function must not be used again. On a processor nothing is copied.
    `numpy.asarray` alone makes one that cannot be written to, about which PyTorch warns.
    """
    return np.asarray(_Memory(np.asarray(array)))
