"""The slow oracle of a view's picture: plain loops over pixels, of float64, from the numbers of its look."""

import math

import numpy as np

MASK = 0xFFFFFFFF


def mix(number):
    number = (number ^ number >> 16) * 0x7FEB352D & MASK
    number = (number ^ number >> 15) * 0x846CA68B & MASK
    return number ^ number >> 16


def fork(seed, number):
    return mix(seed + number * 0x9E3779B9 & MASK)


def hashed(seed, index):
    return mix(index * 0x9E3779B9 & MASK ^ seed)


def grain(seed, columns, row, column):
    """A value of a grid of uniform numbers, -1 to 1."""
    return 2 * (hashed(seed, row * columns + column) >> 8) / 2**24 - 1


def stretched(seed, grains, shape, row, column):
    """Noise with `grains` values along each side, linear between their centres."""
    total = 0.0
    for r, weight in neighbours((row + 0.5) * grains / shape[0] - 0.5, grains):
        for c, share in neighbours((column + 0.5) * grains / shape[1] - 0.5, grains):
            total += weight * share * grain(fork(seed, grains), grains, r, c)
    return total


def neighbours(position, count):
    position = min(max(position, 0), count - 1)
    lower = min(int(position), count - 2)
    return [(lower, 1 - (position - lower)), (lower + 1, position - lower)]


def fine(seed, shape, row, column):
    side = max(1, round(shape[0] / 64))
    columns = -(-shape[1] // side) + 1
    down, right = (row % side + 0.5) / side, (column % side + 0.5) / side
    total = 0.0
    for r, weight in ((row // side, 1 - down), (row // side + 1, down)):
        for c, share in ((column // side, 1 - right), (column // side + 1, right)):
            total += weight * share * grain(fork(seed, 64), columns, r, c)
    return total


def pattern(look, shape, row, column):
    """The colours of ground and sky at a pixel."""
    ground, sky = (np.array(part, float) for part in (look.ground, look.sky))
    if (behind := look.background) is None:
        return ground, sky
    seed = int(look.seed)
    layers = [stretched(seed, 4, shape, row, column), stretched(seed, 16, shape, row, column)]
    layers.append(fine(seed, shape, row, column))
    noise = sum(float(weight) * layer for weight, layer in zip(behind.weights, layers, strict=True))
    ground, sky = (
        np.clip(plain + part * noise, 0, 255) for plain, part in ((ground, behind.below), (sky, behind.above))
    )
    for (top, left, bottom, right), paint in zip(behind.rectangles, behind.paints, strict=True):
        if top <= row < bottom and left <= column < right:
            sky = np.array(paint, float)
    return ground, sky


def photograph(road, paved, sky, look):
    """The picture of a view: `road` [rows, columns, 3] times the share `paved`, ground and sky behind it."""
    shape, seed = paved.shape, int(look.seed)
    image = np.zeros((*shape, 3))
    for row, column in np.ndindex(*shape):
        low, high = pattern(look, shape, row, column)
        above = sky[row, column if sky.shape[1] > 1 else 0]
        image[row, column] = road[row, column] + low * (1 - paved[row, column] - above) + high * above
    for row, column in np.ndindex(*shape):
        light = 1.0
        if look.shadow is not None:
            depth, level, steepness = map(float, look.shadow)
            field = stretched(seed, 5, shape, row, column)
            light /= 1 / (1 - depth / (1 + math.exp(min(-(field - level) * steepness, 700))))
        if look.vignette is not None:
            away = ((row + 0.5) / shape[0] * 2 - 1) ** 2 + ((column + 0.5) / shape[1] * 2 - 1) ** 2
            light *= 1 - float(look.vignette) * away / 2
        colour = image[row, column] * light
        if look.exponent is not None:
            colour = 255 * np.clip(colour / 255, 1e-6, 1) ** float(look.exponent)
        if look.mixing is not None:
            itself, of_mean, addend = np.array(look.mixing, float).T
            colour = np.clip(itself * colour + of_mean * colour.mean() + addend, 0, 255)
        image[row, column] = colour
    if look.kernel is not None:
        before = image.copy()
        for row, column in np.ndindex(*shape):
            image[row, column] = 0
            for down, right in np.ndindex(5, 5):
                r, c = np.clip((row + down - 2, column + right - 2), 0, np.array(shape) - 1)
                image[row, column] += float(look.kernel[down, right]) * before[r, c]
    if look.noise is not None:
        for row, column, index in np.ndindex(*image.shape):
            bits = hashed(fork(seed, index), row * shape[1] + column)
            total = sum(bits >> shift & 255 for shift in (0, 8, 16, 24)) - 510
            image[row, column, index] += float(look.noise) * total / math.sqrt((256**2 - 1) / 3)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
