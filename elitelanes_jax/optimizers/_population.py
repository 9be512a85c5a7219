"""The evolutionary loop: parents by tournament, mutation, repair, survivors by truncation.

The paper uses it with and without an archive (section "Evolutionary Algorithm with MAP-Elites").
Lower fitness is better. Every tie is decided: the earlier grid wins.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int8, Integer, Key, Real, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, one_of, real, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record, static, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import randint, random_bits
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.optimizers._mutations import Move, paper_mutation
from elitelanes_jax.optimizers.base import Info, Optimizer, check_arguments, count_refused
from elitelanes_jax.problem.archive import Population, finite_or_vacant, vacant_fitness
from elitelanes_jax.problem.problem import Problem

_Tree = TypeVar("_Tree")


@pytree
@dataclass(frozen=True)
class EvolutionConfig(Record):
    """Options of the evolutionary loop; the defaults are the paper's.

    A pytree: `jax.vmap` may map over the rates.

    Attributes:
      population: mu, the number of survivors of a generation; static, a size of arrays.
      offspring: lambda, the number of grids that a generation makes and evaluates; static, a size
        of arrays.
      tournament: the number of competitors from which each parent is chosen; static, a size of
        arrays.
      survivors: "plus" keeps the best of parents and offspring, "comma" the best of the offspring
        alone; static. The paper writes (mu, lambda), but selects from both.
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
        """Checks that there are enough offspring to survive."""
        if self.survivors == "comma" and self.offspring < self.population:
            expected = f"at least the population, {self.population}, when survivors is 'comma'"
            raise InputError("offspring", expected, self.offspring)


@name_wrong_arguments
@runs_jax
def random_population(problem: Problem, key: Key[Array, ""], count: int) -> Population:
    """Returns a first population, sorted, best first; the key is consumed.

    Raises `InputError` for a count below 1.
    """
    check_named("count", whole(1), count)
    return truncate(evaluate(problem, problem.random(key, count)), count=count)


def tournament(
    bits: UInt32[Array, "count size"], population: Population
) -> Int8[Array, "count H W"]:
    """Chooses parents from a sorted population.

    Each parent is the best of its competitors, which are drawn with replacement.
    """
    # The population is sorted, so the best competitor has the lowest index.
    drawn = randint(bits, population.fitness.size)
    return population.grids[drawn.min(axis=1)]


def breed(
    problem: Problem, mutation: Move, bits: UInt32[Array, "P bits"], parents: Int8[Array, "P H W"]
) -> Population:
    """Returns one mutated, repaired and evaluated offspring of each parent, in the same order."""

    def offspring(bits: Array, parent: Array) -> Array:
        return problem.repair(*mutation.apply(bits, parent))

    return evaluate(problem, jax.vmap(offspring)(bits, parents))


def survivors(config: EvolutionConfig, parents: Population, offspring: Population) -> Population:
    """Returns the next population, sorted, best first.

    Among grids of equal fitness parents come first, then earlier offspring.
    """
    both = (offspring,) if config.survivors == "comma" else (parents, offspring)
    return truncate(*both, count=config.population)


@name_wrong_arguments
@runs_jax
def ea(problem: Problem, config: EvolutionConfig = EvolutionConfig()) -> Optimizer:
    """Makes an evolutionary algorithm for a problem.

    Its state is the `Population`, sorted, best first. The default configuration is the preset
    `paper`.
    """
    check_arguments(problem, config, EvolutionConfig)
    mutation = paper_mutation(problem.alphabet, config.tile_rate, config.crossing_rate)

    def init(key: Array) -> Population:
        return random_population(problem, key, config.population)

    def step(key: Array, state: Population) -> tuple[Population, Info]:
        # Each offspring has a row of bits: first those of its tournament, then those of its
        # mutation.
        bits = random_bits(key, (config.offspring, config.tournament + mutation.bits))
        parents = tournament(bits[:, : config.tournament], state)
        offspring = breed(problem, mutation, bits[:, config.tournament :], parents)
        state = survivors(config, state, offspring)
        return state, Info(
            state.fitness[0], state.valid.sum(dtype=jnp.int32), count_refused(offspring)
        )

    return Optimizer.of(init, step, lambda state: state, evaluations_per_step=config.offspring)


@name_wrong_arguments
@runs_jax
def evaluate(problem: Problem, grids: Int8[Array, "P H W"]) -> Population:
    """Evaluates grids, in their order.

    A fitness that is not finite becomes that of a vacant slot, and so does the fitness of a grid
    with a number that does not fit int32.

    Raises:
      InputError: if the problem's evaluation has other shapes or kinds of numbers than `Evaluation`
        says, or its repair other grids than those of the problem.
    """
    grids = check_array("grids", grids, ("P", *problem.shape), jnp.int8)
    evaluation = problem.evaluate(grids)
    is_pair = isinstance(evaluation, tuple | list) and len(evaluation) == 2
    if not is_pair or not all(hasattr(part, "dtype") for part in evaluation):
        pair = "a tuple of two arrays, fitness and features"
        raise InputError("evaluate", pair, quote(evaluation))
    fitness, features = evaluation
    expected = (len(grids),), (len(grids), len(problem.feature_names))
    got = fitness.shape, features.shape
    if expected != got:
        raise InputError("evaluate", f"fitness and features of shapes {expected}", got)
    is_number = jnp.issubdtype(fitness.dtype, jnp.number)
    is_complex = jnp.issubdtype(fitness.dtype, jnp.complexfloating)
    if not is_number or is_complex or not jnp.issubdtype(features.dtype, jnp.integer):
        raise InputError(
            "evaluate",
            "a fitness of real numbers and features of whole numbers",
            f"{fitness.dtype} and {features.dtype}",
        )
    # A number that does not fit int32 refuses its grid, because a conversion would change the
    # number.
    fits = _fits_int32(features).all(axis=1)
    if jnp.issubdtype(fitness.dtype, jnp.floating):
        fitness = finite_or_vacant(fitness.astype(jnp.float32))
    else:
        fits = fits & _fits_int32(fitness)
        fitness = fitness.astype(jnp.int32)
    if not isinstance(fits, np.ndarray):
        # The dtypes alone do not say that all numbers fit.
        fitness = jnp.where(fits, fitness, vacant_fitness(fitness.dtype))
    return Population(grids, fitness, features.astype(jnp.int32))


def _fits_int32(numbers: Integer[Array, "..."]) -> Bool[Array | np.ndarray, "..."]:
    """Returns which numbers fit int32, as an array of NumPy if the dtype alone says that all do."""
    largest = jnp.iinfo(jnp.int32).max
    if jnp.iinfo(numbers.dtype).max <= largest:
        return np.ones(numbers.shape, bool)
    if jnp.iinfo(numbers.dtype).min == 0:
        return numbers <= largest
    # A number that survives the conversion fits.
    return numbers == numbers.astype(jnp.int32).astype(numbers.dtype)


def unevaluated(problem: Problem, grids: Int8[Array, "P H W"]) -> Population:
    """Returns what `evaluate` returns, but all slots are vacant."""
    shapes = jax.eval_shape(partial(evaluate, problem), grids)
    kind = shapes.fitness.dtype
    return Population(
        grids,
        jnp.full(len(grids), vacant_fitness(kind), kind),
        jnp.zeros(shapes.features.shape, jnp.int32),
    )


def select(which: Bool[Array, " P"], new: _Tree, old: _Tree) -> _Tree:
    """Returns row i of `new` if `which[i]` is True, otherwise row i of `old`.

    The arrays of both records have the shape ``[P, ...]``.
    """
    return jax.tree.map(
        lambda a, b: jnp.where(which.reshape(-1, *(1,) * (a.ndim - 1)), a, b), new, old
    )


def concatenate(*records: _Tree) -> _Tree:
    """Concatenates records of arrays along the first axis."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *records)


@name_wrong_arguments
@runs_jax
def truncate(*populations: Population, count: int) -> Population:
    """Returns the `count` best grids of several populations, sorted, best first.

    Grids of equal fitness keep their order.
    """
    if not populations:
        raise InputError("populations", "at least one", "none")
    check_named("count", whole(0), count)
    everyone = concatenate(*populations)
    order = jnp.argsort(everyone.fitness, stable=True)[:count]
    return jax.tree.map(lambda array: array[order], everyone)
