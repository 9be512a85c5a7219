"""Road networks as CommonRoad scenarios, version 2020a, without cars: a lanelet for each movement across a tile."""

from collections import deque
from hashlib import sha256
from itertools import count, groupby

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import rights_of_way
from elitelanes_jax.formats.streets import Streets, bounds, giving_way
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import BACK, lane_graph
from elitelanes_jax.network.codes import CONNECTIONS

_HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>',
    '<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" benchmarkID="ZAM_Tiles-{number}_1_T-1" '
    'date="1970-01-01" author="elitelanes" affiliation="" source="elitelanes">',
    "<location><geoNameId>-999</geoNameId><gpsLatitude>0</gpsLatitude><gpsLongitude>9</gpsLongitude></location>",
    "<scenarioTags><urban/></scenarioTags>",
)
_SPEED, _YIELD, _PRIORITY = "274", "205", "306"  # signs
_SIGNS = {"allway_stop": "206", "right_before_left": "102"}  # by right of way
_CYCLE = (("green", 200), ("yellow", 30), ("red", 200), ("redYellow", 30))  # of a traffic light, in time steps
_SUCCESSORS = ("successorsRight", "successorsStraight", "successorsLeft")


@name_wrong_arguments
def to_commonroad(source: UserValue, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of a CommonRoad scenario, ``.xml``.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file. Connections that no neighbour returns, or that
        leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no other right of way.

    Returns:
      A text; the same map gives the same text. x is east and y north of the grid's south-west corner, in metres.
      Lanelets are numbered from 1 in ascending order of row, column, heading and turn. The format demands a planning
      problem: from lanelet 1 to a lanelet that is farthest from there.

    Raises:
      InputError: for a bad map, one without any road, or bad measures.
    """
    road_map = as_map(source)
    rights = rights_of_way(road_map, streets)
    graph = lane_graph(road_map.codes, turn_back=True)
    movements, after = graph.list_movements(), graph.list_successors()
    links = CONNECTIONS[linked_codes(road_map.codes)]
    sides = [bounds(movement, streets, len(links)) for movement in movements]
    for movement, (left, right) in zip(movements, sides, strict=True):
        if movement.turn == BACK:  # the outline of a lanelet must not touch itself
            left[[0, -1]] += 1e-5 * (right - left)[[0, -1]]
    before: list[list[int]] = [[] for _ in movements]
    for index, others in enumerate(after):
        for other in others:
            before[other].append(index)
    numbers = count(len(movements) + 1)
    limit = next(numbers)
    signs = [_sign(limit, sides[0][1][0], _SPEED, f"<additionalValue>{streets.speed:.9g}</additionalValue>")]
    lights: list[str] = []
    intersections: list[str] = []
    rules: dict[int, str] = {}  # the reference to the sign or light at the end of a lanelet, by its index
    for tile, group in groupby(range(len(movements)), lambda index: movements[index].node.tile):
        across = {heading: list(some) for heading, some in groupby(group, lambda index: movements[index].heading)}
        if links[tile] < 3:
            continue
        low = giving_way(movements[index] for some in across.values() for index in some)
        incoming = {heading: next(numbers) for heading in across}
        parts = []
        for heading, some in across.items():
            entering, from_right = before[some[0]], (heading + 3) % 4
            parts.append(f'<incoming id="{incoming[heading]}">')
            parts += [f'<incomingLanelet ref="{one + 1}"/>' for one in entering]
            parts += [f'<{_SUCCESSORS[movements[index].turn]} ref="{index + 1}"/>' for index in some]
            parts.append(f'<isLeftOf ref="{incoming[from_right]}"/>' if from_right in incoming else "")
            parts.append("</incoming>")
            sign = _SIGNS.get(rights[tile])
            if rights[tile] == "priority" and low:
                sign = _YIELD if heading in low else _PRIORITY
            if sign:
                signs.append(_sign(number := next(numbers), sides[entering[0]][1][-1], sign))
                rules |= dict.fromkeys(entering, f'<trafficSignRef ref="{number}"/>')
            if rights[tile] == "traffic_light":
                lights.append(_light(number := next(numbers), heading))
                rules |= dict.fromkeys(entering, f'<trafficLightRef ref="{number}"/>')
        intersections.append(f'<intersection id="{next(numbers)}">{"".join(parts)}</intersection>')

    oncoming = {
        (*movement.node.tile, (movement.exit + 2) % 4, (movement.heading + 2) % 4): index
        for index, movement in enumerate(movements, 1)
    }
    lanelets = []
    for index, (movement, (left, right)) in enumerate(zip(movements, sides, strict=True)):
        tile = movement.node.tile
        between, rule = links[tile] == 2, rules.get(index, "")
        other = oncoming[*tile, movement.heading, movement.exit]
        stop = f"{_point(left[-1])}{_point(right[-1])}<lineMarking>solid</lineMarking>{rule}"
        parts = [
            _bound("leftBound", left, "dashed" if between else "no_marking"),
            _bound("rightBound", right, "no_marking" if links[tile] > 2 else "solid"),
            *(f'<predecessor ref="{one + 1}"/>' for one in before[index]),
            *(f'<successor ref="{one + 1}"/>' for one in after[index]),
            f'<adjacentLeft ref="{other}" drivingDir="opposite"/>' if between else "",
            f"<stopLine>{stop}</stopLine>" if rule else "",
            f'<laneletType>urban</laneletType><userOneWay>vehicle</userOneWay><trafficSignRef ref="{limit}"/>{rule}',
        ]
        lanelets.append(f'<lanelet id="{index + 1}">{"".join(parts)}</lanelet>')
    reached = {0: None}  # in the order in which they are found
    waiting = deque(reached)
    while waiting:
        found = dict.fromkeys(one for one in after[waiting.popleft()] if one not in reached)
        reached |= found
        waiting += found
    start, then = np.mean(sides[0], axis=0)[:2]
    problem = _problem(next(numbers), start, then, next(reversed(reached)) + 1)
    content = "\n".join([*lanelets, *signs, *lights, *intersections, problem, "</commonRoad>\n"])
    return "\n".join(_HEAD).format(number=_number_of(content)) + "\n" + content


def _number_of(content: str) -> int:
    """Returns the number of a map in the ID of its scenario, from 1 to 2**40: different scenarios have different ones.

    Tools for CommonRoad keep results by that ID.
    """
    return 1 + int.from_bytes(sha256(content.encode()).digest()[:5])


def _bound(side: str, line: NDArray[np.complex128], marking: str) -> str:
    return f"<{side}>{''.join(map(_point, line.tolist()))}<lineMarking>{marking}</lineMarking></{side}>"


def _point(position: complex) -> str:
    return f"<point><x>{position.real:.6f}</x><y>{position.imag:.6f}</y></point>"


def _sign(number: int, position: complex, kind: str, value: str = "") -> str:
    element = f"<trafficSignElement><trafficSignID>{kind}</trafficSignID>{value}</trafficSignElement>"
    virtual = f"<virtual>{'true' if value else 'false'}</virtual>"
    return f'<trafficSign id="{number}">{element}<position>{_point(position)}</position>{virtual}</trafficSign>'


def _light(number: int, heading: int) -> str:
    """Returns a traffic light. Those for north and south are green while the others are red."""
    cycle = "".join(
        f"<cycleElement><duration>{duration}</duration><color>{color}</color></cycleElement>"
        for color, duration in (_CYCLE[2:] + _CYCLE[:2] if heading % 2 else _CYCLE)
    )
    active = "<direction>all</direction><active>true</active>"
    return f'<trafficLight id="{number}"><cycle>{cycle}</cycle>{active}</trafficLight>'


def _problem(number: int, one: complex, other: complex, goal: int) -> str:
    """Returns a planning problem: from halfway between two points to a lanelet, within an hour."""
    values = {"orientation": np.angle(other - one), "time": 0, "velocity": 0, "yawRate": 0, "slipAngle": 0}
    state = "".join(f"<{name}><exact>{value:.9g}</exact></{name}>" for name, value in values.items())
    time = "<time><intervalStart>0</intervalStart><intervalEnd>36000</intervalEnd></time>"
    return (
        f'<planningProblem id="{number}"><initialState><position>{_point((one + other) / 2)}</position>{state}'
        f'</initialState><goalState>{time}<position><lanelet ref="{goal}"/></position></goalState></planningProblem>'
    )
