"""Places buildings, vehicles, trees, cones and duckies at random where they fit."""

from collections.abc import Callable
from math import hypot, pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, Int8

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.progress import Progress
from elitelanes_jax.maps.furnishing.space import Space, make_object, outline_of
from elitelanes_jax.maps.furnishing.spec import AS_MANY_AS_FIT, FurnishSpec
from elitelanes_jax.network.codes import EAST, KINDS, SIDES, WEST

Place = tuple[float, float, float]
"""x and y in tiles, and an angle in radians."""

_Draw = Callable[[list[int], np.random.Generator, float], Place]

# The number of places that are tried for each object, on average. Crowded maps, with
# `all trees=0.9 houses=0.5 buildings=0.3 duckies=0.9`, get as many objects with 64 tries as with
# 512, and 1 % fewer with 16.
_TRIES = 64
# The number of objects from which on a progress bar is shown. So many may take longer than a
# second, and 100,000 duckies take minutes.
_MANY = 1000
# The least and the largest distance from a road's tile to the middle of an object beside it, in
# tiles.
_BESIDE = (0.12, 0.3)

# The four directions along the sides of a cell, in radians.
_QUARTERS = (0.0, pi / 2, pi, -pi / 2)


def place_scenery(space: Space, spec: FurnishSpec, seed: int, lane_offset: float) -> None:
    """Adds the objects of a specification to those that are on the map, large ones first.

    Each amount has random numbers of its own. An amount below 1 places as many as fit. If no cell
    without road has a road beside it, what belongs beside a road is placed anywhere on such cells.
    The middle of a lane is `lane_offset` tiles from the road's middle.

    Raises:
      InputError: if a number of objects do not fit; the message names the amount and how many fit.
    """
    empty_cells = np.count_nonzero(space.codes == 0)
    for index, (name, scenery) in enumerate(_AMOUNTS.items()):
        amount = getattr(spec, name)
        # A share is one of the cells without road.
        count = round(amount * empty_cells) if amount < 1 else int(amount)
        # Each amount has a stream of its own, so another number of trees does not move the cones.
        random = np.random.default_rng([seed, index])
        if amount >= 1:
            _check_count(name, scenery, count, space.codes)
        placed = _place(space, name, scenery, count, random, lane_offset)
        if placed < count and amount >= 1:
            got = f"{count}, of which {placed} fit"
            raise InputError(name, "a number that fits", got, AS_MANY_AS_FIT)


def scenery_kinds(spec: FurnishSpec) -> set[str]:
    """Returns the kinds of the objects in the amounts of a specification."""
    return {scenery.kind for name, scenery in _AMOUNTS.items() if getattr(spec, name)}


def _check_count(
    name: str, scenery: "_Scenery", count: int, codes: Int8[np.ndarray, "H W"]
) -> None:
    """Raises `InputError` if the area has no room for objects.

    Without this check, tries for 100,000 objects would take half an hour.
    """
    # At angle 0 the outline is along the axes, so its corners give length and width.
    outline = outline_of(make_object(scenery.kind, 0, 0, 0))
    length = 2 * max(x for x, _ in outline)
    width = 2 * max(y for _, y in outline)
    spots, _ = _spots_of(scenery, codes)
    cells = len(np.unique(spots[:, :2], axis=0))
    # The middle of an object is on the cell of a spot, so the object is inside a square of this
    # side.
    side = 1 + hypot(length, width)
    # The areas of all objects are at most the area of these squares.
    most = int(cells * side**2 / (length * width))
    if cells and count > most:
        got = f"{count}, of which at most {most} fit"
        raise InputError(name, "a number that fits", got, AS_MANY_AS_FIT)


def _spots_of(
    scenery: "_Scenery", codes: Int8[np.ndarray, "H W"]
) -> tuple[Int[np.ndarray, "N _"], "_Draw"]:
    """Returns the spots of an amount, and the function that draws a place at a spot."""
    spots = scenery.list_spots(codes)
    # Without a kerb, objects that belong beside a road are placed anywhere on blocks.
    if len(spots) == 0 and scenery.draw is _draw_beside_road:
        return _list_blocks(codes), _draw_in_block
    return spots, scenery.draw


def _place(
    space: Space,
    name: str,
    scenery: "_Scenery",
    count: int,
    random: np.random.Generator,
    lane_offset: float,
) -> int:
    """Places up to `count` objects of an amount; returns how many fitted."""
    spot_array, draw = _spots_of(scenery, space.codes)
    spots = spot_array.tolist()
    if not spots:
        return 0
    placed = 0
    # By default, work of over a second is shown in a terminal. Fewer objects are never shown.
    shown = None if count >= _MANY else False
    with Progress(f"placing {name}", count, "objects", shown=shown) as bar:
        for _ in range(_TRIES * count):
            if placed == count:
                break
            spot = spots[random.integers(len(spots))]
            x, y, angle = draw(spot, random, lane_offset)
            candidate = make_object(scenery.kind, x, y, round(angle, 6), static=scenery.static)
            placed += space.place(candidate, in_lane=scenery.in_lane)
            bar.update(placed)
    return placed


def _list_blocks(codes: Int8[np.ndarray, "H W"]) -> Int[np.ndarray, "N 2"]:
    """Lists the cells without road: (row, column)."""
    return np.argwhere(codes == 0)


def _list_kerbs(codes: Int8[np.ndarray, "H W"]) -> Int[np.ndarray, "N 3"]:
    """Lists the sides of cells without road whose neighbour has one: (row, column, side)."""
    # Around the map is a border without roads.
    padded = np.pad(codes, 1)
    height, width = codes.shape
    # Whether the neighbour at each side of each cell has a road.
    roads = [padded[1 + side.down :, 1 + side.right :][:height, :width] > 0 for side in SIDES]
    return np.argwhere((codes == 0)[..., None] & np.stack(roads, axis=-1))


def _list_straights(codes: Int8[np.ndarray, "H W"]) -> Int[np.ndarray, "N 3"]:
    """Lists the straight tiles: (row, column, whether the road leads from west to east)."""
    cells = np.argwhere(np.isin(codes, KINDS["straight"]))
    leads_east = codes[cells[:, 0], cells[:, 1]] == EAST | WEST
    return np.column_stack([cells, leads_east])


def _draw_in_block(spot: list[int], random: np.random.Generator, _: float) -> Place:
    """Draws a place anywhere on a cell, parallel to its sides."""
    row, column = spot
    return column + random.random(), row + random.random(), _QUARTERS[random.integers(4)]


def _draw_beside_road(spot: list[int], random: np.random.Generator, _: float) -> Place:
    """Draws a place at a side of a cell, looking at the road there."""
    row, column, side = spot
    nearest, farthest = _BESIDE
    depth = random.uniform(nearest, farthest)
    along = random.uniform(-0.5, 0.5)
    towards, next_side = SIDES[side], SIDES[(side + 1) % 4]
    x = column + 0.5 + towards.right * (0.5 - depth) + next_side.right * along
    y = row + 0.5 + towards.down * (0.5 - depth) + next_side.down * along
    return x, y, pi / 2 * (1 - side)


def _draw_in_lane(spot: list[int], random: np.random.Generator, lane_offset: float) -> Place:
    """Draws a place in the middle of a lane of a straight tile, in the direction of its traffic."""
    row, column, leads_east = spot
    # Headings 0 and 2 lead north and south, 1 and 3 lead east and west.
    heading = 2 * int(random.integers(2)) + leads_east
    ahead, right = SIDES[heading], SIDES[(heading + 1) % 4]
    along = random.uniform(-0.5, 0.5)
    x = column + 0.5 + along * ahead.right + lane_offset * right.right
    y = row + 0.5 + along * ahead.down + lane_offset * right.down
    return x, y, pi / 2 * (1 - heading)


class _Scenery(NamedTuple):
    """An amount of objects.

    Attributes:
      kind: the kind of the objects.
      list_spots: returns the spots of a map, an array of whole numbers with a row for each.
      draw: returns a random place at a spot.
      static: whether simulators keep the objects where they are.
      in_lane: whether the objects are on roads.
    """

    kind: str
    list_spots: Callable[[Int8[np.ndarray, "H W"]], Int[np.ndarray, "N _"]]
    draw: _Draw
    static: bool = True
    in_lane: bool = False


def _in_block(kind: str) -> _Scenery:
    return _Scenery(kind, _list_blocks, _draw_in_block)


def _beside_road(kind: str, *, static: bool = True) -> _Scenery:
    return _Scenery(kind, _list_kerbs, _draw_beside_road, static)


def _in_lane(kind: str) -> _Scenery:
    return _Scenery(kind, _list_straights, _draw_in_lane, in_lane=True)


# The amounts of a specification. Large objects come first, because they find no room between small
# ones.
_AMOUNTS = {
    "buildings": _in_block("building"),
    "houses": _in_block("house"),
    "buses": _in_block("bus"),
    "trucks": _in_block("truck"),
    "barriers": _beside_road("barrier"),
    "robots": _in_block("duckiebot"),
    "trees": _in_block("tree"),
    "cones": _beside_road("cone"),
    "crossing_duckies": _beside_road("duckie", static=False),
    "duckies": _beside_road("duckie"),
    "lane_robots": _in_lane("duckiebot"),
    "lane_duckies": _in_lane("duckie"),
}
