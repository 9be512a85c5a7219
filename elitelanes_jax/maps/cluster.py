"""A run whose seeds are searched elsewhere, in parts: by any executor, or by the workers of a Dask cluster."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, many
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.packages import import_optional, installed_versions
from elitelanes_jax._util.progress import Progress, announce
from elitelanes_jax._util.records import record
from elitelanes_jax._util.types import Pytree
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps._parts import RECORD
from elitelanes_jax.maps.folder import foreign_to_maps
from elitelanes_jax.maps.generation import check_drawable, generate, inputs_of, write_joined
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.search.compile_cache import use_compile_cache

T = TypeVar("T")

# Fewer seeds side by side do not keep the cores of a worker busy.
_SEEDS_A_PART = 16

_SECONDS_TO_ANSWER = 10


def generate_on(executor: Executor, spec: GenerateSpec, out: Path, *, force: bool = False) -> list[RoadMap]:
    """Evolves maps on an executor's workers and writes the folder that `generate` writes, byte for byte.

    The seeds are cut into parts of 16. The parts that are done are kept beside the folder until it is there: after an
    error, an interruption or a kill the same call runs those that are missing, and goes on within them.

    Args:
      executor: of processes or machines that share the disk with this one.
      spec: of the search and the folder, without a part.
      out: the folder, new or empty.
      force: whether a folder that an earlier run wrote, and nobody else wrote to, is replaced.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: as `generate` does, or for a specification with a part.
      NotEnoughMapsError: if there are fewer valid and different maps than asked for.
      OSError: if the folder cannot be written, or a worker fails.
    """
    spec, out = check_named("spec", record(GenerateSpec), spec), check_named("out", path, out)
    if spec.part is not None:
        raise InputError("part: expected none where workers run all the parts, got {}/{}".format(*spec.part))
    check_drawable(spec)
    count = -(-spec.seeds // _SEEDS_A_PART)
    settings = {"command": "generate on workers", "settings": spec.to_plain(), "versions": installed_versions()}
    with output_folder(out, settings, inputs=inputs_of(spec), foreign=foreign_to_maps, force=force) as work:
        parts = [work.kept / str(number) for number in range(1, count + 1)]
        _run_parts(executor, {part: spec.replace(part=(int(part.name), count)) for part in parts})
        return write_joined(parts, work.files)


def _run_parts(executor: Executor, specs: dict[Path, GenerateSpec]) -> None:
    """Runs the parts that are not yet done."""
    waiting = {folder: spec for folder, spec in specs.items() if not (folder / RECORD).exists()}
    announce(f"searching {many(len(waiting), 'part')} of {len(specs)} on workers")
    jobs = {f"part {folder.name} of {len(specs)}": (spec, folder.absolute()) for folder, spec in waiting.items()}
    with Progress("searching", len(specs), "parts", done=len(specs) - len(waiting)) as bar:
        run_on(executor, _run_part, jobs, lambda _: bar.count())


def run_on(
    executor: Executor,
    function: Callable[..., T],
    jobs: Mapping[str, tuple[Pytree, ...]],
    ended: Callable[[T], None],
) -> None:
    """Calls a function on an executor's workers, once for each job.

    What is not begun at an error or an interruption is called off.

    Args:
      executor: of threads, processes or machines.
      function: takes a job's arguments; it and they can be pickled.
      jobs: the arguments, by a name for messages.
      ended: is called in this thread with what each job returns, as soon as it does.

    Raises:
      ConnectionError: if a worker dies, or cannot import what it needs.
      InputError, NotEnoughMapsError, OSError: as the function raises it.
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
    """Runs one part on a worker, unless a worker that was lost has done it."""
    use_compile_cache()
    if not (folder / RECORD).exists():
        generate(spec, folder)


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Connects to a Dask cluster; a part whose worker dies is given to another one.

    Args:
      address: of its scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises:
      MissingPackageError: without Dask.
      InputError: if no scheduler answers there.
    """
    distributed = import_optional("distributed", "a cluster needs Dask", "distributed")
    try:
        client = distributed.Client(address, timeout=_SECONDS_TO_ANSWER)
    except (OSError, ValueError, TypeError) as error:
        expected = "expected the address of a Dask scheduler, such as tcp://10.0.0.1:8786"
        raise InputError(f"scheduler: {expected}, got {address!r}: {error}") from None
    with client:
        yield client.get_executor()
