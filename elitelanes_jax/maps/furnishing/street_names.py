"""Street name signs, and the tags of all signs.

The signs follow the appearance specification of Duckietown's operation manual, "Street Name Signs",
Placement: every segment of road has at least one sign, and every turn has one. Signs are outside
the driving region, and never perpendicular to the road. In the figures the sign of a turn is in the
outer corner of its tile and faces the middle. The sign of a straight road is at the middle of a
tile's side and faces the road.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from math import atan2, cos, dist, floor, hypot, inf
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.tags import SIGN_TAGS, STREET_NAMES, STREETS
from elitelanes_jax.lanes.links import linked_tiles, walk_roads
from elitelanes_jax.maps.furnishing.space import Point, Space, has_road, make_object
from elitelanes_jax.network.codes import KIND_OF, SIDES
from elitelanes_jax.network.links import Cell

STREET_NAME = "sign_street_name"
"""The kind of signs that name a road."""

# The distance of a sign from the middle of a turn, in tiles along both sides. It is between the
# white tape and the tile's corner.
_CORNER = 0.28
# The distance of a sign from the middle of a straight tile, in tiles. It is as far from the road's
# tile as signs of crossings.
_BESIDE = 0.58
# The distance from its place up to which a sign belongs to that place, in tiles.
_REACH = 0.3


class Tags:
    """The tag numbers that are used on a map, and where."""

    def __init__(self, *, unique: bool) -> None:
        """Starts without tags; `unique` refuses to use a number twice."""
        self._unique = unique
        self._used: dict[int, list[Point]] = defaultdict(list)

    def use(self, thing: MapObject) -> None:
        """Notes the tag of one of the user's objects.

        Raises `InputError` if the tag is in use and tags must be unique.
        """
        # All tags of the user are known before a sign gets one.
        if thing.tag is not None:
            if self._unique and self._used[thing.tag]:
                raise InputError(
                    "unique_tags", "each tag of your own objects once", f"{thing.tag} twice"
                )
            self._used[thing.tag].append((thing.x, thing.y))

    def give(self, sign: MapObject, numbers: Sequence[int] | None = None) -> MapObject:
        """Returns a sign with the first tag number that is not in use.

        The number is one of `numbers`, or of all numbers of the sign's kind. If all are in use, the
        sign gets the number whose nearest use is farthest away; of several, the first one. Raises
        `InputError` if a number must not be used twice.
        """
        numbers = numbers or SIGN_TAGS[sign.kind]
        # A number that is not in use is infinitely far away. `max` returns the first of several.
        tag = max(numbers, key=lambda number: self._distance(sign, [number]))
        if self._unique and self._used[tag]:
            name = STREET_NAMES.get(tag, sign.kind)
            raise InputError("unique_tags", f"at most {len(numbers)} of {name}", "more")
        self._used[tag].append((sign.x, sign.y))
        return sign._replace(tag=tag)

    def name_street(self, signs: Sequence[MapObject]) -> list[MapObject]:
        """Returns the signs of a road with tags of one street name.

        Raises `InputError` as `give` does. The name is one whose nearest use is farthest away, and
        among unused names the one with the fewest tags that are enough.
        """

        def preference(numbers: Sequence[int]) -> tuple[float, int]:
            distance = self._distance(signs[0], numbers)
            if len(numbers) >= len(signs):
                return distance, -len(numbers)
            # The name has fewer tags than are needed. More tags are better here, but any name with
            # enough tags is better still. No name has 1000 tags.
            return distance, len(numbers) - 1000

        numbers = max(STREETS, key=preference)
        return [self.give(sign, numbers) for sign in signs]

    def _distance(self, sign: MapObject, numbers: Sequence[int]) -> float:
        """Returns the distance from a sign to the nearest use of some numbers.

        The distance is infinity if no number is in use.
        """
        nearest = inf
        for number in numbers:
            for place in self._used[number]:
                nearest = min(nearest, dist((sign.x, sign.y), place))
        return nearest


def place_street_names(space: Space, which: str, tags: Tags) -> None:
    """Adds the street name signs of all roads between crossings.

    All signs of a road have the same name. Signs that do not fit are left out if `which` is
    "possible". Raises `InputError` for "all" if one does not fit, and if tags must be unique and
    there are not enough.
    """
    for road, places in _list_roads(space.codes):
        # Each sign has several places. The first clear one is used.
        signs = []
        for alternatives in places:
            clear = next(filter(space.is_clear, alternatives), None)
            if clear is not None:
                signs.append(clear)
        if len(signs) < len(places) and which == "all":
            raise InputError(
                "street_names",
                "room for a sign at each turn and road",
                f"none at the road from {describe_cell(*road[0])}",
                "street_names=possible leaves such signs out",
            )
        if signs:
            for sign in tags.name_street(signs):
                space.add(sign)


class StreetNameFaults(NamedTuple):
    """How the street names of a map differ from what its roads need.

    Attributes:
      signs: the number of street names.
      wrong: the number of street names that are at no road.
      missing: the number of roads and turns that have room for a street name and none. It is 0 for
        a map without street names.
    """

    signs: int
    wrong: int
    missing: int


def street_name_faults(
    codes: Int8[np.ndarray, "H W"], objects: Sequence[MapObject]
) -> StreetNameFaults:
    """Counts the street names of a map that are at no road, and the roads and turns without one."""
    signs = [item for item in objects if item.kind == STREET_NAME]
    if not signs:
        return StreetNameFaults(0, 0, 0)
    space = Space(codes)
    for item in objects:
        space.add(item)
    by_cell: dict[Cell, list[MapObject]] = defaultdict(list)
    for sign in signs:
        by_cell[floor(sign.y), floor(sign.x)].append(sign)
    fitting: set[MapObject] = set()
    missing = 0
    for _, places in _list_roads(codes):
        for alternatives in places:
            there = [sign for place in alternatives for sign in _signs_at(place, by_cell)]
            fitting.update(there)
            if not there and any(map(space.is_clear, alternatives)):
                missing += 1
    return StreetNameFaults(len(signs), sum(sign not in fitting for sign in signs), missing)


def _signs_at(place: MapObject, by_cell: Mapping[Cell, list[MapObject]]) -> list[MapObject]:
    """Returns the street names at a place. Somebody may have moved them by up to `_REACH`."""
    signs = []
    # Signs in farther cells are out of reach.
    for row in range(floor(place.y - _REACH), floor(place.y + _REACH) + 1):
        for column in range(floor(place.x - _REACH), floor(place.x + _REACH) + 1):
            for sign in by_cell.get((row, column), ()):
                is_near = hypot(sign.x - place.x, sign.y - place.y) <= _REACH
                if is_near and cos(sign.angle - place.angle) > 0.5:
                    signs.append(sign)
    return signs


def _list_roads(
    codes: Int8[np.ndarray, "H W"],
) -> Iterator[tuple[list[Cell], list[list[MapObject]]]]:
    """Returns the tiles of each road between crossings, and the places of each of its signs."""
    links = linked_tiles(codes)
    nodes = {tile for tile, neighbours in links.items() if len(neighbours) != 2}
    for path in walk_roads(links, nodes):
        # A ring ends with its first tile, which counts once. Crossings and dead ends have no street
        # name.
        road = [tile for tile in dict.fromkeys(path) if len(links[tile]) == 2]
        yield road, _places_of_signs(codes, road)


def _places_of_signs(codes: Int8[np.ndarray, "H W"], road: list[Cell]) -> list[list[MapObject]]:
    """Lists for each sign of a road where it may be, the best place first.

    A sign is at each turn. A road without a turn has a sign beside its middle.
    """
    places = []
    for tile in road:
        if KIND_OF[int(codes[tile])] == "turn":
            places.append([_in_the_corner(codes, tile)])
    if road and not places:
        # Places nearest to the middle of the road come first.
        middle = (len(road) - 1) / 2
        beside: list[MapObject] = []
        for tile in sorted(road, key=lambda tile: abs(road.index(tile) - middle)):
            beside += _beside(codes, tile)
        places.append(beside)
    return places


def _in_the_corner(codes: Int8[np.ndarray, "H W"], tile: Cell) -> MapObject:
    """Returns the sign of a turn, in the outer corner of its tile."""
    sides = [side for side in SIDES if codes[tile] & side.bit]
    # The sum of both open sides points to the inner corner. The sign is opposite, and faces it.
    right = sum(side.right for side in sides)
    down = sum(side.down for side in sides)
    x, y = tile[1] + 0.5 - _CORNER * right, tile[0] + 0.5 - _CORNER * down
    return make_object(STREET_NAME, x, y, atan2(-down, right))


def _beside(codes: Int8[np.ndarray, "H W"], tile: Cell) -> Iterator[MapObject]:
    """Returns signs on the cells beside a straight tile.

    These cells have no road, or are outside the map.
    """
    if codes[tile] not in (5, 10):
        return
    for side in SIDES:
        if not codes[tile] & side.bit:
            continue
        # This neighbour is across the road, a quarter turn from a side that the tile opens. The
        # rows down to it are the columns right to that side, and vice versa.
        down, right = side.right, side.down
        if not has_road(codes, (tile[0] + down, tile[1] + right)):
            x, y = tile[1] + 0.5 + _BESIDE * right, tile[0] + 0.5 + _BESIDE * down
            yield make_object(STREET_NAME, x, y, atan2(down, -right))
