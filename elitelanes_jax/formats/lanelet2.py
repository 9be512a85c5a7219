"""Road networks as Lanelet2 maps, with a lanelet for each movement across a tile.

The files are OpenStreetMap's XML.

Lanelets that follow each other share the ends of their bounds, and oncoming ones the middle of the
road. Places are on the equator, where UTM's zone 32 has its central meridian: read a map with
``UtmProjector(Origin(0, 9))``, or by its tags ``local_x`` and ``local_y``, in metres from the
grid's south-west corner.
"""

from itertools import count, groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import rights_of_way
from elitelanes_jax.formats.streets import Streets, bounds, giving_way
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import BACK, TURNS, Movement, lane_graph
from elitelanes_jax.network.codes import CONNECTIONS

# These are UTM's constants for the ellipsoid WGS 84. The series end at the third power of _N. The
# error is under a micrometre up to 7 km from the origin, and under 14 micrometres up to 100 km.
_N = 1 / (2 * 298.257223563 - 1)
_RADIUS = 0.9996 * 6378137 / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)
_BETA = (_N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96, _N**2 / 48 + _N**3 / 15, 17 * _N**3 / 480)
_DELTA = (2 * _N - 2 * _N**2 / 3 - 2 * _N**3, 7 * _N**2 / 3 - 8 * _N**3 / 5, 56 * _N**3 / 15)


class _Member(NamedTuple):
    """A part of a relation; its kind is "way" or "relation"."""

    kind: str
    number: int
    role: str


class _Lanelet(NamedTuple):
    """A lanelet of the map.

    Attributes:
      movement: the movement that the lanelet leads along.
      number: the number of its relation.
      members: its bounds, and the rules that it obeys.
      entry: the left and the right point where it begins, in metres.
    """

    movement: Movement
    number: int
    members: list[_Member]
    entry: Complex128[np.ndarray, "2"]


def to_lanelet2(source: UserValue, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of a Lanelet2 map, ``.osm``.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file. Connections that no neighbour
        returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.

    Returns:
      A text; the same map gives the same text. Lanelets have the tag ``name``: row, column, the
      side by which they enter their tile, and the turn, such as ``3_4_west_left``.

    Raises:
      InputError: for a bad map, one without any road, or bad measures.
    """
    road_map = as_map(source)
    rules = rights_of_way(road_map, streets)
    graph = lane_graph(road_map.codes, turn_back=True)
    links = CONNECTIONS[linked_codes(road_map.codes)]
    city = _Map()
    # Movements are in the order of their tiles, so `groupby` collects those of each tile.
    for tile, movements in groupby(graph.list_movements(), attrgetter("node.tile")):
        is_crossing = bool(links[tile] > 2)
        # Rules and lanelets refer to each other. Lanelets get their numbers first, then the rules
        # are added, and the relations of lanelets come last.
        lanelets = [
            _start_lanelet(city, movement, streets, len(links), is_crossing)
            for movement in movements
        ]
        if is_crossing:
            _add_rules(city, lanelets, rules[tile])
        for lanelet in lanelets:
            _finish_lanelet(city, lanelet, streets, is_crossing)
    return city.text()


def _start_lanelet(
    city: "_Map", movement: Movement, streets: Streets, height: int, is_crossing: bool
) -> _Lanelet:
    """Adds the bounds of a lanelet. On a crossing no tape marks the bounds."""
    left, right = bounds(movement, streets, height)
    # A movement back leads around the middle of a dead end, where no line is.
    left_kind = "virtual" if is_crossing or movement.turn == BACK else "line_thin"
    right_kind = "virtual" if is_crossing else "line_thin"
    members = [
        _Member("way", city.add_line(left, left_kind, "dashed"), "left"),
        _Member("way", city.add_line(right, right_kind, "solid"), "right"),
    ]
    return _Lanelet(movement, city.next_number(), members, np.array([left[0], right[0]]))


def _finish_lanelet(city: "_Map", lanelet: _Lanelet, streets: Streets, is_crossing: bool) -> None:
    """Adds the relation of a lanelet, when all its members are known."""
    tags = {
        "type": "lanelet",
        "subtype": "road",
        "location": "urban",
        "one_way": "yes",
        "name": lanelet.movement.name,
        "speed_limit": f"{streets.speed * 3.6:g} km/h",
    }
    if is_crossing:
        tags["turn_direction"] = TURNS[lanelet.movement.turn]
    city.add_relation(lanelet.number, lanelet.members, tags)


def _add_rules(city: "_Map", lanelets: list[_Lanelet], right_of_way: str) -> None:
    """Adds who goes first at a crossing to its lanelets."""
    if right_of_way == "allway_stop":
        _add_stop_for_all(city, lanelets)
    elif right_of_way == "traffic_light":
        _add_lights(city, lanelets)
    elif right_of_way == "priority":
        _add_priority(city, lanelets)


def _entries_of(lanelets: list[_Lanelet]) -> dict[int, Complex128[np.ndarray, "2"]]:
    """Returns the left and the right point where each road enters a crossing, by the heading."""
    return {lanelet.movement.heading: lanelet.entry for lanelet in lanelets}


def _add_stop_for_all(city: "_Map", lanelets: list[_Lanelet]) -> None:
    # Lanelets from one side share a stop line.
    stop_lines = {
        heading: city.add_line(entry, "stop_line")
        for heading, entry in _entries_of(lanelets).items()
    }
    members = [_Member("relation", lanelet.number, "yield") for lanelet in lanelets]
    for lanelet in lanelets:
        members.append(_Member("way", stop_lines[lanelet.movement.heading], "ref_line"))
    _add_rule(city, "all_way_stop", members, lanelets)


def _add_lights(city: "_Map", lanelets: list[_Lanelet]) -> None:
    """Adds a light and a stop line for each road that enters the crossing.

    The light is on the right of the road's lane.
    """
    members_of_lights: dict[int, list[_Member]] = {}
    for heading, entry in _entries_of(lanelets).items():
        left, right = entry
        stop_line = city.add_line(entry, "stop_line")
        # The light is beside the lane, from 0.1 to 0.4 of its width to the right of it.
        beside_lane = right + (right - left) * np.array([0.1, 0.4])
        light = city.add_line(beside_lane, "traffic_light", "red_yellow_green")
        members_of_lights[heading] = [
            _Member("way", light, "refers"),
            _Member("way", stop_line, "ref_line"),
        ]
    for heading, members in members_of_lights.items():
        ruled = [lanelet for lanelet in lanelets if lanelet.movement.heading == heading]
        _add_rule(city, "traffic_light", members, ruled)


def _add_priority(city: "_Map", lanelets: list[_Lanelet]) -> None:
    """Adds the rule that the road that goes straight on goes first.

    A crossing with four arms has two such roads, and gets no rule.
    """
    yielding = giving_way(lanelet.movement for lanelet in lanelets)
    # At four arms no road gives way.
    if not yielding:
        return
    members = []
    for lanelet in lanelets:
        role = "yield" if lanelet.movement.heading in yielding else "right_of_way"
        members.append(_Member("relation", lanelet.number, role))
    _add_rule(city, "right_of_way", members, lanelets)


def _add_rule(city: "_Map", subtype: str, members: list[_Member], ruled: list[_Lanelet]) -> None:
    """Adds a rule, and names it in the lanelets that obey it."""
    number = city.next_number()
    city.add_relation(number, members, {"type": "regulatory_element", "subtype": subtype})
    for lanelet in ruled:
        lanelet.members.append(_Member("relation", number, "regulatory_element"))


class _Map:
    """The elements of a map.

    Points with equal coordinates, and lines through the same points, are added once.
    """

    def __init__(self) -> None:
        self.points: dict[complex, int] = {}
        self.lines: dict[tuple[int, ...], int] = {}
        self.ways: list[str] = []
        self.relations: list[str] = []
        self.next_number = count(1).__next__

    def add_line(self, points: Complex128[np.ndarray, " P"], kind: str, subtype: str = "") -> int:
        """Adds a line, and returns its number."""
        # Micrometres are enough, and make points of neighbours equal in spite of rounding errors.
        node_numbers = [self._add_point(point) for point in np.round(points, 6).tolist()]
        # The direction does not matter, because oncoming lanelets share their left bound.
        key = min(tuple(node_numbers), tuple(reversed(node_numbers)))
        if key not in self.lines:
            self.lines[key] = self.next_number()
            nodes = "".join(f'<nd ref="{number}"/>' for number in node_numbers)
            tags = {"type": kind}
            # A virtual line has no tape, and so no subtype.
            if subtype and kind != "virtual":
                tags["subtype"] = subtype
            self.ways.append(_element("way", self.lines[key], nodes, tags))
        return self.lines[key]

    def _add_point(self, point: complex) -> int:
        if point not in self.points:
            self.points[point] = self.next_number()
        return self.points[point]

    def add_relation(self, number: int, members: list[_Member], tags: dict[str, str]) -> None:
        """Adds a lanelet or a rule."""
        parts = "".join(
            f'<member type="{kind}" ref="{ref}" role="{role}"/>' for kind, ref, role in members
        )
        self.relations.append(_element("relation", number, parts, tags))

    def text(self) -> str:
        """Returns the text of the file."""
        latitudes, longitudes = _on_earth(np.array(list(self.points)))
        lines = [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<osm version="0.6" generator="elitelanes">',
        ]
        for (point, number), latitude, longitude in zip(
            self.points.items(), latitudes, longitudes, strict=True
        ):
            place = f'lat="{latitude:.12f}" lon="{longitude:.12f}"'
            local = (
                f'<tag k="local_x" v="{point.real:.6f}"/><tag k="local_y" v="{point.imag:.6f}"/>'
            )
            lines.append(f'<node id="{number}" visible="true" version="1" {place}>{local}</node>')
        lines += self.ways
        lines += self.relations
        lines.append("</osm>\n")
        return "\n".join(lines)


def _element(kind: str, number: int, parts: str, tags: dict[str, str]) -> str:
    listed = "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
    return f'<{kind} id="{number}" visible="true" version="1">{parts}{listed}</{kind}>'


def _on_earth(
    points: Complex128[np.ndarray, " P"],
) -> tuple[Float64[np.ndarray, " P"], Float64[np.ndarray, " P"]]:
    """Returns the latitudes and longitudes of points, in degrees.

    UTM is inverted by Krüger's series.
    """
    # `zeta` is the point on the plane: north as its real part, east as its imaginary part, in
    # radii.
    zeta = (points.imag + 1j * points.real) / _RADIUS
    # The first series leads to the transverse Mercator projection of a sphere.
    zeta = zeta - sum(beta * np.sin(2 * j * zeta) for j, beta in enumerate(_BETA, 1))
    # `chi` is the latitude on that sphere. The second series leads to the latitude on the
    # ellipsoid.
    chi = np.arcsin(np.sin(zeta.real) / np.cosh(zeta.imag))
    latitudes = chi + sum(delta * np.sin(2 * j * chi) for j, delta in enumerate(_DELTA, 1))
    # The sphere has the same longitudes, here from the central meridian of zone 32.
    longitudes = np.arctan2(np.sinh(zeta.imag), np.cos(zeta.real))
    return np.degrees(latitudes), 9 + np.degrees(longitudes)
