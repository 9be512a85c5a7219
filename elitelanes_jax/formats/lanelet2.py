"""Road networks as Lanelet2 maps, with a lanelet for each movement across a tile.

The files are OpenStreetMap's XML.

Lanelets that follow each other share the ends of their bounds, and oncoming ones the middle of the
road. Read a map with ``UtmProjector(Origin(LAT, LON))`` of its origin, by default 0, 9. Or read the
tags ``local_x`` and ``local_y``, in metres from the grid's south-west corner.
"""

from itertools import count, groupby, islice
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from elitelanes_jax.formats._earth import to_earth
from elitelanes_jax.formats._scene import Approach, Lanelet, Line, Scene, make_scene
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.movements import TURNS


class _Member(NamedTuple):
    """A part of a relation; its kind is "way" or "relation"."""

    kind: str
    number: int
    role: str


class _Relation(NamedTuple):
    """The relation of a lanelet.

    Attributes:
      lanelet: the lanelet.
      number: the number of the relation.
      members: its bounds, and the rules that it obeys.
      starts: the left and the right point where it starts, in metres.
    """

    lanelet: Lanelet
    number: int
    members: list[_Member]
    starts: Line


def to_lanelet2(road_map: RoadMap, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of a Lanelet2 map, ``.osm``.

    Args:
      road_map: the map. Connections that no neighbour returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.

    Returns:
      A text; the same map gives the same text. Lanelets have the tag ``name``: row, column, the
      side by which they enter their tile, and the turn, such as ``3_4_west_left``.

    Raises:
      InputError: for a map without any road, or bad measures.
    """
    scene = make_scene(road_map, streets)
    file = _File()
    # Lanelets are in the order of their tiles, so `groupby` collects those of each tile.
    for tile, lanelets in groupby(scene.lanelets, attrgetter("movement.node.tile")):
        # Rules and lanelets refer to each other. Lanelets get their numbers first, then the rules
        # are added, and the relations of lanelets come last.
        relations = [_start_relation(file, lanelet, scene) for lanelet in lanelets]
        if tile in scene.crossings:
            _add_rules(file, scene.crossings[tile], relations)
        for relation in relations:
            file.add_relation(relation.number, relation.members, _tags(relation.lanelet, streets))
    return file.text(streets)


def _start_relation(file: "_File", lanelet: Lanelet, scene: Scene) -> _Relation:
    """Adds the bounds of a lanelet, and gives it a number."""
    left, right = scene.bounds(lanelet)
    # No tape marks the bounds on a crossing, and none the middle of a dead end.
    left_kind = "line_thin" if lanelet.arms == 2 else "virtual"
    right_kind = "line_thin" if lanelet.arms <= 2 else "virtual"
    members = [
        _Member("way", file.add_line(left, left_kind, "dashed"), "left"),
        _Member("way", file.add_line(right, right_kind, "solid"), "right"),
    ]
    return _Relation(lanelet, file.next_number(), members, np.array([left[0], right[0]]))


def _tags(lanelet: Lanelet, streets: Streets) -> dict[str, str]:
    tags = {
        "type": "lanelet",
        "subtype": "road",
        "location": "urban",
        "one_way": "yes",
        "name": lanelet.movement.name,
        "participant:vehicle": "yes",
        # Without a unit it is km/h. Autoware and tactics2d read a number alone.
        "speed_limit": f"{streets.speed * 3.6:g}",
    }
    if lanelet.arms > 2:
        tags["turn_direction"] = TURNS[lanelet.movement.turn]
    return tags


def _add_rules(file: "_File", approaches: list[Approach], relations: list[_Relation]) -> None:
    """Adds who goes first at a crossing. `relations` are those of the lanelets on its tile."""
    # The parts of the crossing's rule are lanelets by their role, then the stop lines.
    roles: list[_Member] = []
    stop_lines: list[_Member] = []
    lights: list[tuple[list[_Member], list[_Relation]]] = []
    # The relations are in the order of the approaches.
    rest = iter(relations)
    for approach in approaches:
        ruled = list(islice(rest, len(approach.lanelets)))
        left, right = starts = ruled[0].starts
        if approach.control in ("stop", "light"):
            # Lanelets from one side share a stop line.
            stop_line = _Member("way", file.add_line(starts, "stop_line"), "ref_line")
            stop_lines += [stop_line] * len(ruled)
        if approach.control == "light":
            # The light is beside the lane, from 0.1 to 0.4 of its width to the right of it.
            beside_lane = right + (right - left) * np.array([0.1, 0.4])
            light = file.add_line(beside_lane, "traffic_light", "red_yellow_green")
            lights.append(([_Member("way", light, "refers"), stop_line], ruled))
        role = "right_of_way" if approach.control == "go_first" else "yield"
        roles += [_Member("relation", relation.number, role) for relation in ruled]
    for members, ruled in lights:
        file.add_rule("traffic_light", members, ruled)
    # Where no road gives way, or the one from the right goes first, there is no rule.
    if approach.control == "stop":
        file.add_rule("all_way_stop", roles + stop_lines, relations)
    elif approach.control in ("yield", "go_first"):
        file.add_rule("right_of_way", roles, relations)


class _File:
    """The elements of a file.

    Points with equal coordinates, and lines through the same points, are added once.
    """

    def __init__(self) -> None:
        self.points: dict[complex, int] = {}
        self.lines: dict[tuple[int, ...], int] = {}
        self.ways: list[str] = []
        self.relations: list[str] = []
        self.next_number = count(1).__next__

    def add_line(self, points: Line, kind: str, subtype: str = "") -> int:
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

    def add_rule(self, subtype: str, members: list[_Member], ruled: list[_Relation]) -> None:
        """Adds a rule, and names it in the lanelets that obey it."""
        number = self.next_number()
        self.add_relation(number, members, {"type": "regulatory_element", "subtype": subtype})
        for relation in ruled:
            relation.members.append(_Member("relation", number, "regulatory_element"))

    def text(self, streets: Streets) -> str:
        """Returns the text of the file."""
        latitudes, longitudes = to_earth(np.array(list(self.points)), streets.origin)
        lines = [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<osm version="0.6" generator="elitelanes">',
            # Autoware reads the version of its own tags here.
            '<MetaInfo format_version="1" map_version="1"/>',
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
