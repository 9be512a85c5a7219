"""Random grids of tile codes."""

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np
from chex import Array, PRNGKey

from elitelanes_jax.checks import check_shape
from elitelanes_jax.codes import ROAD_ALPHABET, alphabet_of
from elitelanes_jax.draws import below, random_words
from elitelanes_jax.errors import InputError

__all__ = ["random_grids"]


def random_grids(
    key: PRNGKey, count: int, shape: tuple[int, int] = (12, 12), *, alphabet: Iterable[int] = ROAD_ALPHABET
) -> Array:
    """Grids with every tile drawn uniformly from an alphabet, without regard to its neighbours; `repair` joins them.

    Args:
      key: consumed. With JAX's default key type grid i depends on the key and i alone, not on `count`.
      count: how many, at least 0.
      shape: (height, width), each at least 2.
      alphabet: the tile codes to draw from.

    Returns:
      int8 ``[count, height, width]``.

    Raises:
      InputError: for a negative count, a bad shape or alphabet.
    """
    if not isinstance(count, int | np.integer) or count < 0:
        raise InputError(f"count: expected a whole number, 0 or more, got {count!r}")
    codes = jnp.asarray(alphabet_of(alphabet), jnp.int8)
    words = random_words(key, (count, *check_shape(shape)))
    return codes[below(words, codes.size)]
