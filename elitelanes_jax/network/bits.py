"""Random choices from random bits: numbers and grids, exact and the same on every machine."""

from collections.abc import Iterable
from contextlib import AbstractContextManager
from math import log, prod

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float32, Int, Int8, Int32, Key, Real, UInt32
from numpy.polynomial import Chebyshev, Polynomial

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, is_whole, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import ROAD_ALPHABET, check_alphabet
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import UNIT, align, materialize, take


def mix(number: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
    """Hashes 32 bits: each bit of the number changes about half of the bits.

    The multipliers are those of lowbias32 (Chris Wellons, "Prospecting for Hash Functions", 2018).
    """
    number = (number ^ (number >> 16)) * np.uint32(0x7FEB352D)
    number = (number ^ (number >> 15)) * np.uint32(0x846CA68B)
    return number ^ (number >> 16)


def check_key(key: UserValue) -> None:
    """Raises `InputError` for anything but one key of JAX, new or old style."""
    if isinstance(key, jax.Array | np.ndarray):
        is_new = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
        # A key of the old style is a vector.
        if (is_new and key.ndim == 0) or (key.dtype == jnp.uint32 and key.ndim == 1):
            return
    raise InputError("key", "a jax.random.key", quote(key))


THREEFRY = "threefry2x32"
"""The kind of key that JAX makes by default."""


def default_draws() -> AbstractContextManager[None]:
    """Makes `jax.random` draw the same bits in its block under all settings.

    The setting is `jax_threefry_partitionable`.
    """
    draws: AbstractContextManager[None] = jax.threefry_partitionable(True)
    return draws


@runs_jax
def seed_key(seed: int) -> Key[Array, ""]:
    """Returns the key of a whole number, 0 to 2**32 - 1: the same whatever JAX's settings."""
    return jax.random.wrap_key_data(jax.device_put(np.array([0, seed], np.uint32)), impl=THREEFRY)


@name_wrong_arguments
@runs_jax
def random_bits(key: Key[Array, ""], shape: tuple[int, ...]) -> UInt32[Array, "..."]:
    """Draws uint32 ``[*shape]``, by default the same bits as `jax.random.bits`.

    The key is consumed.
    """
    return _random_bits(key, shape=shape)


@divide_batches
def _random_bits(key: Key[Array, ""], *, shape: tuple[int, ...]) -> UInt32[Array, "..."]:
    size = prod(shape)
    if not _is_threefry(key):
        with default_draws():
            # One vector compiles four times faster than an array of several axes.
            return jax.random.bits(key, (size,), jnp.uint32).reshape(shape)
    # Number i is made from the encrypted counter i, as in `jax.random.bits`.
    left, right = threefry(jax.random.key_data(key), jnp.arange(size, dtype=jnp.uint32))
    return materialize(left ^ right).reshape(shape)


@runs_jax
@divide_batches
def fold_in(key: Key[Array, ""], number: Int[ArrayLike, ""]) -> Key[Array, ""]:
    """Returns the same key as `jax.random.fold_in`."""
    if not _is_threefry(key):
        return jax.random.fold_in(key, number)
    data = threefry(jax.random.key_data(key), jnp.asarray(number, jnp.uint32))
    return jax.random.wrap_key_data(materialize(jnp.stack(data)), impl=THREEFRY)


def split(key: Key[Array, ""], count: int = 2) -> Key[Array, " count"]:
    """Returns the same keys as `jax.random.split` by default; the key is consumed."""
    with default_draws():
        return jax.random.split(key, count)


def uniform(key: Key[Array, ""], shape: tuple[int, ...]) -> Float32[Array, "..."]:
    """Returns the same numbers in [0, 1) as `jax.random.uniform` does by default.

    The key is consumed.
    """
    with default_draws():
        return jax.random.uniform(key, shape, jnp.float32)


def normal(key: Key[Array, ""], shape: tuple[int, ...]) -> Float32[Array, "..."]:
    """Returns the same normally distributed numbers as `jax.random.normal` by default.

    The key is consumed.
    """
    with default_draws():
        return jax.random.normal(key, shape, jnp.float32)


def _is_threefry(key: Key[Array, ""]) -> bool:
    return (
        jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and str(jax.random.key_impl(key)) == THREEFRY
    )


def threefry(
    key: UInt32[Array | np.ndarray, "2 ..."], counters: UInt32[Array | np.ndarray, "..."]
) -> tuple[UInt32[Array | np.ndarray, "..."], UInt32[Array | np.ndarray, "..."]]:
    """Encrypts the pairs (0, counter) with a key, by Threefry-2x32.

    The cipher has 20 rounds (Salmon et al. 2011). Takes arrays of JAX or of NumPy; the two numbers
    of the key broadcast against the counters. JAX's own function is a loop over the rounds. Without
    a loop it compiles in half the time, and takes 0.6 times as long.
    """
    # The constant and the rotations are those of the article.
    schedule = (key[0], key[1], key[0] ^ key[1] ^ np.uint32(0x1BD11BDA))
    left, right = schedule[0], counters + schedule[1]
    for step in range(20):
        turn = ((13, 15, 26, 6), (17, 29, 16, 24))[step // 4 % 2][step % 4]
        left = left + right
        right = (right << np.uint32(turn) | right >> np.uint32(32 - turn)) ^ left
        if step % 4 == 3:
            # After every fourth round, two words of the key schedule are added.
            group = step // 4 + 1
            left = left + schedule[group % 3]
            right = right + (schedule[(group + 1) % 3] + np.uint32(group))
    return left, right


def random_bits16(key: Key[Array, ""], shape: tuple[int, ...]) -> Int32[Array, "..."]:
    """Draws int32 ``[*shape]`` in [0, 2**16), all 16 bits random; the key is consumed."""
    size = prod(shape)
    bits = random_bits(key, (-(-size // 2),))
    return jnp.concatenate([bits & 0xFFFF, bits >> 16])[:size].reshape(shape).astype(jnp.int32)


def symmetric_uniform(key: Key[Array, ""], shape: tuple[int, ...]) -> Int32[Array, "..."]:
    """Draws int32 ``[*shape]`` uniformly from -1 to 1, in units of 1 / `UNIT`.

    The key is consumed.
    """
    # A division of 2**16 by 8 leaves 2 * `UNIT` numbers.
    return random_bits16(key, shape) // 8 - UNIT


@name_wrong_arguments
@runs_jax
def randint(bits: UInt32[Array, "..."], count: Int[ArrayLike, "..."]) -> Int32[Array, "..."]:
    """Returns a whole number in [0, count) from 32 random bits.

    Each number has probability 1 / count, within 2**-32. The result is the upper half of the 64-bit
    product of the bits and the count, in 32-bit arithmetic.

    Args:
      bits: uint32, any shape.
      count: 0 to 2**31 - 1, a number or an array that broadcasts against `bits`. Where it is 0, so
        is the result.

    Returns:
      int32, of the broadcast shape.

    Raises:
      InputError: for bits of another dtype, or counts that are no whole numbers in this range. The
        range of counts in an array of JAX is not checked.
    """
    bits = _check_bits(bits)
    _check_counts(count)
    high, low = bits >> 16, bits & 0xFFFF
    if isinstance(count, int | np.integer | np.ndarray) and np.max(count, initial=0) < 2**16:
        counts_below: Untyped = np.asarray(count).astype(np.uint32)
        high, low, few = align(high, low, counts_below)
        # The upper half of a count below 2**16 is 0, and so are most terms of the product below.
        return (high * few + (low * few >> 16) >> 16).astype(jnp.int32)
    # The product is computed from halves of 16 bits, and carried into its upper 32 bits.
    high, low, counts = align(high, low, jnp.asarray(count, jnp.uint32))
    count_high, count_low = counts >> 16, counts & 0xFFFF
    middle = high * count_low + (low * count_low >> 16)
    carry = (middle & 0xFFFF) + low * count_high
    return (high * count_high + (middle >> 16) + (carry >> 16)).astype(jnp.int32)


def _check_bits(bits: UserValue) -> UInt32[Array, "..."]:
    """Checks random bits; returns them as an array of JAX.

    Shifts of another dtype give other numbers: those of int32 keep the sign.
    """
    dtype = bits.dtype if hasattr(bits, "dtype") else np.asarray(bits).dtype
    if dtype != np.uint32:
        raise InputError("bits", "uint32", dtype)
    return jnp.asarray(bits)


def _check_counts(count: UserValue) -> None:
    """Checks one count or many; the numbers in an array of JAX may be unknown."""
    if is_whole(count):
        check_named("count", whole(0), count)
        return
    counts = count if isinstance(count, jax.Array) else np.asarray(count)
    are_known = isinstance(counts, np.ndarray) and counts.size > 0
    if counts.dtype.kind not in "iu" or (
        are_known and not 0 <= counts.min() <= counts.max() < 2**31
    ):
        got = quote(count)
        raise InputError("count", f"whole numbers, 0 to {2**31 - 1}", got)


@name_wrong_arguments
@runs_jax
def random_grids(
    key: Key[Array, ""],
    count: int,
    shape: tuple[int, int] = (12, 12),
    *,
    alphabet: Iterable[int] = ROAD_ALPHABET,
) -> Int8[Array, "count H W"]:
    """Draws every tile uniformly from an alphabet, independently of its neighbours.

    `repair` then links the tiles.

    Args:
      key: consumed. With JAX's default key type grid i depends on the key and i alone, not on
        `count`.
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
    return _random_grids(key, shape=(count, *check_shape(shape)), alphabet=check_alphabet(alphabet))


@divide_batches
def _random_grids(
    key: Key[Array, ""], *, shape: tuple[int, int, int], alphabet: tuple[int, ...]
) -> Int8[Array, "count H W"]:
    codes = jnp.asarray(alphabet, jnp.int8)
    return codes[randint(random_bits(key, shape), codes.size)]


@name_wrong_arguments
@runs_jax
def bernoulli(
    bits: UInt32[Array, "..."], probability: Real[ArrayLike, "..."]
) -> Bool[Array, "..."]:
    """Returns True with a probability, from the upper 24 of 32 random bits.

    The result is never True for probability 0, and always True for probability 1. As in
    `jax.random.bernoulli`, a probability above 1 counts as 1, and one below 0 or NaN as 0. The
    probability broadcasts against the bits. Raises `InputError` for bits of another dtype than uint32.
    """
    drawn, limit = align(
        (_check_bits(bits) >> 8).astype(jnp.float32), 2**24 * jnp.asarray(probability, jnp.float32)
    )
    return drawn < limit


def exponential(bits: UInt32[Array, "..."]) -> Int32[Array, "..."]:
    """Returns an exponentially distributed number of mean 1 from 32 random bits.

    The number is in units of 1 / `UNIT`, and at most 8.4. It is one of 2048 equally likely
    quantiles.
    """
    return take(_QUANTILES, bits >> 21)


def categorical(bits: UInt32[Array, "..."], logits: Int32[Array, "K ..."]) -> Int32[Array, "..."]:
    """Returns a whole number in [0, K) from 32 random bits, by a softmax.

    The probabilities are those of the softmax of the logits, within 1 / 10,000. The logits int32
    ``[K, ...]`` are in units of 1 / `UNIT`; K is at most 31.
    """
    # The largest logit becomes 0, and its weight 2**26. So the sum of 31 weights fits int32.
    weights = _exponential_of(logits - logits.max(axis=0, keepdims=True))
    drawn = randint(bits, weights.sum(axis=0, dtype=jnp.int32))
    # The index is the number of cumulative weights that the drawn number reaches.
    index, reached = jnp.zeros(bits.shape, jnp.int32), jnp.zeros(bits.shape, jnp.int32)
    for weight in weights:
        reached = reached + weight
        index = index + (drawn >= reached).astype(jnp.int32)
    return index


def _exponential_of(value: Int32[Array, "..."]) -> Int32[Array, "..."]:
    """Returns the exponential of a number of at most 0, in units of 2**-26."""
    # The result is 2**-(n + f), where n is whole and f is in [0, 1). `halvings` is n + f in units
    # of 2**-26. Values below -20 count as -20, so `halvings` fits int32. Their result is 0 either
    # way.
    halvings = jnp.minimum(-value, 20 * UNIT) * round(2**14 / log(2))
    f = (halvings & 2**26 - 1) >> 11
    # A polynomial computes 2**-f in units of 2**-15.
    share = jnp.zeros_like(f)
    for coefficient in _EXPONENTIAL:
        share = (share * f >> 15) + coefficient
    return share << 11 >> (halvings >> 26)


# The quantiles of the exponential distribution, in the middles of 2048 equal parts of [0, 1].
_QUANTILES = np.rint(-UNIT * np.log((np.arange(2048) + 0.5) / 2048)).astype(np.int32)

# The coefficients of 2**-f as a polynomial that is exact at the Chebyshev points of [0, 1], the
# highest power first, in units of 2**-15.
_EXPONENTIAL = [
    round(2**15 * c)
    for c in Chebyshev.interpolate(lambda f: 2.0**-f, 4, [0, 1]).convert(kind=Polynomial).coef[::-1]
]
