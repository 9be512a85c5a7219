"""The programs of a search: compiled once in a process, and kept on disk for later ones."""

import gc
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property, lru_cache, partial
from pathlib import Path
from threading import RLock
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32, Key, UInt32

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import Plain, Pytree, Untyped
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.network.metrics import unstack_metrics
from elitelanes_jax.network.records import METRIC_NAMES, Metrics, Weights
from elitelanes_jax.optimizers.base import Info, Optimizer
from elitelanes_jax.optimizers.loop import advance, check_elites, over_seeds, start
from elitelanes_jax.optimizers.presets import make_optimizer, user_moves
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor
from elitelanes_jax.problem.features import columns_for
from elitelanes_jax.problem.fixed_cells import FixedCells
from elitelanes_jax.problem.kernels import Fitness, Kernel
from elitelanes_jax.problem.problem import Problem, make_road_problem
from elitelanes_jax.search._devices import part_rows
from elitelanes_jax.search._executables import (
    LEVELS,
    Executable,
    Kept,
    compile_and_serialise,
    compile_program,
    find_file,
    find_folder,
    load,
    refuse,
    save,
    settings_of_thread,
)
from elitelanes_jax.search.elites import MeasuredElites

KeyData: TypeAlias = UInt32[Array | np.ndarray, "*S B"]
Digests: TypeAlias = tuple[tuple[str, str], ...]
States: TypeAlias = tuple[Array | np.ndarray, ...]
"""The leaves of the optimiser's states, arrays ``[S, ...]``."""

MOST = 256
"""The largest number of generations of one call."""

# The searches whose programs stay in memory. Each takes about 18 MB.
_MOST_SEARCHES = 64

_START, _ADVANCE, _COLLECT = "start", "advance", "collect"

# The most cells that searches evaluate with a program of level 0 and of level 1, see `compile_program`. For 12 x 12
# tiles, compiling for level 1 and 2 takes 1.4 s and 3.5 s more of processor time than for level 0. In exchange, each
# million cells take 0.4 s to 1.2 s less, and at level 2 another 0.007 s to 0.018 s less.
_MOST_CELLS = (2_500_000, 160_000_000)

_tracing_lock = RLock()


def _least_level(platform: str, cells: int) -> int:
    """Returns the level of optimisation that a search needs for some cells: the highest one on a GPU or TPU.

    For a GPU, level 0 compiles in four fifths of the time of level 2.
    """
    return bisect_left(_MOST_CELLS, cells) if platform == "cpu" else LEVELS - 1


def _name(program: str, device: jax.Device, level: int) -> str:
    return f"{program} {device}, level {level}"


@contextmanager
def _tracing() -> Iterator[None]:
    """Lets one thread trace at a time, without Python's garbage collector.

    Threads that trace at once take turns, and all their programs come late. Tracing makes many lasting objects; the
    collector takes a tenth of the time to look through them.
    """
    with _tracing_lock:
        collects = gc.isenabled()
        try:
            gc.disable()
            yield
        finally:
            if collects:
                gc.enable()


class Traced(NamedTuple):
    """The arguments of a compiled search: other values need no second compilation."""

    weights: Weights
    limits: Int32[np.ndarray, "2 C"]
    config: tuple[Pytree, ...]  # the leaves that are traced
    initial: Int8[np.ndarray, "N H W"] | None
    feature_weights: Int32[np.ndarray, " K"] | None


class Static(NamedTuple):
    """What a search is compiled for; hashable."""

    shape: tuple[int, int]
    axes: tuple[Axis, ...]
    alphabet: tuple[int, ...]
    fill: bool
    fix: FixedCells | None
    bounded: bool
    config: Pytree  # the structure of the configuration; None for an optimiser of the user's own
    factory: Callable[[Problem], Optimizer] | None
    measured: tuple[str, ...]
    kernels: tuple[tuple[str, Kernel], ...]  # of the user's features that are needed
    fitness: Fitness | None
    impl: str = THREEFRY  # of the keys
    digests: Digests = ()  # of the user's functions, by name

    def optimizer(self, traced: Traced) -> Optimizer:
        """Makes the optimiser, while a program is traced."""
        problem = make_road_problem(
            self.shape,
            self.axes,
            columns_for((axis.metric for axis in self.axes), self.measured),
            alphabet=self.alphabet,
            weights=traced.weights,
            fill=self.fill,
            limits=traced.limits if self.bounded else None,
            measured=self.measured,
            feature_weights=traced.feature_weights,
            features=dict(self.kernels),
            fitness=self.fitness,
            fix=self.fix,
            initial=traced.initial,
        )
        if self.factory is not None:
            made = self.factory(problem)
            if not isinstance(made, Optimizer):
                raise InputError(f"optimizer: expected a function that returns an Optimizer, got {type(made).__name__}")
            return made
        return make_optimizer(problem, jax.tree.unflatten(self.config, traced.config))

    def keys(self, data: KeyData) -> Key[Array, "*S"]:
        return jax.random.wrap_key_data(jnp.asarray(data), impl=self.impl)


class Programs:
    """The programs of a search, for arguments of given shapes; see `find_programs`."""

    def __init__(
        self,
        static: Static,
        traced: Pytree,
        keys: Pytree,
        single: bool,
        devices: Sequence[jax.Device],
        floats: bool = False,
        folder: Path | None = None,
    ):
        """Finds the programs in a folder, if there is one. Only the shapes and dtypes of `traced` and `keys` count."""
        self._static, self._traced, self._keys, self._single, self._floats = static, traced, keys, single, floats
        self._rows, count = part_rows(len(keys), devices)
        self._devices = list(dict.fromkeys(devices[:count]))
        self._cells = 0  # evaluated in this process
        self._put: tuple[str, Traced] | None = None  # the last arguments
        self._programs: dict[str, Callable[..., Pytree]] = {}
        # The name of a file does not depend on what the user's functions compute.
        users = static.factory or static.kernels or static.fitness
        if folder and not users and not user_moves(jax.tree.unflatten(static.config, traced.config)):
            shapes = [(leaf.shape, str(leaf.dtype)) for leaf in jax.tree.leaves((traced, keys))]
            about = (static, jax.tree.structure(traced), shapes, single, self._rows, *self._devices)
            self._file = find_file(folder, *about)
        else:
            self._file = None
        found = None if self._file is None else load(self._file)
        self._on_disk = None if found is None else found.facts
        self._contents = {} if found is None else found.programs  # those that are not loaded
        self._refused = False

    @property
    def kept(self) -> bool:
        """Whether a file has some of the programs; otherwise they are traced at their first use."""
        return self._on_disk is not None

    @cached_property
    def states(self) -> tuple[jax.ShapeDtypeStruct, ...]:
        """The shapes and dtypes of the states of all seeds."""
        if self._on_disk is not None:
            return tuple(jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in self._on_disk["states"])
        leaves = jax.tree.leaves(self._tree)
        return tuple(jax.ShapeDtypeStruct((len(self._keys), *leaf.shape[1:]), leaf.dtype) for leaf in leaves)

    @property
    def evaluations_per_step(self) -> int:
        """The evaluations of a generation of one seed."""
        return int(self._facts["evaluations_per_step"])

    @property
    def first_generation(self) -> int:
        """The first generation after the start, see `Optimizer`."""
        return int(self._facts["first_generation"])

    @cached_property
    def _facts(self) -> dict[str, Plain]:
        """Facts about the optimiser, as the file has them."""
        if self._on_disk is not None:
            return self._on_disk
        found: dict[str, Plain] = {}

        def find(traced: Traced) -> None:
            optimizer = self._static.optimizer(traced)
            each = check_named("optimizer: evaluations_per_step", whole(1), optimizer.evaluations_per_step)
            found["evaluations_per_step"] = each
            found["first_generation"] = optimizer.first_generation

        jax.eval_shape(find, self._traced)
        return found

    @property
    def memory(self) -> int:
        """The bytes of the states of all seeds."""
        return sum(leaf.size * leaf.dtype.itemsize for leaf in self.states)

    def put(self, traced: Traced, said: str) -> Traced:
        """Puts the arguments of a search on the default device; returns them. `said` has their values as text.

        Calls with equal arguments share one copy. Otherwise each program would copy them, which takes a millisecond.
        """
        put = self._put
        if put is None or put[0] != said:
            put = self._put = said, jax.device_put(traced)
        return put[1]

    def prepare(self, *, starts: bool, generations: int, runs: bool = True, compiles: bool = True) -> None:
        """Loads the programs for a run of some generations, and compiles the missing ones, side by side.

        The program that collects runs once and is not optimised. How far the others are optimised depends on the cells
        that the searches in this process have evaluated. The bits are the same. `runs` says whether this run counts
        among them. Without `compiles`, the missing programs stay missing.
        """
        height, width = self._static.shape
        cells = self._cells + generations * self.evaluations_per_step * len(self._keys) * height * width
        # The largest programs are first: they compile while the others are lowered.
        names = [self._choose(_ADVANCE, device, cells) for device in self._devices] if generations else []
        names += [self._choose(_START, device, cells) for device in self._devices] if starts else []
        names += [self._choose(_COLLECT, jax.local_devices()[0], 0)]
        if runs:
            self._cells = cells
        names = [name for name in names if name not in self._programs]
        contents = self._contents  # other threads may load some
        self._load({name: contents[name] for name in names if name in contents})
        names = [name for name in names if name not in self._programs]
        if names and compiles:
            self._compile(names)

    def start(self, device: jax.Device, traced: Traced, keys: KeyData) -> States:
        """Returns the states of generation 0 of the seeds of a part."""
        return tuple(jax.tree.leaves(self._loaded(_START, device)(traced, keys)))

    def advance(
        self, device: jax.Device, traced: Traced, keys: KeyData, states: States, first: int, last: int
    ) -> tuple[States, Info]:
        """Runs the generations `first` to `last` of the seeds of a part, see `loop.advance`; waits for the end."""
        program = self._loaded(_ADVANCE, device)
        return jax.block_until_ready(program(traced, keys, states, np.int32(first), np.int32(last)))

    def collect(self, traced: Traced, states: States) -> tuple[MeasuredElites, States]:
        """Returns the elites and the states; for one key alone, both without the axis of seeds."""
        self.prepare(starts=False, generations=0)  # the program is missing if the compiler was interrupted
        program = self._loaded(_COLLECT, jax.local_devices()[0])
        found = program(traced, states)
        # A loaded program binds its results to their device, a compiled one does not.
        return jax.device_put(jax.tree.map(np.asarray, found)) if isinstance(program, Executable) else found

    def _choose(self, program: str, device: jax.Device, cells: int) -> str:
        """Returns the name of a program on a device, for some evaluated cells.

        The cells need a level of optimisation. Of the programs that have it, the highest known one is taken.
        """
        least = _least_level(device.platform, min(cells, _MOST_CELLS[1]) if program == _START else cells)
        if self._floats:
            least = LEVELS - 1  # at level 0 a sum with a product is rounded twice, at higher levels once
        names = [_name(program, device, level) for level in range(least, LEVELS)]
        known = [name for name in names if name in self._programs or name in self._contents]
        return known[-1] if known else names[0]

    def _loaded(self, program: str, device: jax.Device) -> Callable[..., Pytree]:
        """Returns the program of the highest level that is there. Searches in other threads may have added one."""
        names = [_name(program, device, level) for level in reversed(range(LEVELS))]
        return next(self._programs[name] for name in names if name in self._programs)

    def _load(self, contents: dict[str, bytes]) -> None:
        """Loads programs of the file, by name. If one of them cannot be loaded, none is."""
        leaf: Pytree = 0
        features: dict[str, Pytree] = dict.fromkeys(self._static.measured, leaf)
        elites = MeasuredElites(leaf, leaf, leaf, leaf, Metrics(*[leaf] * len(Metrics._fields)), features)
        advanced = (self.states, Info(*[leaf] * len(Info._fields)))
        outputs = {_START: self.states, _ADVANCE: advanced, _COLLECT: (elites, self.states)}
        calls = [
            partial(Executable, content, self._device(name), jax.tree.structure(outputs[name.split(" ")[0]]))
            for name, content in contents.items()
        ]
        try:
            self._programs |= zip(contents, side_by_side(calls), strict=True)
            self._contents = {name: content for name, content in self._contents.items() if name not in contents}
        except Exception as error:  # of XLA, of any type
            assert self._file is not None
            refuse(self._file, error)
            self._contents, self._refused = {}, True

    def _compile(self, names: Sequence[str]) -> None:
        """Compiles programs, and adds them to the file. An interruption does not wait for the threads that compile."""
        levels = [int(name[-1]) for name in names]
        # Each is lowered in this thread, whose settings of JAX may be its own, while those before it compile.
        lowered = ((self._lower(name), level) for name, level in zip(names, levels, strict=True))
        if self._file is None:
            plain = (partial(compile_program, program, level) for program, level in lowered)
            self._programs |= zip(names, side_by_side(plain, wait=False), strict=True)
            return
        calls = (partial(compile_and_serialise, program, level) for program, level in lowered)
        contents = {}
        for name, (program, content) in zip(names, side_by_side(calls, wait=False), strict=True):
            self._programs[name] = program
            if content is not None:
                contents[name] = content
        found = None if self._refused else load(self._file, quiet=True)  # another process may have added some
        shapes = [[list(leaf.shape), str(leaf.dtype)] for leaf in self.states]
        save(self._file, Kept(self._facts | {"states": shapes}, (found.programs if found else {}) | contents))

    @cached_property
    def _tree(self) -> Pytree:
        """The shapes and dtypes of the states of a part, in the optimiser's structure."""
        with _tracing():
            keys = jax.ShapeDtypeStruct((self._rows, *self._keys.shape[1:]), self._keys.dtype)
            return _jitted(self._static)[_START].eval_shape(self._traced, keys)

    def _device(self, name: str) -> jax.Device:
        """Returns the device of a program. The program that collects runs on the default device."""
        said = name.split(" ", 1)[-1].split(", level ")[0]
        return next((one for one in self._devices if str(one) == said), jax.local_devices()[0])

    def _lower(self, name: str) -> jax.stages.Lowered:
        traced, jitted = self._traced, _jitted(self._static)
        # Before this thread waits for others that trace: Python 3.11 lets one thread at a time compute `_tree`.
        structure, states = jax.tree.structure(self._tree), self.states
        device = self._device(name)
        # Arrays for the default device are not bound to it, see `_devices._put`.
        bound = None if device == jax.local_devices()[0] else jax.sharding.SingleDeviceSharding(device)
        keys, *part = (
            jax.ShapeDtypeStruct((self._rows, *leaf.shape[1:]), leaf.dtype, sharding=bound)
            for leaf in (self._keys, *states)
        )
        first = jax.ShapeDtypeStruct((), jnp.int32)
        with _tracing():
            if name.startswith(_COLLECT):
                return jitted[_COLLECT].lower(structure, traced, states, self._single)
            if name.startswith(_START):
                return jitted[_START].lower(traced, keys)
            return jitted[_ADVANCE].lower(structure, traced, keys, tuple(part), first, first)


def find_programs(
    static: Static, traced: Traced, keys: KeyData, single: bool, devices: Sequence[jax.Device], floats: bool = False
) -> Programs:
    """Returns the programs of a search: those of an earlier call if there was one of the same shapes.

    `single` says whether there was one key alone. The devices share the seeds. `floats` says whether the user's
    functions compute with floats.
    """
    leaves, structure = jax.tree.flatten((traced, keys))
    shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
    return _find(static, structure, shapes, single, tuple(devices), floats, find_folder(), settings_of_thread())


@lru_cache(maxsize=_MOST_SEARCHES)
def _find(
    static: Static,
    structure: Pytree,
    shapes: tuple[tuple[tuple[int, ...], np.dtype], ...],
    single: bool,
    devices: tuple[jax.Device, ...],
    floats: bool,
    folder: Path | None,
    _: Pytree,
) -> Programs:
    traced, keys = jax.tree.unflatten(structure, [jax.ShapeDtypeStruct(*each) for each in shapes])
    return Programs(static, traced, keys, single, devices, floats, folder)


@lru_cache(maxsize=_MOST_SEARCHES)
def _jitted(static: Static) -> dict[str, Untyped]:
    """Returns the programs for JAX, which keeps what it traced of them as long as they are kept here."""
    jit = partial(jax.jit, keep_unused=True)
    return {
        _START: jit(partial(_start, static)),
        _ADVANCE: jit(partial(_advance, static), static_argnames="structure"),
        _COLLECT: jit(partial(_collect, static), static_argnames=("structure", "single")),
    }


def _start(static: Static, traced: Traced, keys: KeyData) -> Pytree:
    return start(static.optimizer(traced), static.keys(keys))


def _advance(
    static: Static, structure: Pytree, traced: Traced, keys: KeyData, states: States, first: Array, last: Array
) -> tuple[States, Info]:
    inner = jax.tree.unflatten(structure, states)
    inner, info = advance(static.optimizer(traced), static.keys(keys), inner, first, last, most=MOST)
    return tuple(jax.tree.leaves(inner)), info


def _collect(
    static: Static, structure: Pytree, traced: Traced, states: States, single: bool
) -> tuple[MeasuredElites, States]:
    optimizer = static.optimizer(traced)

    def find(state: Pytree) -> Population:
        return check_elites(optimizer.elites(state), static.shape, len(METRIC_NAMES) + len(static.measured))

    measured = as_measured(static, over_seeds(find, jax.tree.unflatten(structure, states)))
    return jax.tree.map(lambda array: array[0], (measured, states)) if single else (measured, states)


def as_measured(static: Static, elites: Population) -> MeasuredElites:
    """Returns elites with their descriptor, metrics and features."""
    names = (*METRIC_NAMES, *static.measured)
    return MeasuredElites(
        grids=elites.grids,
        fitness=elites.fitness,
        descriptor=compute_descriptor(elites.features, names, static.axes),
        valid=elites.valid,
        metrics=unstack_metrics(elites.features, static.shape[0] * static.shape[1]),
        features={name: elites.features[..., names.index(name)] for name in static.measured},
    )
