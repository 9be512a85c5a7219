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
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from elitelanes_jax.drive import LaneNode, Level, RoadNav
from elitelanes_jax.drive import RoadNavParams as Params
from experiments.common import Pytree
from experiments.navigation.ued.agent import NETWORK, params
from experiments.navigation.ued.spaces import Space

__all__ = ["Outcome", "Summary", "evaluate", "most_probable_actions", "regret_to_goals", "summarise"]


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
    regret, success = _evaluate(weights, space, params(), greedy, _most_choices(space))
    return Outcome(regret.reshape(-1)[space.pairs], success.reshape(-1)[space.pairs])


def regret_to_goals(
    weights: Pytree, space: Space, network: Int[Array, " K"], goal: Int[Array, " K"]
) -> Float[Array, "K N"]:
    """Computes the exact regret of the policy that draws its actions, from every start to each of K goals.

    This asks the policy once at each choice of each goal's network. `evaluate` does so for all goals.

    Args:
      weights: of the agent's network.
      space: the levels.
      network: the index of each goal's network.
      goal: the index of each goal among the nodes of its network.

    Returns:
      The regret from each of the N nodes. It has a meaning only where ``space.distance`` is above 0.
    """
    return _to_goals(weights, space, network, goal, params(), _most_choices(space))


def most_probable_actions(weights: Pytree, space: Space, network: int, goal: int) -> Int[np.ndarray, " N"]:
    """Returns the most probable action at each node of a network on the way to a goal; 0 where no turn is to choose."""
    deciding = np.flatnonzero(space.choice[network])
    grid, nodes = space.grids[network], jax.tree.map(lambda part: part[network], space.nodes)
    chances = _chances(weights, grid, nodes, jnp.asarray(deciding), jnp.array([goal]), params(), True)
    actions = np.zeros(space.choice.shape[1], int)
    actions[deciding] = chances[:, 0].argmax(axis=-1)
    return actions


def _most_choices(space: Space) -> int:
    return int(space.choice.sum(axis=1).max())


@partial(jax.jit, static_argnames=("greedy", "choices"))
def _evaluate(weights: Pytree, space: Space, params: Params, greedy: bool, choices: int) -> tuple[Array, Array]:
    goals = jnp.arange(space.choice.shape[1])

    def evaluate_network(network: Array) -> tuple[Array, Array]:
        return _of_network(weights, space, network, goals, params, greedy, choices)

    return jax.lax.map(evaluate_network, jnp.arange(len(space.grids)))


@partial(jax.jit, static_argnames="choices")
def _to_goals(weights: Pytree, space: Space, network: Array, goal: Array, params: Params, choices: int) -> Array:
    def evaluate_goal(network: Array, goal: Array) -> Array:
        return _of_network(weights, space, network, goal[None], params, False, choices)[0][:, 0]

    return jax.vmap(evaluate_goal)(network, goal)


def _of_network(
    weights: Pytree, space: Space, network: Array, goals: Array, params: Params, greedy: bool, choices: int
) -> tuple[Array, Array]:
    """Returns the regret and the probability of success ``[N, M]`` from every node of a network to M goals."""
    grid, onward, choice = space.grids[network], space.onward[network], space.choice[network]
    nodes = jax.tree.map(lambda part: part[network], space.nodes)
    # Nodes with a choice come first. The same turn is taken at all others, whatever the action.
    deciding = jnp.argsort(~choice, stable=True)[:choices]
    chances = _chances(weights, grid, nodes, deciding, goals, params, greedy)
    value, success = _returns(chances, deciding, goals, onward, params)
    best = jnp.subtract(params.goal_reward, params.tile_cost * space.distance[network][:, goals])
    return best - value, success


def _chances(
    weights: Pytree, grid: Array, nodes: LaneNode, deciding: Array, goals: Array, params: Params, greedy: bool
) -> Array:
    """Returns the probabilities ``[C, M, 3]`` of actions at C nodes on the way to each of M goals."""

    def observe(node: LaneNode, goal: LaneNode) -> Pytree:
        # The agent does not see the distance.
        level = Level(grid, node, goal, jnp.int32(0), jnp.zeros(grid.shape, jnp.uint8))
        return RoadNav.reset_to_level(jax.random.key(0), level, params)[0]

    at, towards = (jax.tree.map(lambda part, index=index: part[index], nodes) for index in (deciding, goals))
    seen = jax.vmap(jax.vmap(observe, (None, 0)), (0, None))(at, towards)
    count = deciding.size * goals.size
    row = jax.tree.map(lambda part: part.reshape(1, count, *part.shape[2:]), seen)
    outputs: Pytree = NETWORK.apply(weights, jnp.zeros((count, NETWORK.memory)), row, jnp.ones((1, count), bool))
    _, head, _ = outputs
    if greedy:
        chances = jax.nn.one_hot(head.argmax(axis=-1), 3)
    else:
        chances = jax.nn.softmax(head)
    return chances.reshape(deciding.size, goals.size, 3)


def _returns(chances: Array, deciding: Array, goals: Array, onward: Array, params: Params) -> tuple[Array, Array]:
    """Returns the expected return and the probability of success ``[N, M]`` from each node to each of M goals."""
    at_goal = jnp.arange(len(onward))[:, None] == goals
    ways = onward[deciding]  # [C, action]

    def extend(_: Array, after: tuple[Array, Array]) -> tuple[Array, Array]:
        """Allows one tile more."""
        value, success = jnp.where(at_goal, params.goal_reward, after[0]), jnp.where(at_goal, 1, after[1])
        return go(value) - params.tile_cost, go(success)

    def go(after: Array) -> Array:
        # Whole rows are read, which is fast. Nodes without a choice go on by any action.
        decided = sum(chances[:, :, action] * after[ways[:, action]] for action in range(3))
        return after[onward[:, 0]].at[deciding].set(decided)

    nothing = jnp.zeros(at_goal.shape)
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
