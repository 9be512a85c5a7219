"""RoadNav: from tile to tile across a map, choosing right, straight or left at crossings."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Int8, Int32, Key

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    clip_to_int32,
    flag,
    instance,
    one_of,
    real,
    whole,
)
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import REQUIRED, option, static, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric, UserValue
from elitelanes_jax.drive._environment import (
    Environment,
    EnvironmentParams,
    Transition,
    checks_first,
    draw_level,
    spl,
)
from elitelanes_jax.drive._levels import Level, check_batch, check_single
from elitelanes_jax.drive.lanes import TURN_TAKEN
from elitelanes_jax.lanes.movements import MOVEMENTS, LaneNode, Movement, step_towards
from elitelanes_jax.network.codes import CONNECTIONS
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.sharding import divide_batches


def _check_window(value: UserValue) -> int:
    size = whole(0, 63)(value)
    if size and size % 2 == 0:
        raise InputError("", "an odd number of tiles, or 0 for none", size)
    return size


@pytree
@dataclass(frozen=True)
class RoadNavParams(EnvironmentParams):
    """Options of `RoadNav`. A pytree: numbers may be arrays, mapped by `jax.vmap`.

    Attributes:
      levels: a batch, from which `reset` draws; `make_levels` makes one.
      limit: steps after which an episode is truncated.
      goal_reward: the reward for reaching the goal.
      tile_cost: the cost of each tile driven.
      stuck_cost: the cost of entering a dead end other than the goal, which terminates the episode.
      window: k, side of the observed window in tiles, odd, or 0 for none; static.
      goal: how the goal is observed: "compass", "mark" in the window, "both" or "none"; static.
      whole_map: whether the map, the node and, unless `goal` is "none", the goal are observed;
        static.
    """

    levels: Level = option(REQUIRED, check_batch)
    limit: Numeric = traced(256, whole(1))
    goal_reward: Numeric = traced(1.0, real(-1e6, 1e6))
    tile_cost: Numeric = traced(0.01, real(-1e6, 1e6))
    stuck_cost: Numeric = traced(1.0, real(-1e6, 1e6))
    window: int = static(5, _check_window)
    goal: str = static("compass", one_of("compass", "mark", "both", "none"))
    whole_map: bool = static(False, flag)

    def check_together(self) -> None:
        """Checks that a goal that is marked in the window is seen.

        There must be a window, or the whole map must be observed, which shows the goal in `there`.
        """
        if self.goal in ("mark", "both") and not self.window and not self.whole_map:
            raise InputError(
                "window",
                "1 or more, because the goal is marked in the window",
                "0",
                "goal='compass' needs no window, and goal='none' hides the goal",
            )


class RoadNavState(NamedTuple):
    """The state of an episode. `grid`, `goal` and `shortest` are the level's.

    Attributes:
      grid: the links of the level's map.
      goal: the level's goal.
      shortest: the tiles of the level's shortest way.
      node: the node of the agent.
      tiles: the number of tiles driven so far.
    """

    grid: Int8[Array, "H W"]
    goal: LaneNode
    shortest: Int32[Array, ""]
    node: LaneNode
    tiles: Int32[Array, ""]


class RoadNavObservation(NamedTuple):
    """An observation from the agent's view: up is ahead. Fields that are not observed are None.

    Attributes:
      ways: bool ``[3]``, the turns that are open here: right, straight, left.
      window: int8 ``[k, k]``, codes of the tiles around, turned so that the bit of north means
        ahead; the agent is in the middle; 0 beyond the map.
      mark: bool ``[k, k]``, the goal's tile in the window.
      compass: float32 ``[3]``, the goal's direction (cosine, sine to the left; 0, 0 on its tile),
        and its straight-line distance in tiles.
      whole_map: int8 ``[H, W]``, the codes, north up.
      here: int32 ``[3]``, the agent's row, column and heading.
      there: int32 ``[3]``, the goal's row, column and heading.
    """

    ways: Bool[Array, "3"]
    window: Int8[Array, "k k"] | None
    mark: Bool[Array, "k k"] | None
    compass: Float[Array, "3"] | None
    whole_map: Int8[Array, "H W"] | None
    here: Int32[Array, "3"] | None
    there: Int32[Array, "3"] | None


class RoadNavInfo(NamedTuple):
    """Metrics after a step.

    Attributes:
      success: bool, the goal is reached.
      tiles: int32, driven.
      shortest: int32, the tiles of a shortest way.
      spl: float32, success times shortest / driven (Anderson et al., "On evaluation of embodied
        navigation agents", 2018).
    """

    success: Bool[Array, ""]
    tiles: Int32[Array, ""]
    shortest: Int32[Array, ""]
    spl: Float[Array, ""]


@name_wrong_arguments
@runs_jax
@checks_first(level=check_single, params=instance(RoadNavParams))
@jax.jit
@divide_batches
def _reset_to_level(
    key: Key[Array, ""], level: Level, params: RoadNavParams
) -> tuple[RoadNavObservation, RoadNavState]:
    """Puts the agent on the start of a level. The key is not used."""
    state = RoadNavState(level.grid, level.goal, level.shortest, level.start, jnp.int32(0))
    return _observe(state, params), state


@name_wrong_arguments
@runs_jax
@checks_first(params=instance(RoadNavParams))
@jax.jit
@divide_batches
def _reset(key: Key[Array, ""], params: RoadNavParams) -> tuple[RoadNavObservation, RoadNavState]:
    """Puts the agent on the start of a level drawn uniformly from ``params.levels``.

    The key is consumed.
    """
    return _reset_to_level(key, draw_level(key, params.levels), params)


@name_wrong_arguments
@runs_jax
@checks_first(state=instance(RoadNavState), action=clip_to_int32, params=instance(RoadNavParams))
@jax.jit
@divide_batches
def _step(
    key: Key[Array, ""], state: RoadNavState, action: Int[ArrayLike, ""], params: RoadNavParams
) -> Transition:
    """Drives to the next tile.

    The episode terminates on the goal and on a dead end, and is truncated at the limit.

    Args:
      key: not used.
      state: the state before.
      action: 0 right, 1 straight, 2 left; other numbers are clipped. If that turn is not open, the
        next open turn is taken, in the order right, straight, left, right. So any action follows a
        road without choice. On a dead end the agent stays.
      params: the options of the environment.
    """
    action = jnp.asarray(action)
    if action.shape != ():
        raise InputError("action", "one whole number", f"shape {action.shape}")
    if not jnp.issubdtype(action.dtype, jnp.integer):
        raise InputError("action", "one whole number", action.dtype)
    grid, goal = state.grid, state.goal
    code = grid[state.node.row, state.node.column].astype(jnp.int32)
    # The flat index of the table has the code, the heading and the action.
    choice = code * 12 + state.node.heading * 3 + jnp.clip(action, 0, 2)
    turn = jnp.asarray(TURN_TAKEN.reshape(-1))[choice].astype(jnp.int32)
    onward = Movement(*state.node, turn).next_node
    # On a dead end there is no turn, so the agent stays.
    moves = jnp.asarray(CONNECTIONS)[code] > 1
    node = jax.tree.map(lambda new, old: jnp.where(moves, new, old), onward, state.node)
    tiles = state.tiles + 1
    after = state._replace(node=node, tiles=tiles)

    # The goal is a node: its tile has to be entered with its heading.
    success = moves & node.equals(goal)
    # Without a U-turn a dead end cannot be left.
    stuck = ~success & (jnp.asarray(CONNECTIONS)[grid[node.row, node.column]] < 2)
    earned = jnp.where(success, params.goal_reward, 0) - jnp.where(stuck, params.stuck_cost, 0)
    info = RoadNavInfo(success, tiles, state.shortest, spl(success, state.shortest, tiles))
    terminated = success | stuck
    seen = _observe(after, params)
    reward = jnp.asarray(earned - params.tile_cost, jnp.float32)
    return Transition(
        seen, after, reward, terminated, ~terminated & (tiles >= params.limit), info, seen
    )


@name_wrong_arguments
@runs_jax
@checks_first(state=instance(RoadNavState), params=instance(RoadNavParams))
@divide_batches
def _observe(state: RoadNavState, params: RoadNavParams) -> RoadNavObservation:
    grid, goal, node = state.grid, state.goal, state.node
    code = grid[node.row, node.column].astype(jnp.int32)
    window, mark = _look_around(grid, goal, node, params.window) if params.window else (None, None)
    everything = params.whole_map
    return RoadNavObservation(
        ways=jnp.asarray(MOVEMENTS)[code, node.heading],
        window=window,
        mark=mark if params.goal in ("mark", "both") else None,
        compass=_compass(node, goal) if params.goal in ("compass", "both") else None,
        whole_map=grid if everything else None,
        here=jnp.stack(node) if everything else None,
        there=jnp.stack(goal) if everything and params.goal != "none" else None,
    )


def _look_around(grid: Array, goal: LaneNode, node: LaneNode, size: int) -> tuple[Array, Array]:
    """Returns the codes around a node and the mark of the goal, two ``[k, k]``.

    Both are turned to the heading of the node.
    """
    reach = size // 2
    # A slice of a padded grid takes a third of the time of reading tile by tile (measured).
    north_up = jax.lax.dynamic_slice(jnp.pad(grid, reach), (node.row, node.column), (size, size))
    # The mark is True where a step from the node leads to the goal's tile.
    steps = np.arange(size) - reach
    marked = (node.row + steps[:, None] == goal.row) & (node.column + steps[None] == goal.column)
    codes, mark = north_up, marked
    # A rotation by a traced number is a selection among the four rotations.
    for quarter in (1, 2, 3):
        turned = node.heading == quarter
        codes = jnp.where(turned, jnp.rot90(north_up, quarter), codes)
        mark = jnp.where(turned, jnp.rot90(marked, quarter), mark)
    # Rotating the window moves the tiles, and rotating the four bits of each code turns the tiles.
    wide = codes.astype(jnp.int32)
    codes = ((wide << node.heading | wide >> (4 - node.heading)) & 15).astype(jnp.int8)
    return codes, mark


def _compass(node: LaneNode, goal: LaneNode) -> Array:
    down, right = (
        (goal.row - node.row).astype(jnp.float32),
        (goal.column - node.column).astype(jnp.float32),
    )
    distance = jnp.sqrt(down * down + right * right)
    # Tiles are at least 1 apart. The maximum only avoids a division by 0 on the goal's tile.
    scale = 1 / jnp.maximum(distance, 1)
    # The direction is turned from the map's frame to the agent's.
    ahead_down, ahead_right = (part.astype(jnp.float32) for part in step_towards(node.heading))
    ahead = down * ahead_down + right * ahead_right
    left = down * -ahead_right + right * ahead_down
    return jnp.stack([ahead * scale, left * scale, distance])


RoadNav = Environment(_reset, _reset_to_level, _step, _observe, actions=3)
"""The environment of an agent that drives from tile to tile.

`RoadNavParams` has its options, and `RoadNav.step` says what an action does.
"""
