"""Street name signs, by the appearance specification of Duckietown's operation manual.

"Street Name Signs", Placement: every segment of road has at least one sign, and every turn has one. Signs are outside
the driving region, and never perpendicular to the road. In the figures the sign of a turn is in the outer corner of its
tile and faces the middle. The sign of a straight road is at the middle of a tile's side and faces the road.
"""

from collections.abc import Iterator
from math import atan2

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.graph import Cell, linked_tiles, walk_roads
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.maps.furnishing.space import Space, make_object
from elitelanes_jax.maps.furnishing.tagging import Tags
from elitelanes_jax.network.codes import KIND_OF, SIDES

_CORNER = 0.28  # tiles from the middle of a turn, along both sides: between the white tape and the tile's corner
_BESIDE = 0.58  # tiles from the middle of a straight tile: as far from the road's tile as signs of crossings


def place_street_names(space: Space, which: str, tags: Tags) -> None:
    """Adds the street name signs of all roads between crossings. All signs of a road have the same name.

    Signs that do not fit are left out if `which` is "possible". Raises `InputError` for "all" if one does not fit, and
    if tags must be unique and there are not enough.
    """
    links = linked_tiles(space.codes)
    for path in walk_roads(links, {tile for tile, others in links.items() if len(others) != 2}):
        road = [tile for tile in dict.fromkeys(path) if len(links[tile]) == 2]
        spots = [[_in_the_corner(space.codes, tile)] for tile in road if KIND_OF[int(space.codes[tile])] == "turn"]
        if road and not spots:
            middle = (len(road) - 1) / 2
            nearest = sorted(road, key=lambda tile: abs(road.index(tile) - middle))
            spots = [[sign for tile in nearest for sign in _beside(space.codes, tile)]]
        signs = [sign for listed in spots for sign in [one for one in listed if space.is_clear(one)][:1]]
        if len(signs) < len(spots) and which == "all":
            row, column = road[0]
            raise InputError(
                f"street_names: expected room for a sign at each turn and road, got none at the road from row {row}, "
                f"column {column}; street_names=possible leaves such signs out"
            )
        for sign in tags.name_street(signs) if signs else ():
            space.add(sign)


def _in_the_corner(codes: NDArray[np.int8], tile: Cell) -> MapObject:
    """Returns the sign of a turn, in the outer corner of its tile."""
    sides = [side for side in SIDES if codes[tile] & side.bit]
    right, down = sum(side.right for side in sides), sum(side.down for side in sides)
    x, y = tile[1] + 0.5 - _CORNER * right, tile[0] + 0.5 - _CORNER * down
    return make_object("sign_street_name", x, y, atan2(-down, right))


def _beside(codes: NDArray[np.int8], tile: Cell) -> Iterator[MapObject]:
    """Returns signs on the cells beside a straight tile that have no road or are outside the map."""
    height, width = codes.shape
    for down, right in ((side.right, side.down) for side in SIDES if codes[tile] in (5, 10) and codes[tile] & side.bit):
        row, column = tile[0] + down, tile[1] + right
        if not (0 <= row < height and 0 <= column < width and codes[row, column]):
            x, y = tile[1] + 0.5 + _BESIDE * right, tile[0] + 0.5 + _BESIDE * down
            yield make_object("sign_street_name", x, y, atan2(down, -right))
