"""The tuned EA, PSO and GWO: annealed chains on islands.

The methods differ in the mates whose blocks a chain copies.

In the EA a chain is a parent with one offspring a step, and its mate is any grid of its island. The
swarms move through the space of networks instead of a space of real numbers: a pull towards a good
position copies a block of that grid. A particle moves by itself with any other move. Clerc,
"Discrete particle swarm optimization", 2004, does so with permutations. Grids are not sampled, so
that a grid near an optimum can come nearer.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Int8, Real

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import real, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record, nested, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.optimizers._annealing import (
    AnnealingConfig,
    Cooling,
    StepBits,
    island_mates,
    metropolis_accepts,
    problem_move,
    random_grid,
)
from elitelanes_jax.optimizers._population import evaluate, select
from elitelanes_jax.optimizers.base import Info, Optimizer, check_arguments, count_refused
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.problem import Problem


@pytree
@dataclass(frozen=True)
class AnnealedPsoConfig(Record):
    """Options of the tuned PSO; the defaults are its preset `tuned`.

    A pytree: `jax.vmap` may map over the numbers.

    Attributes:
      annealing: options of the particles; each knows the particles of its island.
      cognitive: probability that a particle is pulled towards its own best position.
      social: probability that it is pulled towards the best position of its island. Otherwise it
        moves by itself.
    """

    annealing: AnnealingConfig = nested(AnnealingConfig())
    cognitive: Real[ArrayLike, "..."] = traced(0.3, real(0, 1))
    social: Real[ArrayLike, "..."] = traced(0.3, real(0, 1))

    def check_together(self) -> None:
        """Checks that the sum of the probabilities is at most 1."""
        one, other = self.cognitive, self.social
        if isinstance(one, float) and isinstance(other, float) and one + other > 1:
            raise InputError("social", "cognitive + social to be at most 1", f"{one:g} + {other:g}")


@pytree
@dataclass(frozen=True)
class AnnealedGwoConfig(Record):
    """Options of the tuned GWO; the defaults are its preset `tuned`.

    A pytree: `jax.vmap` may map over the numbers.

    Attributes:
      annealing: options of the wolves; each island is a pack.
      leaders: the number of best positions that lead a pack: alpha, beta and so on; at most the
        whole pack.
    """

    annealing: AnnealingConfig = nested(AnnealingConfig())
    leaders: Int[ArrayLike, "..."] = traced(3, whole(1))


class AnnealedState(NamedTuple):
    """The state of all chains.

    Attributes:
      chains: the current grids.
      cycle_best: the best grid of each chain in this cycle.
      best: the best grid of each chain in all cycles.
      cooling: the step within the cycle.
    """

    chains: Population
    cycle_best: Population
    best: Population
    cooling: Cooling


_Mates = Callable[[StepBits, AnnealedState], Int8[Array, "C H W"]]


@name_wrong_arguments
@runs_jax
def annealed_ea(problem: Problem, config: AnnealingConfig = AnnealingConfig()) -> Optimizer:
    """Makes the tuned EA for a problem; its elites are the chains' best grids.

    The default is preset `tuned`.
    """
    check_arguments(problem, config, AnnealingConfig)

    def mates(bits: StepBits, state: AnnealedState) -> Array:
        return island_mates(bits.mate, state.chains.grids, config.chains_on(problem.shape))

    return _make_optimizer(problem, config, mates)


@name_wrong_arguments
@runs_jax
def annealed_pso(problem: Problem, config: AnnealedPsoConfig = AnnealedPsoConfig()) -> Optimizer:
    """Makes the tuned PSO for a problem; its elites are the particles' best grids.

    The default is preset `tuned`.
    """
    check_arguments(problem, config, AnnealedPsoConfig)
    each = config.annealing.chains_on(problem.shape)

    def mates(bits: StepBits, state: AnnealedState) -> Array:
        known = state.cycle_best
        # This is the index of the best grid of each island.
        best = (
            jnp.argmin(known.fitness.reshape(-1, each), axis=1)
            + np.arange(known.fitness.size // each) * each
        )
        # One number draws the pull. Below the first limit it is the particle's own best grid, and
        # below the second one the best grid of its island. Without a pull a particle is its own
        # mate, so a copied block comes from its own grid.
        by_itself = bernoulli(bits.mate, config.cognitive)[:, None, None]
        pulled = bernoulli(bits.mate, config.cognitive + config.social)[:, None, None]
        mates = jnp.where(by_itself, known.grids, jnp.repeat(known.grids[best], each, axis=0))
        return jnp.where(pulled, mates, state.chains.grids)

    return _make_optimizer(problem, config.annealing, mates)


@name_wrong_arguments
@runs_jax
def annealed_gwo(problem: Problem, config: AnnealedGwoConfig = AnnealedGwoConfig()) -> Optimizer:
    """Makes the tuned GWO for a problem; its elites are the wolves' best grids.

    The default is preset `tuned`.
    """
    check_arguments(problem, config, AnnealedGwoConfig)
    each = config.annealing.chains_on(problem.shape)

    def mates(bits: StepBits, state: AnnealedState) -> Array:
        known = state.cycle_best
        # Each wolf follows one of the best positions of its pack, each equally likely.
        ranking = jnp.argsort(known.fitness.reshape(-1, each), axis=1, stable=True)
        pack = np.arange(known.fitness.size) // each
        return known.grids[
            ranking[pack, randint(bits.mate, jnp.minimum(config.leaders, each))] + pack * each
        ]

    return _make_optimizer(problem, config.annealing, mates)


def _make_optimizer(problem: Problem, config: AnnealingConfig, mates: _Mates) -> Optimizer:
    count = config.population
    move = problem_move(problem, config.moves)

    def init(key: Array) -> AnnealedState:
        chains = evaluate(problem, problem.random(key, count))
        return AnnealedState(chains, chains, chains, Cooling.first(config, problem.shape))

    def step(key: Array, state: AnnealedState) -> tuple[AnnealedState, Info]:
        chains, cycle_best, best, cooling = state
        bits = StepBits.draw(key, count, move)
        # All chains begin a cycle in the same step. Then their children are random grids, which
        # replace them whatever their fitness.
        restart = cooling.begins

        def make_child(grid: Array, mate: Array, fresh: Array, move_bits: Array) -> Array:
            varied = move.apply(move_bits, grid, mate)
            new = random_grid(problem, fresh)
            return problem.repair(
                jnp.where(restart, new, varied.grid), varied.dirty, raster=restart
            )

        grids = jax.vmap(make_child)(chains.grids, mates(bits, state), bits.fresh, bits.move)
        children = evaluate(problem, grids)
        temperature = cooling.temperature(config.hottest, config.coldest, problem.shape)
        accepted = metropolis_accepts(bits.accept, temperature, chains.fitness, children.fitness)
        chains = select(restart | accepted, children, chains)
        # A cycle that begins forgets the best grids of the cycle before. The chains' best grids of
        # all cycles are the elites.
        cycle_best = select(restart | (children.fitness < cycle_best.fitness), children, cycle_best)
        best = select(children.fitness < best.fitness, children, best)
        info = Info(best.fitness.min(), best.valid.sum(dtype=jnp.int32), count_refused(children))
        return AnnealedState(chains, cycle_best, best, cooling.after(grows=True)), info

    return Optimizer.of(init, step, lambda state: state.best, evaluations_per_step=count)
