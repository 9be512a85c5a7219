"""Compiled programs of this process: counts those that are compiled, and frees them."""

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import jax

__all__ = ["QUICK_FLAGS", "compilations", "forget_programs", "free_programs"]

# A test runs a program a few times, so compiling sooner is worth more than speed. Without optimisation and MLIR it
# takes half the time, for the same results. Passes that make loops faster took a tenth of the rest.
_LOOP_PASSES = "simplify-while-loops,while-loop-invariant-code-motion,while-loop-constant-sinking"
QUICK_FLAGS = f"--xla_cpu_parallel_codegen_split_count=1 --xla_disable_hlo_passes={_LOOP_PASSES}"
if (0, 8) <= jax.__version_info__ < (0, 11):
    QUICK_FLAGS += " --xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
else:
    # At level 0, other compilers round in another way in a batch than alone, and at level 1, JAX 0.7 crashes while it
    # compiles an environment. New ones refuse the emitters' flag.
    QUICK_FLAGS += f" --xla_backend_optimization_level={2 if jax.__version_info__ < (0, 8) else 1}"

# The most programs in memory. Each takes memory mappings, and a process has 65,530 of them.
_MOST_PROGRAMS = 100

_compiled: list[str] = []
_in_memory: list[str] = []


def _count(event: str, _: float, **__: object) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        _compiled.append(event)
        _in_memory.append(event)


jax.monitoring.register_event_duration_secs_listener(_count)


@contextmanager
def compilations() -> Iterator[list[str]]:
    """A list that has an entry for each program compiled within the block."""
    _compiled.clear()
    yield _compiled


def forget_programs() -> None:
    """Forgets the programs of JAX and of searches: as in a new process, none is known."""
    from elitelanes_jax.search import _programs

    jax.clear_caches()
    _programs._find.cache_clear()


def free_programs() -> None:
    """Forgets all programs, and returns their memory to the system if they are many.

    Collecting garbage takes a third of a second, so it is not done after each module.
    """
    forget_programs()
    if len(_in_memory) < _MOST_PROGRAMS:
        return
    _in_memory.clear()
    gc.collect()
    with suppress(OSError, AttributeError):  # not every system has glibc, which keeps freed memory unless it is told
        ctypes.CDLL("libc.so.6").malloc_trim(0)
