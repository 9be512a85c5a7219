"""Runs the functions of a group of `batches` on four devices, and prints which fail.

It is a program of its own, because the number of devices is fixed when JAX starts.
"""

import sys
from operator import itemgetter

import jax
import numpy as np
from batches import COUNT, batches, plain
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from elitelanes_jax import measure, repair

LINE = jax.make_mesh((COUNT,), ("x",), axis_types=(AxisType.Explicit,))
AUTOMATIC = jax.make_mesh((COUNT,), ("x",), axis_types=(AxisType.Auto,))
SQUARE = jax.make_mesh((2, 2), ("x", "y"), axis_types=(AxisType.Explicit,) * 2)
ROWS = {"over one axis": (LINE, "x"), "over two axes": (SQUARE, ("x", "y")), "over one axis of two": (SQUARE, "y")}


def compare(name, expected, function, *arguments):
    try:
        for one, other in zip(plain(function(*arguments)), expected, strict=True):
            np.testing.assert_array_equal(one, other)
    except Exception as error:
        print(f"{name}: {type(error).__name__}: {str(error)[:300]}")


# The batches of a short test, and those that it runs in `jax.shard_map`: each has a loop of another file.
FEW = ("measure", "repair, fill", "problem, plain", "random, plain")
FEW_IN_SHARD_MAP = ("measure large grids", "gridlock", "strips", "levels")


def main(group):
    if group == "few":
        for name, batch in batches("kernels", "moves", "environments"):
            if name in FEW:
                compare_rows(name, batch, {"over two axes": ROWS["over two axes"]})
            if name in FEW_IN_SHARD_MAP:
                compare_in_shard_map(name, batch, LINE)
        return
    rows = ROWS if group == "kernels" else {"over one axis": ROWS["over one axis"]}
    for name, batch in batches(group):
        compare_rows(name, batch, rows, in_use=True)
        compare_in_shard_map(name, batch, LINE)
        compare_in_shard_map(name, batch, AUTOMATIC)
    if group == "kernels":
        for kernel in (measure, repair):
            compare_other_axes(kernel)


def compare_rows(name, batch, rows, in_use=False):
    """A batch whose first axis is sharded, also over the mesh that is set."""
    function, arguments = batch
    program = jax.jit(function)
    expected = plain(program(*arguments))
    for how, (mesh, axes) in rows.items():
        sharded = jax.device_put(arguments, NamedSharding(mesh, PartitionSpec(axes)))
        compare(f"{name} {how}", expected, program, *sharded)
        if in_use:
            with jax.set_mesh(mesh):
                compare(f"{name} {how}, of the mesh in use", expected, program, *sharded)


def compare_in_shard_map(name, batch, mesh):
    """Each device computes with its element of the batch as with a batch of one."""
    function, arguments = batch
    program = jax.jit(function)
    elements = [jax.tree.map(itemgetter(np.s_[index : index + 1]), arguments) for index in range(COUNT)]
    parts = [plain(program(*element)) for element in elements]
    expected = [np.concatenate(leaves) for leaves in zip(*parts, strict=True)]
    axis = PartitionSpec("x")
    divided = jax.jit(jax.shard_map(function, mesh=mesh, in_specs=axis, out_specs=axis))
    sharded = jax.device_put(arguments, NamedSharding(mesh, axis))
    compare(f"{name} in shard_map, {mesh.axis_types}", expected, divided, *sharded)


def compare_other_axes(kernel):
    """Two axes of a batch, and axes of the grids."""
    grids = np.random.default_rng(0).integers(0, 16, (4, 2, 4, 6)).astype(np.int8)
    twice = jax.vmap(jax.vmap(kernel))
    expected = plain(twice(grids))
    for spec in (("x", "y"), (None, "x"), ("x", None, "y"), (None, None, None, "x"), (None, None, ("x", "y"))):
        sharded = jax.device_put(grids, NamedSharding(SQUARE, PartitionSpec(*spec)))
        compare(f"{kernel.__name__} {spec}", expected, jax.jit(twice), sharded)
        compare(f"{kernel.__name__} {spec}, not compiled", expected, twice, sharded)
    alone = jax.device_put(grids[0, 0], NamedSharding(SQUARE, PartitionSpec("x", "y")))
    compare(f"{kernel.__name__} alone", plain(kernel(grids[0, 0])), kernel, alone)


if __name__ == "__main__":
    main(sys.argv[1])
