"""Rows of the tasks of two descriptors, by track: loops on fixed operators, and further loops of the open track.

All rows of a track of fixed operators have the same operators, so they differ in what they keep and whom they choose.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float32, Int32, Key
from numpy.typing import NDArray

from elitelanes_jax.benchmark import OperatorSet, find_operators
from elitelanes_jax.optimizers import PRESETS, Info, Optimizer, evaluate, make_optimizer, truncate
from elitelanes_jax.optimizers.interop import ribs_archive_space
from elitelanes_jax.problem import Population, Problem, insert
from experiments.common import Untyped
from experiments.search.board_rows import ROWS, Decode, Row, in_jax, in_ribs, make_qdax, ribs_on_logits

__all__ = ["CITATIONS", "TRACK_ROWS", "dominated_novelty"]

_BATCH, _POPULATION, _NEIGHBOURS = 100, 200, 3


class _State(NamedTuple):
    """What a loop selects parents from, and the best grid of each niche, which it does not see."""

    population: Population
    record: Population


def _loop(
    problem: Problem,
    operators: str,
    start: Callable[[Population], Population],
    choose: Callable[[Key[Array, ""], Population], Int32[Array, " B"]] | None,
    survive: Callable[[Population, Population], Population],
) -> Optimizer:
    """Makes a loop on a set of operators.

    Args:
      problem: that evaluates.
      operators: the name of the set.
      start: from the first batch to a population.
      choose: draws the indices of parents; None draws new grids instead of mutating.
      survive: from a population and its offspring to the next population.
    """
    kit = find_operators(operators, problem.shape, fill=problem.fill)

    def note(record: Population, offspring: Population) -> Population:
        return insert(record, problem.niche(offspring.features), offspring)

    def init(key: Key[Array, ""]) -> _State:
        first = evaluate(problem, kit.random(key, _BATCH))
        return _State(start(first), note(problem.empty_archive(), first))

    def step(key: Key[Array, ""], state: _State) -> tuple[_State, Info]:
        drawn, changed = jax.random.split(key)
        if choose is None:
            grids = kit.random(drawn, _BATCH)
        else:
            grids = kit.mutate(state.population.grids[choose(drawn, state.population)], changed)
        offspring = evaluate(problem, grids)
        record = note(state.record, offspring)
        filled = record.valid.sum(dtype=jnp.int32)
        return _State(survive(state.population, offspring), record), Info(record.fitness.min(), filled)

    return Optimizer(init, step, lambda state: state.record, _BATCH)


def _uniform(key: Key[Array, ""], population: Population) -> Int32[Array, " B"]:
    """Draws parents, each individual equally often."""
    return jax.random.categorical(key, jnp.where(population.valid, 0.0, -jnp.inf), shape=(_BATCH,))


def _random(problem: Problem, *, operators: str) -> Optimizer:
    return _loop(problem, operators, lambda first: first, None, lambda population, offspring: offspring)


def _elites(problem: Problem, *, operators: str) -> Optimizer:
    """Makes MAP-Elites (Mouret and Clune, 2015)."""

    def survive(archive: Population, offspring: Population) -> Population:
        return insert(archive, problem.niche(offspring.features), offspring)

    return _loop(problem, operators, lambda first: survive(problem.empty_archive(), first), _uniform, survive)


def _genetic(problem: Problem, *, operators: str) -> Optimizer:
    """Makes a (100 + 100) evolutionary algorithm without niches."""

    def survive(population: Population, offspring: Population) -> Population:
        return truncate(population, offspring, count=_BATCH)

    return _loop(problem, operators, lambda first: first, _uniform, survive)


def dominated_novelty(
    fitness: Float32[Array, " N"], descriptors: Float32[Array, "N D"], valid: Bool[Array, " N"]
) -> Float32[Array, " N"]:
    """Computes the competition fitness of Dominated Novelty Search (Bahlous-Boldi et al., arXiv 2502.00593).

    It is the mean distance to the three nearest individuals that are strictly fitter; infinite for the fittest, and
    minus infinity for invalid individuals. A lower `fitness` is fitter.
    """
    fitter = valid & (fitness < fitness[:, None])
    distances = jnp.sqrt(((descriptors[:, None] - descriptors) ** 2).sum(axis=-1))
    nearest = -jax.lax.top_k(-jnp.where(fitter, distances, jnp.inf), _NEIGHBOURS)[0]
    known = jnp.isfinite(nearest)
    mean = jnp.where(known, nearest, 0).sum(axis=-1) / known.sum(axis=-1)
    return jnp.where(valid, jnp.where(known.any(axis=-1), mean, jnp.inf), -jnp.inf)


def _novelty(problem: Problem, *, operators: str) -> Optimizer:
    """Makes Dominated Novelty Search with a population of 200."""

    def survive(population: Population, offspring: Population) -> Population:
        both = jax.tree.map(lambda one, other: jnp.concatenate([one, other]), population, offspring)
        # The descriptors of the task; the third axis only separates flawed grids in archives.
        descriptors = problem.descriptor(both.features)[:, :2].astype(jnp.float32)
        scores = dominated_novelty(both.fitness.astype(jnp.float32), descriptors, both.valid)
        best = jnp.argsort(-scores, stable=True)[:_POPULATION]
        return jax.tree.map(lambda values: values[best], both)

    def start(first: Population) -> Population:
        # The second half is vacant, and offspring replace it.
        vacant = jax.tree.map(lambda values: values[:_BATCH], problem.empty_archive())
        return jax.tree.map(lambda one, other: jnp.concatenate([one, other]), first, vacant)

    return _loop(problem, operators, start, _uniform, survive)


def _qdax(problem: Problem, *, operators: str) -> Optimizer:
    kit = find_operators(operators, problem.shape, fill=problem.fill)
    # QDax asks for a variation too, and draws none at a share of 0.
    vary = (kit.mutate, lambda grids, mates, key: grids)
    return make_qdax(problem, kit.random, lambda grids: grids, vary, _BATCH, 0.0)


@cache
def _kit(problem: Problem, operators: str) -> OperatorSet:
    """Compiles a set of operators once for all seeds."""
    kit = find_operators(operators, problem.shape, fill=problem.fill)
    return OperatorSet(jax.jit(kit.random, static_argnums=1), jax.jit(kit.mutate))


def _ribs(problem: Problem, seed: int, *, operators: str) -> tuple[Untyped, Decode]:
    """Makes the archive and the scheduler of pyribs, with an emitter on a set of operators."""
    from ribs.archives import GridArchive
    from ribs.emitters import GeneticAlgorithmEmitter
    from ribs.schedulers import Scheduler

    kit, draws = _kit(problem, operators), np.random.default_rng(seed)

    def draw_key() -> Key[Array, ""]:
        return jax.random.key(int(draws.integers(2**31)))

    def as_grids(solutions: NDArray[np.floating]) -> NDArray[np.int8]:
        return solutions.reshape(-1, *problem.shape).astype(np.int8)

    class OperatorEmitter(GeneticAlgorithmEmitter):  # it takes its operators by name, not a function
        def ask(self) -> NDArray[np.floating]:
            if self.archive.empty:
                return self.initial_solutions
            parents = as_grids(self.archive.sample_elites(_BATCH)["solution"])
            return np.asarray(kit.mutate(jnp.asarray(parents), draw_key())).reshape(_BATCH, -1)

    archive = GridArchive(**ribs_archive_space(problem), seed=seed)
    start = np.asarray(kit.random(draw_key(), _BATCH)).reshape(_BATCH, -1)
    settings = {"operator": "gaussian", "operator_kwargs": {"sigma": 1}, "initial_solutions": start, "seed": seed}
    return Scheduler(archive, [OperatorEmitter(archive, **settings)]), as_grids


def _bandit(problem: Problem, seed: int) -> tuple[Untyped, Decode]:
    """Makes the bandit scheduler of pyribs: five of fifteen emitters of CMA-ME at a time, with three step sizes."""
    from ribs.schedulers import BanditScheduler

    pools = [
        ribs_on_logits(problem, 3 * seed + index, {}, {"ranker": "2imp", "sigma0": sigma, "batch_size": 20})
        for index, sigma in enumerate((0.1, 0.5, 2.0))
    ]
    archive, decode = pools[0][0].archive, pools[0][1]
    for scheduler, _ in pools[1:]:
        for emitter in scheduler.emitters:
            # All emitters share the first archive.
            emitter._archive = archive
    emitters = [emitter for scheduler, _ in pools for emitter in scheduler.emitters]
    return BanditScheduler(archive, emitters, num_active=5, reselect="terminated"), decode


def _preset(problem: Problem, *, method: str) -> Optimizer:
    """Makes a tuned method without niches, with a record of the grids that its chains move to."""
    base = make_optimizer(problem, PRESETS[method, "tuned"])

    def note(record: Population, state: Untyped) -> Population:
        return insert(record, problem.niche(state.chains.features), state.chains)

    def init(key: Key[Array, ""]) -> Untyped:
        state = base.init(key)
        return state, note(problem.empty_archive(), state)

    def step(key: Key[Array, ""], carried: Untyped) -> tuple[Untyped, Info]:
        state, info = base.step(key, carried[0])
        return (state, note(carried[1], state)), info

    return Optimizer(init, step, lambda carried: carried[1], base.evaluations_per_step)


def _fixed(operators: str) -> dict[str, Row]:
    return {
        "random": Row("random search", in_jax(partial(_random, operators=operators))),
        "genetic": Row("evolutionary algorithm, no niches", in_jax(partial(_genetic, operators=operators))),
        "map-elites": Row("MAP-Elites", in_jax(partial(_elites, operators=operators))),
        "qdax": Row("QDax: MAP-Elites", in_jax(partial(_qdax, operators=operators))),
        "dns": Row("Dominated Novelty Search", in_jax(partial(_novelty, operators=operators))),
        "ribs": Row("pyribs: MAP-Elites", in_ribs(partial(_ribs, operators=operators))),
    }


TRACK_ROWS = {
    "open": {
        "random": Row("random search", in_jax(partial(_random, operators="moves"))),
        **{name: ROWS[name] for name in ("paper", "standard", "tuned", "ea")},
        "dns": Row("Dominated Novelty Search, our moves", in_jax(partial(_novelty, operators="moves"))),
        "pso": Row("PSO, `tuned`", in_jax(partial(_preset, method="pso"))),
        "gwo": Row("GWO, `tuned`", in_jax(partial(_preset, method="gwo"))),
        **{name: ROWS[name] for name in ("qdax-moves", "qdax-line", "ribs-moves", "ribs-cma", "ribs-cma-mae")},
        "ribs-bandit": Row("pyribs: bandit of CMA-ME emitters on logits", in_ribs(_bandit)),
        "evosax": ROWS["evosax"],
    },
    **{operators: _fixed(operators) for operators in ("tiles", "links", "moves")},
}
"""The rows of each track by their names on the command line."""

_OURS = "this package"
_MOURET = "Mouret and Clune, [arXiv 1504.04909](https://arxiv.org/abs/1504.04909)"
_PYRIBS = "Tjanaka et al., [arXiv 2303.00191](https://arxiv.org/abs/2303.00191)"
_QDAX = "Chalumeau et al., [JMLR 25, 2024](https://www.jmlr.org/papers/v25/23-1027.html)"

CITATIONS = {
    "random": "none: the baseline of the track",
    "genetic": "Eiben and Smith, Introduction to Evolutionary Computing, 2015",
    "map-elites": _MOURET,
    "qdax": _QDAX,
    "dns": "Bahlous-Boldi et al., [arXiv 2502.00593](https://arxiv.org/abs/2502.00593)",
    "ribs": _PYRIBS,
    **dict.fromkeys(("paper", "standard", "tuned", "ea", "pso", "gwo"), _OURS),
    **dict.fromkeys(("qdax-moves", "qdax-line"), _QDAX),
    "ribs-moves": _PYRIBS,
    "ribs-cma": "Fontaine et al., [arXiv 1912.02400](https://arxiv.org/abs/1912.02400)",
    "ribs-cma-mae": "Fontaine and Nikolaidis, [arXiv 2205.10752](https://arxiv.org/abs/2205.10752)",
    "ribs-bandit": "Cully, [arXiv 2007.05352](https://arxiv.org/abs/2007.05352)",
    "evosax": "Lange, [arXiv 2212.04180](https://arxiv.org/abs/2212.04180)",
}
"""The publication of each row."""
