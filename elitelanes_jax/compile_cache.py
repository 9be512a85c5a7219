"""A cache of compiled programs on disk: only the first run on a machine waits for the compiler."""

import os
from pathlib import Path

import jax

__all__ = ["use_compile_cache"]


def use_compile_cache() -> None:
    """Keeps compiled programs in the user's cache folder, unless JAX's settings name another one.

    It changes JAX's settings for the whole process: call it in programs, not in libraries.
    """
    if jax.config.values.get("jax_compilation_cache_dir"):
        return
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "elitelanes_jax"
        cache.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError where there is no home
        return  # only slower
    if not os.access(cache, os.W_OK | os.X_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
