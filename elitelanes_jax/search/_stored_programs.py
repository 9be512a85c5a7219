"""Exported programs of a search in a file.

A later process loads them instead of tracing and lowering again. The name of a file is a digest of
all that its programs depend on, so any change leads to another file. A file that cannot be read is
replaced. The files are next to JAX's own cache of compiled programs, if that is in use. There JAX
finds the compiled form of a loaded program.
"""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import jax

from elitelanes_jax._util import LOADED
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import Plain

# The limit of all files together, in bytes. The least recently used files are removed.
_MOST_BYTES = 2**28

# The rooms whose sources make the programs.
_ROOMS = ("_util", "network", "problem", "optimizers", "search")


class StoredPrograms(NamedTuple):
    """The content of a file.

    Attributes:
      facts: facts about the search, plain values for JSON.
      exports: serialised `jax.export.Exported` by the program's name.
    """

    facts: Mapping[str, Plain]
    exports: Mapping[str, bytes]


def find_folder() -> Path | None:
    """Returns the folder of the files, or None.

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
    if jax.local_devices()[0].platform != "cpu" or jax.process_count() > 1:
        return None
    if not jax.sharding.get_abstract_mesh().empty:
        # Exported programs would need this mesh.
        return None
    return Path(folder) / "exported"


def find_file(folder: Path, *parts: Plain) -> Path | None:
    """Returns the file of the programs that depend on some values.

    The `repr` of each value must say all that matters of it. Returns None if the sources have
    changed since this process loaded them.
    """
    sources = _list_sources()
    if not sources or max(map(_last_change, sources)) > LOADED:
        return None
    text = repr((_digest_sources(), installed_versions(), settings_of_thread(), parts))
    return folder / sha256(text.encode()).hexdigest()


def settings_of_thread() -> tuple[tuple[str, Plain], ...]:
    """Returns the names and values of JAX's settings, except those of its cache.

    The settings may differ between threads.
    """
    names = sorted(name for name in jax.config.values if "_cache" not in name)
    return tuple((name, getattr(jax.config, name, None)) for name in names)


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


def load(file: Path) -> StoredPrograms | None:
    """Reads a file; returns None if there is none. Announces a damaged file, and returns None."""
    # A file has a digest of all that follows, a line of JSON with the facts and the sizes of the
    # exports, and the exports.
    try:
        content = file.read_bytes()
        digest, (head, body) = content[:32], content[32:].split(b"\n", 1)
        if sha256(content[32:]).digest() != digest:
            raise ValueError("its checksum is wrong")
        facts = json.loads(head)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        announce_refused(file, error)
        return None
    exports, start = {}, 0
    for name, size in facts.pop("sizes").items():
        exports[name] = body[start : start + size]
        start += size
    # The time of the last use decides which files are removed.
    with suppress(OSError):
        # The file may belong to another user.
        os.utime(file)
    return StoredPrograms(facts, exports)


def announce_refused(file: Path, error: Exception) -> None:
    """Announces that the programs of a file cannot be loaded."""
    announce(f"{file}: compiled programs cannot be loaded ({error}); they are compiled again")


def save(file: Path, stored: StoredPrograms) -> None:
    """Writes a file, and removes the least recently used files beyond the limit.

    A full disk keeps none.
    """
    sizes = {name: len(export) for name, export in stored.exports.items()}
    head = json.dumps({**stored.facts, "sizes": sizes}).encode()
    content = head + b"\n" + b"".join(stored.exports.values())
    with suppress(OSError):
        write_atomic(file, [sha256(content).digest(), content])
        _remove_oldest(file)


def _remove_oldest(newest: Path) -> None:
    stats = {file: file.stat() for file in newest.parent.iterdir()}
    total = sum(stat.st_size for stat in stats.values())
    for file in sorted(stats, key=lambda file: stats[file].st_mtime):
        if total > _MOST_BYTES and file != newest:
            file.unlink(missing_ok=True)
            total -= stats[file].st_size
