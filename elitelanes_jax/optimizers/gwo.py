"""Grey wolf optimisation over tiles (paper, section "Gray Wolf Optimization").

A grid is a position, each tile the corner of a simplex that its code names (one-hot). A wolf moves to the mean of
alpha, beta and omega, plus a perturbation that shrinks over the run; each tile takes the code that is nearest, and the
grid is repaired. All is done in whole numbers, which are the same bit for bit on every machine and in every batch.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.draws import UNIT
from elitelanes_jax.errors import InputError
from elitelanes_jax.evolution import Population, evaluated, joined, merged
from elitelanes_jax.fixed_point import either_way, part, units
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer, all_of
from elitelanes_jax.problem import Problem

__all__ = ["GwoConfig", "GwoState", "gwo"]

# Its product with the largest perturbation fits 32 bits.
_LONGEST_HORIZON = 2**15 - 1


class GwoConfig(NamedTuple):
    """Settings; the defaults are the preset `paper`.

    Attributes:
      wolves: how many, and how many grids a step evaluates.
      perturbation: the largest at the start, either way, 0 to 16; from 1/6 on a code without a vote can beat one that
        has one. The paper calls it small.
      horizon: the number of steps over which the perturbation shrinks to nothing, in equal parts, 1 to 32,767.
      omega: "own" is each wolf's own position ("and their own" in the paper), "worst" that of the worst wolf.
    """

    wolves: int = 40
    perturbation: Numeric = 0.35
    horizon: int = 200
    omega: Literal["own", "worst"] = "own"

    def checked(self) -> "GwoConfig":
        """The settings with the perturbation as a float.

        Raises:
          InputError: for a setting out of its range.
        """
        check_count("config", "wolves", self.wolves)
        check_count("config", "horizon", self.horizon)
        if self.horizon > _LONGEST_HORIZON:
            raise InputError(f"config: expected horizon to be at most {_LONGEST_HORIZON}, got {self.horizon}")
        if self.omega not in ("own", "worst"):
            raise InputError(f"config: expected omega to be 'own' or 'worst', got {self.omega!r}")
        return self._replace(perturbation=check_real("config", "perturbation", self.perturbation, 0, 16))


class GwoState(NamedTuple):
    """What is carried from step to step.

    Attributes:
      pack: the wolves' grids and what they are worth.
      leaders: alpha and beta, the best two grids found so far, best first.
      steps: int32, how many were taken.
    """

    pack: Population
    leaders: Population
    steps: Array


def gwo(problem: Problem, config: GwoConfig = GwoConfig()) -> Optimizer:  # noqa: B008
    """Grey wolf optimisation; its elites are alpha and beta, then the pack.

    Args:
      problem: with a shape, an alphabet and a fitness.
      config: the defaults are the preset `paper`.

    Raises:
      InputError: for a setting out of its range.
    """
    config = config.checked()
    codes = jnp.array(problem.alphabet, jnp.int8)
    shape = (config.wolves, codes.size, *problem.shape)
    largest = units(config.perturbation)

    def votes(grids: Array) -> Array:
        """One for the code of each tile, int32 ``[P, K, H, W]``."""
        return (grids[:, None] == codes[:, None, None]).astype(jnp.int32)

    def init(key: PRNGKey) -> GwoState:
        pack = evaluated(problem, problem.random(key, config.wolves))
        return GwoState(pack, merged(pack, count=2), jnp.int32(0))

    def step(key: PRNGKey, state: GwoState) -> tuple[GwoState, Info]:
        pack, leaders, steps = state
        omega = pack.grids if config.omega == "own" else pack.grids[jnp.argmax(pack.fitness)][None]
        # Three times the mean, so that there is no division.
        mean = votes(leaders.grids[:1]) + votes(leaders.grids[1:]) + votes(omega)
        size = largest * jnp.maximum(config.horizon - steps, 0) // config.horizon
        moved = jnp.argmax(mean * UNIT + 3 * part(either_way(key, shape), size), axis=1)
        pack = evaluated(problem, jax.vmap(problem.settle)(codes[moved]))
        leaders = merged(leaders, pack, count=2)
        info = Info(best_fitness=leaders.fitness[0], elite_count=jnp.int32(config.wolves + 2))
        return GwoState(pack, leaders, steps + 1), info

    def elites(state: GwoState) -> Elites:
        return all_of(joined(state.leaders, state.pack))

    return Optimizer(init, step, elites, evaluations_per_step=config.wolves)
