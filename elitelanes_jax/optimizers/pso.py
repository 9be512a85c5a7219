"""Particle swarm optimisation over tile probabilities (paper, section "Particle Swarm Optimization").

A particle has a position and a velocity for every tile and every code that the tile may take. Tiles are drawn from the
softmax of the velocities, and the grid is repaired. Positions and velocities are fixed-point numbers: sums and products
of whole numbers are the same bit for bit on every machine and in every batch, those of floats are not.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.draws import UNIT, categorical, random_halves, random_words
from elitelanes_jax.evolution import Population, evaluated, taken
from elitelanes_jax.fixed_point import either_way, part, units
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer, all_of
from elitelanes_jax.problem import Problem

__all__ = ["PsoConfig", "PsoState", "pso"]

# Differences of positions and positions themselves are held within these; products then fit 32 bits. In the paper's
# settings no difference comes near.
_FARTHEST_PULL, _FARTHEST = 32 * UNIT, 2**29


class PsoConfig(NamedTuple):
    """Settings; the defaults are the preset `paper`.

    Attributes:
      particles: how many, and how many grids a step evaluates.
      inertia: w, what remains of a velocity, 0 to 3.
      cognitive: c1, the pull towards a particle's own best position, 0 to 3.
      social: c2, the pull towards the best position of all, 0 to 3.
      fastest: the largest velocity, either way, 0 to 16.
      start: velocities start between minus this and this, 0 to 16.
    """

    particles: int = 40
    inertia: Numeric = 0.7
    cognitive: Numeric = 1.5
    social: Numeric = 1.5
    fastest: Numeric = 4.0
    start: Numeric = 0.1

    def checked(self) -> "PsoConfig":
        """The settings with real numbers as floats.

        Raises:
          InputError: for a setting out of its range.
        """
        limits = {"inertia": 3, "cognitive": 3, "social": 3, "fastest": 16, "start": 16}
        check_count("config", "particles", self.particles)
        return self._replace(
            **{name: check_real("config", name, getattr(self, name), 0, most) for name, most in limits.items()}
        )


class PsoState(NamedTuple):
    """What is carried from step to step.

    Attributes:
      position: int32 ``[P, K, H, W]``, of the particles, for each of K codes, in units of 1 / `UNIT`.
      velocity: likewise.
      best_position: likewise, where each particle was when it found its best grid.
      best: those grids and what they are worth, in the particles' order.
    """

    position: Array
    velocity: Array
    best_position: Array
    best: Population


def pso(problem: Problem, config: PsoConfig = PsoConfig()) -> Optimizer:  # noqa: B008
    """Particle swarm optimisation; its elites are the particles' best grids.

    Args:
      problem: with a shape, an alphabet and a fitness.
      config: the defaults are the preset `paper`.

    Raises:
      InputError: for a setting out of its range.
    """
    config = config.checked()
    codes = jnp.array(problem.alphabet, jnp.int8)
    shape = (config.particles, codes.size, *problem.shape)
    inertia, cognitive, social, fastest, spread = (units(value) for value in config[1:])

    def draw(key: PRNGKey, velocity: Array) -> Population:
        words = random_words(key, (config.particles, *problem.shape))
        drawn = codes[jax.vmap(categorical)(words, velocity)]
        return evaluated(problem, jax.vmap(problem.settle)(drawn))

    def init(key: PRNGKey) -> PsoState:
        first, second = jax.random.split(key)
        velocity = part(either_way(first, shape), spread)
        position = jnp.zeros(shape, jnp.int32)
        return PsoState(position, velocity, position, draw(second, velocity))

    def step(key: PRNGKey, state: PsoState) -> tuple[PsoState, Info]:
        first, second = jax.random.split(key)
        position, velocity, best_position, best = state
        luck = random_halves(first, (2, config.particles, 1, 1, 1)) // 16

        def pull(strength: Array, target: Array) -> Array:
            return part(jnp.clip(target - position, -_FARTHEST_PULL, _FARTHEST_PULL), strength)

        velocity = (
            part(velocity, inertia)
            + pull(part(luck[0], cognitive), best_position)
            + pull(part(luck[1], social), best_position[jnp.argmin(best.fitness)])
        )
        velocity = jnp.clip(velocity, -fastest, fastest)
        position = jnp.clip(position + velocity, -_FARTHEST, _FARTHEST)
        found = draw(second, velocity)

        better = found.fitness < best.fitness
        best_position = jnp.where(better[:, None, None, None], position, best_position)
        best = taken(better, found, best)
        info = Info(best_fitness=best.fitness.min(), elite_count=jnp.int32(config.particles))
        return PsoState(position, velocity, best_position, best), info

    def elites(state: PsoState) -> Elites:
        return all_of(state.best)

    return Optimizer(init, step, elites, evaluations_per_step=config.particles)
