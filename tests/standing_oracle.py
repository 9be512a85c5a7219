"""A slow renderer of objects that stand on a map: ray by ray and plane by plane, from back to front."""

import numpy as np

from elitelanes_jax.formats import OBJECT_KINDS, MapObject

TILE = 0.585
TOWN = np.array([[6, 5, 7, 3], [10, 0, 10, 10], [14, 5, 15, 11], [12, 5, 13, 9]], np.int8)
CAMERA = {"rows": 48, "columns": 64, "height": 0.108, "forward": 0.066, "pitch": 19.15, "field_of_view": 75.0}


def some_objects(count, seed=0):
    rng = np.random.default_rng(seed)
    kinds = [kind for kind in OBJECT_KINDS if OBJECT_KINDS[kind].height]
    kinds = [kinds[number % len(kinds)] for number in range(count)]
    return tuple(
        MapObject(kind, *rng.uniform(0, 4, 2), rng.uniform(-3, 3), OBJECT_KINDS[kind].height * rng.uniform(0.8, 1.2))
        for kind in kinds
    )


def some_poses(count, seed=0):
    rng = np.random.default_rng(seed)
    return [(*rng.uniform(0.5, 3.5, 2), rng.uniform(-3.1, 3.1)) for _ in range(count)]


def pixel_rays(camera):
    """Right, down and ahead of each pixel's ray, [rows, columns, 3], as the camera has them."""
    focal = camera["rows"] / 2 / np.tan(np.radians(camera["field_of_view"]) / 2)
    right, down = np.meshgrid(
        (np.arange(camera["columns"]) + 0.5 - camera["columns"] / 2) / focal,
        (np.arange(camera["rows"]) + 0.5 - camera["rows"] / 2) / focal,
    )
    if camera.get("distortion") is not None:
        k1, k2 = camera["distortion"]
        there = right, down
        for _ in range(50):
            square = there[0] ** 2 + there[1] ** 2
            there = right / (1 + k1 * square + k2 * square**2), down / (1 + k1 * square + k2 * square**2)
        right, down = there
    return np.stack([right, down, np.ones_like(right)], axis=-1)


def draw_back_to_front(things, views, pose, camera, prepare=lambda picture: picture):
    """Returns 1 + the index of the object that each pixel shows, or 0, and its colours."""
    x, y, theta = pose
    pitch = np.radians(camera["pitch"])
    heading = np.array([np.cos(theta), np.sin(theta), 0.0])
    right, up = np.array([np.sin(theta), -np.cos(theta), 0.0]), np.array([0, 0, 1.0])
    axis, down = heading * np.cos(pitch) - up * np.sin(pitch), -heading * np.sin(pitch) - up * np.cos(pitch)
    eye = np.array([x * TILE, -y * TILE, camera["height"]]) + camera["forward"] * heading
    rays = pixel_rays(camera) @ np.stack([right, down, axis])
    owners, colours = np.zeros(rays.shape[:2], int), np.zeros(rays.shape, np.uint8)
    feet = [np.array([thing.x * TILE, -thing.y * TILE, 0.0]) for thing in things]
    for index in sorted(range(len(things)), key=lambda index: -((feet[index] - eye) @ heading)):
        thing, foot = things[index], feet[index]
        depth = (foot - eye) @ heading
        if depth <= 0.02:
            continue
        towards = np.degrees(np.arctan2(*(eye - foot)[1::-1]) - thing.angle)
        angles = views[thing.kind]
        nearest = min(angles, key=lambda angle: abs((towards - angle + 180) % 360 - 180))
        picture = angles[nearest]
        width = thing.height * picture.shape[1] / picture.shape[0]
        pixels = prepare(picture)
        rows, columns = pixels.shape[:2]
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = depth / (rays @ heading)
            point = eye + reach[..., None] * rays - foot
        across = np.floor((point @ right / width + 0.5) * columns)
        below = np.floor((1 - point[..., 2] / thing.height) * rows)
        hit = (reach > 0) & (across >= 0) & (across < columns) & (below >= 0) & (below < rows)
        shown = pixels[np.where(hit, below, 0).astype(int), np.where(hit, across, 0).astype(int)]
        hit &= shown[..., 3] >= 128
        owners[hit], colours[hit] = index + 1, shown[hit, :3]
    return owners, colours
