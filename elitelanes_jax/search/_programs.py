"""The three programs of a search, which start it, advance it, and collect its elites.

| program | from | to | runs on |
|---|---|---|---|
| start | numbers, keys | states of generation 0 | one part of the seeds |
| advance | numbers, keys, states, first, last | states after `last`, a report per generation | one part |
| collect | numbers, states | elites with their metrics, states | all seeds |

Numbers are the leaves of a `Setup`: weights, limits and rates. Because they are arguments, searches
that differ in the values of numbers and keys, or in length, run the same programs. `find_programs`
keeps these `Programs` for later calls, by the structure of the setup.

A program goes through four forms. `_exportable` makes a function that JAX can trace. `_export`
traces it, or reads the trace from a file. `_lower` makes the compiler's input for one device.
`_compile` compiles it at a level of optimisation. A program that JAX has compiled is called with
the shapes that it was compiled for: the number of seeds in a part, or all seeds.

Programs of searches without functions of the user are also exported to disk, so that a later
process neither traces nor lowers them; see `_stored_programs`.
"""

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from threading import RLock
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32
from numpy.typing import DTypeLike

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import Plain, Pytree, Untyped
from elitelanes_jax.network.bits import default_draws
from elitelanes_jax.network.metrics import unstack_metrics
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.optimizers.base import Info
from elitelanes_jax.optimizers.loop import advance, check_elites, over_seeds, start
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.descriptor import compute_descriptor
from elitelanes_jax.problem.road import RoadProblem
from elitelanes_jax.search._compiling import LEVELS, compile_at, least_level, least_level_of_start
from elitelanes_jax.search._devices import part_rows
from elitelanes_jax.search._setup import KeyData, Setup
from elitelanes_jax.search._stored_programs import (
    StoredPrograms,
    announce_refused,
    find_file,
    find_folder,
    load,
    save,
    settings_of_thread,
)
from elitelanes_jax.search.elites import MeasuredElites

States: TypeAlias = tuple[Array | np.ndarray, ...]
"""The leaves of the optimiser's states, arrays ``[S, ...]``."""

Jitted: TypeAlias = Untyped
"""What `jax.jit` returns; JAX has no public name for its type."""

MOST_GENERATIONS = 256
"""The largest number of generations of one call."""

# The searches whose programs stay in memory. Each takes about 18 MB.
_MOST_SEARCHES = 64

_START, _ADVANCE, _COLLECT = "start", "advance", "collect"

# A thread that traces one thing may trace another on the way: the facts need the states.
_tracing_lock = RLock()

_with_jit = jax.disable_jit(False)
"""Runs JAX's `jit` whatever the setting `jax_disable_jit` is.

Without `jit` JAX refuses to run compiled programs.
"""


class ProgramKey(NamedTuple):
    """What distinguishes the compiled programs of one search.

    Attributes:
      program: start, advance or collect.
      device: the device that runs the program.
      level: the level of optimisation, see `_compiling`.
    """

    program: str
    device: jax.Device
    level: int


class SearchFacts(NamedTuple):
    """What is known of a search once its optimiser was traced.

    Attributes:
      evaluations_per_step: the evaluations of a generation of one seed.
      first_generation: the first generation after the start, see `Optimizer`.
      states: the shape and the dtype of each leaf of one seed's state.
    """

    evaluations_per_step: int
    first_generation: int
    states: tuple[tuple[tuple[int, ...], DTypeLike], ...]

    @classmethod
    def from_plain(cls, plain: Plain) -> "SearchFacts":
        states = []
        for shape, dtype in plain["states"]:
            states.append((tuple(shape), jnp.dtype(dtype)))
        return cls(plain["evaluations_per_step"], plain["first_generation"], tuple(states))

    def to_plain(self) -> dict[str, Plain]:
        """Returns plain values for JSON."""
        states = [(shape, str(dtype)) for shape, dtype in self.states]
        return self._asdict() | {"states": states}


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


class Programs:
    """The programs of a search, for arguments of given shapes; see `find_programs`.

    Args:
      setup: the setup of the search; only its structure, and the shapes and dtypes of its numbers,
        matter.
      keys: the data of the keys of all seeds; only its shape and dtype matter.
      single: whether there was one key alone, so that results have no axis of seeds.
      devices: the devices of the parts of the search.
      floats: whether the user's functions compute with floats.
      folder: the folder for exported programs, or None.
    """

    def __init__(
        self,
        setup: Setup,
        keys: jax.ShapeDtypeStruct,
        single: bool,
        devices: Sequence[jax.Device],
        floats: bool,
        folder: Path | None,
    ):
        self._numbers, self._structure = jax.tree.flatten(setup)
        self._problem = setup.problem
        self._keys = keys
        self._single = single
        self._floats = floats
        self._part_rows, part_count = part_rows(len(keys), devices)
        # Several parts on one device share its programs.
        self._devices = list(dict.fromkeys(devices[:part_count]))
        # The cells that this process has evaluated with these programs.
        self._evaluated_cells = 0
        self._compiled: dict[ProgramKey, Callable[..., Pytree]] = {}
        self._exports: dict[str, jax.export.Exported] = {}
        self._facts: SearchFacts | None = None
        self._traced_states: Pytree = None
        self._last_numbers: tuple[int, tuple[Array, ...]] | None = None
        self._file: Path | None = None
        self._stored: StoredPrograms | None = None
        # The name of a file has a digest of the package's sources. The user's sources are unknown.
        if folder is not None and not setup.has_user_functions():
            shapes = [(leaf.shape, str(leaf.dtype)) for leaf in self._numbers]
            shapes.append((keys.shape, str(keys.dtype)))
            self._file = find_file(folder, self._structure, shapes, single, self._part_rows)
        if self._file is not None:
            self._stored = load(self._file)

    # Not cached properties: Python 3.11 computes one of these at a time, of whatever object, so
    # that a thread which traces and a thread which waits to trace would wait for each other.
    @property
    def facts(self) -> SearchFacts:
        """What is known of the search. Traces the optimiser unless a file has it."""
        if self._facts is None and self._stored is not None:
            self._facts = SearchFacts.from_plain(self._stored.facts)
        if self._facts is None:
            with _tracing():
                self._facts = self._trace_facts()
        return self._facts

    @property
    def _state_tree(self) -> Pytree:
        """The shapes and dtypes of the states of a part, in the optimiser's structure."""
        if self._traced_states is None:
            with _tracing():
                start_all = _start_in_structure(self._structure)
                self._traced_states = start_all.eval_shape(*self._arguments(_START))
        return self._traced_states

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

        jax.eval_shape(read_optimizer, jax.tree.unflatten(self._structure, self._numbers))
        # The first axis is that of the seeds in a part.
        leaves = jax.tree.leaves(self._state_tree)
        states = tuple((leaf.shape[1:], leaf.dtype) for leaf in leaves)
        return SearchFacts(evaluations_per_step, first_generation, states)

    @property
    def states(self) -> tuple[jax.ShapeDtypeStruct, ...]:
        """The shapes and dtypes of the states of all seeds."""
        return self._states(len(self._keys))

    @property
    def memory(self) -> int:
        """The bytes of the states of all seeds."""
        return sum(leaf.size * leaf.dtype.itemsize for leaf in self.states)

    def put_numbers(self, setup: Setup, fingerprint: int) -> tuple[Array, ...]:
        """Puts the numbers of a setup on the default device.

        `fingerprint` differs for other numbers. Calls with equal numbers share one copy. Otherwise
        each program would copy them, which takes a millisecond.
        """
        # Searches in other threads may replace the attribute at any time, so it is read once.
        last_numbers = self._last_numbers
        if last_numbers is not None and last_numbers[0] == fingerprint:
            return last_numbers[1]
        numbers = jax.device_put(tuple(jax.tree.leaves(setup)))
        self._last_numbers = fingerprint, numbers
        return numbers

    def prepare(self, *, starts: bool, generations: int, counts: bool = True) -> None:
        """Compiles the programs for a run of some generations that are missing, side by side.

        How far they are optimised depends on the cells that the searches in this process have
        evaluated. The bits are the same. `counts` says whether this run counts among those
        searches.
        """
        height, width = self._problem.shape
        evaluations = generations * self.facts.evaluations_per_step * len(self._keys)
        cells = self._evaluated_cells + evaluations * height * width
        if counts:
            self._evaluated_cells = cells
        # The largest programs are first: they compile while the others are lowered.
        program_keys = []
        if generations:
            program_keys += [self._choose(_ADVANCE, device, cells) for device in self._devices]
        if starts:
            program_keys += [self._choose(_START, device, cells) for device in self._devices]
        # This program runs once for each result, so it counts as one that evaluates no cells.
        program_keys.append(self._choose(_COLLECT, jax.local_devices()[0], 0))
        missing_keys = [key for key in program_keys if key not in self._compiled]
        if missing_keys:
            self._compile(missing_keys)

    @runs_jax
    @_with_jit
    def start(self, device: jax.Device, numbers: Sequence[Array], keys: KeyData) -> States:
        """Returns the states of generation 0 of the seeds of a part."""
        return self._program(_START, device)(numbers, keys)

    @runs_jax
    @_with_jit
    def advance(
        self,
        device: jax.Device,
        numbers: Sequence[Array],
        keys: KeyData,
        states: States,
        first: int,
        last: int,
    ) -> tuple[States, Info]:
        """Runs the generations `first` to `last` of the seeds of a part.

        Waits for the end. See `loop.advance`.
        """
        program = self._program(_ADVANCE, device)
        results = program(numbers, keys, states, np.int32(first), np.int32(last))
        states, (best_fitness, elite_count, refused) = jax.block_until_ready(results)
        return states, Info(best_fitness, elite_count, refused)

    @runs_jax
    @_with_jit
    def collect(self, numbers: Sequence[Array], states: States) -> tuple[MeasuredElites, States]:
        """Returns the elites and the states; for one key alone, both without the axis of seeds."""
        # The program is missing if the compiler was interrupted.
        self.prepare(starts=False, generations=0)
        program = self._program(_COLLECT, jax.local_devices()[0])
        leaves, states = program(numbers, states)
        structure = _structure_of_elites(self._problem.measured)
        return jax.tree.unflatten(structure, leaves), states

    def _choose(self, program: str, device: jax.Device, cells: int) -> ProgramKey:
        """Returns the key of the compiled program to run.

        The program has the highest level that is compiled, if that level is high enough. Otherwise
        the key has the least level that is enough.
        """
        if program == _START:
            level = least_level_of_start(device.platform, cells)
        else:
            level = least_level(device.platform, cells)
        if self._floats:
            # At level 0 a sum with a product is rounded twice, at higher levels once.
            level = LEVELS - 1
        for higher_level in reversed(range(level, LEVELS)):
            key = ProgramKey(program, device, higher_level)
            if key in self._compiled:
                return key
        return ProgramKey(program, device, level)

    def _program(self, program: str, device: jax.Device) -> Callable[..., Pytree]:
        """Returns the compiled program of the highest level.

        Searches in other threads may have added one.
        """
        compiled_keys = []
        for level in range(LEVELS):
            key = ProgramKey(program, device, level)
            if key in self._compiled:
                compiled_keys.append(key)
        return self._compiled[compiled_keys[-1]]

    def _compile(self, keys: Sequence[ProgramKey]) -> None:
        """Compiles programs. An interruption does not wait for the threads that compile."""
        # A generator, so that this thread, which may have settings of JAX of its own, lowers a
        # program while the programs before it compile in other threads.
        calls = (partial(compile_at, self._lower(key), key.level) for key in keys)
        compiled_programs = side_by_side(calls, wait=False)
        self._compiled |= zip(keys, compiled_programs, strict=True)
        self._store()

    def _lower(self, key: ProgramKey) -> jax.stages.Lowered:
        """Lowers a program for a device."""
        # Arguments on the default device are not bound to it, see `_devices._put`, and the program
        # has to expect them as they come.
        sharding = None
        if key.device != jax.local_devices()[0]:
            sharding = jax.sharding.SingleDeviceSharding(key.device)
        with _tracing():
            if self._file is None:
                # Without a file, an export would only add a second lowering.
                program = self._exportable(key.program)
            else:
                # JAX finds what an earlier process compiled of the same export.
                program = jax.jit(self._export(key.program).call)
            arguments = jax.tree.map(partial(_shape_on, sharding), self._arguments(key.program))
            return program.lower(*arguments)

    def _export(self, program: str) -> "jax.export.Exported":
        """Returns the export of a program: that of the file, if it has one."""
        from jax import export

        if program in self._exports:
            return self._exports[program]
        if self._stored is not None and program in self._stored.exports:
            try:
                self._exports[program] = export.deserialize(
                    bytearray(self._stored.exports[program])
                )
            except Exception as error:
                # JAX raises errors of any type.
                assert self._file is not None
                announce_refused(self._file, error)
                # `_store` then replaces the file.
                self._stored = None
        if program not in self._exports:
            export_program = export.export(self._exportable(program))
            self._exports[program] = export_program(*self._arguments(program))
        return self._exports[program]

    def _store(self) -> None:
        """Writes the exports to the file, unless it has all of them."""
        if self._file is None:
            return
        if self._stored is not None and set(self._exports) <= set(self._stored.exports):
            return
        exports = {program: bytes(export.serialize()) for program, export in self._exports.items()}
        # A search that continues a state does not start, so its file may lack a program that
        # another search adds.
        if self._stored is not None:
            exports = dict(self._stored.exports) | exports
        self._stored = StoredPrograms(self.facts.to_plain(), exports)
        save(self._file, self._stored)

    def _exportable(self, program: str) -> Jitted:
        """Returns a program that JAX can trace.

        Its arguments and results are tuples of arrays.
        """
        if program == _START:
            return _start_program(self._structure)
        states = jax.tree.structure(self._state_tree)
        if program == _ADVANCE:
            return _advance_program(self._structure, states)
        return _collect_program(self._structure, states, self._single)

    def _arguments(self, program: str) -> tuple[Pytree, ...]:
        """Returns the shapes and dtypes of the arguments of a program."""
        numbers = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in self._numbers)
        if program == _COLLECT:
            return numbers, self.states
        keys = jax.ShapeDtypeStruct((self._part_rows, *self._keys.shape[1:]), self._keys.dtype)
        if program == _START:
            return numbers, keys
        generation = jax.ShapeDtypeStruct((), jnp.int32)
        return numbers, keys, self._states(self._part_rows), generation, generation

    def _states(self, rows: int) -> tuple[jax.ShapeDtypeStruct, ...]:
        states = []
        for shape, dtype in self.facts.states:
            states.append(jax.ShapeDtypeStruct((rows, *shape), dtype))
        return tuple(states)


def _shape_on(
    sharding: jax.sharding.Sharding | None, leaf: jax.ShapeDtypeStruct
) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)


def find_programs(
    setup: Setup, keys: KeyData, single: bool, devices: Sequence[jax.Device], floats: bool = False
) -> Programs:
    """Returns the programs of a search.

    They are those of an earlier call if there was one of the same shapes. `single` says whether
    there was one key alone. The devices share the seeds. `floats` says whether the user's functions
    compute with floats.
    """
    numbers, structure = jax.tree.flatten(setup)
    # The cache of `_find` compares its arguments, so they are hashable and hold no arrays.
    shapes = tuple((leaf.shape, leaf.dtype) for leaf in numbers)
    return _find(
        structure,
        shapes,
        (keys.shape, keys.dtype),
        single,
        tuple(devices),
        floats,
        find_folder(),
        settings_of_thread(),
    )


@lru_cache(maxsize=_MOST_SEARCHES)
def _find(
    structure: Pytree,
    shapes: tuple[tuple[tuple[int, ...], np.dtype], ...],
    keys_shape: tuple[tuple[int, ...], np.dtype],
    single: bool,
    devices: tuple[jax.Device, ...],
    floats: bool,
    folder: Path | None,
    # JAX's settings of this thread: other settings make other programs.
    settings: Pytree,
) -> Programs:
    numbers = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in shapes]
    setup = jax.tree.unflatten(structure, numbers)
    keys = jax.ShapeDtypeStruct(*keys_shape)
    return Programs(setup, keys, single, devices, floats, folder)


# JAX keeps what it traced of a program as long as the program is kept here. The structures are
# those of a setup and of the optimiser's state; numbers are the leaves of a setup. Arguments and
# results are tuples of arrays, because JAX cannot serialise an export with types of this package.
# Each program keeps unused arguments, so that all take the same numbers, whatever their optimiser
# reads.


@lru_cache(maxsize=_MOST_SEARCHES)
def _start_in_structure(structure: Pytree) -> Jitted:
    """Returns the program from numbers and keys to states in the optimiser's structure."""

    def start_all(numbers: Sequence[Array], keys: KeyData) -> Pytree:
        setup: Setup = jax.tree.unflatten(structure, numbers)
        return start(setup.make_optimizer(), setup.wrap_keys(keys))

    return jax.jit(start_all, keep_unused=True)


@lru_cache(maxsize=_MOST_SEARCHES)
def _start_program(structure: Pytree) -> Jitted:
    """Returns the program from numbers and keys to the leaves of states."""
    start_all = _start_in_structure(structure)

    def start_leaves(numbers: Sequence[Array], keys: KeyData) -> States:
        return tuple(jax.tree.leaves(start_all(numbers, keys)))

    return jax.jit(start_leaves, keep_unused=True)


@lru_cache(maxsize=_MOST_SEARCHES)
def _advance_program(structure: Pytree, state_structure: Pytree) -> Jitted:
    """Returns the program that runs the generations `first` to `last`."""

    def advance_all(
        numbers: Sequence[Array],
        keys: KeyData,
        states: States,
        first: Int32[Array, ""],
        last: Int32[Array, ""],
    ) -> tuple[States, tuple[Array, ...]]:
        setup: Setup = jax.tree.unflatten(structure, numbers)
        optimizer, keys = setup.make_optimizer(), setup.wrap_keys(keys)
        inner = jax.tree.unflatten(state_structure, states)
        inner, info = advance(optimizer, keys, inner, first, last, most=MOST_GENERATIONS)
        return tuple(jax.tree.leaves(inner)), (info.best_fitness, info.elite_count, info.refused)

    return jax.jit(advance_all, keep_unused=True)


@lru_cache(maxsize=_MOST_SEARCHES)
def _collect_program(structure: Pytree, state_structure: Pytree, single: bool) -> Jitted:
    """Returns the program from states to the leaves of elites, and the states.

    The results have no axis of seeds if there is a single seed.
    """

    def collect_all(numbers: Sequence[Array], states: States) -> tuple[tuple[Array, ...], States]:
        setup: Setup = jax.tree.unflatten(structure, numbers)
        optimizer, problem = setup.make_optimizer(), setup.problem

        def collect_one(state: Pytree) -> Population:
            return check_elites(optimizer.elites(state), problem.shape, len(problem.feature_names))

        inner = jax.tree.unflatten(state_structure, states)
        elites = measured_elites(problem, over_seeds(collect_one, inner))
        collected = tuple(jax.tree.leaves(elites)), tuple(states)
        if single:
            return jax.tree.map(lambda array: array[0], collected)
        return collected

    return jax.jit(collect_all, keep_unused=True)


def measured_elites(problem: RoadProblem, elites: Population) -> MeasuredElites:
    """Returns elites with their descriptor, metrics and features."""
    names = problem.feature_names
    height, width = problem.shape
    return MeasuredElites(
        grids=elites.grids,
        fitness=elites.fitness,
        descriptor=compute_descriptor(elites.features, names, problem.axes),
        valid=elites.valid,
        metrics=unstack_metrics(elites.features, height * width),
        features={name: elites.features[..., names.index(name)] for name in problem.measured},
    )


def _structure_of_elites(measured: Sequence[str]) -> Pytree:
    leaf: Pytree = 0
    metrics = Metrics(*[leaf] * len(Metrics._fields))
    features: dict[str, Pytree] = dict.fromkeys(measured, leaf)
    return jax.tree.structure(MeasuredElites(leaf, leaf, leaf, leaf, metrics, features))
