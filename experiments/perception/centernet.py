"""A detector that finds the centres of boxes (Zhou, Wang and Krähenbühl, 2019), and its training."""

from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import serialization
from jaxtyping import Array, Bool, Float, Int, Key, UInt8
from numpy.typing import NDArray

from experiments.common import Pytree, write
from experiments.perception.unet import UNet, space_to_depth

__all__ = ["Output", "detect", "targets", "train"]

CELL = 2
"""The side of a cell of the net's output, in pixels."""

_CHANNELS = (24, 32, 48, 64)
_LEARNING_RATE, _WARM_UP = 3e-3, 0.15
_RARE = 4.6  # a sigmoid of -4.6 is 0.01, the share of cells near a centre
_REACH = 16.0  # pixels from a cell to each side of its box, where the net's output is 0
_MOST = 40  # boxes found in a picture, at most

Output = tuple[Float[Array, "B h w K"], Float[Array, "B h w 4"]]
"""Logits of each kind, and the distances in pixels from a cell's middle to the left, upper, right and lower side."""


def train(
    images: UInt8[NDArray, "N H W 3"],
    boxes: Float[NDArray, "N M 4"],
    kinds: Int[NDArray, "N M"],
    count: int,
    seed: int,
    *,
    steps: int,
    batch: int = 8,
    file: Path | None = None,
    report: Callable[[int, float], None] = lambda step, loss: None,
) -> Pytree:
    """Trains a detector on random pictures, half of them mirrored.

    Args:
      images: uint8, sides multiples of 32.
      boxes: x, y, width and height in pixels; a width of 0 for none.
      kinds: of each box, from 0; -1 if it is to be found or not, as the net likes.
      count: number of kinds.
      seed: of the first weights and of the pictures' order.
      steps: of Adam. The step size rises, then falls to 0.
      batch: pictures a step.
      file: where to keep unfinished work, which the same call continues.
      report: called with the step and the loss, 20 times.

    Returns:
      The weights, for `detect`.
    """
    data = jnp.asarray(images), jnp.asarray(boxes, jnp.float32), jnp.asarray(kinds, jnp.int32)
    first, order = jax.random.split(jax.random.key(seed))
    weights = UNet(count + 4, _CHANNELS).init(first, space_to_depth(data[0][:1]))
    state, done = (weights, _optimizer(steps).init(weights)), 0
    if file is not None and file.exists():
        state, done = serialization.from_bytes((state, done), file.read_bytes())
    part = max(1, steps // 20)
    for step in range(done, steps):
        state, loss = _step(state, *data, jax.random.fold_in(order, step), steps, batch, count)
        if (step + 1) % part == 0:
            report(step + 1, float(loss))
            if file is not None:
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
    turned = jax.random.bernoulli(sides, 0.5, (batch,))
    shown = jnp.where(turned[:, None, None, None], images[chosen, :, ::-1], images[chosen])
    box = boxes[chosen]
    mirrored = box.at[..., 0].set(images.shape[2] - box[..., 0] - box[..., 2])
    box = jnp.where(turned[:, None, None], mirrored, box)
    size = shown.shape[1] // CELL, shown.shape[2] // CELL
    heat, care, owner, share = jax.vmap(partial(targets, size=size, count=count))(box, kinds[chosen])

    def loss(weights: Pytree) -> Float[Array, ""]:
        logits, sides = _apply(weights, shown, count)
        found = jax.nn.sigmoid(logits)
        hit = heat == 1
        cost = jnp.where(hit, (1 - found) ** 2 * jax.nn.softplus(-logits), 0)
        cost += jnp.where(~hit & care, (1 - heat) ** 4 * found**2 * jax.nn.softplus(logits), 0)
        true = jnp.take_along_axis(box, owner.reshape(batch, -1)[..., None], axis=1).reshape(sides.shape)
        return (cost.sum() + 5 * (share * _misses(sides, true)).sum()) / jnp.maximum(hit.sum(), 1)

    weights, moments = state
    value, gradient = jax.value_and_grad(loss)(weights)
    updates, moments = _optimizer(steps).update(gradient, moments)
    return (optax.apply_updates(weights, updates), moments), value


def _apply(weights: Pytree, images: UInt8[Array, "B H W 3"], count: int) -> Output:
    out: Pytree = UNet(count + 4, _CHANNELS).apply(weights, space_to_depth(images))
    return out[..., :count] - _RARE, _REACH * jnp.exp(jnp.clip(out[..., count:], -6, 6))


def targets(
    boxes: Float[Array, "M 4"], kinds: Int[Array, " M"], size: tuple[int, int], count: int
) -> tuple[Float[Array, "h w K"], Bool[Array, "h w K"], Int[Array, "h w"], Float[Array, "h w"]]:
    """Makes what the net learns of one picture.

    Args:
      boxes: x, y, width and height in pixels; a width of 0 for none.
      kinds: of each box, or -1.
      size: rows and columns of cells.
      count: number of kinds.

    Returns:
      For each cell and kind a bell around the centre of each box, 1 at its cell; whether the cell counts for kinds that
      are not there, which it does not in boxes of kind -1; the box that the cell belongs to; and the weight of its
      sides, 1 in all for each box.
    """
    rows, columns = jnp.meshgrid(*map(jnp.arange, size), indexing="ij")
    x, y, wide, high = (side[:, None, None] / CELL for side in boxes.T)
    centre = jnp.floor(x + wide / 2), jnp.floor(y + high / 2)
    spread = jnp.maximum(wide, 1) / 8 + 0.3, jnp.maximum(high, 1) / 8 + 0.3
    bells = jnp.exp(-(((columns - centre[0]) / spread[0]) ** 2 + ((rows - centre[1]) / spread[1]) ** 2) / 2)
    there = ((wide > 0) & (kinds >= 0)[:, None, None]).astype(float)
    bells *= there
    heat = jnp.stack([jnp.max(bells * (kinds == kind)[:, None, None], axis=0, initial=0) for kind in range(count)], -1)
    within = (columns + 0.5 > x) & (columns + 0.5 < x + wide) & (rows + 0.5 > y) & (rows + 0.5 < y + high)
    free = (within & (kinds < 0)[:, None, None]).any(axis=0)
    owner = bells.argmax(axis=0)
    own = bells * (owner == jnp.arange(len(boxes))[:, None, None]) * (bells > 0.3)
    share = (own / jnp.maximum(own.sum(axis=(1, 2), keepdims=True), 1e-6)).sum(axis=0)
    return heat, ~free[..., None] | (heat > 0), owner, share


def _misses(sides: Float[Array, "B h w 4"], boxes: Float[Array, "B h w 4"]) -> Float[Array, "B h w"]:
    """Returns 1 minus the generalised IoU (Rezatofighi et al., 2019) of the boxes found and the true ones."""
    x, y = _middles(sides.shape[1:3])
    true = jnp.stack(
        [x - boxes[..., 0], y - boxes[..., 1], boxes[..., 0] + boxes[..., 2] - x, boxes[..., 1] + boxes[..., 3] - y], -1
    )
    least, most = jnp.minimum(sides, true), jnp.maximum(sides, true)
    both = jnp.maximum(least[..., 0] + least[..., 2], 0) * jnp.maximum(least[..., 1] + least[..., 3], 0)
    area, hull = (
        (part[..., 0] + part[..., 2]) * (part[..., 1] + part[..., 3]) for part in (jnp.stack([sides, true]), most)
    )
    union = area[0] + area[1] - both
    return 2 - both / jnp.maximum(union, 1e-3) - union / jnp.maximum(hull, 1e-3)


def _middles(size: tuple[int, ...]) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    rows, columns = jnp.meshgrid(*map(jnp.arange, size), indexing="ij")
    return (columns + 0.5) * CELL, (rows + 0.5) * CELL


def detect(weights: Pytree, images: UInt8[NDArray, "N H W 3"], count: int, batch: int = 8) -> NDArray[np.float32]:
    """Finds boxes, float32 ``[N, 40, 6]``: x, y, width and height in pixels, score and kind; the best first."""
    parts = [_peaks(weights, images[start : start + batch], count) for start in range(0, len(images), batch)]
    return np.concatenate([np.asarray(part) for part in parts])


@partial(jax.jit, static_argnames="count")
def _peaks(weights: Pytree, images: UInt8[Array, "B H W 3"], count: int) -> Float[Array, "B P 6"]:
    """Finds the cells that are the best of a kind among their neighbours."""
    logits, sides = _apply(weights, images, count)
    score = jax.nn.sigmoid(logits)
    highest = jax.lax.reduce_window(score, -jnp.inf, jax.lax.max, (1, 3, 3, 1), (1, 1, 1, 1), "SAME")
    score = jnp.where(score == highest, score, 0).reshape(len(images), -1)
    best, place = jax.lax.top_k(score, min(_MOST, score.shape[1]))
    cell, kind = place // count, place % count
    left, above, right, below = jnp.moveaxis(
        jnp.take_along_axis(sides.reshape(len(images), -1, 4), cell[..., None], axis=1), -1, 0
    )
    x, y = (middle.ravel()[cell] for middle in _middles(sides.shape[1:3]))
    return jnp.stack([x - left, y - above, left + right, above + below, best, kind], axis=-1)
