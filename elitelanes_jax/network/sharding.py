"""Batches that are sharded over devices: each device computes its part."""

import inspect
from collections.abc import Callable
from functools import partial, wraps
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from elitelanes_jax._util.types import Pytree
from elitelanes_jax.network.xla import vary_together

P = ParamSpec("P")
R = TypeVar("R")


def divide_batches(function: Callable[P, R], *, rows: Pytree = None) -> Callable[P, R]:
    """Lets each device compute its part of a batch that is sharded over a mesh with explicit axes.

    The types of such arrays have their sharding, and JAX refuses many operations on sharded axes:
    it asks how to shard the result. Here no element of a batch depends on another one, so each
    device needs only its own elements. XLA decides about other axes, and about all axes of other
    meshes.

    Args:
      function: a function of pytrees of arrays; `jax.vmap` makes its batches. Arguments that can
        only be given by name are static.
      rows: None; or for a function whose rows, along the first axis of its arguments, do not depend
        on each other: the axis of the rows in each result.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if _explicit_mesh((args, kwargs)) is None:
            # XLA divides batches on other meshes by itself.
            result = function(*args, **kwargs)
        else:
            bound = inspect.signature(function).bind(*args, **kwargs)
            result = _divided(partial(function, **bound.kwargs), rows)(*bound.args)
        # A caller in `jax.shard_map` may carry the result in a loop, in which the next result
        # differs between devices if an argument does.
        return vary_together(result, args, kwargs)

    return call


def _divided(function: Callable[..., R], rows: Pytree = None) -> Callable[..., R]:
    """Returns the function with a rule for batches: each device computes its part of a batch."""

    @jax.custom_batching.custom_vmap
    def alone(*args: Pytree) -> Pytree:
        if rows is None:
            # The arguments are those of one element, so there is no batch to divide.
            return _in_one_part(function, *args)
        batched = jax.tree.map(lambda leaf: jnp.ndim(leaf) > 0, args)
        return _on_shards(function, args, batched, rows)

    @alone.def_vmap
    def _(_: int, batched: list[Pytree], *args: Pytree) -> tuple[Pytree, Pytree]:
        is_batched = tuple(batched)
        axes = jax.tree.map(lambda has_axis: 0 if has_axis else None, is_batched)
        # The function is divided again, because another axis of the batch may be sharded over
        # another axis of the mesh.
        batch_function = _divided(jax.vmap(function, axes))
        result = _on_shards(batch_function, args, is_batched, 0, leaves_others=True)
        return result, jax.tree.map(lambda _: True, result)

    return alone


def _in_one_part(function: Callable[..., R], *args: Pytree) -> R:
    """Calls a function on whole arrays, and leaves it to XLA how to divide its work."""
    mesh = _explicit_mesh(args)
    if mesh is None:
        return function(*args)
    whole = NamedSharding(mesh, PartitionSpec())
    auto_function = jax.sharding.auto_axes(function, axes=_explicit_axes(mesh), out_sharding=whole)
    result: R = auto_function(*args)
    return result


def _on_shards(
    function: Callable[..., R],
    args: tuple[Pytree, ...],
    batched: Pytree,
    rows: Pytree,
    *,
    leaves_others: bool = False,
) -> R:
    """Calls a function of a batch on each device.

    Each device gets its part of the arguments that are batched. `rows` is the axis of the batch in
    each result, `leaves_others` says whether the function divides a batch further.
    """
    mesh_axis = _mesh_axis_of_batch(args, batched)
    if mesh_axis is None and leaves_others:
        return function(*args)
    if mesh_axis is None:
        return _in_one_part(function, *args)
    # Each device gets its part of the batched arguments, and the others whole.
    mesh = _explicit_mesh(args)
    specs = jax.tree.map(
        lambda has_axis: PartitionSpec(mesh_axis) if has_axis else PartitionSpec(), batched
    )
    sharded_args = jax.tree.map(
        lambda leaf, spec: jax.sharding.reshard(leaf, NamedSharding(mesh, spec)), args, specs
    )
    out_specs = jax.tree.map(lambda row_axis: PartitionSpec(*[None] * row_axis, mesh_axis), rows)
    if not leaves_others:
        divided_axes = set(_explicit_axes(mesh))
    elif isinstance(mesh_axis, tuple):
        divided_axes = set(mesh_axis)
    else:
        divided_axes = {mesh_axis}
    # The check of what devices exchange is off, because they exchange nothing.
    on_shards = jax.shard_map(
        function,
        mesh=mesh,
        in_specs=specs,
        out_specs=out_specs,
        axis_names=divided_axes,
        check_vma=False,
    )
    result: R = on_shards(*sharded_args)
    return result


def _mesh_axis_of_batch(args: tuple[Pytree, ...], batched: Pytree) -> Pytree:
    """Returns the axis of the mesh, or the axes, that the batch is sharded over.

    Returns None if the batch is whole.
    """
    leaves = jax.tree.leaves(args)
    for leaf, has_axis in zip(leaves, jax.tree.leaves(batched), strict=True):
        if not has_axis:
            continue
        mesh_axis = jax.typeof(leaf).sharding.spec[0]
        if mesh_axis is not None:
            return mesh_axis
    return None


def _explicit_mesh(tree: Pytree) -> Pytree:
    """Returns the mesh of the first array whose mesh has an explicit axis, or None."""
    for leaf in jax.tree.leaves(tree):
        if isinstance(leaf, jax.Array):
            mesh = jax.typeof(leaf).sharding.mesh
            if AxisType.Explicit in mesh.axis_types:
                return mesh
    return None


def _explicit_axes(mesh: Pytree) -> tuple[str, ...]:
    explicit_names = []
    for name, axis_type in zip(mesh.axis_names, mesh.axis_types, strict=True):
        if axis_type == AxisType.Explicit:
            explicit_names.append(name)
    return tuple(explicit_names)
