"""A detector that finds the centres of boxes, and its training.

The method is CenterNet's (Zhou, Wang and Krähenbühl, 2019), with the sides of boxes as in FCOS (Tian et al., 2019).
"""

from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import serialization
from jaxtyping import Array, Float, Int, Key, UInt8
from numpy.typing import NDArray

from experiments.common import Pytree, write
from experiments.perception.unet import UNet, space_to_depth

__all__ = ["detect", "targets", "train"]

_CELL = 2  # pixels a side of a cell of the net's output
_CHANNELS = (24, 32, 64, 96)
_LEARNING_RATE, _WARM_UP = 2e-3, 0.15
_RARE = 4.6  # a sigmoid of -4.6 is 0.01, so that a new net finds few centres
_REACH = 16.0  # pixels from a cell to each side of its box, where the net's output is 0
_MOST = 80  # boxes found in a picture, at most
_OVERLAP = 0.45  # the IoU from which a box with a lower score is taken for the same object


def train(
    images: UInt8[NDArray, "N H W 3"],
    boxes: Float[NDArray, "N M 4"],
    kinds: Int[NDArray, "N M"],
    count: int,
    seed: int,
    *,
    steps: int,
    batch: int,
    file: Path,
    report: Callable[[int, float], None],
) -> Pytree:
    """Trains a detector on random pictures, half of them mirrored.

    Args:
      images: uint8, sides multiples of 32.
      boxes: x, y, width and height in pixels.
      kinds: of each box, from 0; -1 pads the list.
      count: number of kinds.
      seed: of the first weights and of the pictures' order.
      steps: of Adam. The step size rises, then falls to 0.
      batch: pictures a step.
      file: checkpoint. The same call resumes from it.
      report: called with the step and the loss, 20 times.

    Returns:
      The weights, for `detect`.
    """
    data = jnp.asarray(images), jnp.asarray(boxes, jnp.float32), jnp.asarray(kinds, jnp.int32)
    first, order = jax.random.split(jax.random.key(seed))
    weights = UNet(count + 4, _CHANNELS).init(first, space_to_depth(data[0][:1]))
    state, done = (weights, _optimizer(steps).init(weights)), 0
    if file.exists():
        state, done = serialization.from_bytes((state, done), file.read_bytes())
    for step in range(done, steps):
        state, loss = _step(state, *data, jax.random.fold_in(order, step), steps, batch, count)
        if (step + 1) % max(1, steps // 20) == 0 or step + 1 == steps:
            report(step + 1, float(loss))
            write(file, serialization.to_bytes((state, step + 1)))
    return state[0]


@lru_cache
def _optimizer(steps: int) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_onecycle_schedule(steps, _LEARNING_RATE, _WARM_UP))


@partial(jax.jit, static_argnames=("steps", "batch", "count"), donate_argnames="state")
def _step(
    state: Pytree,
    images: UInt8[Array, "N H W 3"],
    boxes: Float[Array, "N M 4"],
    kinds: Int[Array, "N M"],
    key: Key[Array, ""],
    steps: int,
    batch: int,
    count: int,
) -> tuple[Pytree, Float[Array, ""]]:
    places, sides = jax.random.split(key)
    chosen = jax.random.randint(places, (batch,), 0, len(images))
    mirrored = jax.random.bernoulli(sides, 0.5, (batch,))
    shown, box = images[chosen], boxes[chosen]
    shown = jnp.where(mirrored[:, None, None, None], shown[:, :, ::-1], shown)
    box = box.at[..., 0].set(jnp.where(mirrored[:, None], images.shape[2] - box[..., 0] - box[..., 2], box[..., 0]))
    size = shown.shape[1] // _CELL, shown.shape[2] // _CELL
    heat, true, share = jax.vmap(partial(targets, size=size, count=count))(box, kinds[chosen])

    def loss(weights: Pytree) -> Float[Array, ""]:
        logits, sides = _apply(weights, shown, count)
        found, hit = jax.nn.sigmoid(logits), heat == 1
        cost = jnp.where(hit, (1 - found) ** 2 * jax.nn.softplus(-logits), 0)
        cost += jnp.where(hit, 0, (1 - heat) ** 4 * found**2 * jax.nn.softplus(logits))
        missed = jnp.abs(jnp.log(sides / jnp.maximum(true, 1))).sum(axis=-1)
        return (cost.sum() + (share * missed).sum()) / jnp.maximum(hit.sum(), 1)

    weights, moments = state
    value, gradient = jax.value_and_grad(loss)(weights)
    updates, moments = _optimizer(steps).update(gradient, moments)
    return (optax.apply_updates(weights, updates), moments), value


def _apply(
    weights: Pytree, images: UInt8[Array, "B H W 3"], count: int
) -> tuple[Float[Array, "B h w K"], Float[Array, "B h w 4"]]:
    """Returns logits of the kinds, and the pixels from each cell to the left, top, right and bottom side of its box."""
    out: Pytree = UNet(count + 4, _CHANNELS).apply(weights, space_to_depth(images))
    return out[..., :count] - _RARE, _REACH * jnp.exp(jnp.clip(out[..., count:], -6, 6))


def _middles(size: tuple[int, int]) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    y, x = jnp.meshgrid(*((jnp.arange(side) + 0.5) * _CELL for side in size), indexing="ij")
    return x, y


def targets(
    boxes: Float[Array, "M 4"], kinds: Int[Array, " M"], size: tuple[int, int], count: int
) -> tuple[Float[Array, "h w K"], Float[Array, "h w 4"], Float[Array, "h w"]]:
    """Makes what the net learns of one picture: see `train` for its arguments; `size` is in cells.

    Returns:
      For each cell and kind, the highest bell of a box of this kind, exactly 1 in the cell of the box's middle. The
      pixels from the cell to the sides of the box whose bell is the highest. The weight of these sides: the cells near
      a box's middle share 1.
    """
    x, y = _middles(size)
    left, top, wide, high = boxes.T[:, :, None, None]
    middle = [(jnp.floor(at / _CELL) + 0.5) * _CELL for at in (left + wide / 2, top + high / 2)]
    spread = [side / 8 + 0.3 * _CELL for side in (wide, high)]
    bells = jnp.exp(-(((x - middle[0]) / spread[0]) ** 2 + ((y - middle[1]) / spread[1]) ** 2) / 2)
    bells *= (kinds >= 0)[:, None, None]
    heat = jnp.stack([jnp.max(bells * (kinds == kind)[:, None, None], axis=0, initial=0) for kind in range(count)], -1)
    sides = jnp.stack([x - left, y - top, left + wide - x, top + high - y], axis=-1)
    owner = bells.argmax(axis=0)
    own = bells * (bells > 0.3) * (owner == jnp.arange(len(boxes))[:, None, None])
    share = (own / jnp.maximum(own.sum(axis=(1, 2), keepdims=True), 1e-6)).sum(axis=0)
    true = jnp.take_along_axis(sides, owner[None, :, :, None], axis=0)[0]
    return heat, true, share


def detect(weights: Pytree, images: UInt8[NDArray, "N H W 3"], count: int, batch: int = 8) -> NDArray[np.float32]:
    """Finds boxes, float32 ``[N, 80, 6]``: x, y, width and height in pixels, score and kind; zeros pad the list."""
    parts = [_peaks(weights, images[start : start + batch], count) for start in range(0, len(images), batch)]
    found = np.concatenate(parts)
    for boxes in found:
        kept = cv2.dnn.NMSBoxesBatched(boxes[:, :4], boxes[:, 4], boxes[:, 5].astype(int), 0.0, _OVERLAP)
        boxes[np.setdiff1d(np.arange(_MOST), kept)] = 0
    return found


@partial(jax.jit, static_argnames="count")
def _peaks(weights: Pytree, images: UInt8[Array, "B H W 3"], count: int) -> Float[Array, "B P 6"]:
    """Finds the boxes of the cells whose score of a kind is the highest among their neighbours.

    Scores and boxes are the means of those in a picture and in its mirror image.
    """
    (logits, sides), (others, mirrored) = (_apply(weights, one, count) for one in (images, images[:, :, ::-1]))
    score = (jax.nn.sigmoid(logits) + jax.nn.sigmoid(others[:, :, ::-1])) / 2
    sides = (sides + mirrored[:, :, ::-1, jnp.array([2, 1, 0, 3])]) / 2
    highest = jax.lax.reduce_window(score, -jnp.inf, jax.lax.max, (1, 3, 3, 1), (1, 1, 1, 1), "SAME")
    score = jnp.where(score == highest, score, 0).reshape(len(images), -1)
    best, place = jax.lax.top_k(score, _MOST)
    x, y = _middles((sides.shape[1], sides.shape[2]))
    boxes = jnp.concatenate([jnp.stack([x, y], -1) - sides[..., :2], sides[..., :2] + sides[..., 2:]], axis=-1)
    boxes = jnp.take_along_axis(boxes.reshape(len(images), -1, 4), (place // count)[..., None], axis=1)
    return jnp.concatenate([boxes, best[..., None], (place % count)[..., None]], axis=-1)
