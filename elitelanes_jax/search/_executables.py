"""Compiled programs in files: a later process loads them instead of tracing, lowering and compiling.

A file has the programs of one search. Its name is a digest of all that they depend on, so any change leads to another
file. A file that cannot be read or loaded is replaced. Only programs for the processor are kept, next to JAX's own
cache, if that is in use.
"""

import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from threading import Lock, get_ident
from typing import NamedTuple

import jax

from elitelanes_jax._util import LOADED
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import Plain, Pytree, Untyped

# The limit of all files together, in bytes. The least recently used files are removed.
_MOST_BYTES = 2**28

# The rooms whose sources make the programs.
_ROOMS = ("_util", "network", "problem", "optimizers", "search")


class Kept(NamedTuple):
    """The content of a file: facts about a search, and its programs by name, as XLA serialises them."""

    facts: dict[str, Plain]
    programs: dict[str, bytes]


class Executable:
    """A loaded program: takes any arrays, and returns arrays on its device."""

    def __init__(self, program: bytes, device: jax.Device, outputs: Pytree) -> None:
        """Loads a program that XLA serialised for a device; `outputs` is the structure of what it returns."""
        devices = jax.sharding.SingleDeviceSharding(device)._internal_device_list
        self._loaded = device.client.deserialize_executable(program, devices)
        self._device, self._outputs = device, outputs

    def __call__(self, *arguments: Pytree) -> Pytree:
        arrays = jax.tree.leaves(arguments)
        others = [index for index, leaf in enumerate(arrays) if getattr(leaf, "device", None) != self._device]
        for index, array in zip(others, jax.device_put([arrays[index] for index in others], self._device), strict=True):
            arrays[index] = array
        results = self._loaded.execute_sharded(arrays).disassemble_into_single_device_arrays()
        return jax.tree.unflatten(self._outputs, [array for (array,) in results])


def find_folder() -> Path | None:
    """Returns the folder of the files, or None if this thread, with its settings of JAX, can keep no programs now."""
    folder = jax.config.values.get("jax_compilation_cache_dir")
    home = jax.local_devices()[0]
    keeps = (
        getattr(jax.config, "jax_enable_compilation_cache", True)
        and home.platform == "cpu"
        and jax.process_count() == 1
        # With the following ones, programs have other devices or more arguments.
        and getattr(jax.config, "jax_default_device", None) in (None, "cpu", home)
        and jax.sharding.get_abstract_mesh().empty
        and not getattr(jax.config, "jax_use_simplified_jaxpr_constants", False)
    )
    return Path(folder) / "executables" if keeps and folder and "://" not in folder else None


def find_file(folder: Path, *parts: Plain) -> Path | None:
    """Returns the file of the programs that depend on some values.

    The `repr` of each value must say all that matters of it. Returns None if the sources are not those that this
    process has loaded.
    """
    sources = _list_sources()
    stats = [source.stat() for source in sources]
    if not sources or max(max(stat.st_mtime_ns, stat.st_ctime_ns) for stat in stats) > LOADED:
        return None
    said = repr((_of_machine(), os.environ.get("XLA_FLAGS"), settings_of_thread(), parts))
    return folder / sha256(said.encode()).hexdigest()


def settings_of_thread() -> tuple[tuple[str, Plain], ...]:
    """Returns the names and values of JAX's settings, but those of its cache; they may differ between threads."""
    names = sorted(name for name in jax.config.values if "_cache" not in name)
    return tuple((name, getattr(jax.config, name, None)) for name in names)


def _list_sources() -> list[Path]:
    return [
        file
        for room in _ROOMS
        for folder in find_spec(f"{__package__.split('.')[0]}.{room}").submodule_search_locations  # type: ignore[union-attr]
        for file in sorted(Path(folder).glob("*.py"))
    ]


@cache
def _of_machine() -> str:
    """Returns what all programs depend on: sources, versions, the processor and its instructions."""
    sources = sha256()
    for file in _list_sources():
        sources.update(file.read_bytes())
    processor = [platform.machine(), platform.processor()]
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))})
    versions = jax.local_devices()[0].client.platform_version
    return repr((sources.hexdigest(), installed_versions(), versions, processor))


def load(file: Path, *, quiet: bool = False) -> Kept | None:
    """Reads a file; returns None if there is none, or a damaged one, which it announces unless it is quiet."""
    try:
        content = file.read_bytes()
        digest, head, body = content[:32], *content[32:].split(b"\n", 1)
        if sha256(content[32:]).digest() != digest:
            raise ValueError("its checksum is wrong")
        facts = json.loads(head)
        programs, start = {}, 0
        for name, size in facts.pop("programs").items():
            programs[name] = body[start : start + size]
            start += size
        with suppress(OSError):  # another user's file
            os.utime(file)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        if not quiet:
            refuse(file, error)
        return None
    return Kept(facts, programs)


def save(file: Path, kept: Kept) -> None:
    """Writes a file, and removes the least recently used ones beyond the limit. A full disk keeps none."""
    facts = {**kept.facts, "programs": {name: len(program) for name, program in kept.programs.items()}}
    content = json.dumps(facts).encode() + b"\n" + b"".join(kept.programs.values())
    with suppress(OSError):
        write_atomic(file, [sha256(content).digest(), content])
        sizes = {one: one.stat() for one in file.parent.iterdir()}
        left = sum(stat.st_size for stat in sizes.values())
        for one in sorted(sizes, key=lambda one: sizes[one].st_mtime):
            if left > _MOST_BYTES and one != file:
                one.unlink(missing_ok=True)
                left -= sizes[one].st_size


def refuse(file: Path, error: Exception) -> None:
    """Announces that the programs of a file cannot be loaded."""
    announce(f"{file}: compiled programs cannot be loaded ({error}); they are compiled again")


# The threads in which JAX took a program from its own cache. XLA serialises such programs without their functions.
_taken: set[int] = set()


def _notice(event: str, **_: Plain) -> None:
    if event == "/jax/compilation_cache/cache_hits":
        _taken.add(get_ident())


jax.monitoring.register_event_listener(_notice)


def compile_and_serialise(lowered: jax.stages.Lowered, level: int) -> tuple[jax.stages.Compiled, bytes | None]:
    """Compiles a program, see `compile_program`; returns it, and its bytes, or None if XLA cannot serialise it.

    XLA cannot serialise a program that was compiled earlier in this process and has run. A later process adds it to the
    file. JAX writes it to no cache of its own.
    """
    _taken.discard(get_ident())
    with _without_the_cache_of_jax():
        compiled = compile_program(lowered, level)
    executable = compiled.runtime_executable()
    if get_ident() not in _taken and executable is not None:
        with suppress(Exception):  # of XLA, of any type
            return compiled, _serialise(executable)
    return compiled, None


def _serialise(executable: Untyped) -> bytes:
    if hasattr(executable, "serialize"):
        return bytes(executable.serialize())
    return bytes(jax.local_devices()[0].client.serialize_executable(executable))  # in versions of JAX before 0.9


# The options of the compiler, by level of optimisation.
_OPTIONS: tuple[dict[str, str | bool], ...] = (
    {
        "xla_backend_optimization_level": "0",
        "xla_cpu_use_fusion_emitters": False,
        "xla_cpu_parallel_codegen_split_count": "2",  # takes 15 % less processor time than the usual 32 parts for LLVM
    },
    {"xla_backend_optimization_level": "1", "xla_cpu_use_fusion_emitters": False},
    {},
)
_unknown: set[str] = set()  # those that this version of XLA does not know

LEVELS = len(_OPTIONS)
"""The number of levels of optimisation."""


def compile_program(lowered: jax.stages.Lowered, level: int) -> jax.stages.Compiled:
    """Compiles a program at a level of optimisation.

    Level 2 is XLA's usual one. Level 1 compiles in two thirds of the time and runs 1.1 to 1.5 times as long, level 0
    compiles in a third and runs 12 to 18 times as long.
    """
    options = {name: value for name, value in _OPTIONS[level].items() if name not in _unknown}
    try:
        return lowered.compile(options or None)
    except Exception as error:  # of XLA, of any type; it checks the options first
        names = [name for name in options if name in str(error)]
        if not names:
            raise
        _unknown.update(names)
        return compile_program(lowered, level)


_SHORTEST = "jax_persistent_cache_min_compile_time_secs"
_lock = Lock()
_before: list[float] = []  # the setting, once for each thread in the block below


@contextmanager
def _without_the_cache_of_jax() -> Iterator[None]:
    """Keeps JAX from writing programs to its own cache while a thread is in this block."""
    with _lock:
        _before.append(_before[0] if _before else getattr(jax.config, _SHORTEST))
        jax.config.update(_SHORTEST, float("inf"))
    try:
        yield
    finally:
        with _lock:
            before = _before.pop()
            if not _before:
                jax.config.update(_SHORTEST, before)
