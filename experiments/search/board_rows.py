"""The rows of the board: searches as loops of their own libraries over our evaluation.

A loop in JAX is an `Optimizer`, so that `evolve` runs all seeds side by side. pyribs runs one seed after another.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32, Key
from numpy.typing import NDArray

from elitelanes_jax import InputError, evolve, measure
from elitelanes_jax.benchmark import Task
from elitelanes_jax.optimizers import (
    PRESETS,
    AnnealedMapElitesConfig,
    Info,
    MoveWeights,
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
from elitelanes_jax.problem import Axis, Population, Problem, insert, road_problem
from elitelanes_jax.search import MeasuredElites
from experiments.common import Pytree, Untyped

__all__ = ["ROWS", "TUNED", "Row", "Setting", "in_jax", "in_ribs", "make_qdax", "make_space", "ribs_on_logits"]


Decode = Callable[[NDArray[np.floating]], Array | NDArray[np.int8]]
"""From the solutions of pyribs to grids."""

Play = Callable[[Task, range, Sequence[int]], NDArray[np.int8]]
"""(task, R seeds, T budgets) -> the elites of each run after each budget ``[R, T, N, H, W]``; vacant grids are zero."""

Setting = str | int | float


class Row(NamedTuple):
    """One row.

    Attributes:
      title: its name in the table.
      play: runs it.
    """

    title: str
    play: Play


def _grids(archives: Sequence[Population | MeasuredElites]) -> NDArray[np.int8]:
    """Returns the elites of the archives ``[R, N]`` of each budget."""
    of_budgets = [np.where(np.asarray(archive.valid)[..., None, None], archive.grids, 0) for archive in archives]
    return np.stack(of_budgets, axis=1).astype(np.int8)


def count_flaws(grid: Int8[Array, "H W"]) -> Int32[Array, ""]:
    """Counts the flaws of a grid in a task of two descriptors that fills no cells."""
    found = measure(grid)
    at_cells = found.dead_ends + found.boundary_violations + found.mismatches + found.bridges
    return at_cells + found.adjacent_crossings + found.adjacent_turns + abs(found.components - 1)


def make_space(task: Task) -> dict[str, Untyped]:
    """Returns the axes of the archives, and the features of them: options of `road_problem` and `evolve`.

    With two descriptors each niche has an elite without flaws and one with flaws, a stepping stone.
    """
    if task.tiles is None:
        return {"axes": road_problem(task.shape, "tuned").axes}
    most = task.niches.max(axis=0).tolist()
    axes = [Axis(name, 1 + last, 1) for name, last in zip(("cyclomatic", task.tiles), most, strict=True)]
    return {"axes": (*axes, Axis("flaws", 2, 1, target=0)), "features": {"flaws": count_flaws}}


def in_jax(make: Callable[[Problem], Optimizer]) -> Play:
    """Runs a loop in JAX. `make` returns an optimiser for a problem; its first state is one batch."""

    def play(task: Task, seeds: range, budgets: Sequence[int]) -> NDArray[np.int8]:
        space = make_space(task)
        problem = road_problem(task.shape, fill=task.fill, **space)
        batch = make(problem).evaluations_per_step
        keys, state, done, archives = seed_keys(0, seeds.stop)[seeds.start :], None, 1, []
        # The first batch is evaluated as a whole, so that smaller budgets end with an empty archive.
        within = [budget for budget in budgets if budget >= batch]
        for budget in within:
            result = evolve(
                keys,
                task.shape,
                fill=task.fill,
                **space,
                optimizer=make,
                generations=budget // batch - done,
                state=state,
                progress=False,
            )
            state, done = result.state, budget // batch
            archives.append(result.elites)
        grids = _grids(archives)
        return np.pad(grids, [(0, 0), (len(budgets) - len(within), 0), *[(0, 0)] * 3])

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


def make_qdax(
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
        vacant = problem.empty_archive(found.fitness.dtype)
        return found._replace(fitness=jnp.where(filled, found.fitness, vacant.fitness))

    return Optimizer(init, step, elites, batch)


# Of the rows with our moves: grids a step, the share of them that take parts of a mate, and the weights of moves.
_BATCH, _CROSSED, _WEIGHTS = 16, 0.2, MoveWeights(fill_probability=0.0, refit=25)


def _qdax_moves(problem: Problem) -> Optimizer:
    """QDax's MAP-Elites with our moves: genotypes are grids."""
    vary = qdax_moves(problem, _WEIGHTS)
    return make_qdax(problem, problem.random, lambda grids: grids, vary, _BATCH, _CROSSED)


def _qdax_line(problem: Problem, *, batch: int, iso: float, line: float) -> Optimizer:
    """QDax's MAP-Elites with its own variation, Iso+LineDD, on logits."""
    from qdax.core.emitters.mutation_operators import isoline_variation

    task = evosax_task(problem)
    vary = partial(isoline_variation, iso_sigma=iso, line_sigma=line)
    return make_qdax(
        problem,
        lambda key, count: jax.vmap(task.sample)(jax.random.split(key, count)),
        jax.vmap(task.decode),
        (None, vary),
        batch,
        1.0,
    )


def _qdax_dns(
    problem: Problem, *, population: int, neighbours: int, batch: int, share: float, filling: float, refit: int
) -> Optimizer:
    """Makes QDax's Dominated Novelty Search with our moves. Its population has no niches, so a record has them."""
    try:
        from qdax.core.dns import DominatedNoveltySearch
    except ImportError:
        repository = "git+https://github.com/adaptive-intelligent-robotics/QDax"
        raise InputError("qdax-dns", "QDax 0.5.1 or later", f"an earlier one: pip install {repository}") from None
    from qdax.core.emitters.standard_emitters import MixingEmitter

    score = qdax_scoring_fn(problem)
    vary = qdax_moves(problem, MoveWeights(fill_probability=filling, refit=refit))
    emitter = MixingEmitter(*vary, variation_percentage=share, batch_size=batch)
    search = DominatedNoveltySearch(score, emitter, lambda repertoire: {}, population, neighbours)

    def note(record: Population, genotypes: Array) -> Population:
        offspring = evaluate(problem, genotypes)
        return insert(record, problem.niche(offspring.features), offspring)

    def init(key: Key[Array, ""]) -> Pytree:
        drawn, rest = jax.random.split(key)
        genotypes = problem.random(drawn, batch)
        repertoire, emitter_state, _ = search.init(genotypes, rest)
        return repertoire, emitter_state, note(problem.empty_archive(), genotypes)

    def step(key: Key[Array, ""], state: Pytree) -> tuple[Pytree, Info]:
        repertoire, emitter_state, record = state
        genotypes, extra = search.ask(repertoire, emitter_state, key)
        fitness, descriptors, scores = score(genotypes, key)
        told = search.tell(genotypes, fitness, descriptors, repertoire, emitter_state, scores, extra)
        record = note(record, genotypes)
        return (*told[:2], record), Info(record.fitness.min(), record.valid.sum(dtype=jnp.int32))

    return Optimizer(init, step, lambda state: state[2], batch)


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


def in_ribs(make: Callable[..., tuple[Untyped, Decode]]) -> Play:
    """Runs pyribs's loop. `make` returns, for a problem and a seed, a scheduler and what makes grids."""

    def play(task: Task, seeds: range, budgets: Sequence[int]) -> NDArray[np.int8]:
        problem = road_problem(task.shape, fill=task.fill, **make_space(task))
        of_runs = []

        @jax.jit
        def score(grids: Array, record: Population) -> tuple[Int32[Array, " B"], Int32[Array, "B D"], Population]:
            found: Population = evaluate(problem, grids)
            record = insert(record, problem.niche(found.features), found)
            return -found.fitness, problem.descriptor(found.features), record

        for seed in seeds:
            scheduler, decode = make(problem, seed)
            record, done, archives = problem.empty_archive(), 0, []
            solutions = scheduler.ask()
            for budget in budgets:
                while done + len(solutions) <= budget:
                    objective, measures, record = score(jnp.asarray(decode(solutions)), record)
                    scheduler.tell(np.asarray(objective, np.float64), np.asarray(measures, np.float64))
                    done += len(solutions)
                    solutions = scheduler.ask()
                archives.append(jax.tree.map(lambda array: array[None], record))
            of_runs.append(_grids(archives))
        return np.concatenate(of_runs)

    return play


def _ribs_cma(problem: Problem, seed: int, *, ranker: str, sigma: float, batch: int) -> tuple[Untyped, Decode]:
    """Makes CMA-ME of pyribs on logits."""
    return ribs_on_logits(problem, seed, {}, {"ranker": ranker, "sigma0": sigma, "batch_size": batch})


def _ribs_cma_mae(
    problem: Problem, seed: int, *, learning_rate: float, floor: int, sigma: float, batch: int
) -> tuple[Untyped, Decode]:
    """Makes CMA-MAE of pyribs on logits. The least objective of its archive is `floor` times the number of cells."""
    thresholds = {"learning_rate": learning_rate, "threshold_min": floor * prod(problem.shape)}
    rules = {"ranker": "imp", "selection_rule": "mu", "restart_rule": "basic"}
    return ribs_on_logits(problem, seed, thresholds, rules | {"sigma0": sigma, "batch_size": batch})


def ribs_on_logits(
    problem: Problem, seed: int, thresholds: dict[str, Untyped], emitter: dict[str, Untyped]
) -> tuple[Untyped, Decode]:
    """Makes five emitters of separable CMA-ES on logits, as in the tutorials of pyribs."""
    from ribs.archives import GridArchive
    from ribs.emitters import EvolutionStrategyEmitter
    from ribs.schedulers import Scheduler

    start, decode = _logits(problem)
    space = ribs_archive_space(problem) | {"solution_dim": len(start)}
    archive = GridArchive(**space, **thresholds, seed=seed)
    emitters = [
        EvolutionStrategyEmitter(archive, x0=start, es="sep_cma_es", seed=5 * seed + index, **emitter)
        for index in range(5)
    ]
    return Scheduler(archive, emitters), decode


@cache
def _logits(problem: Problem) -> tuple[NDArray[np.float64], Decode]:
    """Returns logits of 0, and the function from logits to grids, which is compiled once for all seeds."""
    task = evosax_task(problem)
    decode = jax.jit(jax.vmap(task.decode))
    return np.zeros(task.num_dims), lambda solutions: decode(solutions.astype(np.float32))


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


_MIX = {"filling": (0.0, 0.05, 0.1, 0.3), "refit": (0, 8, 25)}

TUNED: dict[str, tuple[Callable[..., Play], dict[str, tuple[Setting, ...]]]] = {
    "qdax-dns": (
        lambda **settings: in_jax(partial(_qdax_dns, **settings)),
        {
            "population": (50, 100, 200, 400),
            "neighbours": (1, 3, 5, 15),
            "batch": (16, 32, 64, 128),
            "share": (0.0, 0.2, 0.5, 0.8),
            **_MIX,
        },
    ),
    "ribs-cma-mae": (
        lambda **settings: in_ribs(partial(_ribs_cma_mae, **settings)),
        {
            "learning_rate": (0.001, 0.01, 0.1),
            "floor": (-300, -100, -30),
            "sigma": (0.1, 0.3, 1.0, 3.0),
            "batch": (12, 36, 72),
        },
    ),
}
"""Searches and the choices of their settings, for `experiments.search.tune`."""

# Settings of other libraries' rows are the best of eight trials each, on 6 x 6 alone: results/tuning.
ROWS = {
    **{
        preset: Row(f"MAP-Elites, `{preset}`", in_jax(partial(_preset, method="map-elites", preset=preset)))
        for preset in ("paper", "standard", "tuned")
    },
    "drawn": Row(
        "the same, no refitted strips, with the effort of the other libraries",
        in_jax(partial(_drawn, hottest=80, penalty=400, restart=0.0, filling=0.05, refit=25)),
    ),
    "ea": Row("EA with restarts, `tuned`", in_jax(_ea)),
    "qdax-moves": Row("QDax: MAP-Elites, our moves", in_jax(_qdax_moves)),
    "qdax-line": Row(
        "QDax: MAP-Elites, Iso+LineDD on logits", in_jax(partial(_qdax_line, batch=128, iso=0.3, line=0.2))
    ),
    "qdax-dns": Row(
        "QDax: Dominated Novelty Search, our moves",
        in_jax(partial(_qdax_dns, population=200, neighbours=1, batch=128, share=0.0, filling=0.1, refit=25)),
    ),
    "ribs-cma": Row("pyribs: CMA-ME on logits", in_ribs(partial(_ribs_cma, ranker="2imp", sigma=0.1, batch=72))),
    "ribs-cma-mae": Row(
        "pyribs: CMA-MAE on logits",
        in_ribs(partial(_ribs_cma_mae, learning_rate=0.01, floor=-30, sigma=1.0, batch=36)),
    ),
    "ribs-moves": Row("pyribs: genetic emitter, our moves", in_ribs(_ribs_moves)),
    "evosax": Row(
        "evosax: SNES on logits, with restarts", in_jax(partial(_evosax, population=16, restart=100, std=3.0))
    ),
}
"""The rows by their names on the command line."""
