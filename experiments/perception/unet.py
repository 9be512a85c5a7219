"""A small U-Net that labels pictures, its training and its evaluation (Ronneberger, Fischer and Brox, 2015)."""

from collections.abc import Sequence
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import linen as nn
from jaxtyping import Array, Float, Int, Key, UInt8
from numpy.typing import ArrayLike, NDArray

from experiments.common import Pytree

__all__ = ["UNet", "confusion", "depth_to_space", "ious", "predict", "random_crop", "space_to_depth", "train"]

_LEARNING_RATE, _WARM_UP = 5e-3, 0.15


class UNet(nn.Module):
    """A network from pictures to logits. It works on packs of 2 x 2 pixels, at a quarter of the cost.

    Attributes:
      classes: number of classes.
      channels: of each level from fine to coarse, multiples of 4. A level has half the resolution of the one before.
    """

    classes: int
    channels: Sequence[int] = (16, 24, 32)

    @nn.compact
    def __call__(self, images: UInt8[Array, "B H W 3"]) -> Float[Array, "B H W classes"]:
        """Maps uint8 ``[B, H, W, 3]``, sides multiples of 8, to float32 ``[B, H, W, classes]``."""
        *finer, coarsest = self.channels
        x, skipped = space_to_depth(images.astype(jnp.float32) / 128 - 1), []
        for channels in finer:
            skipped.append(_block(x, channels))
            batch, height, width, _ = skipped[-1].shape
            x = skipped[-1].reshape(batch, height // 2, 2, width // 2, 2, channels).mean(axis=(2, 4))
        x = _block(x, coarsest)
        for channels, skip in zip(reversed(finer), reversed(skipped), strict=True):
            x = _block(jnp.concatenate([x.repeat(2, axis=1).repeat(2, axis=2), skip], axis=-1), channels)
        return depth_to_space(nn.Conv(4 * self.classes, (1, 1))(x))


def _block(x: Array, channels: int) -> Array:
    for _ in range(2):
        x = nn.relu(nn.GroupNorm(num_groups=4)(nn.Conv(channels, (3, 3), use_bias=False)(x)))
    return x


def space_to_depth(x: Array) -> Array:
    """Packs 2 x 2 pixels into one with four times the channels."""
    batch, height, width, channels = x.shape
    x = x.reshape(batch, height // 2, 2, width // 2, 2, channels).transpose(0, 1, 3, 2, 4, 5)
    return x.reshape(batch, height // 2, width // 2, 4 * channels)


def depth_to_space(x: Array) -> Array:
    """Unpacks what `space_to_depth` packs."""
    batch, height, width, channels = x.shape
    x = x.reshape(batch, height, width, 2, 2, channels // 4).transpose(0, 1, 3, 2, 4, 5)
    return x.reshape(batch, 2 * height, 2 * width, channels // 4)


def train(
    images: ArrayLike, labels: ArrayLike, classes: int, seed: int, *, steps: int, batch: int = 8, crop: int = 96
) -> Pytree:
    """Trains a network on crops, each from a random place of a random picture, rotated by random quarter-turns.

    Args:
      images: uint8 ``[N, H, W, 3]``.
      labels: uint8 ``[N, H, W]``, each below ``classes``.
      classes: number of classes.
      seed: of the first weights and of the crops.
      steps: of Adam on the cross-entropy. The weight of a class is one over the root of its share of all pixels. The
        step size rises, then falls to 0.
      batch: crops a step.
      crop: their side in pixels, a multiple of 8.

    Returns:
      The weights, for `predict`.
    """
    shares = np.bincount(np.ravel(labels), minlength=classes) / np.size(labels)
    balance = jnp.asarray(1 / np.sqrt(np.maximum(shares, 1e-6)), jnp.float32)
    images, labels = jnp.asarray(images), jnp.asarray(labels)
    first, crops = jax.random.split(jax.random.key(seed))
    weights = UNet(classes).init(first, jnp.zeros((1, crop, crop, 3), jnp.uint8))
    state = _optimizer(steps).init(weights)
    for step in range(steps):
        key = jax.random.fold_in(crops, step)
        weights, state = _step(weights, state, images, labels, balance, key, steps, batch, crop)
    return weights


@lru_cache
def _optimizer(steps: int) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_onecycle_schedule(steps, _LEARNING_RATE, _WARM_UP))


@partial(jax.jit, static_argnames=("steps", "batch", "crop"), donate_argnames=("weights", "state"))
def _step(
    weights: Pytree,
    state: Pytree,
    images: UInt8[Array, "N H W 3"],
    labels: UInt8[Array, "N H W"],
    balance: Float[Array, " classes"],
    key: Key[Array, ""],
    steps: int,
    batch: int,
    crop: int,
) -> tuple[Pytree, Pytree]:
    shown, true = jax.vmap(partial(random_crop, images, labels, crop))(jax.random.split(key, batch))

    def loss(weights: Pytree) -> Float[Array, ""]:
        logits = UNet(balance.size).apply(weights, shown)
        return jnp.average(optax.softmax_cross_entropy_with_integer_labels(logits, true), weights=balance[true])

    updates, state = _optimizer(steps).update(jax.grad(loss)(weights), state)
    return optax.apply_updates(weights, updates), state


def random_crop(
    images: UInt8[Array, "N H W 3"], labels: UInt8[Array, "N H W"], side: int, key: Key[Array, ""]
) -> tuple[Int[Array, "side side 3"], Int[Array, "side side"]]:
    """Cuts a square out of a random picture and its labels, at a random position, rotated by random quarter-turns."""
    limits = jnp.array([*labels.shape, 4]) - jnp.array([0, side - 1, side - 1, 0])
    index, row, column, turns = jax.random.randint(key, (4,), 0, limits)
    image = jax.lax.dynamic_slice(images, (index, row, column, 0), (1, side, side, 3))[0]
    label = jax.lax.dynamic_slice(labels, (index, row, column), (1, side, side))[0]
    ways = [jnp.stack([jnp.rot90(layer, k) for k in range(4)]) for layer in (image, label.astype(jnp.int32))]
    return ways[0][turns], ways[1][turns]


def predict(
    weights: Pytree,
    images: NDArray[np.uint8],
    classes: int,
    *,
    batch: int = 8,
    shares: ArrayLike | None = None,
    unweighted: float | None = None,
) -> NDArray[np.uint8]:
    """Returns labels uint8 ``[N, H, W]`` of pictures uint8 ``[N, H, W, 3]``, whose sides are multiples of 8.

    `train` weighs rare classes more, so that lines come out too thick. With `unweighted`, 0 to 1, this share of the
    weights is taken back, for classes with these `shares` of the pixels in training. Then the probabilities are also
    the means of those in the four quarter turns of a picture, which must be square.
    """
    prior = None if unweighted is None else jnp.asarray(shares) ** (unweighted / 2)
    parts = [_labels(weights, images[start : start + batch], classes, prior) for start in range(0, len(images), batch)]
    return np.concatenate([np.asarray(part, np.uint8) for part in parts])


@partial(jax.jit, static_argnames="classes")
def _labels(
    weights: Pytree, images: UInt8[Array, "B H W 3"], classes: int, prior: Float[Array, " classes"] | None
) -> Int[Array, "B H W"]:
    def scores(turns: int) -> Float[Array, "B H W classes"]:
        logits: Pytree = UNet(classes).apply(weights, jnp.rot90(images, turns, (1, 2)))
        return jnp.rot90(logits if prior is None else jax.nn.softmax(logits), -turns, (1, 2))

    return scores(0).argmax(axis=-1) if prior is None else (sum(map(scores, range(4))) * prior).argmax(axis=-1)


def confusion(true: NDArray[np.uint8], found: NDArray[np.uint8], classes: int) -> NDArray[np.int_]:
    """Counts pixels by true label (row) and label found (column), int ``[classes, classes]``."""
    return np.bincount(classes * true.ravel().astype(int) + found.ravel(), minlength=classes**2).reshape(classes, -1)


def ious(counts: ArrayLike) -> NDArray[np.float64]:
    """Computes each class's intersection over union from a `confusion`, float64 ``[classes]``; NaN without pixels."""
    counts = np.asarray(counts, float)
    both = np.diag(counts)
    union = counts.sum(axis=0) + counts.sum(axis=1) - both
    return np.divide(both, union, out=np.full(len(both), np.nan), where=union > 0)
