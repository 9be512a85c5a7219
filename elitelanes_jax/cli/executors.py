"""The options ``--dask`` and ``--slurm``, and the executors that they open."""

import argparse
import asyncio
import logging
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import which
from types import ModuleType

from elitelanes_jax._util.checks import whole
from elitelanes_jax._util.engine import Engine, Pool
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.folders import locked, remove
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.cli.arguments import checked_by

# Seconds that a scheduler has to answer. The whole command fails within ten, also on a busy
# machine.
_ANSWER = 4

_ADDRESS = "the address of a Dask scheduler, such as tcp://host:8786"
_OPTIONS = "options of Submitit such as timeout_min=60"

# The options of Submitit that start several tasks in a job, with or without `slurm_` before them.
_TASKS = ("nodes", "tasks_per_node", "ntasks")

# The options of Submitit that are lists of commands or arguments.
_LISTS = ("setup", "teardown", "srun_args")


def _text_of(expected: str) -> Callable[[str], str]:
    """Makes a check for a text that is not blank."""

    def check(text: str) -> str:
        if not text.strip():
            raise InputError("", expected, repr(text))
        return text

    return check


def add_executors(command: argparse.ArgumentParser) -> None:
    """Adds the options of a command whose work a cluster may share."""
    either = command.add_mutually_exclusive_group()
    either.add_argument(
        "--dask",
        type=checked_by(_text_of(_ADDRESS)),
        metavar="ADDRESS",
        help="share the work among the workers of a Dask scheduler",
    )
    either.add_argument(
        "--slurm",
        type=checked_by(_text_of(_OPTIONS)),
        metavar="OPTIONS",
        help="share the work among jobs of SLURM, by Submitit, with its options, such as "
        "'cpus_per_task=4 timeout_min=60 slurm_partition=short'; "
        "cluster=local starts processes here",
    )
    command.add_argument(
        "--parts",
        type=checked_by(whole(1)),
        metavar="N",
        help="with --dask or --slurm, the number of parts to divide the work into; by default up "
        "to 32 seeds or 250 pictures each",
    )


@contextmanager
def open_pool(options: argparse.Namespace) -> Iterator[Pool | None]:
    """Opens the executor that the options name, and closes it at the end of its block.

    Yields None if the options name no executor.
    """
    if options.dask is not None:
        with _open_dask(options.dask) as executor:
            yield Pool(executor, options.parts)
    elif options.slurm is not None:
        # Submitit needs a folder that all hosts see. A temporary folder may belong to one host
        # alone, so the jobs are next to the output folder.
        jobs = options.out.absolute().parent / f".{options.out.name}-jobs"
        # Submitit and SLURM replace %j, %A and others in the names of their files by the job's
        # number, also in the names of folders.
        if "%" in str(jobs):
            raise InputError(
                "--slurm", "an output folder without % in its path", options.out.absolute()
            )
        # A second command for the same output folder must not remove the jobs of the first one.
        with locked(jobs, options.out, force=options.force), _keeping_logs(jobs):
            yield Pool(_open_submitit(options.slurm, jobs), options.parts)
    elif options.parts is not None:
        # Without an executor, this process does all the work, and parts would have no meaning.
        raise InputError("--parts", "--dask or --slurm with it", "neither")
    else:
        yield None


@contextmanager
def _open_dask(address: str) -> Iterator[Engine]:
    distributed = import_optional("distributed", "--dask needs Dask", "dask distributed")
    # Dask would log errors that the command says in one line.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        asyncio.run(_shake_hands(distributed, address))
        client = distributed.Client(address, timeout=_ANSWER)
    except Exception as error:
        # Another program at this address can answer anything.
        expected = "the address of a Dask scheduler that answers, such as tcp://host:8786"
        reason = shorten(str(error) or f"no answer in {_ANSWER} s", 100)
        raise InputError("--dask", expected, f"{address!r}: {reason}") from None
    with client:
        yield client.get_executor()


async def _shake_hands(distributed: ModuleType, address: str) -> None:
    """Connects to a scheduler and disconnects.

    Raises `TimeoutError` if another program at the address never answers. A client of Dask waits
    for that answer without a limit.
    """
    options = distributed.Security().get_connection_args("client")
    connection = distributed.comm.connect(address, timeout=_ANSWER, **options)
    (await asyncio.wait_for(connection, _ANSWER)).abort()


@contextmanager
def _keeping_logs(jobs: Path) -> Iterator[None]:
    """Removes Submitit's folder at the end of its block.

    The folder is kept if it has the logs of a job that was lost.
    """
    keeps = False
    try:
        yield
    except ConnectionError:
        # A job that SLURM refused has no logs.
        keeps = any(jobs.glob("*_log.*"))
        raise
    finally:
        if not keeps:
            remove(jobs)


def _open_submitit(text: str, jobs: Path) -> Engine:
    submitit = import_optional("submitit", "--slurm needs Submitit", "submitit")
    # Errors come as one line of this command instead of Submitit's log.
    logging.getLogger("submitit").setLevel(logging.CRITICAL)
    values: dict[str, Untyped] = {}
    try:
        # A value with spaces is quoted.
        words = shlex.split(text)
    except ValueError:
        raise InputError("--slurm", "quotes in pairs", repr(text)) from None
    # Options have the form name=value, as in Submitit's own functions.
    for word in words:
        option, _, value = word.partition("=")
        if not option.isidentifier() or not value:
            raise InputError("--slurm", _OPTIONS, repr(word))
        # Each task of a job would do the same part again.
        if option.endswith(_TASKS) and value != "1":
            raise InputError("--slurm", "one task for each job", word)
        if option in values:
            raise InputError("--slurm", "each option once", f"{option} again in {word!r}")
        values[option] = _value_of(option, value)
    # Submitit's own default is to run here if it finds no SLURM, which nobody asked for.
    cluster = values.pop("cluster", "slurm")
    # Submitit starts jobs with one of these programs, and their tasks with the other one.
    for program in ("sbatch", "srun"):
        if cluster == "slurm" and which(program) is None:
            raise InputError(
                "--slurm",
                f"SLURM's program {program} on the PATH",
                "none",
                "cluster=local needs none",
            )
    try:
        executor = submitit.AutoExecutor(jobs, cluster=cluster)
        executor.update_parameters(**values)
    except (NameError, TypeError, ValueError, AssertionError) as error:
        raise InputError("--slurm", "options of Submitit", shorten(str(error), 200)) from None
    return executor


def _value_of(option: str, text: str) -> UserValue:
    """Returns the value of an option: a list of one text, a truth value, a number, or the text."""
    # A list on the command line has one item, because a command may contain any separator.
    if option.endswith(_LISTS):
        return [text]
    # `bool("False")` is True, so truth values are read as words.
    if text in ("True", "False"):
        return text == "True"
    for kind in (int, float):
        with suppress(ValueError):
            # A text such as 007 is a name.
            if str(kind(text)) == text:
                return kind(text)
    return text
