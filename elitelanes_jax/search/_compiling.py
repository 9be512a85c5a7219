"""The programs of a search: traced, and compiled or loaded from a file.

A program is compiled at a level of optimisation: a longer search is worth a longer compilation.
"""

import gc
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import RLock
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import Pytree, Untyped
from elitelanes_jax.network.bits import default_draws
from elitelanes_jax.search._setup import Setup
from elitelanes_jax.search.compile_cache import announce_refused, load, save, unique_prefix

START, ADVANCE, COLLECT = "start", "advance", "collect"
"""The names of the programs, which are methods of `Setup`."""

Jitted: TypeAlias = Untyped
"""What `jax.jit` returns; JAX has no public name for its type."""

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

# A thread that traces one thing may trace another on the way: a program needs the facts.
_tracing_lock = RLock()


class SearchFacts(NamedTuple):
    """What is known of a search once its optimiser was traced.

    Attributes:
      evaluations_per_step: the evaluations of a generation of one seed.
      first_generation: the first generation after the start, see `Optimizer`.
      states: the shapes and dtypes of the states of a part.
    """

    evaluations_per_step: int
    first_generation: int
    states: Pytree


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
      facts: the facts of the search; None without a file.
      programs: by `ProgramKey.in_file`, what `jax.experimental.serialize_executable` makes of a
        compiled program.
    """

    facts: SearchFacts | None = None
    programs: Mapping[tuple[str, int, int], tuple[Untyped, ...]] = {}


class CompiledPrograms:
    """The programs of a setup, for arguments of given shapes.

    Args:
      setup: the setup; only its structure, and the shapes and dtypes of its numbers, matter.
      keys: the data of the keys of all seeds; only its shape and dtype matter.
      rows: the number of seeds of the programs that start and advance a search.
      floats: whether the user's functions compute with floats. Then all programs have the highest
        level: at level 0 a sum with a product is rounded twice, at higher levels once.
      file: the file that the programs are kept in, or None.
    """

    def __init__(
        self,
        setup: Setup,
        keys: jax.ShapeDtypeStruct,
        rows: int,
        floats: bool,
        file: Path | None,
    ) -> None:
        self._setup, self._seeds, self._floats = setup, len(keys), floats
        self._keys = jax.ShapeDtypeStruct((rows, *keys.shape[1:]), keys.dtype)
        self._file, prefix, stored = file, "", StoredPrograms()
        if file is not None:
            prefix, stored = unique_prefix(), load(file) or stored
        self._facts, self._stored = stored
        # All programs keep unused arguments, so that they take the same numbers, whatever their
        # optimiser reads.
        self._jitted: dict[str, Jitted] = {}
        for name in (START, ADVANCE, COLLECT):
            function: Untyped = partial(getattr(Setup, name))
            function.__name__ = prefix + name
            self._jitted[name] = jax.jit(function, keep_unused=True)
        # The compiled programs with their levels, by name and device.
        self._programs: dict[tuple[str, jax.Device], tuple[int, Callable[..., Pytree]]] = {}

    # Not a cached property, because Python 3.11 computes one cached property at a time, of whatever
    # object. A thread which traces and a thread which waits to trace would wait for each other.
    @property
    def facts(self) -> SearchFacts:
        """What is known of the search. Traces the optimiser unless the file has it."""
        if self._facts is None:
            with _tracing():
                self._facts = self._trace_facts()
        return self._facts

    @property
    def states(self) -> Pytree:
        """The shapes and dtypes of the states of all seeds."""
        return jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct((self._seeds, *leaf.shape[1:]), leaf.dtype),
            self.facts.states,
        )

    # Whatever the setting `jax_disable_jit` is: without `jit` JAX refuses to run compiled programs.
    @runs_jax
    @jax.disable_jit(False)
    def run(self, program: str, device: jax.Device, *arguments: Pytree) -> Pytree:
        """Runs a program, and waits for its results."""
        _, call = self._programs[program, device]
        return jax.block_until_ready(call(*arguments))

    def prepare(self, cells: Mapping[tuple[str, jax.Device], int]) -> None:
        """Loads or compiles programs that are missing, side by side.

        Args:
          cells: the number of cells that a program evaluates, by its name and device. The largest
            program is first: it compiles while the others are lowered.
        """
        missing = []
        for (program, device), count in cells.items():
            level, _ = self._programs.get((program, device), (-1, None))
            least = _HIGHEST if self._floats else least_level(device.platform, count)
            if level < least:
                missing.append(ProgramKey(program, device, least))
        missing = self._load(missing)
        if missing:
            self._compile(missing)

    def _load(self, keys: Sequence[ProgramKey]) -> list[ProgramKey]:
        """Loads the programs that the file has; returns the keys of the others."""
        stored_keys = [key for key in keys if key.in_file in self._stored]
        if not stored_keys:
            return [*keys]
        calls = []
        for key in stored_keys:
            load_program = partial(deserialize_and_load, execution_devices=[key.device])
            calls.append(partial(load_program, *self._stored[key.in_file]))
        try:
            programs = side_by_side(calls, wait=False)
        except Exception as error:
            # JAX raises errors of any type. The file is then written anew.
            assert self._file is not None
            announce_refused(self._file, error)
            self._stored = {}
            return [*keys]
        self._keep(stored_keys, programs)
        return [key for key in keys if key not in stored_keys]

    def _compile(self, keys: Sequence[ProgramKey]) -> None:
        """Compiles programs, and writes them to the file.

        An interruption does not wait for the threads that compile.
        """
        # A generator, so that this thread lowers a program while the programs before it compile in
        # other threads. This thread may have settings of JAX of its own.
        calls = (partial(compile_at, self._lower(key), key.level) for key in keys)
        programs = side_by_side(calls, wait=False)
        self._keep(keys, programs)
        if self._file is not None:
            # The file may have other programs: a search that continues a state does not start.
            stored = dict(self._stored)
            for key, program in zip(keys, programs, strict=True):
                stored[key.in_file] = serialize(program)
            self._stored = stored
            save(self._file, StoredPrograms(self.facts, stored))

    def _keep(self, keys: Sequence[ProgramKey], programs: Sequence[Callable[..., Pytree]]) -> None:
        for key, program in zip(keys, programs, strict=True):
            self._programs[key.program, key.device] = key.level, program

    def _lower(self, key: ProgramKey) -> jax.stages.Lowered:
        """Lowers a program for its device."""
        sharding = None
        # Arguments on the default device are not bound to it, and the program has to expect them as
        # they come.
        if key.device != jax.local_devices()[0]:
            sharding = jax.sharding.SingleDeviceSharding(key.device)
        bind = partial(jax.ShapeDtypeStruct, sharding=sharding)
        arguments = jax.tree.map(
            lambda leaf: bind(leaf.shape, leaf.dtype), self._arguments(key.program)
        )
        with _tracing():
            return self._jitted[key.program].lower(*arguments)

    def _arguments(self, program: str) -> tuple[Pytree, ...]:
        """Returns the shapes and dtypes of the arguments of a program."""
        if program == START:
            return self._setup, self._keys
        if program == COLLECT:
            return self._setup, self.states
        generation = jax.ShapeDtypeStruct((), jnp.int32)
        return self._setup, self._keys, self.facts.states, generation, generation

    def _trace_facts(self) -> SearchFacts:
        evaluations_per_step = first_generation = 0

        # An optimiser can only be made from numbers. This function is traced with their shapes
        # alone. The facts do not depend on numbers, and leave the function as variables.
        def read_optimizer(setup: Setup) -> None:
            nonlocal evaluations_per_step, first_generation
            optimizer = setup.make_optimizer()
            name = "optimizer: evaluations_per_step"
            evaluations_per_step = check_named(name, whole(1), optimizer.evaluations_per_step)
            first_generation = optimizer.first_generation

        jax.eval_shape(read_optimizer, self._setup)
        states = self._jitted[START].eval_shape(*self._arguments(START))
        # JAX adds the devices, which differ between parts.
        states = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), states)
        return SearchFacts(evaluations_per_step, first_generation, states)


@contextmanager
def _tracing() -> Iterator[None]:
    """Lets one thread trace at a time, without Python's garbage collector.

    Threads that trace at once take turns, and all their programs come late. Tracing makes many
    lasting objects; the collector takes a tenth of the time to look through them. The user's
    functions draw as by default, so that a search can be continued under other settings of JAX.
    Without `jit` JAX would write every generation into the program, which then compiles for
    minutes.
    """
    with _tracing_lock, default_draws(), jax.disable_jit(False):
        collects = gc.isenabled()
        try:
            gc.disable()
            yield
        finally:
            if collects:
                gc.enable()


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
