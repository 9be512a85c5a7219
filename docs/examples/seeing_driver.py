"""A driver for `elitelanes drive --policy` that sees its camera alone, by the network of docs/perception.md.

elitelanes drive docs/examples/town.json --policy docs/examples/seeing_driver.py --out seeing.gif

It needs the files of a checkout, and Flax.
"""

import sys
from pathlib import Path

from elitelanes_jax.drive import Camera, LaneDriveObservation

sys.path.append(str(Path(__file__).parents[2]))
from experiments.perception.gym_duckietown.nets import find_poses, read_weights

FOLDER = Path(__file__).parents[2] / "experiments" / "perception" / "gym_duckietown" / "weights"
WEIGHTS = read_weights(FOLDER / "pose.npz", "pose")
SPEED = 0.3  # metres a second
TILE, WHEEL_DISTANCE, TOP_SPEED = 0.585, 0.102, 1.2  # metres, metres, metres a second


def act(observation: LaneDriveObservation) -> tuple[float, float]:
    """Returns the commands of the left and the right wheel, -1 to 1."""
    d, phi, curvature = find_poses(WEIGHTS, observation.image[None])[0].tolist()
    turn = curvature * SPEED / TILE - 12 * d - 6 * phi  # radians a second, to the left
    half = turn * WHEEL_DISTANCE / 2
    return (SPEED - half) / TOP_SPEED, (SPEED + half) / TOP_SPEED


act.camera = Camera(rows=120, columns=160)
