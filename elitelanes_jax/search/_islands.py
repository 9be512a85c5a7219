"""One search on many hosts: islands, each a whole MAP-Elites, that exchange elites."""

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Key

from elitelanes_jax._util.checks import check_named, flag, is_whole, none_or, whole
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.types import Pytree, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.optimizers.base import Optimizer
from elitelanes_jax.optimizers.loop import advance, start
from elitelanes_jax.optimizers.presets import Config
from elitelanes_jax.problem.archive import Population, keep_best
from elitelanes_jax.problem.kernels import Fitness, Kernel
from elitelanes_jax.search._options import SearchOptions
from elitelanes_jax.search._programs import as_measured
from elitelanes_jax.search.evolution import Users, check_keys, prepare
from elitelanes_jax.search.result import History, Result, RunState
from elitelanes_jax.search.spec import SearchSpec

_AXIS = "islands"


def evolve_islands(
    key: int | Key[Array, ""] = 0,
    shape: tuple[int, int] = (12, 12),
    *,
    islands: int,
    every: int = 200,
    spec: SearchSpec = SearchSpec(),
    config: Config | None = None,
    features: Mapping[str, Kernel] | None = None,
    fitness: Fitness | None = None,
    moves: Mapping[str, UserValue] | None = None,
    progress: bool | None = None,
    **options: Unpack[SearchOptions],
) -> Result:
    """Evolves road networks on islands that exchange elites: one search for all devices of all hosts.

    Each island is a MAP-Elites with the key ``fold_in(key, island)``. After every few generations, each island replaces
    the elites of its niches by better ones of other islands (island model: Tanese, "Distributed genetic algorithms",
    1989).

    With `jax.distributed.initialize`, call it in every process with the same arguments: the islands are spread over the
    devices of all processes, and each process returns the same result. It is the same, bit for bit, on any number of
    devices and processes.

    Args:
      key: one `jax.random.key`, or a whole number, the same in all processes.
      shape: (height, width) of the grids, each at least 2.
      islands: the number of islands, a multiple of the number of devices.
      every: generations from one exchange to the next.
      spec: the search; its budget is that of each island.
      config: a configuration of MAP-Elites, instead of a preset.
      features: your own features, as in `evolve`.
      fitness: your own fitness, as in `evolve`.
      moves: weights of moves and your own moves, as in `evolve`.
      progress: as in `evolve`; in the first process alone.
      **options: options of `SearchSpec`, which override those of `spec`.

    Returns:
      The best elite of each niche, as of one seed. The history has a row for each exchange; its evaluations and speed
      are those of all islands together. The state cannot be continued from.

    Raises:
      InputError: for an argument out of its range, a method without an archive, or islands that cannot be spread
        evenly.
    """
    keys, impl, single = check_keys(jax.random.key(key) if is_whole(key) else key, None)
    if not single:
        raise InputError(f"key: expected one key for all islands, got {pluralize(len(keys), 'key')}")
    shape = check_shape(shape, new=True)
    spec, config, static, traced = prepare(spec, shape, config, None, Users(features, fitness, moves), options)
    check_named("islands", whole(1), islands)
    check_named("every", whole(1), every)
    check_named("progress", none_or(flag), progress)
    devices = jax.devices() if jax.process_count() > 1 else jax.local_devices()[:1]
    if islands % len(devices):
        raise InputError(f"islands: expected a multiple of {pluralize(len(devices), 'device')}, got {islands}")
    optimizer = static.optimizer(traced)
    if optimizer.migrate is None:
        raise InputError(f"method: expected map-elites, which has an archive to exchange, got {spec.method}")
    per_step = optimizer.evaluations_per_step * islands
    last = spec.steps(optimizer.evaluations_per_step)
    make_key = partial(static._replace(impl=impl).keys, keys[0])
    first_states, stretch = _compiled(optimizer, make_key, islands, every, devices)
    rows: list[History] = []
    done, shown = 0, progress if jax.process_index() == 0 else False
    with Progress(f"{spec.method} {static.shape[0]}x{static.shape[1]}", last, "generations", shown=shown) as bar:
        with bar.doing("compiling"):
            states, found = first_states()
        while done < last:
            began, count = time.perf_counter(), min(every, last - done)
            states, (found, refused) = stretch(states, np.int32(done + 1), np.int32(done + count))
            done += count
            best = np.asarray(_local(found.fitness)).min(keepdims=True)
            filled = np.asarray(_local(found.valid)).sum(keepdims=True, dtype=np.int32)
            rejected = np.asarray(_local(refused), np.int32).reshape(1)
            speed = np.array([per_step * count / (time.perf_counter() - began)])
            rows.append(History(np.array([done]), np.array([done * per_step]), best, filled, speed, rejected))
            bar.update(done, f"best {rows[-1].best_fitness[-1]:,}, {rows[-1].elite_count[-1]:,} elites")
    elites = as_measured(static, _local(found))
    history = History.joined([History.empty(dtype=elites.fitness.dtype), *rows])
    state = RunState(np.array(done, np.int32), (), np.zeros((), np.uint32))
    return Result(elites, history, state, spec, static.axes, config)


def _compiled(
    optimizer: Optimizer, make_key: Callable[[], Key[Array, ""]], islands: int, every: int, devices: list[jax.Device]
) -> tuple[Callable[..., Pytree], Callable[..., Pytree]]:
    """Returns two compiled programs: the first populations, and the generations up to an exchange.

    Each returns the states of all islands, spread over the devices, and the elites that all have in common. The second
    program also returns the number of grids that all islands refused.
    """
    mesh = jax.make_mesh((len(devices),), (_AXIS,), devices=devices, axis_types=(jax.sharding.AxisType.Auto,))
    split, same = PartitionSpec(_AXIS), PartitionSpec()
    each = islands // len(devices)

    def keys() -> Array:
        island = jax.lax.axis_index(_AXIS) * each + jnp.arange(each)
        return jax.vmap(partial(jax.random.fold_in, make_key()))(island)

    def exchange(states: Pytree) -> tuple[Pytree, Population]:
        found = jax.vmap(optimizer.elites)(states)
        elites = keep_best(jax.lax.all_gather(found, _AXIS, tiled=True))
        assert optimizer.migrate is not None
        return jax.vmap(optimizer.migrate, (0, None))(states, elites), elites

    def begin() -> tuple[Pytree, Population]:
        return exchange(start(optimizer, keys()))

    def proceed(states: Pytree, first: Array, last: Array) -> tuple[Pytree, tuple[Population, Array]]:
        states, info = advance(optimizer, keys(), states, first, last, most=every)
        states, elites = exchange(states)
        return states, (elites, jax.lax.psum(info.refused.sum(), _AXIS))

    spread = partial(jax.shard_map, mesh=mesh, out_specs=(split, same), check_vma=False)
    return jax.jit(spread(begin, in_specs=())), jax.jit(spread(proceed, in_specs=(split, same, same)))


def _local(tree: Pytree) -> Pytree:
    """Returns this process's copy of arrays that are equal on all devices."""
    return jax.tree.map(lambda array: jnp.asarray(np.asarray(array.addressable_data(0))), tree)
