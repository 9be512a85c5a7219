"""Calls a function on the workers of an executor: processes here, or on the hosts of a cluster."""

import pickle
import platform
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import contextmanager, nullcontext, suppress
from functools import lru_cache
from typing import NamedTuple, Protocol, TypeVar, cast, runtime_checkable

from elitelanes_jax._util.checks import check_named, none_or, whole
from elitelanes_jax._util.errors import (
    InputError,
    MissingPackageError,
    NotEnoughMapsError,
    NotEnoughMemoryError,
    quote,
    shorten,
)
from elitelanes_jax._util.interruption import raise_if_interrupted
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.running import check_not_forked
from elitelanes_jax._util.types import Untyped, UserValue

A = TypeVar("A")
R = TypeVar("R")

# The parts that an executor has at once. It keeps their results in memory until they are written.
_AT_ONCE = 1000

# The shortest and the longest time between two questions whether parts are done, in seconds.
# Submitit reads files to answer.
_SOON, _LATER = 0.02, 1.0

# The errors of executors that lost a worker or a job, besides those of Python, by module and name.
_LOST = {
    ("distributed", "KilledWorker"),
    ("distributed", "FutureCancelledError"),
    ("distributed", "TimeoutError"),
    ("submitit", "UncompletedJobError"),
    ("submitit", "FailedSubmissionError"),
}

# The errors of this package, and of disks.
_OURS = (InputError, NotEnoughMapsError, NotEnoughMemoryError, OSError)


class Future(Protocol):
    """What an executor's `submit` returns. `concurrent.futures.Future` has these methods."""

    def done(self) -> bool:
        """Tells whether the call has ended."""

    def result(self) -> object:
        """Returns the result of the call, or raises its error."""

    def cancel(self) -> object:
        """Cancels the call if it has not started."""


# Type checks in tests ask whether an object is an `Engine`.
@runtime_checkable
class Engine(Protocol):
    """The interface of an executor, which divides work among workers.

    A `concurrent.futures.Executor` has it, and so has any other class with its `submit`.
    """

    def submit(self, function: Callable[..., object], /, *args: object) -> Future:
        """Starts a call on a worker, and returns its future."""


class Pool(NamedTuple):
    """An executor, and the number of parts to divide work into.

    If `parts` is None, the work has a default number.
    """

    executor: Engine
    parts: int | None = None

    def parts_for(self, usual: int, most: int) -> int:
        """Returns the number of parts: the user's, or `usual`, and at most `most`."""
        return min(self.parts or max(usual, 1), most)


def check_pool(executor: UserValue, parts: UserValue) -> Pool | None:
    """Checks the arguments `executor` and `parts` of a public function.

    Returns None without an executor.
    """
    parts = check_named("parts", none_or(whole(1)), parts)
    if executor is None:
        if parts is not None:
            raise InputError("parts", f"an executor to run {parts} parts on", "none")
        return None
    if isinstance(executor, type) or not callable(getattr(executor, "submit", None)):
        expected = "a concurrent.futures.Executor, or another object with its method submit"
        raise InputError("executor", expected, quote(executor))
    return Pool(cast(Engine, executor), parts)


def part_of(count: int, index: int, parts: int) -> range:
    """Returns the indices in part `index`, from 0, of `count` things that are divided evenly."""
    return range(count * index // parts, count * (index + 1) // parts)


def part_with(count: int, position: int, parts: int) -> int:
    """Returns the index of the part that has a position, of those of `part_of`."""
    return ((position + 1) * parts - 1) // count


class _Outcome(NamedTuple):
    """What a worker returns: the result of a call, or its error.

    An error is a value here because executors change what a call raises. Submitit makes a text of
    it.
    """

    value: Untyped
    error: Exception | None


def call_on_workers(
    executor: Engine,
    function: Callable[[A], R],
    arguments: Sequence[A],
    packages: Sequence[str] = (),
) -> Iterator[tuple[int, R]]:
    """Calls a function with each argument on the workers of an executor.

    Yields (index, result) as the calls end. The function, the arguments and the results travel by
    pickle, the function by cloudpickle where it is installed. A worker loads the function once.
    When the iterator ends early, calls that have not started are cancelled.

    Args:
      executor: starts the calls.
      function: the function to call, which has one argument.
      arguments: one for each call.
      packages: whose versions are compared besides those of `installed_versions`.

    Raises:
      InputError: if the function cannot be pickled, the executor returns no futures, a worker has
        other versions or was forked after JAX started, or the function raised it.
      ConnectionError: if the executor lost a call.
    """
    # All calls have the same bytes, so that a worker loads the function once, see `_load`.
    payload, versions = _dump(function), installed_versions(*packages)
    # Submitit's executor has such a method, which makes one array of jobs.
    together = getattr(executor, "batch", nullcontext)
    running: dict[int, Future] = {}
    first, pause = 0, _SOON
    try:
        while first < len(arguments) or running:
            if fresh := range(first, min(first + _AT_ONCE - len(running), len(arguments))):
                with _naming_loss(first, len(arguments), "it to start"), together():
                    for index in fresh:
                        argument = pickle.dumps(arguments[index])
                        running[index] = _check_future(
                            executor.submit(_call, versions, payload, argument)
                        )
                first = fresh.stop
            raise_if_interrupted()
            # The loop asks instead of waiting, because not every executor has futures of
            # `concurrent.futures`.
            ended = [index for index, future in running.items() if future.done()]
            for index in ended:
                yield index, _read(running.pop(index), index, len(arguments))
            if ended:
                pause = _SOON
            else:
                time.sleep(pause)
                # Short parts return at once, and long ones are asked about less and less often.
                pause = min(2 * pause, _LATER)
    finally:
        for future in running.values():
            # A job of Submitit without a number, because SLURM refused it, raises. The error that
            # ended the loop says more.
            with suppress(Exception):
                future.cancel()


def _check_future(value: UserValue) -> Future:
    """Checks what an executor's `submit` returned."""
    if not all(callable(getattr(value, name, None)) for name in ("done", "result", "cancel")):
        expected = "submit to return a future with the methods done, result and cancel"
        raise InputError("executor", expected, quote(value))
    return cast(Future, value)


def _dump(function: Callable[[A], R]) -> bytes:
    """Pickles a function, which may hold functions of the user."""
    try:
        import cloudpickle
    except ImportError:
        dumps, hint = (
            pickle.dumps,
            "pip install cloudpickle, or define functions at the top level of a module",
        )
    else:
        dumps, hint = cloudpickle.dumps, ""
    try:
        return bytes(dumps(function))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError("executor", "functions that can be sent to workers", error, hint) from None


@lru_cache(maxsize=8)
def _load(payload: bytes) -> Callable[..., Untyped]:
    """Loads a function once in a worker.

    JAX would compile again for the functions of another copy.
    """
    try:
        return pickle.loads(payload)
    except ImportError as error:
        hint = "cloudpickle.register_pickle_by_value(module) sends a module's functions"
        raise InputError("", "the modules of your functions", error, hint) from None


def _call(versions: dict[str, str], payload: bytes, argument: bytes) -> _Outcome:
    """Runs on a worker, whose versions are checked before it loads the function.

    Another version may not be able to load it.
    """
    try:
        # JAX in a forked worker would hang instead of failing.
        check_not_forked()
        _check_versions(versions)
        function = _load(payload)
    except InputError as error:
        return _Outcome(None, error.within(f"worker {platform.node()}"))
    try:
        return _Outcome(function(pickle.loads(argument)), None)
    except _OURS as error:
        return _Outcome(None, _name_worker(error))
    except Exception as error:
        return _Outcome(None, _add_worker(error))


def _check_versions(expected: dict[str, str]) -> None:
    """Checks that this worker has the versions of the caller."""
    for name, version in installed_versions(*expected).items():
        if version != expected.get(name):
            raise InputError("", f"{name} {expected.get(name)}, as here", version)


def _name_worker(error: Exception) -> Exception:
    """Returns an error with the worker's name, unless the error is about the input."""
    worker = f"worker {platform.node()}"
    if isinstance(error, OSError) and error.errno is not None:
        place = worker if error.filename is None else f"{worker}: {error.filename}"
        return OSError(error.errno, error.strerror, place)
    if isinstance(error, MissingPackageError):
        return error.within(worker)
    if isinstance(error, OSError | NotEnoughMemoryError):
        return type(error)(f"{worker}: {error}")
    return error


def _add_worker(error: Exception) -> Exception:
    """Returns another error, such as one of the user's functions, with notes.

    The notes are the worker and the traceback there. An error that pickle cannot send becomes a
    `RuntimeError` with its type and message.
    """
    place = "".join(traceback.format_exception(error)).rstrip()
    worker = platform.node()
    try:
        # An error that cannot be loaded would look like a lost worker to the caller, so it is tried
        # here.
        error = pickle.loads(pickle.dumps(error))
    except Exception:
        # The error's class is the user's, and its pickling can fail in any way.
        error = RuntimeError(f"worker {worker}: {type(error).__name__}: {error}")
    error.__notes__ = [f"on the worker {worker}", place]
    return error


def _read(future: Future, index: int, count: int) -> Untyped:
    """Returns the result of a call, or raises its error."""
    with _naming_loss(index, count, "its result"):
        outcome = future.result()
        if not isinstance(outcome, _Outcome):
            got = quote(outcome)
            raise InputError("executor", "futures with the result of the submitted call", got)
        # Submitit raises in a job whose time is over.
        if outcome.error is not None and _is_loss(outcome.error):
            raise outcome.error
    if outcome.error is not None:
        raise outcome.error
    return outcome.value


@contextmanager
def _naming_loss(index: int, count: int, expected: str) -> Iterator[None]:
    """Makes an executor's own errors one line.

    They come from workers without this package, or from lost workers and jobs.
    """
    try:
        yield
    except ImportError as error:
        package = f"elitelanes_jax {installed_versions()['elitelanes_jax']} on all workers"
        raise InputError("executor", package, error) from None
    except Exception as error:
        if not _is_loss(error):
            raise
        words = shorten(f"{type(error).__name__}: {error}", 200)
        raise ConnectionError(
            f"part {index + 1} of {count}: expected {expected}, but the executor lost it: {words}"
        ) from None


def _is_loss(error: Exception) -> bool:
    """Tells whether an error says that an executor lost a worker or a job, or was shut down."""
    if isinstance(error, RuntimeError) and "after shutdown" in str(error):
        return True
    kinds = {(kind.__module__.partition(".")[0], kind.__name__) for kind in type(error).__mro__}
    return isinstance(error, BrokenExecutor | CancelledError) or not kinds.isdisjoint(_LOST)
