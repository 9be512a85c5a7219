"""Particle swarm optimisation over tile probabilities.

The method is that of the paper's section "Particle Swarm Optimization". A particle has a position
and a velocity for every tile and every code that the tile may have. Tiles are drawn from the
softmax of the velocities, and the grid is repaired. Positions and velocities are fixed-point
numbers: unlike those of floats, sums and products of whole numbers are the same on every machine
and in every batch.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int32, Real

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import real, whole
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.records import Record, static, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import (
    categorical,
    random_bits,
    random_bits16,
    split,
    symmetric_uniform,
)
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.xla import UNIT, multiply, to_fixed
from elitelanes_jax.optimizers._population import evaluate, select
from elitelanes_jax.optimizers.base import Info, Optimizer, check_arguments, count_refused
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.problem import Problem

# Differences of positions, and positions, are limited to these numbers, so that products fit int32.
# The paper's settings stay far below.
_FARTHEST_PULL, _FARTHEST = 32 * UNIT, 2**29


@pytree
@dataclass(frozen=True)
class PsoConfig(Record):
    """Options of particle swarm optimisation; the defaults are the preset `paper`.

    A pytree: `jax.vmap` may map over all options except `particles`.

    Attributes:
      particles: the number of particles, and of grids that a step evaluates; static, a size of
        arrays.
      inertia: w, the part of a velocity that a step keeps, 0 to 3.
      cognitive: c1, the pull towards a particle's own best position, 0 to 3.
      social: c2, the pull towards the best position of all particles, 0 to 3.
      fastest: the largest velocity, in size, 0 to 16.
      start: the largest velocity of the first step, in size, 0 to 16.
    """

    particles: int = static(40, whole(1))
    inertia: Real[ArrayLike, "..."] = traced(0.7, real(0, 3))
    cognitive: Real[ArrayLike, "..."] = traced(1.5, real(0, 3))
    social: Real[ArrayLike, "..."] = traced(1.5, real(0, 3))
    fastest: Real[ArrayLike, "..."] = traced(4.0, real(0, 16))
    start: Real[ArrayLike, "..."] = traced(0.1, real(0, 16))


class PsoState(NamedTuple):
    """The state of the particles.

    Attributes:
      position: the position of each particle for each of K codes, in units of 1 / UNIT.
      velocity: the velocity in the same units.
      best_position: the position when each particle found its best grid.
      best: the best grid of each particle.
    """

    position: Int32[Array, "P K H W"]
    velocity: Int32[Array, "P K H W"]
    best_position: Int32[Array, "P K H W"]
    best: Population


@name_wrong_arguments
@runs_jax
def pso(problem: Problem, config: PsoConfig = PsoConfig()) -> Optimizer:
    """Makes particle swarm optimisation of a problem; its elites are the particles' best grids.

    The default configuration is the preset `paper`. Raises `InputError` for a problem with initial
    grids: a particle is a distribution, so a run cannot start from grids.
    """
    check_arguments(problem, config, PsoConfig)
    if problem.initial is not None and len(problem.initial):
        raise InputError(
            "initial",
            "none with the paper's PSO, whose particles are no grids",
            pluralize(len(problem.initial), "grid"),
        )
    codes = jnp.array(problem.alphabet, jnp.int8)
    shape = (config.particles, codes.size, *problem.shape)
    inertia, cognitive, social = (
        to_fixed(config.inertia),
        to_fixed(config.cognitive),
        to_fixed(config.social),
    )
    fastest, spread = to_fixed(config.fastest), to_fixed(config.start)

    def draw(key: Array, velocity: Array) -> Population:
        bits = random_bits(key, (config.particles, *problem.shape))
        drawn = codes[jax.vmap(categorical)(bits, velocity)]
        return evaluate(problem, jax.vmap(problem.repair_raster)(drawn))

    def init(key: Array) -> PsoState:
        first, second = split(key)
        velocity = multiply(symmetric_uniform(first, shape), spread)
        position = jnp.zeros(shape, jnp.int32)
        return PsoState(position, velocity, position, draw(second, velocity))

    def step(key: Array, state: PsoState) -> tuple[PsoState, Info]:
        first, second = split(key)
        position, velocity, best_position, best = state
        # Each pull of a particle has one random number in [0, 1), in units of 1 / `UNIT`.
        luck = random_bits16(first, (2, config.particles, 1, 1, 1)) // 16

        def pull(strength: Array, towards: Array) -> Array:
            return multiply(jnp.clip(towards - position, -_FARTHEST_PULL, _FARTHEST_PULL), strength)

        velocity = (
            multiply(velocity, inertia)
            + pull(multiply(luck[0], cognitive), best_position)
            + pull(multiply(luck[1], social), best_position[jnp.argmin(best.fitness)][None])
        )
        velocity = jnp.clip(velocity, -fastest, fastest)
        position = jnp.clip(position + velocity, -_FARTHEST, _FARTHEST)
        children = draw(second, velocity)

        # Of equally good grids a particle keeps the earlier one.
        better = children.fitness < best.fitness
        best_position = jnp.where(better[:, None, None, None], position, best_position)
        best = select(better, children, best)
        info = Info(best.fitness.min(), best.valid.sum(dtype=jnp.int32), count_refused(children))
        return PsoState(position, velocity, best_position, best), info

    return Optimizer.of(init, step, lambda state: state.best, evaluations_per_step=config.particles)
