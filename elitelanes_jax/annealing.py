"""Annealing on islands: chains of grids that accept what is worse by chance, less and less, and begin again.

Kirkpatrick, Gelatt and Vecchi, "Optimization by simulated annealing", 1983. A few chains share an island and take parts
of each other's grids; islands know nothing of each other, so that what is common on one is not common on all. A cycle
cools from hot to cold, then all chains start anew and the next cycle is half as long again: whatever the size of the
grid, some cycle has about the right length, and no budget need be known beforehand.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.checks import check_count
from elitelanes_jax.codes import turned
from elitelanes_jax.draws import below, exponential, random_words
from elitelanes_jax.errors import InputError
from elitelanes_jax.moves import Mix, mixed
from elitelanes_jax.problem import Problem
from elitelanes_jax.repairs import raster_rank
from elitelanes_jax.variation import Move

__all__ = ["LONGEST_CYCLE", "AnnealingConfig", "Cooling", "Draw", "accepts", "fresh_grid", "island_mates", "tuned_move"]

# Temperatures are whole sixteenths of a unit of fitness; with more the product with a draw would not fit 32 bits.
_PARTS, _HOTTEST = 16, 4000

# The size of grid that the temperatures are given for; they grow with the sides, as straights do.
_USUAL_SIDE = 12

_STEPS = 256

LONGEST_CYCLE = 2**22
"""In steps: its product with the number of temperatures fits 32 bits."""

# How many chains an island has, and up to how many cells islands of one chain were found better.
_CHAINS, _SMALL = 4, 64


class AnnealingConfig(NamedTuple):
    """Settings; the defaults are the presets `tuned`.

    Attributes:
      population: how many chains there are in all. A step evaluates one grid a chain.
      chains: how many there are on each island; by default 4, and 1 on grids of up to 64 cells, where several soon
        become alike.
      hottest: temperature at the start of a cycle, in units of fitness at 12 x 12.
      coldest: at its end.
      cycle: steps of the first cycle; by default 5/32 of the square of the number of cells.
      moves: the mix of moves.
    """

    population: int = 32
    chains: int | None = None
    hottest: int = 60
    coldest: int = 18
    cycle: int | None = None
    moves: Mix = Mix()

    def checked(self) -> "AnnealingConfig":
        """The settings.

        Raises:
          InputError: for a setting out of its range.
        """
        for name in ("population", "chains", "hottest", "coldest", "cycle"):
            if getattr(self, name) is not None:
                check_count("config", name, getattr(self, name))
        chains = self.chains or _CHAINS
        if self.population % chains:
            raise InputError(
                f"config: expected a population that is a multiple of the {chains} chains of an island, "
                f"got {self.population}"
            )
        if not self.coldest <= self.hottest <= _HOTTEST:
            raise InputError(
                f"config: expected coldest <= hottest <= {_HOTTEST}, got {self.coldest} and {self.hottest}"
            )
        return self._replace(moves=self.moves.checked())

    def chains_on(self, shape: tuple[int, int]) -> int:
        """How many chains an island has on grids of a shape."""
        return self.chains or (1 if shape[0] * shape[1] <= _SMALL else _CHAINS)

    def first_cycle(self, shape: tuple[int, int]) -> int:
        """The steps of the first cycle on grids of a shape."""
        return min(self.cycle or max(16, 5 * (shape[0] * shape[1]) ** 2 // 32), LONGEST_CYCLE)


class Cooling(NamedTuple):
    """Where in its cycle a run is.

    Attributes:
      step: int32, of the cycle, 0 at its start.
      length: int32, how many steps the cycle has.
    """

    step: Array
    length: Array

    @staticmethod
    def first(config: AnnealingConfig, shape: tuple[int, int]) -> "Cooling":
        """The place at which a run begins, with random grids."""
        return Cooling(jnp.int32(1), jnp.int32(config.first_cycle(shape)))

    @property
    def begins(self) -> Array:
        """Bool: whether the coming step is a cycle's first."""
        return self.step == 0

    def after(self, *, grows: bool) -> "Cooling":
        """The place after one more step; the next cycle is half as long again, if they grow."""
        ends = self.step + 1 >= self.length
        longer = jnp.minimum(self.length + self.length // 2, LONGEST_CYCLE) if grows else self.length
        return Cooling(jnp.where(ends, 0, self.step + 1), jnp.where(ends, longer, self.length))

    def temperature(self, config: AnnealingConfig, shape: tuple[int, int]) -> Array:
        """int32, in sixteenths of a unit of fitness: it falls by equal factors from hottest to coldest."""
        fall = (config.coldest / config.hottest) ** (np.arange(_STEPS) / (_STEPS - 1))
        table = np.rint(_PARTS * config.hottest * max(shape) / _USUAL_SIDE * fall)
        table = np.clip(table, 1, _PARTS * _HOTTEST).astype(np.int32)
        return jnp.asarray(table)[self.step * _STEPS // self.length]


def accepts(word: Array, temperature: Array, before: Array, after: Array) -> Array:
    """Whether a chain takes a grid of fitness `after` in place of one of `before`: Metropolis' rule, in whole numbers.

    What is no worse is always taken, what is worse by d with probability exp(-d / temperature).
    """
    return after - before <= temperature * (exponential(word) >> 2) >> 14


class Draw(NamedTuple):
    """The random words of one step, for each chain.

    Attributes:
      accept: uint32 ``[C]``.
      mate: likewise.
      fresh: likewise.
      other: uint32 ``[C, others]``, for what a method has beside.
      move: uint32 ``[C, words]``.
    """

    accept: Array
    mate: Array
    fresh: Array
    other: Array
    move: Array

    @staticmethod
    def of(key: PRNGKey, chains: int, move: Move, *, others: int = 0) -> "Draw":
        first = 3 + others
        words = random_words(key, (chains, first + move.words))
        return Draw(words[:, 0], words[:, 1], words[:, 2], words[:, 3:first], words[:, first:])


def tuned_move(problem: Problem, mix: Mix) -> Move:
    """The mix of moves on a problem."""
    return mixed(mix, fill=problem.fill, kept=problem.kept)


def island_mates(words: Array, grids: Array, chains: int) -> Array:
    """For each of the grids ``[C, H, W]`` one of its own island, perhaps itself."""
    first = np.arange(len(grids)) // chains * chains
    return grids[first + below(words, chains)]


def fresh_grid(problem: Problem, word: Array, *, symmetric: Numeric = False) -> tuple[Array, Array]:
    """A random grid of the alphabet from one random word, and the ranks with which repair settles it.

    Both are symmetric under half a turn if asked for: the second half of the grid is the first one, turned.

    So every step can make one of each chain's grids anew, at next to no cost: where all seeds of a run are one
    computation, a branch that is seldom taken is always paid for.
    """
    codes = jnp.asarray(problem.alphabet, jnp.int8)
    cells = np.arange(problem.shape[0] * problem.shape[1], dtype=np.uint32).reshape(problem.shape)
    rank, second = raster_rank(problem.shape), symmetric & (cells > cells[::-1, ::-1])
    bits = word + jnp.where(second, cells[::-1, ::-1], cells) * np.uint32(0x9E3779B9)
    # The finaliser of MurmurHash3 (A. Appleby): every bit of the word and of the cell's number reaches every other.
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        bits = (bits ^ bits >> shift) * np.uint32(factor)
    grid = codes[below(bits ^ bits >> 16, codes.size)]
    return jnp.where(second, turned(grid, 2), grid), jnp.where(second, rank[::-1, ::-1], rank)
