"""Trains the network for lane poses, or for labels, on a dataset of robots' views.

    python -m experiments.perception.gym_duckietown.train {pose,labels} DATASET --out FILE [--steps N]

DATASET is a folder of `elitelanes dataset --camera rows=120 columns=160`, or a file of `pictures`.
An interrupted training continues with the same command.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax.serialization import from_bytes, to_bytes
from jaxtyping import Array, Float, UInt8
from numpy.typing import NDArray

from elitelanes_jax import InputError
from experiments.common import Parser, Pytree, leave, run, whole, write
from experiments.perception.gym_duckietown.nets import (
    COLUMNS,
    NETS,
    ROWS,
    SCALES,
    write_weights,
)

__all__ = [
    "BATCH",
    "STEPS",
    "Views",
    "draw_batches",
    "main",
    "read_views",
    "shares_of",
    "train",
    "train_on",
    "write_trained",
]

BATCH = {"pose": 64, "labels": 8}
STEPS = {"pose": 3000, "labels": 900}
_LEARNING_RATE = {"pose": 2e-3, "labels": 5e-3}
_KEEP_EVERY = 60  # seconds


class Views(NamedTuple):
    """Pictures to train on.

    Attributes:
      images: uint8 ``[N, 120, 160, 3]``.
      labels: uint8 ``[N, 120, 160]``.
      lanes: float32 ``[N, 3]``, tiles and radians to the left of the nearest lane, and its curvature.
    """

    images: UInt8[NDArray, "N 120 160 3"]
    labels: UInt8[NDArray, "N 120 160"]
    lanes: Float[NDArray, "N 3"]


def read_views(folder: Path, part: str = "train") -> Views:
    """Reads a part of a dataset in the layout imagefolder, or a file of `pictures`.

    Raises:
      InputError: for another folder, or pictures of another size.
    """
    if folder.suffix == ".npz":
        with np.load(folder) as arrays:
            return Views(*(arrays[name] for name in Views._fields))
    try:
        lines = (folder / part / "metadata.jsonl").read_text(encoding="utf-8").splitlines()
        rows = [json.loads(line) for line in lines]
        lanes = [[row["nearest"][name] for name in ("d", "phi", "curvature")] for row in rows]
    except FileNotFoundError:
        raise InputError(folder, f"a dataset of dataset --camera with a split {part}", "none") from None
    except (OSError, ValueError, KeyError):
        raise InputError(folder, "a dataset of dataset --camera", "another one") from None
    if {tuple(row["pixels"]) for row in rows} != {(ROWS, COLUMNS)}:
        raise InputError(folder, f"pictures of {ROWS} x {COLUMNS} pixels", rows[0]["pixels"])
    images = [np.asarray(cv2.imread(str(folder / part / row["image_file_name"])))[..., ::-1] for row in rows]
    files = [str(folder / part / row["labels_file_name"]) for row in rows]
    labels = [np.asarray(cv2.imread(file, cv2.IMREAD_GRAYSCALE)) for file in files]
    return Views(np.stack(images), np.stack(labels).astype(np.uint8), np.array(lanes, np.float32))


def _pose_loss(weights: Pytree, images: Array, labels: Array, lanes: Array, shares: Array) -> Array:
    """Computes the mean absolute error in units of `SCALES`."""
    found: Pytree = NETS["pose"].apply(weights, images)
    return jnp.abs(found - lanes / SCALES).mean()


def _label_loss(weights: Pytree, images: Array, labels: Array, lanes: Array, shares: Array) -> Array:
    """Computes the cross-entropy; a class weighs one over the root of its share of all pixels."""
    logits: Pytree = NETS["labels"].apply(weights, images)
    weight = (1 / jnp.sqrt(shares))[labels]
    losses = optax.softmax_cross_entropy_with_integer_labels(logits, labels)
    return (weight * losses).sum() / weight.sum()


def draw_batches(task: str, views: Views, seed: int, first: int) -> Iterator[Views]:
    """Yields random batches of pictures without end, from the batch of index `first` on."""
    for step in count(first):
        chosen = np.random.default_rng([seed, step]).integers(len(views.images), size=BATCH[task])
        yield Views(*(part[chosen] for part in views))


def shares_of(labels: UInt8[NDArray, "N 120 160"]) -> Float[NDArray, "4"]:
    """Returns the share of each label in all pixels."""
    return np.asarray(np.maximum(np.bincount(labels.ravel(), minlength=4) / labels.size, 1e-4))


def train(task: str, views: Views, steps: int, seed: int, checkpoint: Path, say: Callable[[str], None]) -> Pytree:
    """Trains a network on random batches of views, see `train_on`."""
    batches = partial(draw_batches, task, views, seed)
    return train_on(task, batches, shares_of(views.labels[::10]), steps, seed, checkpoint, say)


def train_on(
    task: str,
    batches: Callable[[int], Iterator[Views]],
    shares: Float[NDArray, "4"],
    steps: int,
    seed: int,
    checkpoint: Path,
    say: Callable[[str], None],
) -> Pytree:
    """Trains a network; returns its weights. The checkpoint is kept up to date, and continued if it exists.

    `batches` returns the batches of pictures from an index on, and `shares` are those of labels.
    """
    loss = _pose_loss if task == "pose" else _label_loss
    schedule = optax.warmup_cosine_decay_schedule(0, _LEARNING_RATE[task], min(200, steps), steps + 1)
    optimizer = optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(schedule, weight_decay=1e-4))
    weights = NETS[task].init(jax.random.key(seed), jnp.zeros((1, ROWS, COLUMNS, 3), jnp.uint8))
    state: Pytree = (0, weights, optimizer.init(weights), 0.0)
    if checkpoint.exists():
        state = from_bytes(state, checkpoint.read_bytes())
    class_shares = jnp.asarray(shares)

    @partial(jax.jit, donate_argnums=(0, 1))
    def update(weights: Pytree, memory: Pytree, *parts: Array) -> tuple[Pytree, Pytree, Array]:
        value, slope = jax.value_and_grad(loss)(weights, *parts, class_shares)
        change, memory = optimizer.update(slope, memory, weights)
        return optax.apply_updates(weights, change), memory, value

    first, weights, memory, mean = state
    kept = time.monotonic()
    for step, views in zip(range(int(first), steps), batches(int(first)), strict=False):
        weights, memory, value = update(weights, memory, *views)
        mean += (float(value) - mean) * max(0.01, 1 / (step + 1))
        if time.monotonic() - kept > _KEEP_EVERY or step + 1 == steps:
            write(checkpoint, to_bytes((step + 1, weights, memory, mean)))
            say(f"{task}: step {step + 1} of {steps}, loss {mean:.4f}")
            kept = time.monotonic()
    return weights


def write_trained(out: Path, training: Callable[[Path, Callable[[str], None]], Pytree]) -> None:
    """Writes the weights of a training, which keeps its checkpoint beside them until then."""
    checkpoint = out.with_suffix(".checkpoint")
    write_weights(out, training(checkpoint, partial(print, flush=True)))
    print(f"{out}: {out.stat().st_size:,} bytes")
    checkpoint.unlink()


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("train", __doc__)
    parser.add_argument("task", choices=STEPS)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="weights, .npz")
    defaults = " and ".join(f"{steps} for {task}" for task, steps in STEPS.items())
    parser.add_argument("--steps", type=whole(1), metavar="N", help=f"by default {defaults}")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="of first weights and batches; default 0")
    options = parser.parse_args(arguments)
    return run("train", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    views, steps = read_views(options.dataset), options.steps or STEPS[options.task]
    if options.task == "labels" and not views.labels.any():
        raise InputError(options.dataset, "pictures with labels", "pictures without")
    write_trained(options.out, partial(train, options.task, views, steps, options.seed))


if __name__ == "__main__":
    leave(main())
