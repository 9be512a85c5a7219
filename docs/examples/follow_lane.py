"""A driver for `elitelanes drive --policy`: it keeps to the lane by what it observes of it.

elitelanes drive docs/examples/town.json --policy docs/examples/follow_lane.py --out ride.gif
"""

from elitelanes_jax.drive import LaneDriveObservation

SPEED = 0.3  # metres a second
TILE, WHEEL_DISTANCE, TOP_SPEED = 0.585, 0.102, 1.2  # metres, metres, metres a second


def act(observation: LaneDriveObservation) -> tuple[float, float]:
    """Returns the commands of the left and the right wheel, -1 to 1."""
    lane = observation.curvature[0] * SPEED / TILE  # radians a second, to the left
    turn = lane - 12 * observation.d - 6 * observation.phi
    half = turn * WHEEL_DISTANCE / 2
    return (SPEED - half) / TOP_SPEED, (SPEED + half) / TOP_SPEED
