"""Grey wolf optimisation over tiles (paper, section "Gray Wolf Optimization").

A grid is a position: each tile is the corner of a simplex that its code names (one-hot). A wolf
moves to the mean of alpha, beta and omega, plus a perturbation that shrinks over the run. Each tile
then takes the nearest code, and repair follows. The arithmetic is in whole numbers, so that results
are the same on every machine and in every batch.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int, Int8, Int32, Real

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import one_of, real, whole
from elitelanes_jax._util.records import Record, static, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import symmetric_uniform
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.xla import UNIT, multiply, to_fixed
from elitelanes_jax.optimizers._population import concatenate, evaluate, truncate
from elitelanes_jax.optimizers.base import Info, Optimizer, check_arguments, count_refused
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.problem import Problem

# The product of this number with the largest perturbation fits int32.
_LONGEST_HORIZON = 2**15 - 1


@pytree
@dataclass(frozen=True)
class GwoConfig(Record):
    """Options of grey wolf optimisation; the defaults are the preset `paper`.

    A pytree: `jax.vmap` may map over `perturbation` and `horizon`.

    Attributes:
      wolves: the number of wolves, and of grids that a step evaluates, at least 2; static, a size
        of arrays.
      perturbation: the largest perturbation of the first step, in size, 0 to 16. From 1/6 on a code
        without a vote can beat a code with one. The paper calls it small.
      horizon: the number of steps over which the perturbation shrinks linearly to 0, 1 to 32,767.
      omega: "own" is each wolf's own position ("and their own" in the paper), "worst" the position
        of the worst wolf; static, it chooses the program.
    """

    wolves: int = static(40, whole(2))
    perturbation: Real[ArrayLike, "..."] = traced(0.35, real(0, 16))
    horizon: Int[ArrayLike, "..."] = traced(200, whole(1, _LONGEST_HORIZON))
    omega: Literal["own", "worst"] = static("own", one_of("own", "worst"))


class GwoState(NamedTuple):
    """The state of the pack.

    Attributes:
      pack: the wolves' grids.
      leaders: alpha and beta, the two best grids so far, best first.
      steps: the number of steps so far.
    """

    pack: Population
    leaders: Population
    steps: Int32[Array, ""]


@name_wrong_arguments
@runs_jax
def gwo(problem: Problem, config: GwoConfig = GwoConfig()) -> Optimizer:
    """Makes grey wolf optimisation of a problem; its elites are alpha and beta, then the pack.

    The default configuration is the preset `paper`.
    """
    check_arguments(problem, config, GwoConfig)
    codes = jnp.array(problem.alphabet, jnp.int8)
    shape = (config.wolves, codes.size, *problem.shape)
    largest = to_fixed(config.perturbation)

    def one_hot(grids: Int8[Array, "P H W"]) -> Int32[Array, "P K H W"]:
        return (grids[:, None] == codes[None, :, None, None]).astype(jnp.int32)

    def init(key: Array) -> GwoState:
        pack = evaluate(problem, problem.random(key, config.wolves))
        return GwoState(pack, truncate(pack, count=2), jnp.int32(0))

    def step(key: Array, state: GwoState) -> tuple[GwoState, Info]:
        pack, leaders, steps = state
        if config.omega == "own":
            omega = pack.grids
        else:
            omega = pack.grids[jnp.argmax(pack.fitness)][None]
        # The votes are three times the mean. So the noise is added three times too, and nothing is
        # divided.
        votes = one_hot(leaders.grids[:1]) + one_hot(leaders.grids[1:]) + one_hot(omega)
        amplitude = largest * jnp.maximum(config.horizon - steps, 0) // config.horizon
        noise = multiply(symmetric_uniform(key, shape), amplitude)
        nearest = jnp.argmax(votes * UNIT + 3 * noise, axis=1)
        pack = evaluate(problem, jax.vmap(problem.repair_raster)(codes[nearest]))
        leaders = truncate(leaders, pack, count=2)
        state = GwoState(pack, leaders, steps + 1)
        return state, Info(
            leaders.fitness[0], elites(state).valid.sum(dtype=jnp.int32), count_refused(pack)
        )

    def elites(state: GwoState) -> Population:
        return concatenate(state.leaders, state.pack)

    return Optimizer.of(init, step, elites, evaluations_per_step=config.wolves)
