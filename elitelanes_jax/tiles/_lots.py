"""Lots of a seed, by which pictures are chosen."""

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError


def draw_lots(seed: int | list[int], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Draws numbers from 0 to under 1 by `numpy.random.default_rng`.

    Raises:
      InputError: for a seed that is not whole numbers, 0 or more.
    """
    try:
        return np.random.default_rng(seed).random(shape)
    except (TypeError, ValueError):
        raise InputError(f"seed: expected whole numbers, 0 or more, got {seed!r}") from None
