"""A slow renderer of what a camera sees of a rendered map: many points of each pixel, looked up one by one."""

import numpy as np

TILE = 0.585


def matrix_of(pose, camera, size, tile_px):
    """From pixels of the rendered map to points of a picture; the third coordinate is the depth in metres."""
    (x, y, theta), (rows, columns) = pose, size
    focal = rows / 2 / np.tan(np.radians(camera["field_of_view"]) / 2)
    pitch = np.radians(camera["pitch"])
    # East, north and up of what is ahead, to the right and downwards in the picture.
    ahead = np.array([np.cos(theta) * np.cos(pitch), np.sin(theta) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(theta), -np.cos(theta), 0])
    down = np.cross(ahead, right)
    eye = np.array([x * TILE, -y * TILE, camera["height"]])
    eye += camera["forward"] * np.array([np.cos(theta), np.sin(theta), 0])
    lens = np.array([[focal, 0, columns / 2], [0, focal, rows / 2], [0, 0, 1]])
    turn = lens @ np.stack([right, down, ahead])
    metre = TILE / tile_px
    return turn @ np.column_stack([[metre, 0, 0], [0, -metre, 0], -eye])


def undistorted(right, down, distortion):
    there = right, down
    for _ in range(100):
        square = there[0] ** 2 + there[1] ** 2
        factor = 1 + distortion[0] * square + distortion[1] * square**2
        there = right / factor, down / factor
    return there


def points_of(pose, camera, size, tile_px, finer, lines=0.0, distortion=None):
    """Where `finer` points of each pixel in each direction meet the map, in its pixels; NaN above the horizon."""
    rows, columns = size
    right, down = np.meshgrid((np.arange(columns * finer) + 0.5) / finer, (np.arange(rows * finer) + 0.5) / finer)
    if distortion is not None:
        focal = rows / 2 / np.tan(np.radians(camera["field_of_view"]) / 2)
        right, down = undistorted((right - columns / 2) / focal, (down - rows / 2) / focal, distortion)
        right, down = right * focal + columns / 2, down * focal + rows / 2
    back = np.linalg.inv(matrix_of(pose, camera, size, tile_px))
    x, y, inverse_depth = (part[0] * right + part[1] * down + part[2] for part in back)
    depth = 1 / np.where(inverse_depth > 1e-6, inverse_depth, np.nan)
    places = []
    for place in (x * depth, y * depth):
        shift = lines * tile_px * np.sin(2 * np.pi * place / tile_px) / np.sin(2 * np.pi * 0.09)
        places.append(place + shift)
    return places


def see_labels(labels, points, outside=0):
    """The nearest pixel of the map at each point; 0 above the horizon."""
    x, y = points
    seen = np.isfinite(x)
    x, y = (np.floor(np.where(seen, part, -1)).astype(int) for part in (x, y))
    inside = (x >= 0) & (x < labels.shape[1]) & (y >= 0) & (y < labels.shape[0])
    found = labels[np.where(inside, y, 0), np.where(inside, x, 0)]
    return np.where(inside.reshape(inside.shape + (1,) * (labels.ndim - 2)), found, outside), seen


def see(image, points, finer, ground, sky):
    """The mean colours of all points of each pixel."""
    colours, seen = see_labels(image, points, np.array(ground))
    colours = np.where(seen[..., None], colours, np.array(sky))
    rows, columns = (side // finer for side in seen.shape)
    return colours.reshape(rows, finer, columns, finer, 3).mean(axis=(1, 3))
