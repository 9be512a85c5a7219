"""Batches that are sharded over devices: each device computes its part."""

import inspect
from collections.abc import Callable
from functools import partial, wraps
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from elitelanes_jax._util.types import Pytree

P = ParamSpec("P")
R = TypeVar("R")


def divide_batches(function: Callable[P, R], *, rows: Pytree = None) -> Callable[P, R]:
    """Lets each device compute its part of a batch that is sharded over a mesh with explicit axes.

    The types of such arrays have their sharding, and JAX refuses many operations on sharded axes: it asks how to shard
    the result. Here no element of a batch depends on another one, so each device needs only its own elements. XLA
    decides about other axes, and about all axes of other meshes.

    Args:
      function: of pytrees of arrays; `jax.vmap` makes its batches. Arguments that can only be given by name are static.
      rows: None; or for a function whose rows, along the first axis of its arguments, do not depend on each other: the
        axis of the rows in each result.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if _explicit_mesh((args, kwargs)) is None:
            return function(*args, **kwargs)
        bound = inspect.signature(function).bind(*args, **kwargs)
        result: R = _divided(partial(function, **bound.kwargs), rows)(*bound.args)
        return result

    return call


def _divided(function: Callable[..., R], rows: Pytree = None) -> Callable[..., R]:
    @jax.custom_batching.custom_vmap
    def alone(*args: Pytree) -> Pytree:
        if rows is None:
            return _in_one_part(function, *args)
        batched = jax.tree.map(lambda leaf: jnp.ndim(leaf) > 0, args)
        return _on_shards(function, args, batched, rows)

    @alone.def_vmap
    def _(_: int, batched: list[Pytree], *args: Pytree) -> tuple[Pytree, Pytree]:
        axes = jax.tree.map(lambda has_axis: 0 if has_axis else None, tuple(batched))
        # Divided again, because another axis of the batch may be sharded over another axis of the mesh.
        result = _on_shards(_divided(jax.vmap(function, axes)), args, tuple(batched), 0, leaves_others=True)
        return result, jax.tree.map(lambda _: True, result)

    return alone


def _in_one_part(function: Callable[..., R], *args: Pytree) -> R:
    """Calls a function on whole arrays, and leaves it to XLA how to divide its work."""
    mesh = _explicit_mesh(args)
    if mesh is None:
        return function(*args)
    whole = NamedSharding(mesh, PartitionSpec())
    result: R = jax.sharding.auto_axes(function, axes=_explicit_axes(mesh), out_sharding=whole)(*args)
    return result


def _on_shards(
    function: Callable[..., R], args: tuple[Pytree, ...], batched: Pytree, rows: Pytree, *, leaves_others: bool = False
) -> R:
    """Calls a function of a batch on each device, with the device's part of the arguments that are batched.

    `rows` is the axis of the batch in each result, `leaves_others` says whether the function divides a batch further.
    """
    leaves = zip(jax.tree.leaves(args), jax.tree.leaves(batched), strict=True)
    axis = next((_spec(leaf)[0] for leaf, has_axis in leaves if has_axis and _spec(leaf)[0] is not None), None)
    if axis is None:
        return _in_one_part(function, *args) if not leaves_others else function(*args)
    mesh = _explicit_mesh(args)
    specs = jax.tree.map(lambda has_axis: PartitionSpec(axis) if has_axis else PartitionSpec(), batched)
    args = jax.tree.map(lambda leaf, spec: jax.sharding.reshard(leaf, NamedSharding(mesh, spec)), args, specs)
    out_specs = jax.tree.map(lambda before: PartitionSpec(*[None] * before, axis), rows)
    names = {*axis} if isinstance(axis, tuple) else {axis}
    # Unchecked, because no device needs another one.
    result: R = jax.shard_map(
        function,
        mesh=mesh,
        in_specs=specs,
        out_specs=out_specs,
        axis_names=names if leaves_others else {*_explicit_axes(mesh)},
        check_vma=False,
    )(*args)
    return result


def _spec(leaf: Pytree) -> PartitionSpec:
    return jax.typeof(leaf).sharding.spec


def _explicit_mesh(tree: Pytree) -> Pytree:
    """Returns the mesh of the first array whose mesh has an explicit axis, or None."""
    for leaf in jax.tree.leaves(tree):
        if isinstance(leaf, jax.Array):
            mesh = jax.typeof(leaf).sharding.mesh
            if AxisType.Explicit in mesh.axis_types:
                return mesh
    return None


def _explicit_axes(mesh: Pytree) -> tuple[str, ...]:
    kinds = zip(mesh.axis_names, mesh.axis_types, strict=True)
    return tuple(name for name, kind in kinds if kind == AxisType.Explicit)
