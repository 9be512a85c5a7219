"""The options ``--dask`` and ``--slurm``, and the executors that they open."""

import argparse
import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import which

from elitelanes_jax._util.checks import name, whole
from elitelanes_jax._util.engine import Engine, Pool
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.folders import remove
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax.cli.arguments import checked_by

# Seconds that a scheduler has to answer; with the start of the command at most ten.
_ANSWER = 6


def add_executors(command: argparse.ArgumentParser) -> None:
    """Adds the options of a command whose work a cluster may share."""
    either = command.add_mutually_exclusive_group()
    either.add_argument(
        "--dask",
        type=checked_by(name),
        metavar="ADDRESS",
        help="share the work among the workers of a Dask scheduler",
    )
    either.add_argument(
        "--slurm",
        type=checked_by(name),
        metavar="OPTIONS",
        help="share the work among jobs of SLURM, by Submitit, with its options, such as 'cpus_per_task=4 "
        "timeout_min=60 slurm_partition=short'; cluster=local starts processes here",
    )
    command.add_argument(
        "--parts",
        type=checked_by(whole(1)),
        metavar="N",
        help="with --dask or --slurm, the number of parts to divide the work into; by default up to 32 seeds or 250 "
        "pictures each",
    )


@contextmanager
def open_pool(options: argparse.Namespace) -> Iterator[Pool | None]:
    """Opens the executor that the options name, and closes it at the end of its block; None without one."""
    if options.dask is not None:
        with _open_dask(options.dask) as executor:
            yield Pool(executor, options.parts)
    elif options.slurm is not None:
        jobs = options.out.absolute().parent / f".{options.out.name}-jobs"
        yield Pool(_open_submitit(options.slurm, jobs), options.parts)
        remove(jobs)  # after an error its logs stay
    elif options.parts is not None:
        raise InputError("--parts: expected --dask or --slurm with it, got neither")
    else:
        yield None


@contextmanager
def _open_dask(address: str) -> Iterator[Engine]:
    distributed = import_optional("distributed", "--dask needs Dask", "dask distributed")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are one line of ours
    try:
        client = distributed.Client(address, timeout=_ANSWER)
    except (OSError, ValueError, TypeError) as error:
        expected = "expected the address of a Dask scheduler that answers, such as tcp://host:8786"
        raise InputError(
            f"--dask: {expected}, got {address!r}: {shorten(str(error), 100)}"
        ) from None
    with client:
        yield client.get_executor()


def _open_submitit(text: str, jobs: Path) -> Engine:
    submitit = import_optional("submitit", "--slurm needs Submitit", "submitit")
    values: dict[str, str | int] = {}
    for word in text.split():
        option, equals, value = word.partition("=")
        if not option.isidentifier() or not equals:
            raise InputError(
                f"--slurm: expected options of Submitit such as timeout_min=60, got {word!r}"
            )
        values[option] = int(value) if re.fullmatch(r"\d+", value) else value
    cluster = values.pop("cluster", "slurm")
    if cluster == "slurm" and which("sbatch") is None:
        raise InputError(
            "--slurm: expected SLURM's program sbatch on the PATH, got none; cluster=local needs none"
        )
    try:
        executor = submitit.AutoExecutor(jobs, cluster=cluster)
        executor.update_parameters(**values)
    except (NameError, TypeError, ValueError, AssertionError) as error:
        raise InputError(
            f"--slurm: expected options of Submitit, got {shorten(str(error), 200)}"
        ) from None
    return executor
