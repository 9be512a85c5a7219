"""Populations, and the evolutionary loop: parents by tournament, mutation, repair, survivors by truncation.

The paper has one such loop, with and without an archive (section "Evolutionary Algorithm with MAP-Elites"). Lower
fitness is better, and every tie is decided: what came first wins.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Int8, Int32, Key, Real, UInt32

from elitelanes_jax._util.checks import one_of, real, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.pytrees import pytree, static, traced
from elitelanes_jax._util.records import Record
from elitelanes_jax.network.bits import randint
from elitelanes_jax.optimizers._mutations import Move
from elitelanes_jax.problem.problem import Problem

_Tree = TypeVar("_Tree")


@pytree
@dataclass(frozen=True)
class EvolutionConfig(Record):
    """Settings of the loop; the defaults are the paper's. A pytree: rates may be arrays, mapped by `jax.vmap`.

    Attributes:
      population: mu, the survivors of a generation; static, a size of arrays.
      offspring: lambda, the grids made and evaluated in a generation; static, a size of arrays.
      tournament: the number of competitors for a place as parent; static, a size of arrays.
      survivors: "plus" keeps the best of parents and offspring, "comma" the best of the offspring alone; static. The
        paper writes (mu, lambda), but selects from both.
      tile_rate: probability that an offspring has one tile changed.
      crossing_rate: probability that it has one tile replaced by a crossing.
    """

    population: int = static(20, whole(1))
    offspring: int = static(40, whole(1))
    tournament: int = static(3, whole(1))
    survivors: Literal["plus", "comma"] = static("plus", one_of("plus", "comma"))
    tile_rate: Real[ArrayLike, "..."] = traced(0.7, real(0, 1))
    crossing_rate: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))

    def check_together(self) -> None:
        """Checks that enough offspring are there to survive."""
        if self.survivors == "comma" and self.offspring < self.population:
            expected = f"at least the population, {self.population}, when survivors is 'comma'"
            raise InputError(f"offspring: expected {expected}, got {self.offspring}")


class Population(NamedTuple):
    """Grids and their evaluation.

    Attributes:
      grids: int8 ``[P, H, W]``.
      fitness: int32 ``[P]``.
      counts: int32 ``[P, M]``, the metrics as `stack_counts` orders them.
    """

    grids: Int8[Array, "P H W"]
    fitness: Int32[Array, " P"]
    counts: Int32[Array, "P M"]


def random_population(problem: Problem, key: Key[Array, ""], count: int) -> Population:
    """Makes random repaired grids, sorted, best first."""
    return truncate(evaluate(problem, problem.random(key, count)), count=count)


def tournament(bits: UInt32[Array, "count size"], population: Population) -> Int8[Array, "count H W"]:
    """Chooses parents from a sorted population: each the best of those drawn for it.

    Args:
      bits: uint32 ``[count, size]``, random bits for each competitor, drawn with replacement.
      population: sorted, best first.
    """
    drawn = randint(bits, population.fitness.size)
    return population.grids[drawn.min(axis=1)]


def breed(problem: Problem, mutation: Move, bits: UInt32[Array, "P bits"], parents: Int8[Array, "P H W"]) -> Population:
    """Makes one mutated, repaired and evaluated offspring of each parent, in their order.

    Args:
      problem: that repairs and evaluates.
      mutation: the move that makes an offspring.
      bits: uint32 ``[P, mutation.bits]``.
      parents: int8 ``[P, H, W]``.
    """

    def offspring(bits: Array, parent: Array) -> Array:
        return problem.repair(*mutation.apply(bits, parent))

    return evaluate(problem, jax.vmap(offspring)(bits, parents))


def survivors(config: EvolutionConfig, parents: Population, offspring: Population) -> Population:
    """Returns the next population, sorted, best first; among equals parents first, then the earlier offspring."""
    both = (offspring,) if config.survivors == "comma" else (parents, offspring)
    return truncate(*both, count=config.population)


def evaluate(problem: Problem, grids: Int8[Array, "P H W"]) -> Population:
    """Evaluates grids; they keep their order."""
    return Population(grids, *problem.evaluate(grids))


def select(which: Bool[Array, " P"], new: _Tree, old: _Tree) -> _Tree:
    """Takes of two records of arrays ``[P, ...]`` the new row of each place where `which` is True, else the old one."""
    return jax.tree.map(lambda a, b: jnp.where(which.reshape(-1, *(1,) * (a.ndim - 1)), a, b), new, old)


def concatenate(*populations: Population) -> Population:
    """Puts several populations one after another."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *populations)


def truncate(*populations: Population, count: int) -> Population:
    """Keeps the best of several populations, sorted, best first; among equals what came first is first."""
    everyone = concatenate(*populations)
    order = jnp.argsort(everyone.fitness, stable=True)[:count]
    return jax.tree.map(lambda array: array[order], everyone)
