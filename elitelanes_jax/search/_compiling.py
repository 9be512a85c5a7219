"""Compiled programs of a search: loaded from a file, or compiled.

A program is compiled at a level of optimisation: a longer search is worth a longer compilation.
"""

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import Pytree, Untyped
from elitelanes_jax.search.compile_cache import announce_refused, load, save

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

_HIGHEST = len(_OPTIONS) - 1

# The most cells that searches evaluate with a program of level 0 and of level 1. For 12 x 12 tiles,
# compiling for level 1 and 2 takes 1.4 s and 3.5 s more of processor time than for level 0. In
# exchange, each million cells take 0.4 s to 1.2 s less, and at level 2 another 0.007 s to 0.018 s
# less.
_MOST_CELLS = (2_500_000, 160_000_000)

# The options that this version of XLA does not know.
_unknown_options: set[str] = set()


class ProgramKey(NamedTuple):
    """What distinguishes the compiled programs of one search.

    Attributes:
      program: the name of the program.
      device: the device that runs the program.
      level: the level of optimisation.
    """

    program: str
    device: jax.Device
    level: int

    @property
    def in_file(self) -> tuple[str, int, int]:
        """The key in a file, with the index of the device."""
        return self.program, self.device.id, self.level


class StoredPrograms(NamedTuple):
    """The content of a file.

    Attributes:
      facts: what else is known of the search; None if there is no file.
      programs: by `ProgramKey.in_file`, what `jax.experimental.serialize_executable` makes of a
        compiled program.
    """

    facts: Untyped = None
    programs: Mapping[tuple[str, int, int], tuple[Untyped, ...]] = {}


class CompiledPrograms:
    """The compiled programs of one search.

    Args:
      file: the file of the programs; None to keep none.
      floats: whether the user's functions compute with floats.
    """

    def __init__(self, file: Path | None, floats: bool) -> None:
        self._file = file
        self._floats = floats
        self._stored = StoredPrograms()
        if file is not None:
            self._stored = load(file) or StoredPrograms()
        # The programs with their levels, by name and device.
        self._programs: dict[tuple[str, jax.Device], tuple[int, Callable[..., Pytree]]] = {}

    @property
    def facts(self) -> Untyped:
        """What else the file has of the search, or None."""
        return self._stored.facts

    def run(self, program: str, device: jax.Device, *arguments: Pytree) -> Pytree:
        """Runs a program, and waits for its results."""
        _, call = self._programs[program, device]
        return jax.block_until_ready(call(*arguments))

    def add(
        self,
        cells: Mapping[tuple[str, jax.Device], int],
        lower: Callable[[str, jax.Device], jax.stages.Lowered],
        facts: Untyped,
    ) -> None:
        """Loads or compiles programs that are missing, side by side.

        Args:
          cells: the number of cells that a program evaluates, by its name and device. The largest
            program is first: it compiles while the others are lowered.
          lower: lowers a program for a device.
          facts: what else to write to the file.
        """
        missing = []
        for (program, device), count in cells.items():
            level, _ = self._programs.get((program, device), (-1, None))
            # At level 0 a sum with a product is rounded twice, at higher levels once.
            least = _HIGHEST if self._floats else least_level(device.platform, count)
            if level < least:
                missing.append(ProgramKey(program, device, least))
        missing = self._load(missing)
        if missing:
            self._compile(missing, lower, facts)

    def _load(self, keys: Sequence[ProgramKey]) -> list[ProgramKey]:
        """Loads the programs that the file has; returns the keys of the others."""
        stored = self._stored.programs
        stored_keys = [key for key in keys if key.in_file in stored]
        if not stored_keys:
            return [*keys]
        calls = []
        for key in stored_keys:
            load_program = partial(deserialize_and_load, execution_devices=[key.device])
            calls.append(partial(load_program, *stored[key.in_file]))
        try:
            programs = side_by_side(calls, wait=False)
        except Exception as error:
            # JAX raises errors of any type. The file is then written anew.
            assert self._file is not None
            announce_refused(self._file, error)
            self._stored = StoredPrograms()
            return [*keys]
        self._keep(stored_keys, programs)
        return [key for key in keys if key not in stored_keys]

    def _compile(
        self,
        keys: Sequence[ProgramKey],
        lower: Callable[[str, jax.Device], jax.stages.Lowered],
        facts: Untyped,
    ) -> None:
        """Compiles programs, and writes them to the file.

        An interruption does not wait for the threads that compile.
        """
        # A generator, so that this thread lowers a program while the programs before it compile in
        # other threads. This thread may have settings of JAX of its own.
        calls = (partial(compile_at, lower(key.program, key.device), key.level) for key in keys)
        programs = side_by_side(calls, wait=False)
        self._keep(keys, programs)
        if self._file is not None:
            # The file may have other programs: a search that continues a state does not start.
            stored = dict(self._stored.programs)
            for key, program in zip(keys, programs, strict=True):
                stored[key.in_file] = serialize(program)
            self._stored = StoredPrograms(facts, stored)
            save(self._file, self._stored)

    def _keep(self, keys: Sequence[ProgramKey], programs: Sequence[Callable[..., Pytree]]) -> None:
        for key, program in zip(keys, programs, strict=True):
            self._programs[key.program, key.device] = key.level, program


def least_level(platform: str, cells: int) -> int:
    """Returns the level of optimisation for a number of evaluated cells.

    On a GPU or TPU it is the highest level. For a GPU, level 0 compiles in four fifths of the time
    of level 2.
    """
    return bisect_left(_MOST_CELLS, cells) if platform == "cpu" else _HIGHEST


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
