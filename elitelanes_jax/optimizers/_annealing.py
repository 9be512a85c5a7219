"""Annealing on islands: chains of grids that sometimes accept a worse grid.

The probability that a chain accepts a worse grid falls during each cycle: Kirkpatrick, Gelatt and
Vecchi, "Optimization by simulated annealing", 1983. The chains of an island copy parts of each
other's grids. Islands exchange nothing, so that they keep different grids. A cycle cools from hot
to cold. Then all chains restart from random grids, and the next cycle is half as long again. So for
every size of grid some cycle has about the right length, and the budget need not be known in
advance.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Key, Real, UInt32

from elitelanes_jax._util.checks import none_or, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record, nested, static, traced
from elitelanes_jax.network.bits import exponential, randint, random_bits
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.xla import UNIT, take
from elitelanes_jax.optimizers._moves import MoveWeights, random_move
from elitelanes_jax.optimizers._mutations import Move
from elitelanes_jax.problem.problem import Problem

# Temperatures are whole sixteenths of a unit of fitness. Up to 4000 units, the product with a
# random number fits int32.
_PARTS, _HOTTEST = 16, 4000

# The options are temperatures for grids of this side. They grow with the side, like the scores of
# straights.
_USUAL_SIDE = 12

# The number of temperatures in a cycle.
_STEPS = 256

LONGEST_CYCLE = 2**22
"""The longest cycle in steps: its product with the number of temperatures fits int32."""

SMALL = 64
"""The largest number of cells of a small grid.

There islands of one chain are better (experiments/search/moves.md).
"""

# The number of chains of an island on larger grids.
_CHAINS = 4

# This number replaces the fitness of refused grids. It is larger than any other fitness, and its
# differences fit int32.
_REFUSED = 2**30


@pytree
@dataclass(frozen=True)
class AnnealingConfig(Record):
    """Options of annealing; the defaults are the tuned EA's. A pytree.

    `jax.vmap` may map over `cycle` and `moves`. Temperatures are static: their table is made in
    double precision on the host, so that it is the same on every machine.

    Attributes:
      population: the number of chains of all islands; each evaluates one grid a step; static, a
        size of arrays.
      chains: the number of chains on each island; static. By default 4, and 1 on grids of up to 64
        cells, where the chains of an island soon become alike.
      hottest: temperature at the start of a cycle, in units of fitness at 12 x 12; static.
      coldest: temperature at the end of a cycle, in the same units; static.
      cycle: steps of the first cycle; by default 5/32 of the square of the number of cells.
      moves: the weights of the moves.
    """

    population: int = static(32, whole(1))
    chains: int | None = static(None, none_or(whole(1)))
    hottest: int = static(60, whole(1, _HOTTEST))
    coldest: int = static(18, whole(1))
    cycle: Int[ArrayLike, "..."] | None = traced(None, none_or(whole(1)))
    moves: MoveWeights = nested(MoveWeights())

    def check_together(self) -> None:
        """Checks that all islands have the same number of chains, and that a cycle cools."""
        chains = self.chains or _CHAINS
        if self.population % chains:
            expected = f"a multiple of the {chains} chains of an island"
            raise InputError("population", expected, self.population)
        if self.coldest > self.hottest:
            raise InputError("coldest", f"at most the hottest, {self.hottest}", self.coldest)

    def chains_on(self, shape: tuple[int, int]) -> int:
        """Returns the number of chains of an island on grids of a shape."""
        return self.chains or (1 if shape[0] * shape[1] <= SMALL else _CHAINS)

    def first_cycle(self, shape: tuple[int, int]) -> Int[ArrayLike, "..."]:
        """Returns the number of steps of the first cycle on grids of a shape.

        The number is an int, or an array if `cycle` is an array.
        """
        if self.cycle is None:
            return usual_cycle(shape)
        return min(self.cycle, LONGEST_CYCLE) if isinstance(self.cycle, int) else self.cycle


def usual_cycle(shape: tuple[int, int]) -> int:
    """Returns the number of steps of the first cycle on grids of a shape, without a `cycle`."""
    # These are 640 steps at 8 x 8, where shorter and longer cycles are worse
    # (experiments/search/moves.md).
    return min(max(16, 5 * (shape[0] * shape[1]) ** 2 // 32), LONGEST_CYCLE)


class Cooling(NamedTuple):
    """The step of a run within its cycle.

    Attributes:
      step: the next step of the cycle, from 0.
      length: the number of steps of the cycle.
    """

    step: Int32[Array, "..."]
    length: Int32[Array, "..."]

    @staticmethod
    def first(config: AnnealingConfig, shape: tuple[int, int]) -> "Cooling":
        """Returns the start of a run, whose random grids are step 0."""
        return Cooling(jnp.int32(1), jnp.asarray(config.first_cycle(shape), jnp.int32))

    @property
    def begins(self) -> Bool[Array, "..."]:
        """Whether the next step begins a cycle."""
        return self.step == 0

    def after(self, *, grows: bool) -> "Cooling":
        """Returns the state after one more step.

        If cycles grow, the next one is half as long again.
        """
        ends = self.step + 1 >= self.length
        longer = (
            jnp.minimum(self.length + self.length // 2, LONGEST_CYCLE) if grows else self.length
        )
        return Cooling(jnp.where(ends, 0, self.step + 1), jnp.where(ends, longer, self.length))

    def temperature(
        self, hottest: int, coldest: int, shape: tuple[int, int]
    ) -> Int32[Array, "..."]:
        """Returns the temperature in sixteenths of a unit of fitness; it falls by equal factors.

        `hottest` and `coldest` are those at the start and the end of a cycle, in units of fitness
        at 12 x 12.
        """
        fall = (coldest / hottest) ** (np.arange(_STEPS) / (_STEPS - 1))
        table = np.rint(_PARTS * hottest * max(shape) / _USUAL_SIDE * fall)
        table = np.clip(table, 1, _PARTS * _HOTTEST).astype(np.int32)
        return jnp.asarray(table)[self.step * _STEPS // self.length]


def metropolis_accepts(
    bits: UInt32[Array, "..."],
    temperature: Int32[Array, "..."],
    before: Real[Array, "..."],
    after: Real[Array, "..."],
) -> Bool[Array, "..."]:
    """Returns whether a chain replaces its grid by another one, by Metropolis' rule.

    The fitness of the chain's grid is `before`, and the fitness of the other grid is `after`. A
    grid that is not worse is always accepted. A grid that is worse by d is accepted with
    probability exp(-d / temperature), a refused grid only instead of another refused one. The
    temperature is in sixteenths of a unit.
    """
    # An exponentially distributed number of mean 1 is at least d / temperature with probability
    # exp(-d / temperature).
    if jnp.issubdtype(after.dtype, jnp.floating):
        # Refused grids are infinite, and their difference would be NaN.
        rise = jnp.where(after == before, 0, after - before)
        return rise <= temperature.astype(jnp.float32) * exponential(bits).astype(jnp.float32) / (
            _PARTS * UNIT
        )
    rise = jnp.minimum(after, _REFUSED) - jnp.minimum(before, _REFUSED)
    # The two lowest bits of the random number are dropped, so that the product fits int32.
    return rise <= temperature * (exponential(bits) >> 2) >> 14


class StepBits(NamedTuple):
    """The random bits of one step, for each of C chains.

    Attributes:
      accept: the bits for `metropolis_accepts`.
      mate: the bits that choose a mate.
      fresh: the bits of a random grid.
      extra: the bits for further choices of one method.
      move: the bits for the move.
    """

    accept: UInt32[Array, " C"]
    mate: UInt32[Array, " C"]
    fresh: UInt32[Array, " C"]
    extra: UInt32[Array, "C extra"]
    move: UInt32[Array, "C bits"]

    @staticmethod
    def draw(key: Key[Array, ""], chains: int, move: Move, *, extra: int = 0) -> "StepBits":
        """Draws the bits; the key is consumed."""
        first = 3 + extra
        bits = random_bits(key, (chains, first + move.bits))
        return StepBits(bits[:, 0], bits[:, 1], bits[:, 2], bits[:, 3:first], bits[:, first:])


def problem_move(problem: Problem, weights: MoveWeights) -> Move:
    """Returns the random move that suits a problem's repair."""
    return random_move(weights, fill=problem.fill, fixed=problem.fixed)


def island_mates(
    bits: UInt32[Array, " C"], grids: Int8[Array, "C H W"], chains: int
) -> Int8[Array, "C H W"]:
    """Draws a mate for each chain's grid from the same island; it may be the grid itself."""
    first = np.arange(len(grids)) // chains * chains
    return take(grids, first + randint(bits, chains))


def random_grid(problem: Problem, bits: UInt32[Array, ""]) -> Int8[Array, "H W"]:
    """Makes a random grid of the problem's alphabet from 32 random bits.

    The grid is to be repaired in raster order.

    Every step of the tuned EA makes one for each chain. It is cheap, and since all seeds of a run
    are one computation, a branch would almost always be computed.
    """
    codes = np.array(problem.alphabet, np.int8)
    cells = np.arange(problem.shape[0] * problem.shape[1], dtype=np.uint32).reshape(problem.shape)
    # The factor, 2**32 divided by the golden ratio, spreads the cells' indices over all numbers.
    mixed = bits + cells * np.uint32(0x9E3779B9)
    # By the finaliser of MurmurHash3 (A. Appleby), each bit of the input and of the cell's index
    # may change each bit of the result.
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        mixed = (mixed ^ mixed >> shift) * np.uint32(factor)
    return take(codes, randint(mixed ^ mixed >> 16, codes.size))
