"""Random grids of tile codes."""

from collections.abc import Iterable

import jax.numpy as jnp
from jaxtyping import Array, Int8, Key

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax.network.bits import check_key, randint, random_bits
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import ROAD_ALPHABET, check_alphabet


def random_grids(
    key: Key[Array, ""], count: int, shape: tuple[int, int] = (12, 12), *, alphabet: Iterable[int] = ROAD_ALPHABET
) -> Int8[Array, "count H W"]:
    """Draws every tile uniformly from an alphabet, independently of its neighbours; `repair` links them.

    Args:
      key: consumed. With JAX's default key type grid i depends on the key and i alone, not on `count`.
      count: the number of grids, at least 0.
      shape: (height, width), each at least 1.
      alphabet: the tile codes to draw from.

    Returns:
      int8 ``[count, height, width]``.

    Raises:
      InputError: for anything but a key, a negative count, a bad shape or alphabet.
    """
    check_key(key)
    count = check_named("count", whole(0), count)
    codes = jnp.asarray(check_alphabet(alphabet), jnp.int8)
    bits = random_bits(key, (count, *check_shape(shape)))
    return codes[randint(bits, codes.size)]
