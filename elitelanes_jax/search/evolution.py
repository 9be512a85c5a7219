"""One call from a key to evolved road networks.

`evolve` takes these steps:

1. `resolve` completes what the user asks for to a `Search`, and checks it.
2. `evolve_search` runs it on the devices here. On the workers of an executor, `evolve_parts` runs
   it in parts.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Unpack

import jax
from jaxtyping import Array, Key

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax._util.engine import Engine, check_pool
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.optimizers.base import Optimizer
from elitelanes_jax.optimizers.presets import Config
from elitelanes_jax.problem.kernels import Fitness, Kernel, check_kernels
from elitelanes_jax.problem.problem import Problem
from elitelanes_jax.search._setup import Extensions
from elitelanes_jax.search._user_functions import set_method
from elitelanes_jax.search.keys import check_keys
from elitelanes_jax.search.parts import evolve_on_workers
from elitelanes_jax.search.records import RunState
from elitelanes_jax.search.resolve import Room, resolve
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.running import evolve_search
from elitelanes_jax.search.spec import SearchOptions, SearchSpec


@name_wrong_arguments
@runs_jax
def evolve(
    key: int | Key[Array, "*S"] = 0,
    shape: tuple[int, int] = (12, 12),
    *,
    seeds: int | None = None,
    spec: SearchSpec = SearchSpec(),
    config: Config | None = None,
    optimizer: Callable[[Problem], Optimizer] | None = None,
    state: RunState | None = None,
    checkpoint: str | Path | None = None,
    every: float | None = None,
    progress: bool | None = None,
    devices: int | Sequence[jax.Device] | None = None,
    features: Mapping[str, Kernel] | None = None,
    fitness: Fitness | None = None,
    moves: Mapping[str, UserValue] | None = None,
    executor: Engine | None = None,
    parts: int | None = None,
    **options: Unpack[SearchOptions],
) -> Result:
    """Evolves road networks.

    Args:
      key: one `jax.random.key`; or an array of keys ``[S]``, to run many seeds in one compiled
        call; or a whole number, which is the command's ``--seed``. With an array or a number, all
        arrays of the result have a leading seed axis ``[S, ...]``, except the counts and the speed
        in the history. With JAX's default kind of key, each seed gives the same result alone and
        among others, bit for bit.
      shape: (height, width) of the grids, each at least 2.
      seeds: the number of runs, if `key` is a whole number; defaults to 8, as in the command.
      spec: the search.
      config: a configuration of a method, instead of a preset; its type determines the method.
      optimizer: your own factory, `Problem` -> `Optimizer`, instead of a method.
      state: the state of an earlier result, to continue from. 100 generations and 100 more equal
        200, bit for bit.
      checkpoint: a folder for the result so far, in ``result.npz`` for `Result.load`. If the
        process is killed, the same call resumes and returns the same result, bit for bit except for
        the measured speeds. A larger budget extends the search. Only one process at a time can use
        the folder.
      every: seconds between two checkpoints, 60 by default, or more, so that writing takes at most
        a twentieth of the time; 0 writes one after every compiled call. It needs `checkpoint`.
      progress: whether to show progress, in a terminal a line that changes, elsewhere a line every
        30 seconds. By default it is shown in a terminal or notebook, if a run takes over a second.
      devices: the devices that share the seeds (processor cores, GPUs or TPU cores; a device may be
        repeated), or their number; defaults to all local ones. The result is the same, bit for bit.
      features: your own features by name: functions of one grid, int8 ``[H, W]``, that return an
        integer scalar, less than 2**30 in size. `where`, `axes` and `weights` can use their names.
        They are compiled, so they must be pure.
      fitness: your own fitness, where lower is better: a function that returns an integer scalar,
        at most 2**29 in size, or a float scalar. It takes any of these arguments by name:
        ``metrics``, the `Metrics` of a grid; ``features``, all features that the search measures,
        by name, with shares and ratios in thousandths; ``grid``, int8 ``[H, W]``; and ``usual``,
        int32, the weighted sum of features that is the fitness by default.
        ``lambda usual, metrics: usual + 50 * metrics.turns`` adds to the usual fitness. Ranges in
        `where` add their penalty to it. A grid with a feature or a fitness that is out of range, or
        not a number, becomes no elite; the history counts these grids. A result without any elite
        is warned of.
      moves: other weights of moves, such as ``{"mirror": 0}``, and your own moves with their
        weights, such as ``{"zigzag": (4, zigzag)}``; see `MoveWeights.with_moves`. For the tuned
        methods.
      executor: a `concurrent.futures.Executor`, or another object with its `submit`, whose workers
        share the seeds in place of the devices here: spawned processes, Dask, Submitit, MPI. The
        result is the same, bit for bit except for the measured speeds, but has no state to continue
        from. Your own functions travel by cloudpickle, or without it by pickle.
      parts: the number of parts that an executor's workers get; defaults to parts of up to 32
        seeds.
      **options: options of `SearchSpec`, which override those of `spec`.

    Raises:
      InputError: for an argument out of its range, a state or a checkpoint of a run with another
        key or other options, a checkpoint that another process uses, or a worker with other
        versions or functions.
      ConnectionError: if the executor lost a part.
      SearchInterrupted: at Ctrl-C, after the first generation; a `KeyboardInterrupt` whose
        ``result`` is the result so far. A checkpoint has this result too, if the search took ten
        seconds.
      MemoryError: if the search does not fit into the free memory.
    """
    shape = check_shape(shape, new=True)
    # Functions are no options: a specification is plain, so it has only the names of the features.
    kernels = check_kernels(features, shape)
    extensions = Extensions(
        config=config,
        optimizer=optimizer,
        kernels=kernels,
        fitness=fitness,
        moves=moves,
    )
    all_options: dict[str, UserValue] = dict(options)
    if features is not None:
        all_options["features"] = tuple(kernels)
    spec = _with_options(spec, all_options)
    spec = set_method(spec, options, extensions)
    # `resolve` refuses constraints that no repaired grid satisfies. The user's optimiser may make
    # other grids, so `resolve` omits this check for it.
    room_for: Room = "grids" if optimizer is None else "anything"
    search = resolve(spec, shape, room_for=room_for, shape_name="shape")
    keys = check_keys(key, seeds)
    pool = check_pool(executor, parts)
    if pool is not None:
        _check_none_with_executor(state=state, checkpoint=checkpoint, every=every, devices=devices)
        return evolve_on_workers(search, keys, pool, extensions, progress=progress)
    return evolve_search(
        search,
        keys,
        extensions,
        state=state,
        checkpoint=checkpoint,
        every=every,
        progress=progress,
        devices=devices,
    )


def _check_none_with_executor(**arguments: UserValue) -> None:
    """Checks that the arguments, which an executor's workers cannot use, are not given."""
    for name, value in arguments.items():
        if value is not None:
            got = quote(value, 60)
            raise InputError(name, "none with an executor", got)


def _with_options(spec: UserValue, options: Mapping[str, Untyped]) -> SearchSpec:
    """Returns a specification with the options of a call."""
    spec = check_named("spec", instance(SearchSpec), spec)
    # The command calls these arguments otherwise.
    argument_of_option = {"size": "shape", "seed": "key"}
    for option, argument in argument_of_option.items():
        if option in options:
            value = options[option]
            raise InputError(option, f"it as {argument}={value!r}", f"{option}=")
    if not options:
        return spec
    return spec.replace(**options)
