"""Road networks as CommonRoad scenarios, version 2020a, without cars.

A scenario has a lanelet for each movement across a tile.
"""

from hashlib import sha256
from itertools import count, groupby
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Integer

from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import rights_of_way
from elitelanes_jax.formats.streets import Streets, bounds, giving_way
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import BACK, LaneGraph, Movement, lane_graph
from elitelanes_jax.network.codes import CONNECTIONS

_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" benchmarkID="ZAM_Tiles-{number}_1_T-1" \
date="1970-01-01" author="elitelanes" affiliation="" source="elitelanes">
<location><geoNameId>-999</geoNameId><gpsLatitude>0</gpsLatitude><gpsLongitude>9</gpsLongitude></location>
<scenarioTags><urban/></scenarioTags>
"""

# The numbers of signs in the German road traffic regulations.
_SPEED, _YIELD, _PRIORITY = "274", "205", "306"
# The sign at all entries of a crossing, by right of way.
_SIGN_FOR_ALL = {"allway_stop": "206", "right_before_left": "102"}

# The phases of a traffic light: the colour, and its length in time steps of 0.1 s.
_CYCLE = (("green", 200), ("yellow", 30), ("red", 200), ("redYellow", 30))
# This cycle is half a cycle ahead, so one axis is green while the other is red.
_CYCLE_FROM_RED = _CYCLE[2:] + _CYCLE[:2]

# The elements for the successors of an incoming road, by turn.
_SUCCESSORS = ("successorsRight", "successorsStraight", "successorsLeft")


class _Lanelet(NamedTuple):
    """A lanelet of the scenario.

    Attributes:
      number: the number of the lanelet, from 1.
      movement: the movement that the lanelet leads along.
      left: its left bound in metres.
      right: its right bound, with as many points.
      predecessors: the numbers of the lanelets that lead into it.
      successors: the numbers of the lanelets that continue it.
    """

    number: int
    movement: Movement
    left: Complex128[np.ndarray, " P"]
    right: Complex128[np.ndarray, " P"]
    predecessors: list[int]
    successors: list[int]


def to_commonroad(source: UserValue, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of a CommonRoad scenario, ``.xml``.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file. Connections that no neighbour
        returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.

    Returns:
      A text; the same map gives the same text. x is east and y north of the grid's south-west
      corner, in metres. Lanelets are numbered from 1 in ascending order of row, column, heading and
      turn. The format demands a planning problem: from lanelet 1 to a lanelet that is farthest from
      there.

    Raises:
      InputError: for a bad map, one without any road, or bad measures.
    """
    road_map = as_map(source)
    rights = rights_of_way(road_map, streets)
    links = CONNECTIONS[linked_codes(road_map.codes)]
    lanelets = _make_lanelets(lane_graph(road_map.codes, turn_back=True), streets, len(links))
    scenario = _Scenario(first_number=len(lanelets) + 1)
    speed = f"<additionalValue>{streets.speed:.9g}</additionalValue>"
    # One virtual sign has the speed limit of all lanelets.
    limit = scenario.add_sign(_SPEED, lanelets[0].right[0], speed)
    # Lanelets are in the order of their tiles, so `groupby` collects those of each tile.
    for tile, across in groupby(lanelets, lambda lanelet: lanelet.movement.node.tile):
        if links[tile] > 2:
            _add_crossing(scenario, list(across), lanelets, rights[tile])
    # A lanelet names its sign or light, so lanelets are written when all crossings are known.
    elements = _lanelet_elements(lanelets, scenario.rules, links, limit)
    elements += scenario.signs + scenario.lights + scenario.intersections
    goal = _farthest_from(lanelets[0], lanelets)
    elements += [_problem(scenario.next_number(), lanelets[0], goal), "</commonRoad>\n"]
    # The number of the scenario depends on its content, so the head comes last.
    content = "\n".join(elements)
    return _HEAD.format(number=_number_of(content)) + content


class _Scenario:
    """The elements of a scenario besides lanelets, and their numbers."""

    def __init__(self, first_number: int) -> None:
        self.next_number = count(first_number).__next__
        self.signs: list[str] = []
        self.lights: list[str] = []
        self.intersections: list[str] = []
        # The reference to the sign or the light at the end of a lanelet, by the lanelet's number.
        self.rules: dict[int, str] = {}

    def add_sign(self, kind: str, position: complex, value: str = "") -> int:
        """Adds a sign, and returns its number. A sign with a value is virtual."""
        number = self.next_number()
        element = (
            f"<trafficSignElement><trafficSignID>{kind}</trafficSignID>{value}</trafficSignElement>"
        )
        place = (
            f"<position>{_point(position)}</position>"
            f"<virtual>{'true' if value else 'false'}</virtual>"
        )
        self.signs.append(f'<trafficSign id="{number}">{element}{place}</trafficSign>')
        return number

    def add_light(self, heading: int) -> int:
        """Adds a traffic light, and returns its number.

        North and south are green while the others are red.
        """
        number = self.next_number()
        phases = []
        for color, duration in _CYCLE_FROM_RED if heading % 2 else _CYCLE:
            phases.append(
                f"<cycleElement><duration>{duration}</duration>"
                f"<color>{color}</color></cycleElement>"
            )
        cycle = f"<cycle>{''.join(phases)}</cycle>"
        active = "<direction>all</direction><active>true</active>"
        self.lights.append(f'<trafficLight id="{number}">{cycle}{active}</trafficLight>')
        return number


def _make_lanelets(graph: LaneGraph, streets: Streets, height: int) -> list[_Lanelet]:
    """Returns the lanelets of all movements in order, with the links between them."""
    lanelets = []
    for number, movement in enumerate(graph.list_movements(), 1):
        left, right = bounds(movement, streets, height)
        if movement.turn == BACK:
            # Both ends of this left bound are the middle of the tile's side. They are moved apart,
            # because the outline of a lanelet must not touch itself.
            left[[0, -1]] += 1e-5 * (right - left)[[0, -1]]
        lanelets.append(_Lanelet(number, movement, left, right, [], []))
    for lanelet, next_indices in zip(lanelets, graph.list_successors(), strict=True):
        for index in next_indices:
            lanelet.successors.append(lanelets[index].number)
            lanelets[index].predecessors.append(lanelet.number)
    return lanelets


def _add_crossing(
    scenario: _Scenario, across: list[_Lanelet], lanelets: list[_Lanelet], right_of_way: str
) -> None:
    """Adds the intersection of a crossing with its signs or lights.

    `across` are the lanelets on its tile, and `lanelets` are all lanelets by their numbers, from 1.
    """
    yielding = giving_way(lanelet.movement for lanelet in across)
    by_heading: dict[int, list[_Lanelet]] = {}
    for lanelet in across:
        by_heading.setdefault(lanelet.movement.heading, []).append(lanelet)
    # All numbers are needed first, because the ways into a crossing refer to each other.
    incoming_numbers = {heading: scenario.next_number() for heading in by_heading}
    parts = []
    for heading, turning in by_heading.items():
        # All turns from a side continue the same lanelets, which end at the crossing.
        entering = turning[0].predecessors
        parts.append(_incoming(heading, turning, incoming_numbers))
        sign = _SIGN_FOR_ALL.get(right_of_way)
        # At four arms no road gives way, so a crossing with priority has no signs there.
        if right_of_way == "priority" and yielding:
            sign = _YIELD if heading in yielding else _PRIORITY
        if sign is not None:
            end_of_lane = lanelets[entering[0] - 1].right[-1]
            number = scenario.add_sign(sign, end_of_lane)
            scenario.rules |= dict.fromkeys(entering, f'<trafficSignRef ref="{number}"/>')
        elif right_of_way == "traffic_light":
            number = scenario.add_light(heading)
            scenario.rules |= dict.fromkeys(entering, f'<trafficLightRef ref="{number}"/>')
    intersection = f'<intersection id="{scenario.next_number()}">{"".join(parts)}</intersection>'
    scenario.intersections.append(intersection)


def _incoming(heading: int, turning: list[_Lanelet], incoming_numbers: dict[int, int]) -> str:
    """Returns one way into an intersection, from which the lanelets of all turns lead."""
    parts = [f'<incoming id="{incoming_numbers[heading]}">']
    for number in turning[0].predecessors:
        parts.append(f'<incomingLanelet ref="{number}"/>')
    for lanelet in turning:
        parts.append(f'<{_SUCCESSORS[lanelet.movement.turn]} ref="{lanelet.number}"/>')
    # Who comes from the right has a heading that is a quarter turn to the left.
    from_right = (heading + 3) % 4
    if from_right in incoming_numbers:
        parts.append(f'<isLeftOf ref="{incoming_numbers[from_right]}"/>')
    parts.append("</incoming>")
    return "".join(parts)


def _lanelet_elements(
    lanelets: list[_Lanelet], rules: dict[int, str], links: Integer[np.ndarray, "H W"], limit: int
) -> list[str]:
    """Returns the elements of all lanelets.

    `limit` is the number of the sign with the speed limit.
    """
    numbers = {}
    for lanelet in lanelets:
        movement = lanelet.movement
        numbers[movement.node.tile, movement.heading, movement.exit] = lanelet.number
    elements = []
    for lanelet in lanelets:
        movement = lanelet.movement
        # The oncoming lanelet enters where this one leaves, and leaves where this one enters.
        way_back = movement.node.tile, (movement.exit + 2) % 4, (movement.heading + 2) % 4
        tile_links = int(links[movement.node.tile])
        rule = rules.get(lanelet.number, "")
        elements.append(_lanelet_element(lanelet, tile_links, numbers[way_back], rule, limit))
    return elements


def _lanelet_element(
    lanelet: _Lanelet, tile_links: int, oncoming: int, rule: str, limit: int
) -> str:
    """Returns the element of a lanelet, whose tile has a number of links to its neighbours."""
    has_middle_line = tile_links == 2
    is_crossing = tile_links > 2
    parts = [
        _bound("leftBound", lanelet.left, "dashed" if has_middle_line else "no_marking"),
        _bound("rightBound", lanelet.right, "no_marking" if is_crossing else "solid"),
    ]
    for number in lanelet.predecessors:
        parts.append(f'<predecessor ref="{number}"/>')
    for number in lanelet.successors:
        parts.append(f'<successor ref="{number}"/>')
    if has_middle_line:
        parts.append(f'<adjacentLeft ref="{oncoming}" drivingDir="opposite"/>')
    if rule:
        ends = _point(lanelet.left[-1]) + _point(lanelet.right[-1])
        parts.append(f"<stopLine>{ends}<lineMarking>solid</lineMarking>{rule}</stopLine>")
    parts.append("<laneletType>urban</laneletType><userOneWay>vehicle</userOneWay>")
    parts.append(f'<trafficSignRef ref="{limit}"/>{rule}')
    return f'<lanelet id="{lanelet.number}">{"".join(parts)}</lanelet>'


def _farthest_from(start: _Lanelet, lanelets: list[_Lanelet]) -> int:
    """Returns the number of the lanelet that is farthest from another one.

    A breadth-first search from `start` reaches it last.
    """
    queue = [start.number]
    reached = {start.number}
    for number in queue:
        # The queue grows during the loop, until it has all lanelets that can be reached.
        for successor in lanelets[number - 1].successors:
            if successor not in reached:
                reached.add(successor)
                queue.append(successor)
    return queue[-1]


def _number_of(content: str) -> int:
    """Returns the number of a map in the ID of its scenario, from 1 to 2**40.

    Tools for CommonRoad keep results by that ID, so different scenarios need different numbers. Of
    10,000 scenarios, two have the same number with a probability of 0.005 %.
    """
    return 1 + int.from_bytes(sha256(content.encode()).digest()[:5])


def _bound(side: str, line: Complex128[np.ndarray, " P"], marking: str) -> str:
    points = "".join(map(_point, line.tolist()))
    return f"<{side}>{points}<lineMarking>{marking}</lineMarking></{side}>"


def _point(position: complex) -> str:
    return f"<point><x>{position.real:.6f}</x><y>{position.imag:.6f}</y></point>"


def _problem(number: int, start: _Lanelet, goal: int) -> str:
    """Returns a planning problem from one lanelet to another.

    It starts at the first chord of `start`, and the goal has to be reached within an hour.
    """
    first, second = np.mean([start.left, start.right], axis=0)[:2]
    values = {
        "orientation": np.angle(second - first),
        "time": 0,
        "velocity": 0,
        "yawRate": 0,
        "slipAngle": 0,
    }
    state = "".join(
        f"<{name}><exact>{value:.9g}</exact></{name}>" for name, value in values.items()
    )
    position = f"<position>{_point((first + second) / 2)}</position>"
    time = "<time><intervalStart>0</intervalStart><intervalEnd>36000</intervalEnd></time>"
    goal_position = f'<position><lanelet ref="{goal}"/></position>'
    return (
        f'<planningProblem id="{number}"><initialState>{position}{state}</initialState>'
        f"<goalState>{time}{goal_position}</goalState></planningProblem>"
    )
