"""Objects in views from a robot: each picture stands upright at its position, parallel to the picture's rows.

Such a picture is not turned towards the camera, so that its rows stay rows of the view, but its view is chosen by the
direction from which the camera sees it.
"""

from collections.abc import Sequence

import numpy as np

from elitelanes_jax.dataset._robot_views import Viewpoint, project
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.formats.objects import NEAR, MapObject
from elitelanes_jax.tiles.object_set import ObjectPictures, lay_flat
from elitelanes_jax.tiles.pasting import Placed


def stand(
    objects: Sequence[MapObject], pictures: Sequence[ObjectPictures], viewpoint: Viewpoint, tile_px: int
) -> tuple[list[Placed], list[int], list[float]]:
    """Places objects with their pictures in a view from a robot; `tile_px` is that of the rendered map.

    Returns the pictures from back to front, the objects' indices, and their distances from the camera in metres.
    """
    pose, camera = viewpoint.about["pose"], viewpoint.about["camera"]
    cosine, sine = np.cos(pose["theta"]), np.sin(pose["theta"])
    found = []
    for index, (thing, one) in enumerate(zip(objects, pictures, strict=True)):
        east, north = (thing.x - pose["x"]) * TILE, (pose["y"] - thing.y) * TILE
        ahead, left = east * cosine + north * sine - camera["forward"], north * cosine - east * sine
        distance = float(np.hypot(ahead, left))
        if not one.height:
            flat = lay_flat(thing, one, tile_px)
            found.append((np.inf, -index, flat._replace(matrix=viewpoint.matrix @ flat.matrix), distance))
        elif ahead > NEAR:
            towards = np.arctan2(-left, -ahead) + pose["theta"] - thing.angle
            pixels = one.view(towards)
            rows, columns = pixels.shape[:2]
            metre = thing.height / rows
            # From (column, row) of the picture to metres ahead, to the left and upwards.
            position = np.array(
                [[0, 0, ahead], [-metre, 0, left + columns / 2 * metre], [0, -metre, thing.height], [0, 0, 1]]
            )
            found.append((ahead, -index, Placed(pixels, project(camera, viewpoint.size) @ position), distance))
    found.sort(key=lambda one: one[:2], reverse=True)
    return [one[2] for one in found], [-one[1] for one in found], [one[3] for one in found]
