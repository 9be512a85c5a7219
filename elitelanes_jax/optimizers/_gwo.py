"""Grey wolf optimisation over tiles (paper, section "Gray Wolf Optimization").

A grid is a position: each tile is the corner of a simplex that its code names (one-hot). A wolf moves to the mean of
alpha, beta and omega, plus a perturbation that shrinks over the run; each tile takes the nearest code, and the grid is
repaired. All is done in whole numbers, which are the same bit for bit on every machine and in every batch.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int, Int8, Int32, Real

from elitelanes_jax._util.checks import one_of, real, whole
from elitelanes_jax._util.pytrees import pytree, static, traced
from elitelanes_jax._util.records import Record
from elitelanes_jax.network.bits import symmetric_uniform
from elitelanes_jax.network.fixed_point import UNIT, multiply, to_fixed
from elitelanes_jax.optimizers._population import Population, concatenate, evaluate, truncate
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer, as_elites
from elitelanes_jax.problem.problem import Problem

# Its product with the largest perturbation fits int32.
_LONGEST_HORIZON = 2**15 - 1


@pytree
@dataclass(frozen=True)
class GwoConfig(Record):
    """Settings; the defaults are the preset `paper`. A pytree: all but sizes may be mapped by `jax.vmap`.

    Attributes:
      wolves: how many, and how many grids a step evaluates; static, a size of arrays.
      perturbation: the largest at the start, either way, 0 to 16; from 1/6 on a code without a vote can beat one that
        has one. The paper calls it small.
      horizon: the number of steps over which the perturbation shrinks to nothing, in equal parts, 1 to 32,767.
      omega: "own" is each wolf's own position ("and their own" in the paper), "worst" that of the worst wolf; static,
        it chooses the program.
    """

    wolves: int = static(40, whole(1))
    perturbation: Real[ArrayLike, "..."] = traced(0.35, real(0, 16))
    horizon: Int[ArrayLike, "..."] = traced(200, whole(1, _LONGEST_HORIZON))
    omega: Literal["own", "worst"] = static("own", one_of("own", "worst"))


class GwoState(NamedTuple):
    """The state that is carried from step to step.

    Attributes:
      pack: the wolves' grids and their evaluation.
      leaders: alpha and beta, the best two grids found so far, best first.
      steps: int32, the steps taken.
    """

    pack: Population
    leaders: Population
    steps: Int32[Array, ""]


def gwo(problem: Problem, config: GwoConfig = GwoConfig()) -> Optimizer:
    """Makes grey wolf optimisation; its elites are alpha and beta, then the pack.

    Args:
      problem: with a shape, an alphabet and a fitness.
      config: the defaults are the preset `paper`.
    """
    codes = jnp.array(problem.alphabet, jnp.int8)
    shape = (config.wolves, codes.size, *problem.shape)
    largest = to_fixed(config.perturbation)

    def one_hot(grids: Int8[Array, "P H W"]) -> Int32[Array, "P K H W"]:
        return (grids[:, None] == codes[:, None, None]).astype(jnp.int32)

    def init(key: Array) -> GwoState:
        pack = evaluate(problem, problem.random(key, config.wolves))
        return GwoState(pack, truncate(pack, count=2), jnp.int32(0))

    def step(key: Array, state: GwoState) -> tuple[GwoState, Info]:
        pack, leaders, steps = state
        omega = pack.grids if config.omega == "own" else pack.grids[jnp.argmax(pack.fitness)][None]
        # Three times the mean, so that there is no division.
        mean = one_hot(leaders.grids[:1]) + one_hot(leaders.grids[1:]) + one_hot(omega)
        size = largest * jnp.maximum(config.horizon - steps, 0) // config.horizon
        moved = jnp.argmax(mean * UNIT + 3 * multiply(symmetric_uniform(key, shape), size), axis=1)
        pack = evaluate(problem, jax.vmap(problem.repair_raster)(codes[moved]))
        leaders = truncate(leaders, pack, count=2)
        info = Info(best_fitness=leaders.fitness[0], elite_count=jnp.int32(config.wolves + 2))
        return GwoState(pack, leaders, steps + 1), info

    def elites(state: GwoState) -> Elites:
        return as_elites(concatenate(state.leaders, state.pack))

    return Optimizer(init, step, elites, evaluations_per_step=config.wolves)
