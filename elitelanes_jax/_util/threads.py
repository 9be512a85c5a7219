"""Calls functions in threads, and limits the number of cores."""

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread
from typing import TypeVar

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.types import Untyped

T = TypeVar("T")

_limit: int | None = None


@name_wrong_arguments
def use_cores(count: int) -> None:
    """Limits searches and drawing in this process to a number of the processor's cores.

    The limit holds from the next call on. Does not change results, or JAX's own settings.

    Raises:
      InputError: for a number under 1.
    """
    global _limit
    _limit = check_named("count", whole(1), count)


def count_cores() -> int:
    """Returns the number of cores that this process may use, at most the limit of `use_cores`."""
    # macOS and Windows lack this function.
    known = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if known else os.cpu_count() or 1
    return min(cores, _limit or cores)


def start_thread(call: Callable[[], object]) -> Callable[[], None]:
    """Calls a function in a thread; returns a function that waits for its end.

    Its errors are dropped.
    """

    def work() -> None:
        with suppress(Exception):
            call()

    thread = Thread(target=work)
    thread.start()
    return thread.join


def side_by_side(
    calls: Iterable[Callable[[], T]],
    *,
    workers: int | None = None,
    ended: Callable[[T], object] | None = None,
    wait: bool = True,
) -> list[T]:
    """Calls functions in threads, and returns their results in order.

    A call starts when the iterable yields it and a thread is free. After an error or an
    interruption no further call starts; the exception is raised when the running calls have ended.

    This thread waits at a `SimpleQueue`, because an interruption leaves it intact. A lock written
    in Python, as in `concurrent.futures`, may stay locked if the interruption comes between acquire
    and release.

    Args:
      calls: the functions.
      workers: the number of threads; by default one for each call.
      ended: called in this thread with each result when its call ends.
      wait: whether an interruption waits for the running calls.
    """
    if wait and ended is None and isinstance(calls, Sequence) and len(calls) == 1:
        return [calls[0]()]
    jobs: SimpleQueue[tuple[int, Callable[[], T]] | None] = SimpleQueue()
    outcomes: SimpleQueue[tuple[int, Untyped, BaseException | None]] = SimpleQueue()
    stopped = False

    def work() -> None:
        while (job := jobs.get()) is not None and not stopped:
            index, call = job
            try:
                outcomes.put((index, call(), None))
            except BaseException as error:
                outcomes.put((index, None, error))

    threads: list[Thread] = []
    values: dict[int, T] = {}
    count, joins = 0, True
    try:
        for count, call in enumerate(calls, start=1):
            if workers is None or len(threads) < workers:
                # The interpreter crashes if it ends while a daemon thread compiles.
                threads.append(Thread(target=work, daemon=wait))
                threads[-1].start()
            jobs.put((count - 1, call))
        # The results come in the order in which the calls end.
        for _ in range(count):
            index, value, error = outcomes.get()
            if error is not None:
                raise error
            values[index] = value
            if ended is not None:
                ended(value)
    except KeyboardInterrupt:
        joins = wait
        raise
    finally:
        # Threads that have not taken their next job skip it.
        stopped = True
        for _ in threads:
            jobs.put(None)
        for thread in threads if joins else ():
            if thread.is_alive():
                # A thread whose start was interrupted does not live, and cannot be joined.
                thread.join()
    return [values[index] for index in range(count)]
