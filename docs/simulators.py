"""Draws the picture of MuJoCo: a town and the robot from above, what its camera sees, and what ours sees there.

MUJOCO_GL=egl python docs/simulators.py, with pip install '.[mujoco]'
"""

from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from elitelanes_jax import read_map
from elitelanes_jax.drive import Camera, Pose, look, make_atlas
from elitelanes_jax.formats import to_mjcf
from elitelanes_jax.tiles import choose_tiles, load_tiles, png_of, render, scale_tiles

FOLDER = Path(__file__).parent
_TILE, _ROWS, _COLUMNS = 0.585, 480, 640


def main() -> None:
    town, tiles = read_map(FOLDER / "examples" / "town.json"), load_tiles()
    picture = png_of(render(town, tiles, tile_px=256).image)
    model = mujoco.MjModel.from_xml_string(to_mjcf(town.codes, "town.png"), assets={"town.png": picture})
    data = mujoco.MjData(model)
    at = Pose(*jnp.array([3.3, 2.7, 0.0]))
    data.qpos[:2] = at.x * _TILE, (len(town.codes) - at.y) * _TILE
    data.qpos[3:7] = np.cos(at.theta / 2), 0, 0, np.sin(at.theta / 2)
    mujoco.mj_forward(model, data)
    above = mujoco.MjvCamera()
    above.lookat[:] = 2.05, 1.3, 0
    above.distance, above.azimuth, above.elevation = 4.2, 90, -50
    with mujoco.Renderer(model, _ROWS, _COLUMNS) as renderer:
        shown = []
        for camera in (above, "camera"):
            renderer.update_scene(data, camera)
            shown.append(renderer.render())
    layers, chosen = scale_tiles(tiles, 256), choose_tiles(town.codes, tiles)
    atlas = make_atlas(layers["image"], layers["labels"])
    seen = look(jax.random.key(0), at, chosen[..., 0] * 4 + chosen[..., 1], atlas, Camera(rows=_ROWS, columns=_COLUMNS))
    gap = np.full((_ROWS, 12, 3), 255, np.uint8)
    row = np.hstack([shown[0], gap, shown[1], gap, np.asarray(seen.image)])
    cv2.imwrite(
        str(FOLDER / "mujoco.jpg"), cv2.resize(row, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)[..., ::-1]
    )


if __name__ == "__main__":
    main()
