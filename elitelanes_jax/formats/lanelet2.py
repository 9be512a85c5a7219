"""Road networks as Lanelet2 maps: OpenStreetMap's XML, with a lanelet for each movement across a tile.

Lanelets that follow each other share the ends of their bounds, and oncoming ones the middle of the road. Places are on
the equator, where UTM's zone 32 has its central meridian: read a map with ``UtmProjector(Origin(0, 9))``, or by its
tags ``local_x`` and ``local_y``, in metres from the grid's south-west corner.
"""

from itertools import count, groupby
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import rights_of_way
from elitelanes_jax.formats.streets import Streets, bounds, giving_way
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import BACK, TURNS, Movement, lane_graph
from elitelanes_jax.network.codes import CONNECTIONS

# Of the ellipsoid WGS 84. UTM's series end at the third power of _N. The error is under a micrometre up to 7 km from
# the origin, and under 14 micrometres up to 100 km.
_N = 1 / (2 * 298.257223563 - 1)
_RADIUS = 0.9996 * 6378137 / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)
_BETA = (_N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96, _N**2 / 48 + _N**3 / 15, 17 * _N**3 / 480)
_DELTA = (2 * _N - 2 * _N**2 / 3 - 2 * _N**3, 7 * _N**2 / 3 - 8 * _N**3 / 5, 56 * _N**3 / 15)

_Member = tuple[str, int, str]  # kind of element, number and role


@name_wrong_arguments
def to_lanelet2(source: UserValue, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of a Lanelet2 map, ``.osm``.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file. Connections that no neighbour returns, or that
        leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no other right of way.

    Returns:
      A text; the same map gives the same text. Lanelets have the tag ``name``: row, column, the side by which they
      enter their tile, and the turn, such as ``3_4_west_left``.

    Raises:
      InputError: for a bad map, one without any road, or bad measures.
    """
    road_map = as_map(source)
    rules = rights_of_way(road_map, streets)
    graph = lane_graph(road_map.codes, turn_back=True)
    links = CONNECTIONS[linked_codes(road_map.codes)]
    city = _Map()
    for tile, group in groupby(graph.list_movements(), attrgetter("node.tile")):
        here = {movement: bounds(movement, streets, len(links)) for movement in group}
        crossing = links[tile] > 2
        lanelets: dict[Movement, tuple[int, list[_Member]]] = {}
        for movement, (left, right) in here.items():
            middle = "virtual" if crossing or movement.turn == BACK else "line_thin"
            sides = city.line(left, middle, "dashed"), city.line(right, "virtual" if crossing else "line_thin", "solid")
            lanelets[movement] = city.number(), [("way", sides[0], "left"), ("way", sides[1], "right")]
        if crossing:
            ends = {movement.heading: np.array([left[0], right[0]]) for movement, (left, right) in here.items()}
            _add_rules(city, lanelets, ends, rules[tile])
        for movement, (number, members) in lanelets.items():
            tags = {"type": "lanelet", "subtype": "road", "location": "urban", "one_way": "yes", "name": movement.name}
            tags["speed_limit"] = f"{streets.speed * 3.6:g} km/h"
            city.relation(number, members, tags | ({"turn_direction": TURNS[movement.turn]} if crossing else {}))
    return city.text()


def _add_rules(
    city: "_Map",
    lanelets: dict[Movement, tuple[int, list[_Member]]],
    ends: dict[int, NDArray[np.complex128]],
    right_of_way: str,
) -> None:
    """Adds who goes first at a crossing to its lanelets.

    `ends` are the left and right points where movements enter the crossing, by their headings.
    """
    rules: list[tuple[str, list[_Member], list[Movement]]] = []
    numbers = {movement: number for movement, (number, _) in lanelets.items()}
    low = giving_way(numbers)
    if right_of_way == "allway_stop":
        stops = {heading: city.line(end, "stop_line") for heading, end in ends.items()}
        roles = [("way", stops[movement.heading], "ref_line") for movement in numbers]
        rules.append(("all_way_stop", [("relation", one, "yield") for one in numbers.values()] + roles, list(numbers)))
    elif right_of_way == "traffic_light":
        for heading, end in ends.items():
            stop = ("way", city.line(end, "stop_line"), "ref_line")
            beside = end[1] + (end[1] - end[0]) * np.array([0.1, 0.4])
            light = ("way", city.line(beside, "traffic_light", "red_yellow_green"), "refers")
            rules.append(
                ("traffic_light", [light, stop], [movement for movement in numbers if movement.heading == heading])
            )
    elif right_of_way == "priority" and low:
        first = [
            ("relation", number, "yield" if movement.heading in low else "right_of_way")
            for movement, number in numbers.items()
        ]
        rules.append(("right_of_way", first, list(numbers)))
    for subtype, roles, movements in rules:
        rule = city.number()
        city.relation(rule, roles, {"type": "regulatory_element", "subtype": subtype})
        for movement in movements:
            lanelets[movement][1].append(("relation", rule, "regulatory_element"))


class _Map:
    """The elements of a map. Points with equal coordinates, and lines through the same points, are added once."""

    def __init__(self) -> None:
        self.points: dict[complex, int] = {}
        self.lines: dict[tuple[int, ...], int] = {}
        self.ways: list[str] = []
        self.relations: list[str] = []
        self.number = count(1).__next__

    def line(self, points: NDArray[np.complex128], kind: str, subtype: str = "") -> int:
        """Adds a line, and returns its number."""
        rounded = np.round(points, 6).tolist()
        for point in (point for point in rounded if point not in self.points):
            self.points[point] = self.number()
        ids = [self.points[point] for point in rounded]
        key = min(tuple(ids), tuple(ids[::-1]))
        if key not in self.lines:
            self.lines[key] = self.number()
            nodes = "".join(f'<nd ref="{one}"/>' for one in ids)
            tags = {"type": kind} | ({"subtype": subtype} if subtype and kind != "virtual" else {})
            self.ways.append(_element("way", self.lines[key], nodes, tags))
        return self.lines[key]

    def relation(self, number: int, members: list[_Member], tags: dict[str, str]) -> None:
        """Adds a lanelet or a rule."""
        parts = "".join(f'<member type="{kind}" ref="{ref}" role="{role}"/>' for kind, ref, role in members)
        self.relations.append(_element("relation", number, parts, tags))

    def text(self) -> str:
        """Returns the text of the file."""
        points = np.array(list(self.points))
        nodes = [
            f'<node id="{number}" visible="true" version="1" lat="{latitude:.12f}" lon="{longitude:.12f}">'
            f'<tag k="local_x" v="{point.real:.6f}"/><tag k="local_y" v="{point.imag:.6f}"/></node>'
            for (point, number), latitude, longitude in zip(self.points.items(), *_on_earth(points), strict=True)
        ]
        head = '<?xml version="1.0" encoding="UTF-8"?>\n<osm version="0.6" generator="elitelanes">'
        return "\n".join([head, *nodes, *self.ways, *self.relations, "</osm>\n"])


def _element(kind: str, number: int, parts: str, tags: dict[str, str]) -> str:
    listed = "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
    return f'<{kind} id="{number}" visible="true" version="1">{parts}{listed}</{kind}>'


def _on_earth(points: NDArray[np.complex128]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the latitudes and longitudes of points, in degrees: UTM inverted, by Krüger's series."""
    zeta = (points.imag + 1j * points.real) / _RADIUS
    zeta = zeta - sum(beta * np.sin(2 * j * zeta) for j, beta in enumerate(_BETA, 1))
    chi = np.arcsin(np.sin(zeta.real) / np.cosh(zeta.imag))
    latitudes = chi + sum(delta * np.sin(2 * j * chi) for j, delta in enumerate(_DELTA, 1))
    return np.degrees(latitudes), 9 + np.degrees(np.arctan2(np.sinh(zeta.imag), np.cos(zeta.real)))
