"""Runs whose seeds are searched in parts on other processes: on any executor, or on the workers of a Dask cluster."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.packages import import_optional, installed_versions
from elitelanes_jax._util.progress import Progress, announce
from elitelanes_jax._util.records import record
from elitelanes_jax._util.types import Pytree
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps._parts import join_parts
from elitelanes_jax.maps.folder import RECORD, foreign_to_maps
from elitelanes_jax.maps.generation import generate
from elitelanes_jax.maps.run import plan_run, write_run
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.search.compile_cache import use_compile_cache

T = TypeVar("T")

# Fewer seeds do not keep the cores of a worker busy.
_SEEDS_A_PART = 16

_SECONDS_TO_ANSWER = 10


def generate_on(executor: Executor, spec: GenerateSpec, out: Path, *, force: bool = False) -> list[RoadMap]:
    """Evolves maps on an executor's workers, and writes the folder that `generate` writes, byte for byte.

    The seeds are searched in parts of 16. After an error, an interruption or a kill, the same call runs only the
    missing parts, and resumes the started ones.

    Args:
      executor: of processes or machines that share the disk with this process.
      spec: of the search and the folder, without a part.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: as `generate`, or for a specification with a part.
      NotEnoughMapsError: if there are fewer valid and different maps than requested.
      OSError: if the folder cannot be written, or a worker fails.
    """
    spec, out = check_named("spec", record(GenerateSpec), spec), check_named("out", path, out)
    if spec.part is not None:
        raise InputError("part: expected none, because workers run all the parts, got {}/{}".format(*spec.part))
    plan_run(spec)  # checks it
    inputs = [spec.tiles] if spec.tiles else []
    settings = {"command": "generate on workers", "settings": spec.to_plain(), "versions": installed_versions()}
    with output_folder(out, settings, inputs=inputs, foreign=foreign_to_maps, force=force) as work:
        count = -(-spec.seeds // _SEEDS_A_PART)
        parts = {work.kept / str(index): spec.replace(part=(index, count)) for index in range(1, count + 1)}
        _run_parts(executor, parts)
        return write_run(work.files, join_parts([*parts]))


def _run_parts(executor: Executor, parts: Mapping[Path, GenerateSpec]) -> None:
    waiting = {folder: spec for folder, spec in parts.items() if not (folder / RECORD).exists()}
    announce(f"searching {pluralize(len(waiting), 'part')} of {len(parts)} on workers")
    jobs = {f"part {folder.name} of {len(parts)}": (spec, folder.absolute()) for folder, spec in waiting.items()}
    with Progress("searching", len(parts), "parts", done=len(parts) - len(waiting)) as bar:
        run_on(executor, _run_part, jobs, lambda _: bar.count())


def run_on(
    executor: Executor,
    function: Callable[..., T],
    jobs: Mapping[str, tuple[Pytree, ...]],
    ended: Callable[[T], None],
) -> None:
    """Calls a function on an executor's workers, once for each job.

    An error or an interruption cancels the jobs that have not started.

    Args:
      executor: of threads, processes or machines.
      function: takes the arguments of a job. The function and the arguments can be pickled.
      jobs: the arguments, by a name for messages.
      ended: called in this thread with each result when its job ends.

    Raises:
      ConnectionError: if a worker dies, or lacks a module.
      InputError, NotEnoughMapsError, OSError: of the function.
    """
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


def _run_part(spec: GenerateSpec, folder: Path) -> None:
    """Runs a part on a worker, unless a lost worker has completed it."""
    use_compile_cache()
    if not (folder / RECORD).exists():
        generate(spec, folder)


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
