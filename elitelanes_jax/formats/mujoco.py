"""A model for MuJoCo: the floor with a map's picture, and a robot on a lane of it.

The robot has two driven wheels and a camera. It has Duckietown's measures, as `drive.Robot` and
`drive.Camera` have them, so a policy moves from one to the other. All light is ambient: the floor
has the colours of its picture.

MJX has no contact of a box with a cylinder. The wheels and the chassis touch the floor alone, and
two capsules that are not drawn touch the objects.
"""

from collections.abc import Sequence
from math import atan2, cos, degrees, radians, sin
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from elitelanes_jax._util.checks import check_named, xml_name
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE, check_tile_size
from elitelanes_jax.formats.objects import Standing
from elitelanes_jax.lanes.curves import LANE_OFFSET, check_lane_offset, lane_curves
from elitelanes_jax.lanes.movements import lane_graph
from elitelanes_jax.network.checks import check_grid

WHEEL_RADIUS = 0.0318
"""The radius of the robot's wheels in metres."""

WHEEL_DISTANCE = 0.102
"""The distance between the middles of the robot's wheels in metres."""

# The top speed of a wheel in metres a second.
_TOP_SPEED = 1.2

# The height of the camera above the floor and its distance ahead of the wheels, in metres.
_CAMERA_HEIGHT, _CAMERA_FORWARD = 0.108, 0.066
# The pitch of the camera in radians, and its upright angle of view in degrees.
_PITCH, _FIELD_OF_VIEW = radians(19.15), 75

_MODEL = """<mujoco model="elitelanes">
  <option timestep="0.002" integrator="implicitfast"/>
  <statistic center="{east:.6g} {north:.6g} 0" extent="1"/>
  <visual>
    <headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/>
    <map znear="0.01" zfar="200"/>
    <global offwidth="1280" offheight="960"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="flat" rgb1="0.451 0.824 1" rgb2="0.451 0.824 1" width="8" height="8"/>
    <texture name="floor" type="2d" file={picture}/>
    <material name="floor" texture="floor" specular="0" shininess="0"/>
  </asset>
  <worldbody>
    <geom name="ground" type="plane" pos="{east:.6g} {north:.6g} -0.001" size="0 0 1" rgba="0.337 0.463 0.282 1" \
contype="0" conaffinity="0"/>
    <geom name="floor" type="plane" pos="{east:.6g} {north:.6g} 0" size="{east:.6g} {north:.6g} 1" material="floor" \
friction="1 0.005 0.0001" conaffinity="0"/>
{objects}    <body name="robot" pos="{x:.6g} {y:.6g} {radius}" euler="0 0 {degrees:.6g}">
      <freejoint name="robot"/>
      <geom name="chassis" type="box" pos="-0.02 0 0.02" size="0.06 0.035 0.03" mass="0.8" rgba="0.9 0.2 0.15 1" \
contype="0"/>
      <geom name="caster" type="sphere" pos="-0.06 0 -0.0218" size="0.01" mass="0.05" condim="1" rgba="0.5 0.5 0.5 1" \
contype="0"/>
      <geom name="bumper" type="capsule" fromto="-0.045 0 0.02 0.005 0 0.02" size="0.035" mass="0" group="3" \
conaffinity="0"/>
      <geom name="axle" type="capsule" fromto="0 -0.0312 0.01 0 0.0312 0.01" size="{radius}" mass="0" group="3" \
conaffinity="0"/>
      <camera name="camera" pos="{forward} 0 {above:.6g}" xyaxes="0 -1 0 {up_x:.9f} 0 {up_z:.9f}" fovy="{fov}"/>
      <body name="left" pos="0 {half} 0">
        <joint name="left" axis="0 1 0" damping="0.0001"/>
        <geom type="cylinder" size="{radius} 0.012" zaxis="0 1 0" mass="0.05" rgba="0.1 0.1 0.1 1" contype="0"/>
      </body>
      <body name="right" pos="0 -{half} 0">
        <joint name="right" axis="0 1 0" damping="0.0001"/>
        <geom type="cylinder" size="{radius} 0.012" zaxis="0 1 0" mass="0.05" rgba="0.1 0.1 0.1 1" contype="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity name="left" joint="left" kv="0.05" ctrlrange="-{top:.6g} {top:.6g}"/>
    <velocity name="right" joint="right" kv="0.05" ctrlrange="-{top:.6g} {top:.6g}"/>
  </actuator>
</mujoco>
"""


def to_mjcf(
    codes: ArrayLike,
    picture: str,
    tile_size: float = TILE_SIZE,
    standing: Sequence[Standing] = (),
    lane_offset: float = LANE_OFFSET,
) -> str:
    """Writes the model of a map as MuJoCo's XML.

    The origin is the map's south-west corner; x is east, y north, z up. The body ``robot`` starts
    in the middle of the map's first lane, row by row. The actuators ``left`` and ``right`` take the
    speeds of the wheels in radians a second. ``camera`` is the robot's.

    Args:
      codes: integer codes ``[H, W]``.
      picture: the name of the file with the map's picture, next to the model's file.
      tile_size: side of a tile in metres, 0.1 to 1000. The robot keeps its own measures.
      standing: objects. They are boxes and upright cylinders of the objects' sizes and mean colours
        that do not move. They grow with the tiles.
      lane_offset: tiles from the road's middle to the centre of a lane, over 0 and under 0.5.

    Raises:
      InputError: for a bad grid, one without a lane, or a bad name, size or `lane_offset`.
    """
    check_tile_size(tile_size, 0.1, 1000)
    height, width = check_grid(codes).shape
    lane_offset = check_named("lane_offset", check_lane_offset, lane_offset)
    first_lane = lane_curves(lane_graph(codes).list_movements()[0], lane_offset)[0]
    # The robot starts in the middle of the lane, with the direction between two points around it.
    before, start, after = first_lane.points(np.array([0.49, 0.5, 0.51]))
    east, north = after[0] - before[0], before[1] - after[1]
    # Names in a model must be unique, so each object has its number.
    solids = "".join(
        _solid(item, height, number, tile_size) for number, item in enumerate(standing)
    )
    return _MODEL.format(
        objects=solids,
        east=width * tile_size / 2,
        north=height * tile_size / 2,
        picture=quoteattr(check_named("name", _file_name, picture)),
        x=start[0] * tile_size,
        y=(height - start[1]) * tile_size,
        degrees=degrees(atan2(north, east)),
        radius=WHEEL_RADIUS,
        half=WHEEL_DISTANCE / 2,
        forward=_CAMERA_FORWARD,
        above=_CAMERA_HEIGHT - WHEEL_RADIUS,
        up_x=sin(_PITCH),
        up_z=cos(_PITCH),
        fov=_FIELD_OF_VIEW,
        top=_TOP_SPEED / WHEEL_RADIUS,
    )


def _file_name(value: UserValue) -> str:
    """Checks for the name of a file that MuJoCo finds.

    MuJoCo takes a backslash for the end of a folder's name.
    """
    name = xml_name(value)
    if "\\" in name:
        raise InputError("", "a name without \\, as in MuJoCo's models", quote(name))
    return name


def _solid(item: Standing, rows: int, number: int, tile_size: float) -> str:
    """Returns the element of an object; MuJoCo's sizes are halves."""
    thing, scale = item.thing, tile_size / TILE_SIZE
    length, width = thing.footprint[0] * scale / 2, thing.footprint[1] * scale / 2
    up = thing.height * scale / 2
    x, y = thing.x * tile_size, (rows - thing.y) * tile_size
    if thing.is_round:
        # The footprint of a round object is a disc, whose diameter is its length.
        shape = f'type="cylinder" size="{length:.6g} {up:.6g}"'
    else:
        shape = f'type="box" size="{length:.6g} {width:.6g} {up:.6g}"'
    red, green, blue = item.colour
    return (
        f'    <geom name="{thing.kind} {number}" {shape} pos="{x:.6g} {y:.6g} {up:.6g}" '
        f'euler="0 0 {degrees(thing.angle):.6g}" rgba="{red:.3f} {green:.3f} {blue:.3f} 1" '
        'contype="0"/>\n'
    )
