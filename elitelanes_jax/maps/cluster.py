"""Work on other processes: on any executor, or on the workers of a Dask cluster."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager
from typing import TypeVar

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, shorten
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Pytree

T = TypeVar("T")

_SECONDS_TO_ANSWER = 10


def run_on(
    executor: Executor,
    function: Callable[..., T],
    jobs: Mapping[str, tuple[Pytree, ...]],
    ended: Callable[[T], None],
) -> None:
    """Calls a function on an executor's workers, once with the arguments of each job; jobs have names for messages.

    `ended` is called in this thread with each result when its job ends. An error or an interruption cancels the jobs
    that have not started. Raises the errors of the function, and `ConnectionError` if a worker dies or lacks a module.
    """
    if not hasattr(executor, "submit"):
        raise InputError(f"executor: expected one of concurrent.futures, got {shorten(repr(executor))}")
    futures = {executor.submit(function, *arguments): name for name, arguments in jobs.items()}
    try:
        for future in as_completed(futures):
            try:
                value = future.result()
            except (InputError, NotEnoughMapsError, OSError):
                raise
            except Exception as error:
                raise ConnectionError(
                    f"{futures[future]}: expected a worker to run it, got {type(error).__name__}: {error}"
                ) from None
            ended(value)
    finally:
        for future in futures:
            future.cancel()


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Connects to a Dask cluster by the address of its scheduler, such as ``tcp://10.0.0.1:8786``.

    If a worker dies, another one runs its part.

    Raises:
      MissingPackageError: without Dask.
      InputError: if no scheduler answers at the address.
    """
    distributed = import_optional("distributed", "a cluster needs Dask", "distributed")
    try:
        client = distributed.Client(address, timeout=_SECONDS_TO_ANSWER)
    except (OSError, ValueError, TypeError) as error:
        expected = "expected the address of a Dask scheduler, such as tcp://10.0.0.1:8786"
        raise InputError(f"scheduler: {expected}, got {address!r}: {error}") from None
    with client:
        yield client.get_executor()
