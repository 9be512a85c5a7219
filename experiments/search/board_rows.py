"""The rows of the board: searches as loops of their own libraries over our evaluation.

A loop in JAX is an `Optimizer`, so that `evolve` runs all seeds side by side. pyribs runs one seed after another.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32, Key
from numpy.typing import NDArray

from elitelanes_jax import evolve
from elitelanes_jax.benchmark import Task
from elitelanes_jax.network import METRIC_NAMES
from elitelanes_jax.optimizers import (
    PRESETS,
    AnnealedMapElitesConfig,
    Info,
    MoveWeights,
    Niches,
    Optimizer,
    evaluate,
    make_optimizer,
    seed_keys,
)
from elitelanes_jax.optimizers.interop import (
    evosax_task,
    qdax_centroids,
    qdax_moves,
    qdax_scoring_fn,
    ribs_archive_space,
)
from elitelanes_jax.problem import Population, Problem, insert, road_problem, tuned_axes, vacant_fitness
from experiments.common import Pytree, Untyped

__all__ = ["ROWS", "Found", "Row"]


class Found(NamedTuple):
    """The best flawless networks of R runs after each of T budgets, by cyclomatic number. Vacant grids are zero.

    Attributes:
      grids: int8 ``[R, T, N, H, W]``.
      fitness: int32 ``[R, T, N]``.
      cyclomatic: int32 ``[R, T, N]``.
    """

    grids: NDArray[np.int8]
    fitness: NDArray[np.int32]
    cyclomatic: NDArray[np.int32]


Decode = Callable[[NDArray[np.floating]], Array | NDArray[np.int8]]
"""From the solutions of pyribs to grids."""

Play = Callable[[Task, int, Sequence[int]], Found]
"""(task, runs, budgets) -> `Found`."""


class Row(NamedTuple):
    """One row.

    Attributes:
      title: its name in the table.
      play: runs it.
    """

    title: str
    play: Play


def _found(task: Task, kept: Sequence[Population]) -> Found:
    """Selects the flawless niches of the records ``[R, ...]`` of each budget."""
    wanted = Niches.of(tuned_axes(task.shape)).targeted
    valid, grids, fitness, features = (
        np.stack([np.asarray(getattr(one, name))[:, wanted] for one in kept], axis=1)
        for name in ("valid", "grids", "fitness", "features")
    )
    cyclomatic = features[..., METRIC_NAMES.index("cyclomatic")]
    return Found(np.where(valid[..., None, None], grids, 0).astype(np.int8), fitness, cyclomatic)


def _in_jax(make: Callable[[Problem], Optimizer]) -> Play:
    """Runs a loop in JAX. `make` returns an optimiser for a problem; its first state is one batch."""

    def play(task: Task, runs: int, budgets: Sequence[int]) -> Found:
        axes = tuned_axes(task.shape)
        batch = make(road_problem(task.shape, axes, fill=task.fill)).evaluations_per_step
        keys, state, done, kept = seed_keys(0, runs), None, 1, []
        for budget in budgets:
            result = evolve(
                keys,
                task.shape,
                fill=task.fill,
                axes=axes,
                optimizer=make,
                generations=budget // batch - done,
                state=state,
                progress=False,
            )
            state, done = result.state, budget // batch
            elites = result.elites
            features = np.zeros((*elites.fitness.shape, len(METRIC_NAMES)), np.int32)
            features[..., METRIC_NAMES.index("cyclomatic")] = elites.metrics.cyclomatic
            kept.append(Population(elites.grids, elites.fitness, jnp.asarray(features)))
        return _found(task, kept)

    return play


def _preset(problem: Problem, *, method: str, preset: str) -> Optimizer:
    return make_optimizer(problem, PRESETS[method, preset])


def _drawn(problem: Problem, *, hottest: int, penalty: int, restart: float, filling: float, refit: int) -> Optimizer:
    """Makes the tuned MAP-Elites without refitted strips, with other settings."""
    config = PRESETS["map-elites", "tuned"]
    assert isinstance(config, AnnealedMapElitesConfig)
    moves = replace(config.annealing.moves, fill_probability=filling, refit=refit)
    annealing = replace(config.annealing, hottest=hottest, coldest=3 * hottest // 10, moves=moves)
    config = replace(config, annealing=annealing, bin_penalty=penalty, restart=restart, strips=False)
    return make_optimizer(problem, config)


def _ea(problem: Problem) -> Optimizer:
    """Makes the tuned EA, with a record of the grids that its chains move to."""
    ea = make_optimizer(problem, PRESETS["ea", "tuned"])

    def init(key: Key[Array, ""]) -> Pytree:
        state = ea.init(key)
        return state, insert(problem.empty_archive(), problem.niche(state.chains.features), state.chains)

    def step(key: Key[Array, ""], carried: Pytree) -> tuple[Pytree, Info]:
        state, info = ea.step(key, carried[0])
        return (state, insert(carried[1], problem.niche(state.chains.features), state.chains)), info

    return Optimizer(init, step, lambda carried: carried[1], ea.evaluations_per_step)


def _qdax(
    problem: Problem,
    first: Callable[[Key[Array, ""], int], Array],
    grids: Callable[[Array], Array],
    vary: tuple[Callable[..., Array] | None, Callable[..., Array]],
    batch: int,
    share: float,
) -> Optimizer:
    """Makes QDax's MAP-Elites.

    Args:
      problem: that evaluates.
      first: draws genotypes.
      grids: from genotypes to grids.
      vary: QDax's mutation and variation of genotypes.
      batch: genotypes a step.
      share: of a batch that is varied, not mutated.
    """
    from qdax.core.emitters.standard_emitters import MixingEmitter
    from qdax.core.map_elites import MAPElites

    score = qdax_scoring_fn(problem)

    def scored(genotypes: Array, key: Key[Array, ""]) -> tuple[Array, Array, dict[str, Array]]:
        fitness, descriptor, extra = score(grids(genotypes), key)
        return fitness, descriptor, extra | {"grids": grids(genotypes)}

    emitter = MixingEmitter(*vary, variation_percentage=share, batch_size=batch)
    search = MAPElites(scored, emitter, lambda repertoire: {"best": repertoire.fitnesses.max()})

    def init(key: Key[Array, ""]) -> Pytree:
        drawn, rest = jax.random.split(key)
        return search.init(first(drawn, batch), qdax_centroids(problem.axes), rest)[:2]

    def step(key: Key[Array, ""], state: Pytree) -> tuple[Pytree, Info]:
        repertoire, emitter_state, metrics = search.update(*state, key)
        filled = (repertoire.fitnesses > -jnp.inf).sum(dtype=jnp.int32)
        return (repertoire, emitter_state), Info(-metrics["best"].astype(jnp.int32), filled)

    def elites(state: Pytree) -> Population:
        repertoire = state[0]
        found = evaluate(problem, grids(repertoire.genotypes))
        filled = repertoire.fitnesses.reshape(-1) > -jnp.inf
        return found._replace(fitness=jnp.where(filled, found.fitness, vacant_fitness(found.fitness.dtype)))

    return Optimizer(init, step, elites, batch)


# Of the rows with our moves: grids a step, the share of them that take parts of a mate, and the weights of moves.
_BATCH, _CROSSED, _WEIGHTS = 16, 0.2, MoveWeights(fill_probability=0.0, refit=25)


def _qdax_moves(problem: Problem) -> Optimizer:
    """QDax's MAP-Elites with our moves: genotypes are grids."""
    vary = qdax_moves(problem, _WEIGHTS)
    return _qdax(problem, problem.random, lambda grids: grids, vary, _BATCH, _CROSSED)


def _qdax_line(problem: Problem, *, batch: int, iso: float, line: float) -> Optimizer:
    """QDax's MAP-Elites with its own variation, Iso+LineDD, on logits."""
    from qdax.core.emitters.mutation_operators import isoline_variation

    task = evosax_task(problem)
    vary = partial(isoline_variation, iso_sigma=iso, line_sigma=line)
    return _qdax(
        problem,
        lambda key, count: jax.vmap(task.sample)(jax.random.split(key, count)),
        jax.vmap(task.decode),
        (None, vary),
        batch,
        1.0,
    )


def _evosax(problem: Problem, *, population: int, restart: int, std: float) -> Optimizer:
    """Makes SNES of evosax on logits, which restarts after `restart` generations."""
    from evosax.algorithms import SNES

    task = evosax_task(problem)
    strategy = SNES(population_size=population, solution=jnp.zeros(task.num_dims))
    params = strategy.default_params.replace(std_init=std)

    def begin(key: Key[Array, ""]) -> Pytree:
        drawn, rest = jax.random.split(key)
        return strategy.init(rest, task.sample(drawn), params)

    def init(key: Key[Array, ""]) -> Pytree:
        return begin(key), problem.empty_archive()

    def step(key: Key[Array, ""], carried: Pytree) -> tuple[Pytree, Info]:
        state, record = carried
        ask, tell, again = jax.random.split(key, 3)
        solutions, state = strategy.ask(ask, state, params)
        found = evaluate(problem, jax.vmap(task.decode)(solutions))
        state, _ = strategy.tell(tell, solutions, found.fitness.astype(jnp.float32), state, params)
        ends = state.generation_counter >= restart
        state = jax.tree.map(lambda new, old: jnp.where(ends, new, old), begin(again), state)
        record = insert(record, problem.niche(found.features), found)
        return (state, record), Info(record.fitness.min(), record.valid.sum(dtype=jnp.int32))

    return Optimizer(init, step, lambda carried: carried[1], population)


def _in_ribs(make: Callable[..., tuple[Untyped, Decode]]) -> Play:
    """Runs pyribs's loop. `make` returns, for a problem and a seed, a scheduler and what makes grids."""

    def play(task: Task, runs: int, budgets: Sequence[int]) -> Found:
        problem = road_problem(task.shape, tuned_axes(task.shape), fill=task.fill)
        kept: list[list[Population]] = []

        @jax.jit
        def score(grids: Array, record: Population) -> tuple[Int32[Array, " B"], Int32[Array, "B D"], Population]:
            found: Population = evaluate(problem, grids)
            record = insert(record, problem.niche(found.features), found)
            return -found.fitness, problem.descriptor(found.features), record

        for seed in range(runs):
            scheduler, decode = make(problem, seed)
            record, done, of_run = problem.empty_archive(), 0, []
            solutions = scheduler.ask()
            for budget in budgets:
                while done + len(solutions) <= budget:
                    objective, measures, record = score(jnp.asarray(decode(solutions)), record)
                    scheduler.tell(np.asarray(objective, np.float64), np.asarray(measures, np.float64))
                    done += len(solutions)
                    solutions = scheduler.ask()
                of_run.append(record)
            kept.append(of_run)
        together = [jax.tree.map(lambda *arrays: np.stack(arrays), *of_budget) for of_budget in zip(*kept, strict=True)]
        return _found(task, together)

    return play


def _ribs_cma(problem: Problem, seed: int, *, ranker: str, sigma: float, batch: int) -> tuple[Untyped, Decode]:
    """Makes CMA-ME of pyribs on logits: five emitters of separable CMA-ES, as in its tutorials."""
    from ribs.archives import GridArchive
    from ribs.emitters import EvolutionStrategyEmitter
    from ribs.schedulers import Scheduler

    task = evosax_task(problem)
    archive = GridArchive(**ribs_archive_space(problem) | {"solution_dim": task.num_dims}, seed=seed)
    emitters = [
        EvolutionStrategyEmitter(
            archive,
            x0=np.zeros(task.num_dims),
            sigma0=sigma,
            ranker=ranker,
            es="sep_cma_es",
            batch_size=batch,
            seed=5 * seed + index,
        )
        for index in range(5)
    ]
    decode = jax.jit(jax.vmap(task.decode))
    return Scheduler(archive, emitters), lambda solutions: decode(solutions.astype(np.float32))


@cache
def _vary(problem: Problem) -> Callable[[NDArray[np.int8], NDArray[np.int8], int], Array]:
    """Compiles the moves once for all seeds: (grids, mates, seed) -> grids."""
    _, vary = qdax_moves(problem, _WEIGHTS)
    return jax.jit(lambda grids, mates, seed: vary(grids, mates, jax.random.key(seed)))


def _ribs_moves(problem: Problem, seed: int) -> tuple[Untyped, Decode]:
    """Makes the genetic emitter of pyribs, with our moves instead of its operators."""
    from ribs.archives import GridArchive
    from ribs.emitters import GeneticAlgorithmEmitter
    from ribs.schedulers import Scheduler

    vary, crossed, draws = _vary(problem), int(_BATCH * _CROSSED), np.random.default_rng(seed)

    def as_grids(solutions: NDArray[np.floating]) -> NDArray[np.int8]:
        return solutions.reshape(-1, *problem.shape).astype(np.int8)

    class MovesEmitter(GeneticAlgorithmEmitter):  # it takes its operators by name, not a function
        def ask(self) -> NDArray[np.floating]:
            if self.archive.empty:
                return self.initial_solutions
            one, other = (as_grids(self.archive.sample_elites(_BATCH)["solution"]) for _ in range(2))
            mates = np.concatenate([other[:crossed], one[crossed:]])
            return np.asarray(vary(one, mates, int(draws.integers(2**31)))).reshape(_BATCH, -1)

    archive = GridArchive(**ribs_archive_space(problem), seed=seed)
    start = np.asarray(problem.random(jax.random.key(int(draws.integers(2**31))), _BATCH)).reshape(_BATCH, -1)
    emitter = MovesEmitter(
        archive, operator="gaussian", operator_kwargs={"sigma": 1}, initial_solutions=start, seed=seed
    )
    return Scheduler(archive, [emitter]), as_grids


# Settings of other libraries' rows are the best of eight trials each, on 6 x 6 alone: results/tuning.
ROWS = {
    **{
        preset: Row(f"MAP-Elites, `{preset}`", _in_jax(partial(_preset, method="map-elites", preset=preset)))
        for preset in ("paper", "standard", "tuned")
    },
    "drawn": Row(
        "the same, no refitted strips, with the effort of the other libraries",
        _in_jax(partial(_drawn, hottest=80, penalty=400, restart=0.0, filling=0.05, refit=25)),
    ),
    "ea": Row("EA with restarts, `tuned`", _in_jax(_ea)),
    "qdax-moves": Row("QDax: MAP-Elites, our moves", _in_jax(_qdax_moves)),
    "qdax-line": Row(
        "QDax: MAP-Elites, Iso+LineDD on logits", _in_jax(partial(_qdax_line, batch=128, iso=0.3, line=0.2))
    ),
    "ribs-cma": Row("pyribs: CMA-ME on logits", _in_ribs(partial(_ribs_cma, ranker="2imp", sigma=0.1, batch=72))),
    "ribs-moves": Row("pyribs: genetic emitter, our moves", _in_ribs(_ribs_moves)),
    "evosax": Row(
        "evosax: SNES on logits, with restarts", _in_jax(partial(_evosax, population=16, restart=100, std=3.0))
    ),
}
"""The rows by their names on the command line."""
