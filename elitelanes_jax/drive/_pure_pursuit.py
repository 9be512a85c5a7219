"""Pure pursuit, the expert of `LaneDrive`.

Coulter, "Implementation of the pure pursuit path tracking algorithm", Carnegie Mellon University, 1992.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from elitelanes_jax.drive._lane_drive import LaneDriveParams, LaneDriveState
from elitelanes_jax.drive.lanes import Movement, lane_length, lane_point
from elitelanes_jax.drive.robot import TILE, to_wheels

_SPEED = 0.3  # metres a second
_LOOKAHEAD = 0.12  # tiles along the lane, from the point beside the robot to the point that it drives to


def pure_pursuit(state: LaneDriveState, params: LaneDriveParams) -> Float[Array, "2"]:
    """Returns the action that drives at 0.3 m/s along the arc to a point of the lane 0.12 tiles ahead.

    Args:
      state: of the environment.
      params: of the environment.

    Returns:
      An action of `LaneDrive`, for either kind.
    """
    length = lane_length(state.movement.turn)
    goal_s = state.s + _LOOKAHEAD
    onward = Movement(*state.movement.next_node, state.next_turn)
    here, beyond = lane_point(state.movement, goal_s), lane_point(onward, goal_s - length)
    target = jax.tree.map(lambda one, other: jnp.where(goal_s > length, other, one), here, beyond)
    east, north = target.x - state.pose.x, state.pose.y - target.y
    cosine, sine = jnp.cos(state.pose.theta), jnp.sin(state.pose.theta)
    ahead, left = east * cosine + north * sine, north * cosine - east * sine
    curvature = 2 * left / jnp.maximum(ahead * ahead + left * left, 1e-6)
    turn = _SPEED * curvature / TILE
    if params.action == "twist":
        return jnp.clip(jnp.stack([_SPEED / params.robot.top_speed, turn / params.robot.top_turn]), -1, 1)
    return to_wheels(_SPEED, turn, params.robot)
