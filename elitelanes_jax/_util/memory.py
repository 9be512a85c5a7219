"""The memory that this process can still use, and errors for too little memory."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_GROUPS = Path("/sys/fs/cgroup")


def free_memory() -> int:
    """Returns the bytes that this process can still use.

    They are limited by the machine, the container and the process's limit.
    """
    import psutil

    free = [psutil.virtual_memory().available, *_of_groups()]
    with suppress(ImportError, OSError):
        # Not every system has this module.
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            # This limit is on the address space, so it counts what is reserved and not only what is
            # used.
            free.append(limit - psutil.Process().memory_info().vms)
    return max(0, min(free))


def is_out_of_memory(error: BaseException) -> bool:
    """Returns whether an error of Python or XLA means too little memory."""
    words = str(error)
    return (
        isinstance(error, MemoryError)
        or "RESOURCE_EXHAUSTED" in words
        or "out of memory" in words.lower()
    )


def in_gigabytes(size: float) -> str:
    return f"{size / 1e9:,.1f} GB"


def _of_groups() -> Iterator[int]:
    """Yields the free bytes of the process's control groups.

    Containers and cluster jobs limit memory by these groups.
    """
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
        group = _GROUPS / next(line for line in lines if line.startswith("0::")).removeprefix(
            "0::/"
        )
        # A limit of a group holds for all groups in it.
        for folder in (group, *group.parents):
            if not folder.is_relative_to(_GROUPS):
                break
            with suppress(OSError, ValueError, StopIteration):
                # The word "max" instead of a number means no limit.
                limit = int((folder / "memory.max").read_text())
                taken = int((folder / "memory.current").read_text())
                stat = (folder / "memory.stat").read_text().splitlines()
                pages = next(line for line in stat if line.startswith("inactive_file "))
                # The system frees pages of files when memory is needed.
                yield limit - taken + int(pages.split()[1])
