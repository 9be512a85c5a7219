"""Rotates and mirrors grids: cells and codes together, so that links are preserved.

A NumPy array gives a NumPy array, an array of JAX an array of JAX.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import LARGEST, check_named, whole
from elitelanes_jax._util.running import transfers
from elitelanes_jax._util.types import AnyArray, ArrayOrRows, ArrayT
from elitelanes_jax.network.checks import check_grid, known_grid
from elitelanes_jax.network.codes import EAST, WEST, exchange_sides, rotate_codes
from elitelanes_jax.network.plain_metrics import cut_to_roads

# The grids whose images are in memory at once.
_TOGETHER = 4096


@name_wrong_arguments
def rotate(grid: ArrayOrRows, quarter_turns: int = 1) -> AnyArray:
    """Rotates a grid of codes ``[H, W]`` counter-clockwise by quarter turns, as `numpy.rot90` does.

    Any whole number of turns is valid; negative ones rotate clockwise. Returns int8 ``[H, W]`` or
    ``[W, H]``. Raises `InputError` for a bad grid. Under `jax.jit` and `jax.vmap` codes are not
    checked, and their four lowest bits are read.
    """
    # The four lowest bits of a traced code are read.
    grid = check_grid(grid) & 15
    turns = check_named("quarter_turns", whole(-LARGEST, LARGEST), quarter_turns) % 4
    with transfers():
        for _ in range(turns):
            grid = _turned(grid)
    return grid


@name_wrong_arguments
def mirror(grid: ArrayOrRows) -> AnyArray:
    """Mirrors a grid of codes ``[H, W]`` east to west, as `numpy.fliplr` does.

    Returns int8 ``[H, W]``. Raises `InputError` for a bad grid. Under `jax.jit` and `jax.vmap` codes
    are not checked, and their four lowest bits are read.
    """
    with transfers():
        return _mirrored(check_grid(grid))


@name_wrong_arguments
def canonical_form(grid: ArrayOrRows, *, crop: bool = False) -> bytes:
    """Returns bytes that are equal for a grid and its rotations and mirror images.

    The bytes of other grids differ. It is no kernel: under `jax.jit` and `jax.vmap` there are no
    bytes, and it raises `InputError`.

    Args:
      grid: integer codes ``[H, W]``.
      crop: whether empty rows and columns at the border are removed first. Then the bytes of two
        grids are equal if and only if their roads are the same, at any position.

    Raises:
      InputError: for a bad grid.
    """
    codes = known_grid(grid)
    if crop:
        codes = box_of_roads(codes)
    return next(canonical_forms(codes[None]))


def box_of_roads(grid: Int8[np.ndarray, "H W"]) -> Int8[np.ndarray, "h w"]:
    """Returns the smallest box that contains all tiles; one empty cell without tiles."""
    box = cut_to_roads(grid)
    return box if box.any() else box[:1, :1]


def canonical_forms(grids: Int8[np.ndarray, "B H W"]) -> Iterator[bytes]:
    """Yields the `canonical_form` of each of many checked grids."""
    for some in np.split(grids, range(_TOGETHER, len(grids), _TOGETHER)):
        images = images_of(some)
        size = max(images[0][:1].size, 1)
        # The form begins with a side of the image in two bytes, because grids of other shapes may
        # have the same codes in a row.
        contents = [(bytes(divmod(image.shape[1], 256)), image.tobytes()) for image in images]
        for start in range(0, some.size, size):
            yield min(head + content[start : start + size] for head, content in contents)


def images_of(grids: ArrayT) -> list[ArrayT]:
    """Returns the eight rotations and mirror images of checked grids ``[..., H, W]``.

    The first image is the grids themselves.
    """
    images = []
    for image in (grids, _mirrored(grids)):
        for _ in range(4):
            images.append(image)
            image = _turned(image)
    return images


def _turned(grids: ArrayT) -> ArrayT:
    return rotate_codes(grids).swapaxes(-1, -2)[..., ::-1, :]


def _mirrored(grids: ArrayT) -> ArrayT:
    return exchange_sides(grids, EAST, WEST)[..., ::-1]
