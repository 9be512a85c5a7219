"""Two small networks that see the road: the pose in the lane, and the label of each pixel. Their weights are a file."""

import io
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from flax.traverse_util import flatten_dict, unflatten_dict
from jaxtyping import Array, Float, UInt8
from numpy.typing import NDArray

from elitelanes_jax import InputError
from experiments.common import Pytree, write
from experiments.perception.unet import UNet

__all__ = [
    *("COLUMNS", "NETS", "POLICY_ROWS", "ROWS", "SCALES", "choose_actions", "find_labels", "find_poses"),
    *("read_weights", "write_weights"),
]

ROWS, COLUMNS = 120, 160
"""The pictures that the networks see."""

SCALES = np.array([0.05, 0.25, 2.0], np.float32)
"""The unit of each output of `PoseNet`: tiles, radians, and 1 / tiles. All are about as hard to find."""

POLICY_ROWS = 30
"""The rows of the pictures that a policy sees."""

_BATCH = 32


class PoseNet(nn.Module):
    """A network from pictures to the offset from the lane, the angle to it and its curvature, in units of `SCALES`.

    It sees pictures of half the size, the means of 2 x 2 pixels.
    """

    @nn.compact
    def __call__(self, images: UInt8[Array, "B H W 3"]) -> Float[Array, "B 3"]:
        """Maps uint8 ``[B, 120, 160, 3]`` to float32 ``[B, 3]``, all positive to the left."""
        x = nn.avg_pool(images.astype(jnp.float32), (2, 2), (2, 2))
        x = (x - x.mean(axis=(1, 2, 3), keepdims=True)) / (x.std(axis=(1, 2, 3), keepdims=True) + 8)
        for channels, side in ((16, 5), (32, 3), (48, 3)):
            x = nn.relu(nn.GroupNorm(num_groups=4)(nn.Conv(channels, (side, side), (2, 2), use_bias=False)(x)))
        x = nn.relu(nn.GroupNorm(num_groups=4)(nn.Conv(48, (3, 3), use_bias=False)(x)))
        x = nn.relu(nn.Conv(24, (1, 1))(x)).reshape(len(images), -1)
        return nn.Dense(3)(nn.relu(nn.Dense(96)(x)))


class PolicyNet(nn.Module):
    """A network from pictures to an action, for PPO. It sees pictures of 30 x 40 pixels, the means of larger ones."""

    @nn.compact
    def __call__(self, images: UInt8[Array, "B H W 3"]) -> Float[Array, "B 5"]:
        """Maps uint8 ``[B, 30 k, 40 k, 3]`` to means of speed and turn, their log deviations, and a value."""
        side = images.shape[1] // POLICY_ROWS
        x = nn.avg_pool(images.astype(jnp.float32), (side, side), (side, side))
        x = (x - x.mean(axis=(1, 2, 3), keepdims=True)) / (x.std(axis=(1, 2, 3), keepdims=True) + 8)
        # Products of patches: XLA's gradients of strided convolutions are slow in loops.
        x = x.reshape(len(images), 6, 5, 8, 5, 3).swapaxes(2, 3).reshape(len(images), 48, 75)
        x = nn.relu(nn.Dense(48)(x)).reshape(len(images), -1)
        x = nn.relu(nn.Dense(64)(nn.relu(nn.Dense(128)(x))))
        mean = nn.Dense(2, kernel_init=nn.initializers.orthogonal(0.01))(x)
        deviation = jnp.broadcast_to(self.param("deviation", nn.initializers.constant(-1.0), (2,)), mean.shape)
        return jnp.concatenate([mean, deviation, nn.Dense(1)(x)], axis=-1)


NETS: dict[str, nn.Module] = {"pose": PoseNet(), "labels": UNet(4), "policy": PolicyNet()}
"""The networks by task."""


@jax.jit
def _poses(weights: Pytree, images: Array) -> Array:
    found: Pytree = NETS["pose"].apply(weights, images)
    return found * SCALES


@jax.jit
def _labels(weights: Pytree, images: Array) -> Array:
    logits: Pytree = NETS["labels"].apply(weights, images)
    return logits.argmax(axis=-1).astype(jnp.uint8)


@jax.jit
def _actions(weights: Pytree, images: Array) -> Array:
    found: Pytree = NETS["policy"].apply(weights, images)
    return jnp.clip(found[:, :2], -1, 1)


def choose_actions(weights: Pytree, images: UInt8[NDArray, "N 120 160 3"]) -> Float[NDArray, "N 2"]:
    """Returns a policy's likeliest speed and turn, -1 to 1; see `policy`."""
    return _in_batches(partial(_actions, weights), images)


def find_poses(weights: Pytree, images: UInt8[NDArray, "N 120 160 3"]) -> Float[NDArray, "N 3"]:
    """Returns tiles to the left of the lane, radians to the left, and the lane's curvature in 1 / tiles."""
    return _in_batches(partial(_poses, weights), images)


def find_labels(weights: Pytree, images: UInt8[NDArray, "N 120 160 3"]) -> UInt8[NDArray, "N 120 160"]:
    """Returns the labels of pixels, indices of `LABELS`."""
    return _in_batches(partial(_labels, weights), images)


def _in_batches(find: Pytree, images: UInt8[NDArray, "N 120 160 3"]) -> NDArray[np.generic]:
    if images.ndim != 4 or images.shape[1:] != (ROWS, COLUMNS, 3):
        raise InputError("images", f"pictures of {ROWS} x {COLUMNS} pixels", f"an array {images.shape}")
    return np.concatenate([find(images[first : first + _BATCH]) for first in range(0, len(images), _BATCH)])


def write_weights(file: Path, weights: Pytree) -> None:
    """Writes weights as 16-bit numbers."""
    content = io.BytesIO()
    arrays = {name: np.asarray(value, np.float16) for name, value in flatten_dict(weights, sep="/").items()}
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type, unused-ignore]
    write(file, content.getvalue())


def read_weights(file: Path, task: str) -> Pytree:
    """Reads what `write_weights` wrote.

    Args:
      file: of `train`.
      task: a name in `NETS`.

    Raises:
      InputError: for a file that cannot be read, or weights of another network.
    """
    try:
        with np.load(file) as arrays:
            weights = {name: np.asarray(arrays[name], np.float32) for name in arrays.files}
    except (OSError, ValueError, EOFError) as error:
        raise InputError(file, "weights of train", error) from None
    images = jnp.zeros((1, ROWS, COLUMNS, 3), jnp.uint8)
    expected = flatten_dict(jax.eval_shape(NETS[task].init, jax.random.key(0), images), sep="/")
    if {name: value.shape for name, value in weights.items()} != {name: one.shape for name, one in expected.items()}:
        raise InputError(file, f"weights of train {task}", "those of another network")
    return unflatten_dict(weights, sep="/")
