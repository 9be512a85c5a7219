"""The floor of a 3-D simulator as a stage of OpenUSD, in its text format (.usda), with collision.

z is up, x is east and y north of the map's south-west corner, in metres. Objects are boxes. Floor
and objects have the schema ``PhysicsCollisionAPI``, and no mass, so they do not move.
"""

import re
from collections.abc import Sequence
from math import degrees

from elitelanes_jax._util.checks import check_named, xml_name
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE, check_tile_size
from elitelanes_jax.formats.objects import Standing

# The characters that have a meaning in USD's paths of files, or end a line.
_MEANING = re.compile(r"[@<>\[\]\\\t\n\r]")

_STAGE = """#usda 1.0
(
    defaultPrim = "map"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "map"
{{
    def Mesh "floor" (
        prepend apiSchemas = ["MaterialBindingAPI", "PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"]
    )
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        rel material:binding = </map/paint>
        point3f[] points = [(0, 0, 0), ({east:.6g}, 0, 0), ({east:.6g}, {north:.6g}, 0), (0, {north:.6g}, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "vertex"
        )
        uniform token subdivisionScheme = "none"
    }}

    def Material "paint"
    {{
        token outputs:surface.connect = </map/paint/surface.outputs:surface>

        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </map/paint/picture.outputs:rgb>
            float inputs:roughness = 1
            token outputs:surface
        }}

        def Shader "picture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./{picture}@
            float2 inputs:st.connect = </map/paint/corners.outputs:result>
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float3 outputs:rgb
        }}

        def Shader "corners"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
    }}
{things}}}
"""
_SOLID = """
    def Cube "{name}" (
        prepend apiSchemas = ["PhysicsCollisionAPI"]
    )
    {{
        color3f[] primvars:displayColor = [({colour[0]:.3f}, {colour[1]:.3f}, {colour[2]:.3f})]
        double3 xformOp:translate = ({x:.6g}, {y:.6g}, {height:.6g})
        float xformOp:rotateZ = {degrees:.6g}
        float3 xformOp:scale = ({length:.6g}, {width:.6g}, {height:.6g})
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ", "xformOp:scale"]
    }}
"""


def to_usd(
    shape: tuple[int, int],
    picture: str,
    tile_size: float = TILE_SIZE,
    standing: Sequence[Standing] = (),
) -> str:
    """Writes the floor of a map as the text of an OpenUSD stage, ``.usda``.

    Args:
      shape: rows and columns of the map.
      picture: the name of the file with the map's picture, next to the stage's file.
      tile_size: side of a tile in metres, 0.01 to 1000.
      standing: objects. They are boxes of the objects' sizes and mean colours, and grow with the
        tiles.

    Raises:
      InputError: for a bad name or size.
    """
    check_tile_size(tile_size, most=1000)
    rows, columns = shape
    solids = [_solid(item, rows, number, tile_size) for number, item in enumerate(standing)]
    return _STAGE.format(
        east=columns * tile_size,
        north=rows * tile_size,
        picture=check_named("name", _file_name, picture),
        things="".join(solids),
    )


def _file_name(value: UserValue) -> str:
    name = xml_name(value)
    if _MEANING.search(name):
        raise InputError("", "a name without @ < > [ ] \\ and line breaks, as in USD", quote(name))
    return name


def _solid(item: Standing, rows: int, number: int, tile_size: float) -> str:
    """Returns the box of an object.

    A cube of USD has sides of length 2, so the scales of the box are half of its sides. Half of the
    height is also the z of the middle.
    """
    thing, scale = item.thing, tile_size / TILE_SIZE
    length, width = thing.footprint
    # A name in USD has only letters, digits and underscores, and the number makes it unique.
    return _SOLID.format(
        name=f"{re.sub('[^A-Za-z0-9]', '_', thing.kind)}_{number}",
        colour=item.colour,
        x=thing.x * tile_size,
        y=(rows - thing.y) * tile_size,
        degrees=degrees(thing.angle),
        length=length * scale / 2,
        width=width * scale / 2,
        height=thing.height * scale / 2,
    )
