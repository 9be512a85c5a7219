"""The memory of this machine that a program can still take, and errors that say that there is too little."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_GROUPS = Path("/sys/fs/cgroup")


def free_memory() -> int | None:
    """Returns the bytes that this process can still take: of the machine, of its container, under its own limit.

    Where the system does not tell what is free, it is what the machine has; None where it does not tell that either.
    """
    found = [*_of_machine(), *_of_groups(), *_under_limit()]
    return max(0, min(found)) if found else None


def is_out_of_memory(error: BaseException) -> bool:
    """Tells whether an error, of Python or of XLA, means that there is too little memory."""
    words = str(error)
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in words or "out of memory" in words.lower()


def in_gigabytes(number: float) -> str:
    """Returns a number of bytes in words."""
    return f"{number / 1e9:,.1f} GB"


def _of_machine() -> Iterator[int]:
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        yield 1024 * int(next(line for line in lines if line.startswith("MemAvailable:")).split()[1])
        return
    with suppress(AttributeError, OSError, ValueError):  # not on every system
        yield os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _of_groups() -> Iterator[int]:
    """Yields what is free in the control groups of the process, those of a container or of a job of a cluster."""
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
        group = _GROUPS / next(line for line in lines if line.startswith("0::")).removeprefix("0::/")
        for place in (group, *group.parents):
            if not place.is_relative_to(_GROUPS):
                break
            with suppress(OSError, ValueError, StopIteration):  # "max" is no limit
                most, taken = (int((place / f"memory.{name}").read_text()) for name in ("max", "current"))
                stat = (place / "memory.stat").read_text().splitlines()
                # Pages of files are given back when they are needed.
                yield most - taken + int(next(line for line in stat if line.startswith("inactive_file ")).split()[1])


def _under_limit() -> Iterator[int]:
    with suppress(ImportError, OSError, ValueError):
        import resource  # not on every system

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most != resource.RLIM_INFINITY:
            yield most - int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf(
                "SC_PAGE_SIZE"
            )
