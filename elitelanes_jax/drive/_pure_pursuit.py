"""Pure pursuit, the expert of `LaneDrive`.

Coulter, "Implementation of the pure pursuit path tracking algorithm", Carnegie Mellon University, 1992.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from elitelanes_jax.drive._lane_drive import LaneDriveParams, LaneDriveState, next_movement
from elitelanes_jax.drive.lanes import lane_length, lane_point
from elitelanes_jax.drive.robot import TILE, to_wheels


def pure_pursuit(
    state: LaneDriveState,
    params: LaneDriveParams,
    *,
    speed: Float[ArrayLike, ""] = 0.3,
    lookahead: Float[ArrayLike, ""] = 0.12,
) -> Float[Array, "2"]:
    """Returns the action that drives along the arc to a point of the lane ahead.

    Args:
      state: of the environment.
      params: of the environment.
      speed: metres a second.
      lookahead: tiles along the lane from the point beside the robot to that point, at most 0.4.

    Returns:
      An action of `LaneDrive`, for either kind.
    """
    length = lane_length(state.movement.turn)
    goal_s = state.s + lookahead
    here, beyond = lane_point(state.movement, goal_s), lane_point(next_movement(state), goal_s - length)
    target = jax.tree.map(lambda one, other: jnp.where(goal_s > length, other, one), here, beyond)
    east, north = target.x - state.pose.x, state.pose.y - target.y
    cosine, sine = jnp.cos(state.pose.theta), jnp.sin(state.pose.theta)
    ahead, left = east * cosine + north * sine, north * cosine - east * sine
    curvature = 2 * left / jnp.maximum(ahead * ahead + left * left, 1e-6)
    turn = speed * curvature / TILE
    if params.action == "twist":
        return jnp.clip(jnp.stack([speed / params.robot.top_speed, turn / params.robot.top_turn]), -1, 1)
    return to_wheels(speed, turn, params.robot)
