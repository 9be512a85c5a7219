"""MuJoCo loads and steps a model, and MJX takes it."""

import counted
import mujoco
from mujoco import mjx


def read(file):
    model = mujoco.MjModel.from_xml_path(file)
    data = mujoco.MjData(model)
    for _ in range(50):
        mujoco.mj_step(model, data)
    assert not data.warning.number.any(), "MuJoCo warns"
    mjx.put_model(model)
    # Two geoms are the ground and the floor; all others of the world are objects.
    return {"objects": int((model.geom_bodyid == 0).sum()) - 2}


counted.main(read)
