"""The check of grids that a search yields, and the end of its budget."""

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.checks import check_named, unmasked
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.benchmark.tasks import Task


class SpentError(Exception):
    """The operators have made as many grids as the task has evaluations."""


def check_batch(subject: str, task: Task, batch: UserValue) -> Int8[np.ndarray, "B H W"]:
    """Returns grids of a task as int8; raises `InputError`, with the subject, for anything else."""
    check_named(subject, unmasked, batch)
    try:
        codes = np.asarray(batch)
    except ValueError as error:
        raise InputError(subject, "an array of grids", shorten(str(error))) from None
    if (
        codes.ndim != 3
        or codes.shape[1:] != task.shape
        or not len(codes)
        or codes.dtype.kind not in "iu"
    ):
        shape = f"[B, {task.shape[0]}, {task.shape[1]}]"
        raise InputError(
            subject, f"grids {shape} of whole numbers", f"{codes.dtype} {list(codes.shape)}"
        )
    # Codes are checked before the conversion to int8, in which larger ones would overflow.
    if not 0 <= codes.min() <= codes.max() <= 15:
        raise InputError(subject, "tile codes 0 to 15", f"{codes.min()} to {codes.max()}")
    return codes.astype(np.int8)
