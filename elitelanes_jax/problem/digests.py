"""Digests of functions of the user, made from their jaxprs with all constants."""

import re
import sys
from collections.abc import Callable, Iterator
from hashlib import sha256
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.types import Pytree

if TYPE_CHECKING:
    from jax.extend import core


def digest(function: Callable[..., Pytree], *arguments: Pytree) -> str:
    """Returns 16 hexadecimal digits that are equal in all processes for functions with the same jaxpr and constants.

    Calls out of JAX, such as callbacks, do not count. The arguments may be given by their shapes and dtypes.
    """
    closed = jax.make_jaxpr(function)(*arguments)
    with np.printoptions(threshold=sys.maxsize):
        text = re.sub(r"\bat 0x[0-9a-f]+", "", str(closed))
    parts = sha256(text.encode())
    for constant in _constants(closed):
        parts.update(constant)
    return parts.hexdigest()[:16]


def _constants(closed: "core.ClosedJaxpr") -> Iterator[bytes]:
    """Yields the constants of a jaxpr and of its inner jaxprs. The text of a jaxpr has only their shapes."""
    from jax.extend import core  # most searches have no functions of the user

    for constant in closed.consts:
        is_key = jnp.issubdtype(jnp.result_type(constant), jax.dtypes.prng_key)
        yield np.asarray(jax.random.key_data(constant) if is_key else constant).tobytes()
    for equation in closed.jaxpr.eqns:
        for inner in jax.tree.leaves(equation.params):
            if isinstance(inner, core.ClosedJaxpr):
                yield from _constants(inner)
            elif isinstance(inner, core.Jaxpr):
                yield from _constants(core.ClosedJaxpr(inner, ()))
