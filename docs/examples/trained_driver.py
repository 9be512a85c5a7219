"""A driver for `elitelanes drive --policy`: a network that PPO trained, kept in driver.npz (see docs/drive.md)."""

import numpy as np

NET = dict(np.load("driver.npz"))


def act(observation):
    """Returns the commands of the left and the right wheel, -1 to 1."""
    x = np.array([observation.d, observation.phi, observation.speed, observation.turn, *observation.curvature])
    x = x * NET["scale"]
    for layer in range(3):
        x = x @ NET[f"kernel_{layer}"] + NET[f"bias_{layer}"]
        x = np.tanh(x) if layer < 2 else np.clip(x, -1, 1)
    speed, turn = 1.2 * x[0], 8.0 * x[1]  # metres and radians a second
    wheels = np.array([speed - 0.051 * turn, speed + 0.051 * turn]) / 1.2
    return wheels / max(1.0, np.abs(wheels).max())
