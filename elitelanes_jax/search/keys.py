"""The random keys of a search: one for each seed."""

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt32

from elitelanes_jax._util.checks import SEED, check_named, is_whole
from elitelanes_jax._util.errors import InputError, quote, warn_user
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.optimizers.loop import seed_key_data
from elitelanes_jax.search.spec import SEEDS, check_seeds


class SearchKeys(NamedTuple):
    """The keys of all seeds.

    Attributes:
      data: uint32 ``[S, B]``, see `jax.random.key_data`.
      kind: the implementation, such as threefry2x32.
      single: whether there was one key alone, so that results have no axis of seeds.
    """

    data: UInt32[np.ndarray, "S B"]
    kind: str
    single: bool


def keys_of_seeds(seed: int, indices: Iterable[int]) -> SearchKeys:
    """Returns the keys of some seeds of a run.

    Each key depends on `seed` and its index alone, see `seed_keys`.
    """
    return SearchKeys(seed_key_data(seed, np.array([*indices])), THREEFRY, single=False)


def check_keys(key: UserValue, seeds: int | None = None) -> SearchKeys:
    """Returns the keys of a whole number and a number of seeds, of one key, or of an array of keys.

    Warns of keys that come twice.

    Raises:
      InputError: for anything else.
    """
    if is_whole(key):
        seed = check_named("key", SEED, key)
        count = check_named("seeds", check_seeds, SEEDS if seeds is None else seeds)
        return keys_of_seeds(seed, range(count))
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raise InputError("key", "a whole number, a jax.random.key or an array of them", quote(key))
    if isinstance(key, jax.core.Tracer):
        raise InputError(
            "key",
            "a key outside jax.jit and jax.vmap, because evolve compiles a program of its own",
            "a traced one",
            "give an array of keys for many seeds, or use optimizers.run in your program",
        )
    if seeds is not None:
        raise InputError("seeds", "none with keys, because each key is a seed", repr(seeds))
    if key.ndim > 1 or key.size == 0:
        raise InputError("key", "one key or keys [S] with S at least 1", f"shape {key.shape}")
    # One key becomes an array of one key, so that later steps always have an axis of seeds.
    data = np.asarray(jax.random.key_data(key))
    data = data.reshape(-1, data.shape[-1])
    repeated = len(data) - len(np.unique(data, axis=0))
    if repeated:
        warn_user(
            f"key: expected keys that differ, got {repeated} of {len(data)} again: equal keys give "
            "equal results"
        )
    return SearchKeys(data, str(jax.random.key_impl(key)), single=key.ndim == 0)
