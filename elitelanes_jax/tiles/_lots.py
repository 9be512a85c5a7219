"""Lots of a seed, by which pictures are chosen."""

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import is_flag
from elitelanes_jax._util.errors import InputError, quote


def draw_lots(seed: int | list[int], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Draws numbers from 0 to under 1 by `numpy.random.default_rng`.

    Raises:
      InputError: for a seed that is not whole numbers, 0 or more.
    """
    try:
        # NumPy draws a seed itself for None, and advances a generator: equal calls would differ. A
        # `SeedSequence` takes None too, but no generator.
        if seed is None or is_flag(seed):
            raise TypeError
        return np.random.default_rng(np.random.SeedSequence(seed)).random(shape)
    except (TypeError, ValueError):
        got = quote(seed)
        raise InputError("seed", "whole numbers, 0 or more", got) from None
