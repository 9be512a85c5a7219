"""Blends photographs: a gain and an offset for each tile of a map, and feathered seams.

Photographs differ in light and colour, so that each shows as a square on a map. The tiles of a map
are made equal where their roads meet. Masks and labels do not change.
"""

from collections.abc import Iterator
from math import ceil
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST

# The depth on both sides of a seam over which roads are compared, in tiles.
_STRIP = 1 / 2
# The weights of (255 · (gain - 1))² and offset², relative to squared grey levels.
_GAIN, _OFFSET = 1.0, 0.01
# The width of the blend on both sides of a seam in tiles, and at least two pixels.
_FEATHER = 0.02
# The number of pairs of tiles that are compared at once, which limits the memory.
_PAIRS = 256
# Turns the levels of both pixels and 1 into the coefficients of four unknowns: 255 · (gain - 1) and
# offset of the first tile, then of the second.
_ROW = np.array([[1 / 255, 0, 0], [0, 0, 1], [0, -1 / 255, 0], [0, 0, -1]])


Equations: TypeAlias = dict[
    tuple[bool, int, int], tuple[Float[NDArray, "3 4 4"], Float[NDArray, "3 4"]]
]
"""The normal equations of pairs of pictures, see `_equations`.

Keys are whether the second picture is below the first one instead of right of it, and both.
"""


def solve_tones(
    grid: ArrayLike,
    picture: Int[NDArray, "H W"],
    images: UInt8[NDArray, "T P P 3"],
    labels: UInt8[NDArray, "T P P"],
    known: Equations | None = None,
) -> Float[NDArray, "H W 3 2"]:
    """Solves for the gains and offsets of all tiles of a map by linear least squares.

    A seam is where the roads of two neighbours meet. The pixels within half a tile of a seam are
    compared with their mirror images on the other side, if both have the same label: road, or the
    same kind of line. With less depth, darker or redder borders of photographs would decide, and
    their middles would be too bright or too green. The solution minimises the mean squared
    difference of these pairs, summed over all seams, plus (255 · (gain - 1))² and 0.01 · offset²,
    summed over all tiles. The first cost keeps the contrast, the second one the colour of the whole
    map. Each channel is solved alone.

    `picture` has the index of each cell's picture in `images` and `labels`. `known` has equations of
    these pictures from earlier calls, and gets those of this call. Returns gain and offset of each
    cell and channel; 1 and 0 if its road meets no other.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    codes = np.asarray(grid)
    known = {} if known is None else known
    count = codes.size
    cells = np.arange(count).reshape(codes.shape)
    # The normal equations of each channel begin with the two costs, which are on the diagonal. The
    # unknowns of a cell are 255 · (gain - 1) and the offset.
    diagonal = np.arange(2 * count)
    positions, matrices = [np.stack([diagonal, diagonal])], [np.tile([_GAIN, _OFFSET], (3, count))]
    right = np.zeros((3, 2 * count))
    # Seams in both directions are treated alike: in a transposed map, cells one above the other are
    # side by side.
    for turned, meets in _meetings(codes):
        first, second = (
            _turn(cells, turned)[:, part][meets] for part in (slice(None, -1), slice(1, None))
        )
        # Equal pairs of pictures have equal equations, which are computed once.
        pairs, pair = np.unique(
            np.stack([picture.flat[first], picture.flat[second]], axis=1),
            axis=0,
            return_inverse=True,
        )
        keys = [(turned, *pair) for pair in pairs.tolist()]
        fresh = [number for number, key in enumerate(keys) if key not in known]
        if fresh:
            equations = _equations(pairs[fresh], _turn(images, turned, 1), _turn(labels, turned, 1))
            for index, number in enumerate(fresh):
                known[keys[number]] = equations[0][:, index], equations[1][:, index]
        products, sides = np.zeros((3, len(keys), 4, 4)), np.zeros((3, len(keys), 4))
        for number, key in enumerate(keys):
            products[:, number], sides[:, number] = known[key]
        unknowns = np.stack([2 * first, 2 * first + 1, 2 * second, 2 * second + 1], axis=-1)
        # The products of a seam fill 4 x 4 entries of the matrix. SciPy adds up entries of the same
        # position.
        square = np.broadcast_arrays(unknowns[:, :, None], unknowns[:, None, :])
        positions.append(np.stack([part.reshape(-1) for part in square]))
        matrices.append(products[:, pair.reshape(-1)].reshape(3, -1))
        for channel in range(3):
            np.add.at(right[channel], unknowns, sides[channel, pair.reshape(-1)])
    rows, columns = np.concatenate(positions, axis=1)
    # The channels differ in their values, but not in their positions.
    tones = []
    for values, side in zip(np.concatenate(matrices, axis=1), right, strict=True):
        matrix = coo_array((values, (rows, columns)), shape=(2 * count, 2 * count)).tocsc()
        tones.append(spsolve(matrix, side).reshape(*codes.shape, 2))
    return np.stack(tones, axis=2) * (1 / 255, 1) + (1, 0)


def lay_toned(
    images: UInt8[NDArray, "T P P 3"],
    picture: Int[NDArray, "H W"],
    tones: Float[NDArray, "H W 3 2"],
) -> UInt8[NDArray, "h w 3"]:
    """Lays pictures side by side, each with its own gain and offset.

    Levels are multiplied by the gain. Then the offset is added, and the sum is rounded. `picture`
    has the index of each cell's picture. Sums are clipped to 0..255.
    """
    height, width = picture.shape
    size = images.shape[1]
    gains, offsets = tones[:, :, None, :, 0], tones[:, :, None, :, 1]
    levels = np.arange(256)[:, None]
    # A table has the new level of each of 256 levels, for each cell and channel.
    tables = np.clip(np.rint(levels * gains + offsets), 0, 255).astype(np.uint8)
    toned = np.empty((height * size, width * size, 3), np.uint8)
    for row, column in np.ndindex(height, width):
        cell = toned[row * size : (row + 1) * size, column * size : (column + 1) * size]
        cell[:] = cv2.LUT(images[picture[row, column]], tables[row, column][None])
    return toned


def feather(
    image: UInt8[NDArray, "h w 3"], labels: UInt8[NDArray, "h w"], grid: ArrayLike
) -> UInt8[NDArray, "h w 3"]:
    """Blends the tiles of a picture where their roads meet.

    Within 2 % of a tile of a seam, but at least two pixels, pixels are mixed with their mirror
    images on the other side. Both must have the same label. The mirror image's share is one half at
    the seam and falls with the distance by a cosine.
    """
    codes = np.asarray(grid)
    size = image.shape[0] // codes.shape[0]
    blended, changes, places = image.copy(), [], []
    for turned, meets in _meetings(codes):
        # The axis across the seams.
        axis = 0 if turned else 1
        seen, change = _mix(image, labels, _turn(meets, turned), size, axis)
        depth = seen.shape[axis + 1] // 2
        seams = np.arange(size, image.shape[axis], size)
        # Only the pixels near seams are mixed, because mixing the whole picture takes longer.
        near = (seams[:, None] + np.arange(-depth, depth)).reshape(-1)
        # A map of one row or one column has no seams in one direction, and these shapes are empty.
        shape = (len(near), image.shape[1], 3) if turned else (image.shape[0], len(near), 3)
        blended[near if turned else np.s_[:, near]] = np.rint(seen + change).reshape(shape)
        changes.append(change.reshape(shape))
        places.append(near)
    # Near the corners of tiles, both changes are added.
    columns, rows = places
    corners = np.ix_(rows, columns)
    blended[corners] = np.rint(image[corners] + (changes[0][rows] + changes[1][:, columns]))
    return blended


def _mix(
    image: UInt8[NDArray, "h w 3"],
    labels: UInt8[NDArray, "h w"],
    meets: NDArray[np.bool_],
    size: int,
    axis: int,
) -> tuple[Float[NDArray, "..."], Float[NDArray, "..."]]:
    """Returns the pixels near the S seams across an axis, and what `feather` adds to them.

    `meets` tells of each seam between two tiles whether a road continues. Both results are
    ``[h, S, D, 3]`` across the columns, and ``[S, D, w, 3]`` across the rows.
    """
    reach = max(_FEATHER * size, 2.0)
    depth = ceil(reach - 0.5)
    leading = (slice(None),) * axis
    # The last pixels of each tile and the first pixels of the next one are a strip around their
    # seam.
    before = (*leading, slice(None, -1), slice(size - depth, None))
    after = (*leading, slice(1, None), slice(None, depth))
    strips = []
    for layer in (image, labels):
        tiles = layer.reshape(*layer.shape[:axis], -1, size, *layer.shape[axis + 1 :])
        strips.append(np.concatenate([tiles[before], tiles[after]], axis=axis + 1))
    seen, label = strips[0].astype(np.float32), strips[1]
    # The share of the mirror image falls from one half at the seam to 0 at the reach.
    distance = np.abs(np.arange(2 * depth) + 0.5 - depth)
    share = ((1 + np.cos(np.pi * distance / reach)) / 4).astype(np.float32)
    share = share if axis else share[:, None]
    # Seams without a road on both sides stay as they are, and so do pixels of different labels.
    along = np.expand_dims(np.repeat(meets, size, axis=1 - axis), axis + 1)
    mixed = along & (label == np.flip(label, axis + 1))
    return seen, (share * mixed)[..., None] * (np.flip(seen, axis + 1) - seen)


def _meetings(codes: NDArray[np.int8]) -> Iterator[tuple[bool, NDArray[np.bool_]]]:
    """Yields whether the road continues to the cell on the right.

    The first result is that of the grid, the second one that of its transpose.
    """
    for turned, (ahead, back) in ((False, (EAST, WEST)), (True, (SOUTH, NORTH))):
        upright = _turn(codes, turned)
        yield turned, (upright[:, :-1] & ahead > 0) & (upright[:, 1:] & back > 0)


def _turn(layer: NDArray, turned: bool, axis: int = 0) -> NDArray:
    """Swaps rows and columns if `turned`; a view."""
    return layer.swapaxes(axis, axis + 1) if turned else layer


def _equations(
    pairs: Int[NDArray, "N 2"], images: UInt8[NDArray, "T P P 3"], labels: UInt8[NDArray, "T P P"]
) -> tuple[Float[NDArray, "3 N 4 4"], Float[NDArray, "3 N 4"]]:
    """Returns the normal equations of N pairs of neighbouring pictures.

    The second picture of a pair is right of the first.
    """
    depth = max(1, round(_STRIP * labels.shape[1]))
    # Both strips begin at the seam: the first picture's columns are read backwards.
    near, far = np.s_[:, :, : -depth - 1 : -1], np.s_[:, :, :depth]
    products, sides = np.zeros((3, len(pairs), 4, 4)), np.zeros((3, len(pairs), 4))
    for start in range(0, len(pairs), _PAIRS):
        some = slice(start, start + _PAIRS)
        first, second = pairs[some].T
        marks = labels[near][first]
        # Pixels count where both pictures have the same label, which is not background.
        alike = ((marks == labels[far][second]) & (marks > 0)).reshape(len(first), 1, -1)
        # The products are means, so that wide and narrow roads weigh the same.
        count = np.maximum(alike.sum(axis=2, keepdims=True), 1)
        for channel in range(3):
            here, there = images[..., channel][near][first], images[..., channel][far][second]
            levels = np.stack([here, there, np.ones_like(here)], axis=1)
            levels = levels.reshape(len(first), 3, -1) * alike.astype(float)
            means = levels @ levels.swapaxes(1, 2) / count
            products[channel, some] = _ROW @ means @ _ROW.T
            sides[channel, some] = _ROW @ means @ (-1, 1, 0)
    return products, sides
