"""Runs JAX under any settings of the user, and JAX and OpenCV in forked processes.

Transfers of arrays are allowed. A process that was forked after JAX started is refused. OpenCV
works in a forked process. This module does not import JAX or OpenCV, so that functions for arrays
of NumPy and JAX can use it.
"""

import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import wraps
from typing import ParamSpec, TypeVar

from elitelanes_jax._util.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")

# Whether JAX had started when this process forked.
_started = False
# Whether this process was forked from one in which JAX had started.
_forked = False
# The number of OpenCV's threads when this process forked.
_opencv_threads: int | None = None


def runs_jax(function: Callable[P, R]) -> Callable[P, R]:
    """Declares that a function runs JAX: in its calls transfers are allowed, see `transfers`.

    In a process that was forked after JAX started, the function raises `InputError`. JAX would wait
    there for threads that only the parent has.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        check_not_forked()
        with transfers():
            return function(*args, **kwargs)

    return call


def check_not_forked() -> None:
    """Raises `InputError` in a process that was forked after JAX started."""
    if _forked:
        raise InputError(
            "process",
            "a process in which JAX can run",
            "a fork of a process that had started JAX",
            "start workers with multiprocessing's method spawn or forkserver",
        )


def transfers() -> AbstractContextManager[None]:
    """Allows transfers of arrays in its block.

    They are allowed even if JAX's setting `jax_transfer_guard` forbids them. An array of NumPy as
    an argument of a compiled function is a transfer, and so is a number in an operation on arrays
    of JAX.
    """
    jax = sys.modules.get("jax")
    return nullcontext() if jax is None else jax.transfer_guard("allow")


def _before_fork() -> None:
    global _started
    if (jax := sys.modules.get("jax")) is None:
        return
    # JAX refuses to change this setting once it has started its threads, which tells whether it
    # has. If it takes the change, the setting is set back.
    devices = jax.config.jax_num_cpu_devices
    try:
        jax.config.update("jax_num_cpu_devices", 2 if devices == 1 else 1)
        jax.config.update("jax_num_cpu_devices", devices)
    except RuntimeError:
        _started = True


def _after_fork() -> None:
    global _forked
    _forked = _started


def _stop_opencv() -> None:
    """Ends the threads of OpenCV before a fork.

    The forked process would have OpenCV's record of these threads and not the threads. The next
    change of their number, with which a dataset is drawn, would wait for them forever.
    """
    global _opencv_threads
    cv2 = sys.modules.get("cv2")
    if cv2 is not None and hasattr(cv2, "setNumThreads"):
        # Another thread may be importing OpenCV, which then lacks its functions.
        _opencv_threads = cv2.getNumThreads()
        cv2.setNumThreads(1)


def _continue_opencv() -> None:
    """Lets OpenCV start threads again, in both processes after a fork."""
    if _opencv_threads is not None:
        sys.modules["cv2"].setNumThreads(_opencv_threads)


if hasattr(os, "register_at_fork"):
    # Windows has no fork.
    os.register_at_fork(
        before=_stop_opencv, after_in_parent=_continue_opencv, after_in_child=_continue_opencv
    )
    os.register_at_fork(before=_before_fork, after_in_child=_after_fork)
