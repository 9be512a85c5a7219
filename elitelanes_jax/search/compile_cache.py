"""A folder of compiled programs on disk: only the first run on a machine waits for the compiler."""

import os
from pathlib import Path

import jax

from elitelanes_jax._util.arguments import name_wrong_arguments


@name_wrong_arguments
def use_compile_cache() -> Path | None:
    """Keeps compiled programs on disk, so that later processes load them within a second.

    The programs of `evolve` are loaded without tracing, unless they contain your own functions.

    The folder is ``elitelanes_jax`` in the user's cache, ``$XDG_CACHE_HOME`` or ``~/.cache``,
    unless JAX's own setting, such as the variable JAX_COMPILATION_CACHE_DIR, names another one. The
    call changes JAX's settings for the whole process: call it in programs, not in libraries.

    Returns:
      The folder, or None if none can be written to: the programs are then compiled each time.
    """
    if named := jax.config.values.get("jax_compilation_cache_dir"):
        if "://" in str(named) or _can_write(Path(named)):
            return Path(named)
        # With the former folder, JAX would warn for each program.
        jax.config.update("jax_compilation_cache_dir", None)
        return None
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "elitelanes_jax"
    except RuntimeError:
        # The user has no home folder.
        return None
    if not _can_write(cache):
        return None
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    return cache


def _can_write(folder: Path) -> bool:
    """Makes the folder if it is missing; returns whether programs can be kept in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)
