"""How far the programs of a search are optimised: a longer search is worth a longer compilation."""

from bisect import bisect_left

import jax

# The options of the compiler by level. Level 2 is XLA's usual one. Level 1 compiles in two thirds
# of the time and runs 1.1 to 1.5 times as long, level 0 compiles in a third and runs 12 to 18 times
# as long.
_OPTIONS: tuple[dict[str, str | bool], ...] = (
    {
        "xla_backend_optimization_level": "0",
        "xla_cpu_use_fusion_emitters": False,
        # Takes 15 % less processor time than the usual 32 parts for LLVM.
        "xla_cpu_parallel_codegen_split_count": "2",
    },
    {"xla_backend_optimization_level": "1", "xla_cpu_use_fusion_emitters": False},
    {},
)

LEVELS = len(_OPTIONS)
"""The number of levels of optimisation."""

# The most cells that searches evaluate with a program of level 0 and of level 1. For 12 x 12 tiles,
# compiling for level 1 and 2 takes 1.4 s and 3.5 s more of processor time than for level 0. In
# exchange, each million cells take 0.4 s to 1.2 s less, and at level 2 another 0.007 s to 0.018 s
# less.
_MOST_CELLS = (2_500_000, 160_000_000)

# The options that this version of XLA does not know.
_unknown_options: set[str] = set()


def least_level(platform: str, cells: int) -> int:
    """Returns the level of optimisation for a number of evaluated cells.

    On a GPU or TPU it is the highest level. For a GPU, level 0 compiles in four fifths of the time
    of level 2.
    """
    return bisect_left(_MOST_CELLS, cells) if platform == "cpu" else LEVELS - 1


def least_level_of_start(platform: str, cells: int) -> int:
    """Returns the level for a program that runs once, which is never worth the highest one."""
    return least_level(platform, min(cells, _MOST_CELLS[-1]))


def compile_at(lowered: jax.stages.Lowered, level: int) -> jax.stages.Compiled:
    """Compiles a program at a level of optimisation.

    The bits of its results are the same at all levels.
    """
    options = {
        name: value for name, value in _OPTIONS[level].items() if name not in _unknown_options
    }
    try:
        return lowered.compile(options or None)
    except Exception as error:
        # XLA raises errors of any type. It checks the options before it compiles.
        unknown = [name for name in options if name in str(error)]
        if not unknown:
            raise
        _unknown_options.update(unknown)
        return compile_at(lowered, level)
