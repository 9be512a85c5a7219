"""The evolutionary loop: parents by tournament, mutation, repair, survivors by truncation.

The paper has one such loop, with and without an archive (section "Evolutionary Algorithm with MAP-Elites"). Lower
fitness is better, and every tie is decided: what came first wins.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.draws import below
from elitelanes_jax.errors import InputError
from elitelanes_jax.problem import Problem
from elitelanes_jax.variation import Move

__all__ = [
    "EvolutionConfig",
    "Population",
    "breed",
    "evaluated",
    "joined",
    "merged",
    "random_population",
    "survivors",
    "taken",
    "tournament",
]


class EvolutionConfig(NamedTuple):
    """Settings of the loop; the defaults are the paper's.

    Attributes:
      population: mu, how many survive a generation.
      offspring: lambda, how many are made in one.
      tournament: how many compete to become a parent.
      survivors: "plus" keeps the best of parents and offspring, "comma" the best of the offspring alone. The paper
        writes (mu, lambda), but selects from both.
      tile_rate: probability that an offspring has one tile changed.
      crossing_rate: probability that it has one tile replaced by a crossing.
    """

    population: int = 20
    offspring: int = 40
    tournament: int = 3
    survivors: Literal["plus", "comma"] = "plus"
    tile_rate: Numeric = 0.7
    crossing_rate: Numeric = 0.5

    def checked(self) -> "EvolutionConfig":
        """The settings with rates as floats; a rate that is an array stays one: it may be swept.

        Raises:
          InputError: for a setting out of its range.
        """
        for name in ("population", "offspring", "tournament"):
            check_count("config", name, getattr(self, name))
        if self.survivors not in ("plus", "comma"):
            raise InputError(f"config: expected survivors to be 'plus' or 'comma', got {self.survivors!r}")
        if self.survivors == "comma" and self.offspring < self.population:
            raise InputError(
                f"config: expected at least as many offspring as the population of {self.population} "
                f"when survivors is 'comma', got {self.offspring}"
            )
        rates = {name: check_real("config", name, getattr(self, name), 0, 1) for name in ("tile_rate", "crossing_rate")}
        return self._replace(**rates)


class Population(NamedTuple):
    """Grids and what they are worth.

    Attributes:
      grids: int8 ``[P, H, W]``.
      fitness: int32 ``[P]``.
      counts: int32 ``[P, M]``, the `counts_of` metrics.
    """

    grids: Array
    fitness: Array
    counts: Array


def random_population(problem: Problem, key: PRNGKey, count: int) -> Population:
    """Random repaired grids, sorted, best first."""
    return merged(evaluated(problem, problem.random(key, count)), count=count)


def tournament(words: Array, population: Population) -> Array:
    """Parents, int8 ``[count, H, W]``, from a sorted population: each the best of those drawn for it.

    Args:
      words: uint32 ``[count, size]``, a random word for each that is drawn, with replacement.
      population: sorted, best first.
    """
    drawn = below(words, population.fitness.size)
    return population.grids[drawn.min(axis=1)]


def breed(problem: Problem, mutate: Move, words: Array, parents: Array) -> Population:
    """One mutated, repaired and evaluated offspring of each parent, in their order.

    Args:
      problem: that repairs and evaluates.
      mutate: the move that makes an offspring.
      words: uint32 ``[P, mutate.words]``.
      parents: int8 ``[P, H, W]``.
    """

    def offspring(words: Array, parent: Array) -> Array:
        return problem.repair(*mutate.apply(words, parent))

    return evaluated(problem, jax.vmap(offspring)(words, parents))


def survivors(config: EvolutionConfig, parents: Population, offspring: Population) -> Population:
    """The next population, sorted, best first; among equals parents first, then the earlier offspring."""
    both = (offspring,) if config.survivors == "comma" else (parents, offspring)
    return merged(*both, count=config.population)


def evaluated(problem: Problem, grids: Array) -> Population:
    """Grids int8 ``[P, H, W]`` and what they are worth, in their order."""
    evaluation = problem.evaluate(grids)
    return Population(grids, evaluation.fitness, evaluation.counts)


def taken(which: Array, new: Population, old: Population) -> Population:
    """At each place the new one where `which`, bool ``[P]``, says so, else the old one."""
    return jax.tree.map(lambda a, b: jnp.where(which.reshape(-1, *(1,) * (a.ndim - 1)), a, b), new, old)


def joined(*populations: Population) -> Population:
    """Several populations one after another."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *populations)


def merged(*populations: Population, count: int) -> Population:
    """The best of several populations, so many of them, sorted, best first; among equals what came first is first."""
    everyone = joined(*populations)
    order = jnp.argsort(everyone.fitness, stable=True)[:count]
    return jax.tree.map(lambda array: array[order], everyone)
