"""The size of the largest map that a floor has room for.

The floor also has room for the signs and lights that stand beside the map's roads.
"""

from functools import cache
from math import ceil

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.maps.furnishing.signs import place_light, place_signs
from elitelanes_jax.maps.furnishing.space import outline_of

# The fewest rows and columns of a map that a search makes.
_SMALLEST = 2
# The tiles that rounding errors may cost. A floor of exactly three tiles has room for three.
_ROUNDING = 1e-9


@name_wrong_arguments
def floor_size(width: UserValue, depth: UserValue) -> tuple[int, int]:
    """Returns the rows and columns of the largest map for a floor.

    The map has tiles of 0.585 m. Around it the floor keeps room for signs and lights.

    Args:
      width: the width of the floor, metres from west to east.
      depth: metres from north to south.

    Raises:
      InputError: for anything else than metres over 0 and up to 600, or a floor with room for fewer
        than 2 x 2 tiles.
    """
    # A floor of 600 m has room for 1024 tiles a side, the most that a map has.
    metres = real(0, 600, unit="metres, a number", exclusive=True)
    depth = check_named("depth", metres, depth)
    width = check_named("width", metres, width)
    margin = floor_margin()
    rows, columns = (int((side - 2 * margin) / TILE_SIZE + _ROUNDING) for side in (depth, width))
    if min(rows, columns) < _SMALLEST:
        # The size in the message is rounded up to millimetres, because a smaller floor would fail
        # again.
        least = ceil(1000 * (_SMALLEST * TILE_SIZE + 2 * margin)) / 1000
        raise InputError("floor", f"at least {least:g} x {least:g} m", f"{width:g} x {depth:g} m")
    return rows, columns


@cache
def floor_margin() -> float:
    """Returns how many metres of floor signs and lights need around a map.

    The farthest are those of a crossing at the map's border. Here it is at the northern one,
    without a road to the north. Street names are nearer.
    """
    crossing, sides = (0, 0), [1, 2, 3]
    objects = [place_light(crossing, corner) for corner in range(4)]
    # Signs of a crossing with a light differ from those of one without.
    for lit in (set(), {crossing}):
        objects += place_signs({crossing: sides}, {crossing}, "all", lit)
    margin = 0.0
    for item in objects:
        for _, y in outline_of(item):
            margin = max(margin, -y)
    return TILE_SIZE * margin
