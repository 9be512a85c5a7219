"""The three programs of a search, which start it, advance it, and collect its elites.

| program | from | to | runs on |
|---|---|---|---|
| start | setup, keys | states before any step | one part of the seeds |
| advance | setup, keys, states, first, last | states after `last`, a report per generation | one part |
| collect | setup, states | elites with their metrics | all seeds |

They are the methods of a `Setup`, whose numbers are weights, limits and rates. Because numbers are
arguments, searches that differ in the values of numbers and keys, or in length, run the same
programs. `find_programs` keeps these `Programs` for later calls, by the structure of the setup.

The seeds are divided into parts of equal size. Each part has a device, and a call of a program runs
one part. A device may have several parts. The parts that workers of an executor run are other ones,
see `elitelanes_jax.search.parts`.

Programs without functions of the user are also kept in a file, see `compile_cache`. A later process
loads them, and neither traces nor compiles.
"""

import time
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from operator import itemgetter
from pathlib import Path
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef

from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import AnyArray, Plain, Pytree, Tree
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.search._compiling import (
    ADVANCE,
    COLLECT,
    START,
    CompiledPrograms,
    SearchFacts,
)
from elitelanes_jax.search._devices import device_of_each_part
from elitelanes_jax.search._setup import MOST_GENERATIONS, KeyData, Setup
from elitelanes_jax.search.compile_cache import find_file, find_folder, settings_of_thread
from elitelanes_jax.search.records import History, MeasuredElites, is_key, to_numpy

Parts: TypeAlias = list[Pytree]
"""The optimiser's states of each part of the seeds, arrays ``[S, ...]``."""

# The seconds that a compiled call should take. Between two calls the progress is shown and a run
# can be interrupted.
_SECONDS_A_CALL = 0.2

# The searches whose programs stay in memory. Each takes about 18 MB.
_MOST_SEARCHES = 64


class Programs:
    """The programs of a search, for arguments of given shapes; see `find_programs`.

    Arguments and results have an axis of seeds in front, also for one seed.

    Args:
      setup: the setup of the search; only its structure, and the shapes and dtypes of its numbers,
        matter.
      keys: the data of the keys of all seeds; only its shape and dtype matter.
      devices: the devices that share the seeds; a device may be repeated. As many parts of the seeds
        run side by side.
      floats: whether the user's functions compute with floats.
      folder: the folder of the files, or None.
    """

    def __init__(
        self,
        setup: Setup,
        keys: jax.ShapeDtypeStruct,
        devices: Sequence[jax.Device],
        floats: bool,
        folder: Path | None,
    ):
        self._shape = setup.problem.shape
        self._seeds = len(keys)
        if setup.key_kind != THREEFRY:
            # Seeds can be divided only if a seed draws the same bits alone and among others. The
            # bits of keys of other kinds depend on the whole batch.
            self._devices = [devices[0]]
        else:
            self._devices = device_of_each_part(devices, self._seeds)
        self._workers = len(devices)
        # The division rounds up.
        rows = -(-self._seeds // len(self._devices))
        # The cells that this process has evaluated with these programs.
        self._evaluated_cells = 0
        file = None
        # The name of a file has a digest of the package's sources. The user's sources are unknown.
        if folder is not None and not setup.has_user_functions():
            file = find_file(folder, setup, keys, rows)
        self._compiled = CompiledPrograms(setup, keys, rows, floats, file)

    @property
    def facts(self) -> SearchFacts:
        """What is known of the search. Traces the optimiser unless a file has it."""
        return self._compiled.facts

    @property
    def states(self) -> Pytree:
        """The shapes and dtypes of the states of all seeds."""
        return self._compiled.states

    @property
    def memory(self) -> int:
        """The bytes of the states of all seeds."""
        return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(self.states))

    def prepare(self, *, starts: bool, generations: int, counts: bool = True) -> None:
        """Loads or compiles the programs for a run of some generations that are missing.

        How far they are optimised depends on the cells that the searches in this process have
        evaluated. The bits are the same. `counts` says whether this run counts among those
        searches.
        """
        height, width = self._shape
        cells_per_step = self.facts.evaluations_per_step * self._seeds * height * width
        cells = self._evaluated_cells + (generations + starts) * cells_per_step
        if counts:
            self._evaluated_cells = cells
        # The largest programs are first: they compile while the others are lowered. Several parts
        # on one device share its programs.
        needed: dict[tuple[str, jax.Device], int] = {}
        if generations or (starts and self.facts.first_generation == 0):
            needed |= {(ADVANCE, device): cells for device in self._devices}
        if starts:
            # This program runs once for a search, and the last one once for a result.
            needed |= {(START, device): cells_per_step for device in self._devices}
        needed[COLLECT, jax.local_devices()[0]] = 0
        self._compiled.prepare(needed)

    def start_parts(self, setup: Setup, keys: Sequence[KeyData]) -> Parts:
        """Returns the states of generation 0; there are keys for each part."""
        parts = self._run_on_parts(START, setup, [(part_keys,) for part_keys in keys])
        if self.facts.first_generation == 0:
            # Generation 0 evaluates the initial grids, and is no part of a history.
            parts, _ = self._advance(setup, keys, parts, 0, 0)
        return parts

    def advance_parts(
        self, setup: Setup, keys: Sequence[KeyData], parts: Parts, first: int, last: int
    ) -> Iterator[tuple[Parts, History]]:
        """Runs the generations `first` to `last` call by call.

        Yields the states and the history after each call.
        """
        per_step = self.facts.evaluations_per_step
        # The first call measures the speed. Each later call has as many generations as fit into
        # `_SECONDS_A_CALL`.
        stretch = MOST_GENERATIONS // 2
        while first <= last:
            numbers = np.arange(first, min(first + stretch, last + 1))
            began = time.perf_counter()
            ends = int(numbers[0]), int(numbers[-1])
            parts, fields = self._advance(setup, keys, parts, *ends)
            seconds = time.perf_counter() - began
            best_fitness, elite_count, refused = fields
            speed = numbers.size * per_step * self._seeds / seconds
            history = History(
                generation=numbers,
                evaluations=numbers * per_step,
                best_fitness=best_fitness,
                elite_count=elite_count,
                evaluations_per_second=np.full(numbers.size, speed),
                refused=refused,
            )
            yield parts, history
            first += numbers.size
            fitting = numbers.size * _SECONDS_A_CALL / seconds
            # A call that was fast by chance may no more than double the next one.
            stretch = int(min(max(fitting, 1), 2 * stretch, MOST_GENERATIONS))

    @runs_jax
    def collect_parts(self, setup: Setup, parts: Parts) -> tuple[MeasuredElites, Pytree]:
        """Returns the elites and the states of all seeds."""
        states = jax.device_put(join(parts, self._seeds))
        return self._compiled.run(COLLECT, jax.local_devices()[0], setup, states), states

    def divide(self, tree: Tree) -> list[Tree]:
        """Divides the keys or the states of all seeds into parts."""
        return cut(tree, self._devices)

    def _advance(
        self, setup: Setup, keys: Sequence[KeyData], parts: Parts, first: int, last: int
    ) -> tuple[Parts, list[np.ndarray]]:
        """Runs some generations in a call, and waits for the end.

        Returns the states and the fields of an `Info`: arrays ``[S, G]``.
        """
        arguments = []
        for part_keys, states in zip(keys, parts, strict=True):
            arguments.append((part_keys, states, np.int32(first), np.int32(last)))
        outcomes = self._run_on_parts(ADVANCE, setup, arguments)
        # A call has room for more generations, and the last parts may repeat a seed.
        size = slice(last - first + 1), slice(self._seeds)
        fields = []
        for rows_of_parts in zip(*(info for _, info in outcomes), strict=True):
            fields.append(np.concatenate(rows_of_parts, axis=1)[size].T)
        return [states for states, _ in outcomes], fields

    def _run_on_parts(
        self, program: str, setup: Setup, arguments: Sequence[tuple[Pytree, ...]]
    ) -> list[Pytree]:
        """Runs a program with the arguments of each part; returns the results in order."""
        calls = []
        for device, part in zip(self._devices, arguments, strict=True):
            calls.append(partial(self._compiled.run, program, device, setup, *part))
        return side_by_side(calls, workers=self._workers)


def find_programs(
    setup: Setup, keys: KeyData, devices: Sequence[jax.Device], floats: bool
) -> Programs:
    """Returns the programs of a search.

    They are the programs of an earlier call if a call had the same shapes. The devices share the
    seeds. `floats` says whether the user's functions compute with floats.
    """
    numbers, structure = jax.tree.flatten(setup)
    # The cache of `_find` compares its arguments, so they are hashable and hold no arrays.
    shapes = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in (*numbers, keys))
    return _find(structure, shapes, tuple(devices), floats, find_folder(), settings_of_thread())


@lru_cache(maxsize=_MOST_SEARCHES)
def _find(
    structure: PyTreeDef,
    shapes: tuple[jax.ShapeDtypeStruct, ...],
    devices: tuple[jax.Device, ...],
    floats: bool,
    folder: Path | None,
    # JAX's settings of this thread: other settings make other programs.
    settings: tuple[tuple[str, Plain], ...],
) -> Programs:
    *numbers, keys = shapes
    setup = jax.tree.unflatten(structure, numbers)
    return Programs(setup, keys, devices, floats, folder)


def cut(tree: Tree, devices: Sequence[jax.Device]) -> list[Tree]:
    """Cuts arrays ``[S, ...]`` into parts with equally many rows, one for each device.

    If the rows do not divide evenly, the last parts repeat the last row. All parts have one size,
    so one program serves them, and a part with repeated rows takes no longer than the first part.
    """
    if len(devices) == 1:
        return [_put(tree, devices[0])]
    rows = len(jax.tree.leaves(tree)[0])
    # The division rounds up.
    size = -(-rows // len(devices))
    # The indices of the rows of all parts. Those beyond the end are the last row's.
    indices = np.minimum(np.arange(len(devices) * size), rows - 1).reshape(-1, size)
    tree = jax.tree.map(to_numpy, tree)
    parts = []
    for indices_of_part, device in zip(indices, devices, strict=True):
        part = jax.tree.map(itemgetter(indices_of_part), tree)
        parts.append(_put(part, device))
    return parts


def join(parts: Sequence[Tree], rows: int) -> Tree:
    """Joins the parts that `cut` made to arrays ``[rows, ...]``, for the default device."""
    # A single part on the default device needs no copy: it has no repeated rows.
    if len(parts) == 1 and _is_on_default_device(parts[0]):
        return parts[0]
    return jax.tree.map(lambda *arrays: _concatenate(arrays)[:rows], *parts)


def _is_on_default_device(tree: Pytree) -> bool:
    """Returns whether all arrays are JAX's, and on the default device."""
    default_device = jax.local_devices()[0]
    # A leaf that is no array, such as a number, has no device.
    devices = [getattr(array, "device", default_device) for array in jax.tree.leaves(tree)]
    return all(device == default_device for device in devices)


def _concatenate(arrays: Sequence[AnyArray]) -> AnyArray:
    """Joins arrays in NumPy, or arrays of keys on the default device."""
    if not is_key(arrays[0]):
        return np.concatenate(arrays)
    default_device = jax.local_devices()[0]
    return jnp.concatenate([jax.device_put(array, default_device) for array in arrays])


def _put(tree: Tree, device: jax.Device) -> Tree:
    """Puts arrays on a device.

    Arrays for the default device are not bound to it: JAX would compile again for those.
    """
    if device == jax.local_devices()[0]:
        return tree
    return jax.device_put(tree, device)
