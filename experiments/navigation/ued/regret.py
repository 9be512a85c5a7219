"""The exact regret of an agent on every level of a space.

The agent has no memory, so its expected return on all levels of a network follows from its probabilities at the nodes
with a choice, by one dynamic programme over the tiles that are left. Nothing is sampled. The environment itself says
where actions lead.
"""

from functools import partial
from typing import NamedTuple, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from elitelanes_jax.drive import LaneNode, Level, RoadNav
from elitelanes_jax.drive import RoadNavParams as Params
from experiments.common import Pytree
from experiments.navigation.ued.agent import NETWORK, params
from experiments.navigation.ued.spaces import Space

__all__ = ["Outcome", "Summary", "evaluate", "summarise"]


class Outcome(NamedTuple):
    """The exact figures of all L levels of a space, float32 ``[L]``: regret, and the probability of success."""

    regret: Float[Array, " L"]
    success: Float[Array, " L"]


class Summary(TypedDict):
    """Figures of the regret on all levels of a space.

    Attributes:
      mean: of all levels.
      cvar1: the mean of the worst 1 % of levels.
      cvar5: the mean of the worst 5 %.
      worst: the highest.
      success: the mean probability of success.
      by_loops: the mean by cyclomatic number.
    """

    mean: float
    cvar1: float
    cvar5: float
    worst: float
    success: float
    by_loops: dict[str, float]


def evaluate(weights: Pytree, space: Space, *, greedy: bool) -> Outcome:
    """Computes the exact regret of a policy on all levels of a space.

    Args:
      weights: of the agent's network.
      space: the levels.
      greedy: whether the policy takes its most probable action, the first of several, or draws its actions.
    """
    choices = int(space.choice.sum(axis=1).max())
    regret, success = _evaluate(weights, space, params(), greedy, choices)
    return Outcome(regret.reshape(-1)[space.pairs], success.reshape(-1)[space.pairs])


@partial(jax.jit, static_argnames=("greedy", "choices"))
def _evaluate(weights: Pytree, space: Space, params: Params, greedy: bool, choices: int) -> tuple[Array, Array]:
    def evaluate_network(of: tuple[Array, LaneNode, Array, Array, Array]) -> tuple[Array, Array]:
        grid, nodes, onward, choice, distance = of
        # Nodes with a choice come first. The same turn is taken at all others, whatever the action.
        deciding = jnp.argsort(~choice, stable=True)[:choices]
        chances = _chances(weights, grid, nodes, deciding, params, greedy)
        value, success = _returns(chances, deciding, onward, params)
        best = params.goal_reward - params.tile_cost * distance
        return best - value, success

    return jax.lax.map(evaluate_network, (space.grids, space.nodes, space.onward, space.choice, space.distance))


def _chances(weights: Pytree, grid: Array, nodes: LaneNode, deciding: Array, params: Params, greedy: bool) -> Array:
    """Returns the probabilities ``[C, N, 3]`` of actions at C nodes on the way to each of N goals."""

    def observe(node: LaneNode, goal: LaneNode) -> Pytree:
        # The agent does not see the distance.
        level = Level(grid, node, goal, jnp.int32(0), jnp.zeros(grid.shape, jnp.uint8))
        return RoadNav.reset_to_level(jax.random.key(0), level, params)[0]

    at = jax.tree.map(lambda part: part[deciding], nodes)
    seen = jax.vmap(jax.vmap(observe, (None, 0)), (0, None))(at, nodes)
    count = deciding.size * nodes.row.size
    row = jax.tree.map(lambda part: part.reshape(1, count, *part.shape[2:]), seen)
    outputs: Pytree = NETWORK.apply(weights, jnp.zeros((count, NETWORK.memory)), row, jnp.ones((1, count), bool))
    _, head, _ = outputs
    if greedy:
        chances = jax.nn.one_hot(head.argmax(axis=-1), 3)
    else:
        chances = jax.nn.softmax(head)
    return chances.reshape(deciding.size, nodes.row.size, 3)


def _returns(chances: Array, deciding: Array, onward: Array, params: Params) -> tuple[Array, Array]:
    """Returns the expected return and the probability of success ``[N, N]`` from each node to each goal."""
    count = len(onward)
    at_goal = jnp.eye(count, dtype=bool)
    ways = onward[deciding]  # [C, action]

    def extend(_: Array, after: tuple[Array, Array]) -> tuple[Array, Array]:
        """Allows one tile more."""
        value, success = jnp.where(at_goal, params.goal_reward, after[0]), jnp.where(at_goal, 1, after[1])
        return go(value) - params.tile_cost, go(success)

    def go(after: Array) -> Array:
        # Whole rows are read, which is fast. Nodes without a choice go on by any action.
        decided = sum(chances[:, :, action] * after[ways[:, action]] for action in range(3))
        return after[onward[:, 0]].at[deciding].set(decided)

    nothing = jnp.zeros((count, count))
    return jax.lax.fori_loop(0, params.limit, extend, (nothing, nothing))


def summarise(space: Space, outcome: Outcome) -> Summary:
    """Summarises the figures of all levels of a space."""
    regret = np.asarray(outcome.regret, np.float64)
    descending = np.sort(regret)[::-1]
    loops = np.asarray(space.cyclomatic)[np.asarray(space.pairs) // space.choice.shape[1] ** 2]
    return {
        "mean": float(regret.mean()),
        "cvar1": _mean_of_worst(descending, 0.01),
        "cvar5": _mean_of_worst(descending, 0.05),
        "worst": float(descending[0]),
        "success": float(np.asarray(outcome.success, np.float64).mean()),
        "by_loops": {str(number): float(regret[loops == number].mean()) for number in np.unique(loops)},
    }


def _mean_of_worst(descending: NDArray[np.float64], share: float) -> float:
    return float(descending[: int(np.ceil(share * len(descending)))].mean())
