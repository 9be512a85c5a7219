"""Compiled programs on disk: only the first run on a machine waits for the compiler.

JAX keeps what it compiles in a folder, but finds it only after a program was traced and lowered.
Therefore the programs of a search are kept in a file of their own, beside the files of JAX. A later
process loads them as they run.
"""

import os
import pickle
import platform
import warnings
import zlib
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

import jax

from elitelanes_jax._util import LOADED
from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import Plain, Untyped

# How the names of the programs in our files begin.
_NAME = "elitelanes_"

# The limit of all our files together, in bytes. The least recently used files are removed.
_MOST_BYTES = 2**28

# The magic number of a frame of Zstandard, and the kind of a block that is one repeated byte.
_ZSTANDARD, _REPEATED_BYTE = b"\x28\xb5\x2f\xfd", 1

# The rooms whose sources make the programs.
_ROOMS = ("_util", "network", "problem", "optimizers", "search")

# The lines by which Linux tells which instructions a processor has, and those that name its model.
_INSTRUCTIONS = {"flags", "Features", "isa"}
_MODEL = {"vendor_id", "cpu family", "model", "model name", "CPU implementer", "CPU part"}


@name_wrong_arguments
def use_compile_cache() -> Path | None:
    """Keeps compiled programs on disk, so that later processes load them within a second.

    The programs of `evolve` are loaded without tracing, unless they contain your own functions.

    The folder is ``elitelanes_jax`` in the user's cache, ``$XDG_CACHE_HOME`` or ``~/.cache``,
    unless JAX's own setting, such as the variable JAX_COMPILATION_CACHE_DIR, names another one. The
    call changes JAX's settings for the whole process: call it in programs, not in libraries.

    A program that cannot be read or written is compiled again, without a warning.

    Returns:
      The folder, or None if none can be written to: the programs are then compiled each time.
    """
    folder = jax.config.values.get("jax_compilation_cache_dir")
    if folder and "://" in str(folder):
        return Path(folder)
    chosen = Path(folder) if folder else _default_folder()
    if chosen is None or not _can_write(chosen):
        # With a folder that cannot be written to, JAX would warn for each program.
        jax.config.update("jax_compilation_cache_dir", None)
        return None
    if not folder:
        jax.config.update("jax_compilation_cache_dir", str(chosen))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry")
    with suppress(OSError):
        _remove_cut_off(chosen)
    return chosen


def _default_folder() -> Path | None:
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "elitelanes_jax"
    except RuntimeError:
        # The user has no home folder.
        return None


def _can_write(folder: Path) -> bool:
    """Makes the folder if it is missing; returns whether programs can be kept in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _remove_cut_off(folder: Path) -> None:
    """Removes programs of JAX that a full disk or a kill has cut off.

    JAX writes a program in place, and never replaces one that it cannot read. Each program is
    checked once, at the first call after it was written: the time of an empty file is that of the
    newest program that was checked.
    """
    checked = folder / ".checked"
    last = newest = checked.stat().st_mtime_ns if checked.exists() else 0
    for file in folder.glob("*-cache"):
        written = file.stat().st_mtime_ns
        if written > last and _is_cut_off(file.read_bytes()):
            file.unlink()
        newest = max(newest, written)
    checked.touch()
    os.utime(checked, ns=(newest, newest))


def _is_cut_off(content: bytes) -> bool:
    """Returns whether the end of a compressed program is missing."""
    # JAX compresses with zstandard if that is installed.
    if content.startswith(_ZSTANDARD):
        return _is_cut_off_zstandard(content)
    unzip = zlib.decompressobj()
    try:
        unzip.decompress(content)
    except zlib.error:
        return True
    return not unzip.eof


def _is_cut_off_zstandard(content: bytes) -> bool:
    """Returns whether the end of a frame of Zstandard is missing.

    Only the sizes of its blocks are read, because zstandard may not be installed (RFC 8878, section
    3.1.1).
    """
    flags = content[4] if len(content) > 4 else 0
    has_checksum, is_single_segment = bool(flags & 4), bool(flags & 32)
    dictionary_bytes = (0, 1, 2, 4)[flags & 3]
    size_bytes = (int(is_single_segment), 2, 4, 8)[flags >> 6]
    # A frame of several segments also has a byte with the size of its window.
    start = 5 + (not is_single_segment) + dictionary_bytes + size_bytes
    is_last = False
    while not is_last:
        # A block follows three bytes with a flag, its kind and its size. The bytes of a missing
        # header are 0, so that the next block starts after the end.
        header = int.from_bytes(content[start : start + 3], "little")
        is_last, kind, size = bool(header & 1), header >> 1 & 3, header >> 3
        start += 3 + (1 if kind == _REPEATED_BYTE else size)
        if start > len(content):
            return True
    return start + 4 * has_checksum > len(content)


def find_folder() -> Path | None:
    """Returns the folder of our files, or None.

    There is none if JAX keeps no compiled programs at present, or if the search is not on one
    processor alone.
    """
    folder = jax.config.values.get("jax_compilation_cache_dir")
    if (
        not folder
        or "://" in folder
        or not jax.config.values.get("jax_enable_compilation_cache", True)
    ):
        return None
    device = jax.local_devices()[0]
    if device.platform != "cpu" or jax.process_count() > 1:
        return None
    if getattr(jax.config, "jax_default_device", None) not in (None, device):
        # Arrays that are bound to no device, and so the programs, would be on this one.
        return None
    if not jax.sharding.get_abstract_mesh().empty:
        # The programs would need this mesh.
        return None
    return Path(folder) / "searches"


def find_file(folder: Path, *parts: Plain) -> Path | None:
    """Returns the file of the programs that depend on some values.

    Its name is a digest of all that the programs depend on, so any change leads to another file.
    The `repr` of each value must say all that matters of it. Returns None if the sources have
    changed since this process loaded them.
    """
    sources = _list_sources()
    if not sources or max(map(_last_change, sources)) > LOADED:
        return None
    machine = _processor(), os.environ.get("XLA_FLAGS")
    text = repr((machine, _digest_sources(), installed_versions(), settings_of_thread(), parts))
    return folder / sha256(text.encode()).hexdigest()


def unique_prefix() -> str:
    """Returns how the names of programs that go to a file begin.

    JAX finds a program in its own folder by its name too, and must not find these: XLA cannot
    serialise again what it has loaded.
    """
    return f"{_NAME}{os.urandom(8).hex()}_"


def settings_of_thread() -> tuple[tuple[str, Plain], ...]:
    """Returns the names and values of JAX's settings, except those of its cache.

    The settings may differ between threads.
    """
    names = sorted(name for name in jax.config.values if "_cache" not in name)
    return tuple((name, getattr(jax.config, name, None)) for name in names)


@cache
def _processor() -> tuple[str, ...]:
    """Returns what tells processors with other instructions apart.

    A program may crash on a processor that lacks an instruction of the one it was compiled for.
    """
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        values = {tuple(map(str.strip, line.partition(":")[::2])) for line in lines}
        known = {value for value in values if value[0] in _INSTRUCTIONS | _MODEL}
        if not _INSTRUCTIONS.isdisjoint(name for name, _ in known):
            return platform.machine(), *map(str, sorted(known))
    # Other systems do not tell the instructions, so a file serves one computer alone.
    return platform.machine(), platform.processor(), platform.node()


def _list_sources() -> list[Path]:
    files = []
    for room in _ROOMS:
        spec = find_spec(f"{__package__.split('.')[0]}.{room}")
        assert spec is not None
        for folder in spec.submodule_search_locations or ():
            files += sorted(Path(folder).glob("*.py"))
    return files


def _last_change(file: Path) -> int:
    stat = file.stat()
    return max(stat.st_mtime_ns, stat.st_ctime_ns)


@cache
def _digest_sources() -> str:
    digest = sha256()
    for file in _list_sources():
        digest.update(file.read_bytes())
    return digest.hexdigest()


def load(file: Path) -> Untyped:
    """Reads what `save` wrote. Returns None if there is no file, or announces a damaged one."""
    try:
        content = pickle.loads(zlib.decompress(file.read_bytes()))
    except FileNotFoundError:
        return None
    except Exception as error:
        # Pickle raises errors of any type.
        announce_refused(file, error)
        return None
    # The time of the last use decides which files are removed.
    with suppress(OSError):
        # The file may belong to another user.
        os.utime(file)
    return content


def announce_refused(file: Path, error: Exception) -> None:
    """Announces that the programs of a file cannot be loaded."""
    announce(f"{file}: compiled programs cannot be loaded ({error}); they are compiled again")


def save(file: Path, content: Untyped) -> None:
    """Writes a file, and removes the least recently used files beyond the limit.

    No file is kept on a full disk.
    """
    with suppress(OSError):
        # The fastest level leaves a tenth of the bytes.
        write_atomic(file, zlib.compress(pickle.dumps(content), level=1))
        _remove_oldest(file)
        # JAX has kept these programs too, and would never find them.
        for copy in file.parent.parent.glob(f"jit_{_NAME}*"):
            copy.unlink(missing_ok=True)


def _remove_oldest(newest: Path) -> None:
    stats = {file: file.stat() for file in newest.parent.iterdir()}
    total = sum(stat.st_size for stat in stats.values())
    for file in sorted(stats, key=lambda file: stats[file].st_mtime):
        if total > _MOST_BYTES and file != newest:
            file.unlink(missing_ok=True)
            total -= stats[file].st_size
