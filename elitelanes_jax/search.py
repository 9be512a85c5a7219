"""One call from a key to evolved road networks."""

import time
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array, ArrayTree, PRNGKey

from elitelanes_jax.archive import Axis, check_axes, describe, paper_axes, tuned_axes
from elitelanes_jax.checks import check_grid, check_shape
from elitelanes_jax.codes import ROAD_ALPHABET, alphabet_of
from elitelanes_jax.errors import InputError
from elitelanes_jax.metrics import Metrics, metrics_of
from elitelanes_jax.objective import Weights, check_weights
from elitelanes_jax.optimizers import (
    AimedMapElitesConfig,
    AnnealingConfig,
    DiscreteGwoConfig,
    DiscretePsoConfig,
    EvolutionConfig,
    GwoConfig,
    Info,
    MapElitesConfig,
    Optimizer,
    PsoConfig,
    aimed_map_elites,
    annealed_ea,
    discrete_gwo,
    discrete_pso,
    ea,
    gwo,
    map_elites,
    pso,
)
from elitelanes_jax.problem import Problem, road_problem
from elitelanes_jax.progress import Progress
from elitelanes_jax.requests import Range, Ranges, meets, ranges_of, read_ranges
from elitelanes_jax.rules import rules_named
from elitelanes_jax.run import advance, start
from elitelanes_jax.templates import Template, template_of

__all__ = ["History", "MeasuredElites", "Result", "RunState", "evolve", "preset_config", "seed_keys"]


Config = (
    EvolutionConfig
    | MapElitesConfig
    | PsoConfig
    | GwoConfig
    | AnnealingConfig
    | AimedMapElitesConfig
    | DiscretePsoConfig
    | DiscreteGwoConfig
)

_PRESETS: dict[str, dict[str, Config]] = {
    "ea": {"paper": EvolutionConfig(), "tuned": AnnealingConfig()},
    "map-elites": {
        "paper": MapElitesConfig(),
        "standard": MapElitesConfig(parents="archive"),
        "tuned": AimedMapElitesConfig(),
    },
    "pso": {"paper": PsoConfig(), "tuned": DiscretePsoConfig()},
    "gwo": {"paper": GwoConfig(), "tuned": DiscreteGwoConfig()},
}

# What kind of settings makes what optimiser.
_FACTORIES: dict[type, Callable[..., Optimizer]] = {
    EvolutionConfig: ea,
    MapElitesConfig: map_elites,
    PsoConfig: pso,
    GwoConfig: gwo,
    AnnealingConfig: annealed_ea,
    AimedMapElitesConfig: aimed_map_elites,
    DiscretePsoConfig: discrete_pso,
    DiscreteGwoConfig: discrete_gwo,
}

_GENERATIONS = 200

# Between two compiled calls the progress is shown and a run can be interrupted: so long one is meant to take, and so
# many generations it has at most.
_SECONDS_A_CALL = 0.2
_MOST = 256


class MeasuredElites(NamedTuple):
    """What a run has found, in N places, some of which may be vacant.

    Attributes:
      grids: int8 ``[N, H, W]``.
      fitness: int32 ``[N]``, lower is better; the largest int32 in a vacant place.
      descriptor: int32 ``[N, D]``, the values of the axes' metrics.
      valid: bool ``[N]``, which places hold a grid; the rest of a vacant place is meaningless.
      metrics: `Metrics` of arrays ``[N]``, the ones that the fitness is made of.
    """

    grids: Array
    fitness: Array
    descriptor: Array
    valid: Array
    metrics: Metrics


class History(NamedTuple):
    """A run by generation, as NumPy arrays.

    Attributes:
      generation: int ``[G]``, counted from 1.
      evaluations: int ``[G]``, grids that one seed's steps have evaluated so far.
      best_fitness: int32 ``[G]``, the lowest among the elites.
      elite_count: int32 ``[G]``, how many there are: niches filled, or how many the method keeps.
      evaluations_per_second: float ``[G]``, of all seeds together, as the clock had it.
    """

    generation: np.ndarray
    evaluations: np.ndarray
    best_fitness: np.ndarray
    elite_count: np.ndarray
    evaluations_per_second: np.ndarray


class RunState(NamedTuple):
    """What a run goes on from, beside its key and settings.

    Attributes:
      generation: int, how many are done.
      inner: the optimiser's own state.
      fingerprint: int, of the key and the settings, so that a run is not gone on with by mistake with others.
    """

    generation: int
    inner: ArrayTree
    fingerprint: int


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Result:
    """What `evolve` returns; a pytree.

    Attributes:
      elites: what was found, with its metrics.
      history: of the generations of this call.
      state: to go on from.
      axes: of the descriptor.
      where: the ranges that were asked for.
      rules: the rules' name, if there were any.
      fix: the cells that were given, if there were any.
    """

    elites: MeasuredElites
    history: History
    state: RunState
    axes: tuple[Axis, ...] = field(metadata={"static": True})
    where: tuple[Range, ...] = field(default=(), metadata={"static": True})
    rules: str | None = field(default=None, metadata={"static": True})
    fix: Template | None = field(default=None, metadata={"static": True})

    def best(self) -> Array:
        """The grid of lowest fitness, int8 ``[H, W]``; among equals the one in the first place."""
        worth = jnp.where(self.elites.valid, self.elites.fitness, np.iinfo(np.int32).max)
        place = jnp.argmin(worth, axis=-1)[..., None, None, None]
        return jnp.take_along_axis(self.elites.grids, place, axis=-3)[..., 0, :, :]

    def meets(self) -> np.ndarray:
        """Bool, of the shape of `elites.valid`: which elites meet all the ranges that were asked for, exactly."""
        metrics = {name: np.asarray(values) for name, values in self.elites.metrics._asdict().items()}
        return np.asarray(self.elites.valid) & meets(metrics, self.where)


def evolve(
    key: PRNGKey,
    shape: tuple[int, int] = (12, 12),
    *,
    method: str = "map-elites",
    preset: str = "paper",
    config: Config | None = None,
    generations: int | None = None,
    evaluations: int | None = None,
    alphabet: Iterable[int] | None = None,
    weights: Weights | None = None,
    axes: Iterable[Axis] | None = None,
    fill: bool = False,
    where: Any = None,
    fix: Any = None,
    rules: str | None = None,
    initial: Any = None,
    state: RunState | None = None,
    progress: bool | None = None,
) -> Result:
    """Evolves road networks.

    Args:
      key: one `jax.random.key`, or an array of keys ``[S]``: many seeds in one compiled call, and a leading seed axis
        ``[S, ...]`` in everything that is returned, but for the counts and the speed in the history. With JAX's default
        kind of key a seed gives the same result alone and among others, bit for bit.
      shape: (height, width) of the grids, each at least 2.
      method: "map-elites", "ea", "pso" or "gwo".
      preset: "paper"; "tuned", which reaches farther and sooner; for "map-elites" also "standard", the paper's with
        parents from the archive.
      config: of the method, to be taken in place of the preset's.
      generations: how many to run now, at least 0; by default 200.
      evaluations: how many grids a seed evaluates now, given in place of generations, which are rounded up.
      alphabet: the tile codes to draw from, by default all with two or more connections.
      weights: of the fitness, by default the paper's, or those of the rules.
      axes: of the descriptor space, by default the paper's (see `paper_axes`), for "tuned" `tuned_axes`.
      fill: whether repair also gives every tile at least two connections, so that all have a picture.
      where: ranges of features to steer into, such as ``["crossings=6..10", "straight_share=0.3.."]`` (see
        `read_ranges`). What a grid lacks adds to its fitness; `Result.meets` says which elites meet them.
      fix: rows of given tile codes, None for free cells (see `template_of`); all grids keep them.
      rules: "duckietown": crossings beside no turn or crossing, all neighbours linked, cells may stay empty.
      initial: grids ``[N, H, W]`` that every seed begins with, beside random ones; repaired as all grids are, and
        filled where `fill` says so. None for the paper's PSO, whose particles are no grids.
      state: of an earlier result, to go on from. 100 generations and 100 more are 200, bit for bit.
      progress: whether to show a progress bar; by default in a terminal or notebook, when a run takes over a second.

    Returns:
      A `Result`.

    Raises:
      InputError: for an argument out of its range, or a state of a run with another key or other settings.
    """
    keys, single = _keys(key)
    shape = check_shape(shape)
    config = preset_config(method, preset) if config is None else _checked(config, method, preset)
    leaves, tree = jax.tree.flatten(config)
    law = None if rules is None else rules_named(rules)
    if law and fill:
        raise InputError(f"fill: expected none with the rules of {rules}, which leave cells empty, got fill={fill!r}")
    ranges = read_ranges(() if where is None else where)
    usual_axes = tuned_axes if preset == "tuned" else paper_axes
    setup = _Setup(
        method=method,
        shape=shape,
        alphabet=ROAD_ALPHABET if alphabet is None else alphabet_of(alphabet),
        fill=bool(fill),
        axes=usual_axes(shape) if axes is None else check_axes(axes),
        fix=None if fix is None else template_of(fix, shape),
        steered=bool(ranges),
        config=tuple(None if isinstance(leaf, float) else leaf for leaf in leaves),
        config_tree=tree,
    )
    if weights is None:
        weights = law.weights if law else Weights()
    weights = check_weights(weights, shape)
    reals = tuple(np.float32(leaf) for leaf in leaves if isinstance(leaf, float))
    begun = None if initial is None else _checked_initial(initial, shape, config)
    numbers = _Numbers(Weights(*map(np.int32, weights)), ranges_of(ranges), reals, begun)
    fingerprint = _fingerprint(setup, numbers, keys)
    if state is None:
        done, inner = 0, _start(setup, numbers, keys)
    else:
        done, inner = _resumed(setup, numbers, keys, state, fingerprint, single)

    per_step = setup.optimizer(numbers).evaluations_per_step
    first, last = done + 1, done + _generations(generations, evaluations, per_step)
    rows: list[Info] = []
    speeds: list[float] = []
    stretch = _MOST // 2
    if done < last:
        jax.block_until_ready(_advance(setup, numbers, keys, inner, first, done))  # nothing to do but compile
    with Progress(f"{method} {shape[0]}x{shape[1]}", done, last, shown=progress) as bar:
        while done < last:
            count = min(stretch, last - done)
            began = time.perf_counter()
            inner, info = _advance(setup, numbers, keys, inner, done + 1, done + count)
            rows.append(jax.tree.map(lambda field, count=count: np.asarray(field)[:count], info))
            seconds = time.perf_counter() - began
            done += count
            speeds += [count * per_step * keys.size / seconds] * count
            bar.show(done, rows[-1].best_fitness[-1].min(), rows[-1].elite_count[-1].mean(), speeds[-1])
            wanted = count * _SECONDS_A_CALL / seconds
            stretch = int(min(max(wanted, 1), 2 * stretch, _MOST))

    generation = np.arange(first, last + 1)
    info = jax.tree.map(lambda *parts: np.concatenate(parts).T, *rows) if rows else _no_rows(keys.size)
    found, inner = _found(setup, numbers, inner, single)
    if single:
        info = jax.tree.map(lambda row: row[0], info)
    history = History(
        generation=generation,
        evaluations=generation * per_step,
        best_fitness=info.best_fitness,
        elite_count=info.elite_count,
        evaluations_per_second=np.array(speeds),
    )
    return Result(found, history, RunState(last, inner, fingerprint), setup.axes, ranges, rules, setup.fix)


def _generations(generations: Any, evaluations: Any, per_step: int) -> int:
    """How many generations to run now."""
    for name, value in (("generations", generations), ("evaluations", evaluations)):
        if value is not None and (not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 0):
            raise InputError(f"{name}: expected a whole number, 0 or more, got {value!r}")
    if evaluations is None:
        return _GENERATIONS if generations is None else int(generations)
    if generations is not None:
        raise InputError(f"evaluations: expected them or generations, got both, {evaluations} and {generations}")
    return -(-int(evaluations) // per_step)


def seed_keys(seed: int, count: int) -> PRNGKey:
    """Keys ``[count]`` that follow from a whole number, each the same however many there are."""
    key = jax.random.key(seed)
    return jax.vmap(lambda number: jax.random.fold_in(key, number))(np.arange(count))


def preset_config(method: str, preset: str) -> Config:
    """The settings of a method under a name.

    Raises:
      InputError: if there is no such method, or it has no such preset.
    """
    if method not in _PRESETS:
        raise InputError(f"method: expected one of {', '.join(_PRESETS)}, got {method!r}")
    presets = _PRESETS[method]
    if preset not in presets:
        raise InputError(f"preset: expected one of {', '.join(presets)} for {method}, got {preset!r}")
    return presets[preset]


def _checked(config: Any, method: str, preset: str) -> Config:
    preset_config(method, preset)
    kinds = list(dict.fromkeys(type(known) for known in _PRESETS[method].values()))
    if type(config) not in kinds:
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"config: expected {names} for {method}, got {type(config).__name__}")
    config = config.checked()
    for leaf in jax.tree.leaves(config):
        if isinstance(leaf, jax.Array | np.ndarray):
            raise InputError(f"config: expected plain numbers, got an array of shape {leaf.shape}")
    return config


def _checked_initial(initial: Any, shape: tuple[int, int], config: Config) -> np.ndarray:
    if isinstance(config, PsoConfig):
        raise InputError("initial: expected none with the paper's PSO, whose particles are no grids; tuned would do")
    grids = [np.asarray(check_grid(grid)) for grid in initial]
    for grid in grids:
        if grid.shape != shape:
            raise InputError(
                f"initial: expected grids of {shape[0]} x {shape[1]}, got {grid.shape[0]} x {grid.shape[1]}"
            )
    return np.array(grids, np.int8).reshape(-1, *shape)


class _Numbers(NamedTuple):
    """Settings that may change without a second compilation: weights, ranges, real numbers, grids to begin with."""

    weights: Weights
    ranges: Ranges
    config: tuple[np.float32, ...]
    initial: np.ndarray | None


class _Setup(NamedTuple):
    """Settings that a compiled run is made for; hashable."""

    method: str
    shape: tuple[int, int]
    alphabet: tuple[int, ...]
    fill: bool
    axes: tuple[Axis, ...]
    fix: Template | None
    steered: bool
    config: tuple[Any, ...]  # its leaves, None for the real numbers
    config_tree: Any

    def problem(self, numbers: _Numbers) -> Problem:
        return road_problem(
            self.shape,
            self.axes,
            alphabet=self.alphabet,
            weights=numbers.weights,
            fill=self.fill,
            where=numbers.ranges if self.steered else None,
            fix=self.fix,
            initial=numbers.initial,
        )

    def optimizer(self, numbers: _Numbers) -> Optimizer:
        reals = iter(numbers.config)
        leaves = [next(reals) if leaf is None else leaf for leaf in self.config]
        config = jax.tree.unflatten(self.config_tree, leaves)
        return _FACTORIES[type(config)](self.problem(numbers), config)


def _keys(key: Any) -> tuple[PRNGKey, bool]:
    """The keys as an array ``[S]``, and whether there was one key alone."""
    if isinstance(key, jax.Array) and key.dtype == jnp.uint32 and key.ndim and key.shape[-1] == 2:
        key = jax.random.wrap_key_data(key)
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raise InputError(f"key: expected a jax.random.key or an array of them, got {key!r}")
    if key.ndim > 1 or key.size == 0:
        raise InputError(f"key: expected one key or keys [S] with S at least 1, got shape {key.shape}")
    return jnp.atleast_1d(key), key.ndim == 0


def _fingerprint(setup: _Setup, numbers: _Numbers, keys: PRNGKey) -> int:
    said = repr((setup, [leaf.tolist() for leaf in jax.tree.leaves(numbers)], str(keys.dtype)))
    return zlib.crc32(said.encode() + np.asarray(jax.random.key_data(keys)).tobytes())


def _resumed(
    setup: _Setup, numbers: _Numbers, keys: PRNGKey, state: Any, fingerprint: int, single: bool
) -> tuple[int, ArrayTree]:
    if not isinstance(state, RunState):
        raise InputError(f"state: expected the state of a result of evolve, got {type(state).__name__}")
    inner = jax.tree.map(lambda array: jnp.asarray(array)[None], state.inner) if single else state.inner
    expected = _start.eval_shape(setup, numbers, keys)
    kinds = [
        [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(tree)] + [jax.tree.structure(tree)]
        for tree in (inner, expected)
    ]
    if state.fingerprint != fingerprint or kinds[0] != kinds[1]:
        raise InputError(
            f"state: expected one of the run to go on with ({setup.method} on {setup.shape[0]} x {setup.shape[1]}, "
            f"seeds: {keys.size}), got one of a run with another key or other settings"
        )
    return int(state.generation), inner


def _no_rows(seeds: int) -> Info:
    return Info(*(np.zeros((seeds, 0), np.int32) for _ in Info._fields))


# The first populations are made once: to compile that twice as fast is worth more than to run it.
@partial(jax.jit, static_argnames="setup", compiler_options={"xla_backend_optimization_level": 0})
def _start(setup: _Setup, numbers: _Numbers, keys: PRNGKey) -> ArrayTree:
    return start(setup.optimizer(numbers), keys)


@partial(jax.jit, static_argnames="setup")
def _advance(
    setup: _Setup, numbers: _Numbers, keys: PRNGKey, states: ArrayTree, first: int, last: int
) -> tuple[ArrayTree, Info]:
    return advance(setup.optimizer(numbers), keys, states, first, last, most=_MOST)


@partial(jax.jit, static_argnames=("setup", "single"))
def _found(setup: _Setup, numbers: _Numbers, states: ArrayTree, single: bool) -> tuple[MeasuredElites, ArrayTree]:
    """What was found, and the states; where there was one key alone, both without the axis of seeds."""
    elites = jax.vmap(setup.optimizer(numbers).elites)(states)
    found = MeasuredElites(
        grids=elites.grids,
        fitness=elites.fitness,
        descriptor=describe(elites.counts, setup.axes),
        valid=elites.valid,
        metrics=metrics_of(elites.counts, setup.shape[0] * setup.shape[1]),
    )
    return jax.tree.map(lambda array: array[0], (found, states)) if single else (found, states)
