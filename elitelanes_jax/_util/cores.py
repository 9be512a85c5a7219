"""The number of the processor's cores to work on."""

import os

from elitelanes_jax._util.checks import check_named, whole

_most: int | None = None


def use_cores(count: int) -> None:
    """Lets searches and drawing in this process work on at most so many of the processor's cores, from the next call.

    Results are the same. JAX's own settings stay as they are.

    Raises:
      InputError: for a number under 1.
    """
    global _most
    _most = check_named("cores", whole(1), count)


def count_cores() -> int:
    """Returns the number of cores to work on: those that this process may use, at most as many as `use_cores` says."""
    known = hasattr(os, "sched_getaffinity")  # not on macOS and Windows
    there = len(os.sched_getaffinity(0)) if known else os.cpu_count() or 1
    return min(there, _most or there)
