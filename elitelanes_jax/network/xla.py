"""Arithmetic, control flow and layouts whose form suits XLA.

Gains were measured on one core of a CPU at 12 x 12.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import (
    Array,
    ArrayLike,
    Bool,
    Float,
    Float32,
    Int,
    Int32,
    Integer,
    Real,
    Shaped,
    UInt32,
)

from elitelanes_jax._util.types import ArrayT, Pytree, Tree, Untyped

_Carry = TypeVar("_Carry")

UNIT = 4096
"""The whole number that stands for 1 in fixed-point numbers.

Other machines and batches fuse and order float operations differently, which changes the last bits.
Sums and products of whole numbers are always the same.
"""


def to_fixed(value: Real[ArrayLike, "..."]) -> Int32[Array, "..."]:
    """Rounds a real number to units of 1 / `UNIT`; the product with a power of two is exact."""
    return jnp.rint(jnp.asarray(value, jnp.float32) * UNIT).astype(jnp.int32)


def multiply(value: Int32[Array, "..."], factor: Int32[Array, "..."]) -> Int32[Array, "..."]:
    """Multiplies two numbers in units; the product is rounded down."""
    return value * factor >> 12


@jax.custom_jvp
def rounded(product: Float[ArrayLike, "..."]) -> Float32[Array, "..."]:
    """Rounds a float32 product towards 0 to 23 of its 24 bits.

    Therefore every program adds the same number to a sum. Compilers turn a product and a sum into
    one instruction, which does not round the product. They do so in one program and not in another.
    They cannot do so if bits of the product are changed first. The derivative is that of the
    product.
    """
    bits = lax.bitcast_convert_type(jnp.asarray(product, jnp.float32), jnp.int32)
    return lax.bitcast_convert_type(bits & -2, jnp.float32)


rounded.defjvps(lambda tangent, rounded_product, product: tangent)


def materialize(array: Shaped[Array | np.ndarray, "..."]) -> Shaped[Array, "..."]:
    """Returns an array of numbers unchanged, and makes XLA compute it once and store it.

    Otherwise XLA on a CPU computes a value again for each of its uses, and in a shift for each
    tile. On other devices this is a barrier: without it, steps on a GPU take 1.2 times as long.
    """
    array = jnp.asarray(array)
    return _materialize.bind(array) if array.size else array


def _store(array: Shaped[Array, "..."]) -> Shaped[Array, "..."]:
    """Passes an array through a loop, because the input of a loop is stored.

    This loop has no round (or one that changes nothing), which XLA cannot know. It reads and writes
    one number, and hardly adds to the program. A GPU would wait for the processor at each check of
    the condition.
    """
    if not array.size:
        return array
    info = jnp.finfo if jnp.issubdtype(array.dtype, jnp.floating) else jnp.iinfo
    most = np.array(info(array.dtype).max, array.dtype)

    def first(array: Array) -> Array:
        return lax.slice(array, (0,) * array.ndim, (1,) * array.ndim)

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        done, array = carry
        # In the only round `done` is False, so the first number is written back.
        new = lax.select(
            lax.broadcast(done, (1,) * array.ndim), np.full((1,) * array.ndim, most), first(array)
        )
        return jnp.array(True), lax.dynamic_update_slice(array, new, (0,) * array.ndim)

    def again(carry: tuple[Array, Array]) -> Array:
        return ~carry[0] & (first(carry[1]).reshape(()) == most)

    return lax.while_loop(again, body, (jnp.array(False), array))[1]


# This is a primitive, because a function with its own rule for batches is traced at each use, and
# once more in each `vmap`.
_materialize = Primitive("materialize")
_materialize.def_impl(lambda array: array)
_materialize.def_abstract_eval(lambda array: array)
batching.primitive_batchers[_materialize] = lambda arrays, axes: (
    _materialize.bind(*arrays),
    axes[0],
)
mlir.register_lowering(
    _materialize, mlir.lower_fun(lax.optimization_barrier, multiple_results=False)
)
mlir.register_lowering(_materialize, mlir.lower_fun(_store, multiple_results=False), platform="cpu")


def once(compute: Callable[[], Tree]) -> Tree:
    """Returns the result of `compute`, which XLA computes once in compiled code.

    The result is a pytree of arrays. XLA for processors fuses arithmetic into each of its uses, so
    that many uses of a long formula repeat it. It never fuses into a branch. Therefore this is a
    branch that is always taken, which the barrier hides from XLA. GPUs have no barrier, so that XLA
    removes the branch, because a GPU waits for the processor whenever it checks a condition.

    `materialize` does the same for the small arrays of a search, within batches. It fills and
    copies each array before: 6 us for 120 x 160 numbers.
    """
    shapes = jax.eval_shape(compute)
    taken = jax.lax.platform_dependent(
        cpu=lambda: jax.lax.optimization_barrier(jnp.bool_(True)), default=lambda: jnp.bool_(True)
    )
    # Zeros like a shape differ between the same devices, see `vary_together`.
    return jax.lax.cond(taken, compute, lambda: jax.tree.map(jnp.zeros_like, shapes))


def run_if(
    condition: Bool[Array, ""], compute: Callable[[Bool[Array, ""], _Carry], _Carry], carry: _Carry
) -> _Carry:
    """Returns ``compute(True, carry)`` if a condition holds, otherwise `carry` without computing.

    A loop of at most one round. `jax.lax.cond` would copy the carry, and under `jax.vmap` always
    compute. The first argument of `compute` is a traced True: what depends on it cannot be moved
    out of the loop.
    """

    def body(loop: tuple[Array, _Carry]) -> tuple[Array, _Carry]:
        return vary_together((jnp.array(False), compute(*loop)))

    return lax.while_loop(lambda loop: loop[0], body, vary_together((condition, carry)))[1]


def vary_together(tree: Tree, *others: Pytree) -> Tree:
    """Returns arrays that differ between devices if one of them, or of the other arrays, does.

    In `jax.shard_map` the type of an array says along which axes of the mesh the devices hold
    different numbers. The carry of a loop has to keep its types, but it often begins with constants,
    which are equal on all devices. Elsewhere the arrays are returned unchanged.
    """
    arrays = [leaf for leaf in jax.tree.leaves((tree, others)) if isinstance(leaf, jax.Array)]
    axes = frozenset[str]().union(*map(_varying_axes, arrays))
    if not axes:
        return tree
    return jax.tree.map(lambda leaf: _to_varying(leaf, tuple(axes - _varying_axes(leaf))), tree)


def _varying_axes(array: Array) -> frozenset[str]:
    """Returns the axes of a mesh along which devices of `jax.shard_map` hold different numbers."""
    kind: Untyped = jax.typeof(array)
    # JAX 0.7 names the axes `vma`, and later versions have a record of them.
    varying: frozenset[str] = kind.vma if hasattr(kind, "vma") else kind.manual_axis_type.varying
    return varying


def _to_varying(array: Array, axes: tuple[str, ...]) -> Array:
    versions: Untyped = lax
    # JAX 0.7 has `pvary` instead of `pcast`.
    if hasattr(lax, "pcast"):
        varying: Array = versions.pcast(array, axes, to="varying")
    else:
        varying = versions.pvary(array, axes)
    return varying


def align(*arrays: ArrayT) -> tuple[ArrayT, ...]:
    """Returns arrays with equally many axes: leading axes of length 1 are added, except to scalars.

    NumPy's rules for broadcasting do the same, but a setting of JAX, `jax_numpy_rank_promotion`,
    may forbid it.
    """
    axes = max(array.ndim for array in arrays)
    return tuple(
        array.reshape(*(1,) * (axes - array.ndim), *array.shape) if array.ndim else array
        for array in arrays
    )


def batch_all(axis_size: int, batched: Sequence[bool], arrays: Sequence[Array]) -> list[Array]:
    """Returns the arguments of a batching rule, each with the axis of the batch in front."""
    return [
        array if has_axis else jnp.broadcast_to(array, (axis_size, *array.shape))
        for array, has_axis in zip(arrays, batched, strict=True)
    ]


def take(
    table: Shaped[Array | np.ndarray, "N ..."], indices: Integer[Array | np.ndarray, "..."]
) -> Shaped[Array, "..."]:
    """Returns the rows of a table at indices, each in [0, N).

    Indexing would compile checks of their range.
    """
    table = jnp.asarray(table)
    rows = lax.GatherDimensionNumbers(
        tuple(range(indices.ndim, indices.ndim + table.ndim - 1)), (0,), (0,)
    )
    places = lax.expand_dims(indices, (indices.ndim,))
    return lax.gather(table, places, rows, (1, *table.shape[1:]), mode="promise_in_bounds")


@jax.custom_batching.custom_vmap
def lookup(values: Shaped[Array, " N"], indices: Int[Array, "..."]) -> Shaped[Array, "..."]:
    """Returns the values at indices, each in [0, N).

    A batch of vectors is looked up as one long vector, because otherwise XLA computes the index
    within the batch again for each value.
    """
    return take(values, indices)


@lookup.def_vmap
def _(axis_size: int, batched: list[bool], values: Array, indices: Array) -> tuple[Array, bool]:
    values, indices = batch_all(axis_size, batched, (values, indices))
    first = (
        np.arange(axis_size, dtype=indices.dtype).reshape(-1, *(1,) * (indices.ndim - 1))
        * values.shape[1]
    )
    return lookup(values.reshape(-1), indices + first), True


class PaddedLayout(NamedTuple):
    """The layout of a grid as one vector, in which every neighbour is a shift.

    Each shift is a long contiguous vector.

    Each row of the grid ends in one empty guard cell, and an empty row is above and below the grid.
    Beyond the border a tile then sees an empty cell, and no kernel needs a special case::

        . . . . .        . is empty padding; a row of W tiles has the stride W + 1
        a b c d .
        e f g h .
        . . . . .

    `pad` makes the padded vector of a grid. `here`, `east`, `west`, `south` and `north` return the
    values that each tile sees there: vectors of length `size` = height x `stride`, guard cells
    included.
    """

    height: int
    width: int

    @property
    def stride(self) -> int:
        return self.width + 1

    @property
    def size(self) -> int:
        return self.height * self.stride

    def pad(self, grid: Shaped[Array | np.ndarray, "H W"]) -> Shaped[Array, " padded"]:
        # The padded grid is stored, because otherwise XLA pads again for each use, and divides to
        # find the row of each index.
        return materialize(jnp.pad(grid, ((1, 1), (0, 1)))).reshape(-1)

    def unpad(self, vector: Shaped[Array, " size"]) -> Shaped[Array, "H W"]:
        return vector.reshape(self.height, self.stride)[:, : self.width]

    def here(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        return self._shift(padded, 0)

    def east(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        return self._shift(padded, 1)

    def west(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        return self._shift(padded, -1)

    def south(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        return self._shift(padded, self.stride)

    def north(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        return self._shift(padded, -self.stride)

    def _shift(self, padded: Shaped[Array, " padded"], cells: int) -> Shaped[Array, " size"]:
        start = self.stride + cells
        return lax.slice_in_dim(padded, start, start + self.size)


# The bits of a cell, and the cells of a word of 32 bits.
_BITS, _CELLS = 4, 8
_SHIFTS = np.arange(_CELLS, dtype=np.uint32)[None] * _BITS


class PackedCells(NamedTuple):
    """The layout of a grid with eight cells in a word, four bits each.

    The bits of a cell are its code, or a mask of sides. The cells form one long vector, row by row.
    After the last row there are empty cells, at least one more than a row has. Many grids can then
    be joined to one vector. Every neighbour is a shift of it, and what a shift brings in from the
    next grid is empty. A step on all cells takes a few operations on few words.
    """

    height: int
    width: int

    @property
    def words(self) -> int:
        return -(-(self.height * self.width + self.width + 1) // _CELLS)

    def pack(self, cells: Int[Array | np.ndarray, "H W"]) -> UInt32[Array, " N"]:
        flat = jnp.asarray(cells, jnp.uint32).reshape(-1)
        flat = jnp.pad(flat, (0, -flat.size % _CELLS)).reshape(-1, _CELLS)
        words = (flat << _SHIFTS).sum(axis=1, dtype=jnp.uint32)
        return jnp.pad(words, (0, self.words - words.size))

    def unpack(self, words: UInt32[Array, " N"]) -> Int[Array, "H W"]:
        cells = (words[:, None] >> _SHIFTS & 15).astype(jnp.int8).reshape(-1)
        return cells[: self.height * self.width].reshape(self.height, self.width)

    def following(self, words: UInt32[Array, " M"], cells: int) -> UInt32[Array, " M"]:
        """Returns for each cell the cell that is `cells` positions later.

        The words are those of one grid, or of several joined grids.
        """
        # The eight cells of a result come from two neighbouring words.
        step, bits = divmod(cells * _BITS, 32)
        ahead = jnp.pad(words, (0, step + 1))
        near, far = (
            lax.slice_in_dim(ahead, start, start + words.size) for start in (step, step + 1)
        )
        return near >> bits | far << (32 - bits) if bits else near

    def preceding(self, words: UInt32[Array, " M"], cells: int) -> UInt32[Array, " M"]:
        """Returns for each cell the cell that is `cells` positions earlier.

        The words are those of one grid, or of several joined grids.
        """
        # The eight cells of a result come from two neighbouring words.
        step, bits = divmod(cells * _BITS, 32)
        behind = jnp.pad(words, (step + 1, 0))
        far, near = (lax.slice_in_dim(behind, start, start + words.size) for start in (0, 1))
        return near << bits | far >> (32 - bits) if bits else near


def in_all_cells(bits: int) -> np.uint32:
    """Returns a word that has the same four bits in each of its eight cells."""
    return np.uint32(bits * 0x11111111)
