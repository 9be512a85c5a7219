"""Road networks as CommonRoad scenarios, version 2020a, without cars.

A scenario has a lanelet for each movement across a tile.
"""

from hashlib import sha256
from itertools import count
from typing import NamedTuple

import numpy as np

from elitelanes_jax.formats._scene import Approach, Lanelet, Line, Scene, make_scene
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.movements import BACK

_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" benchmarkID="ZAM_Tiles-{number}_1_T-1" \
date="1970-01-01" author="elitelanes" affiliation="" source="elitelanes">
<location><geoNameId>-999</geoNameId><gpsLatitude>{latitude:.12g}</gpsLatitude><gpsLongitude>{longitude:.12g}</gpsLongitude></location>
<scenarioTags><urban/></scenarioTags>
"""

# The numbers of signs in the German road traffic regulations: the speed limit, and what the drivers
# of an approach find.
_SPEED = "274"
_SIGNS = {"stop": "206", "right_before_left": "102", "yield": "205", "go_first": "306"}

# The phases of a traffic light: the colour, and its length in time steps of 0.1 s.
_CYCLE = (("green", 200), ("yellow", 30), ("red", 200), ("redYellow", 30))
# This cycle is half a cycle ahead, so one axis is green while the other is red.
_CYCLE_FROM_RED = _CYCLE[2:] + _CYCLE[:2]

# The ends of the left bound at a dead end are moved by this towards the right bound, in metres. The
# designer of CommonRoad takes bounds for the same up to 1e-6 m.
_APART = 2.5e-7

# The elements for the successors of an incoming road, by turn.
_SUCCESSORS = ("successorsRight", "successorsStraight", "successorsLeft")


class _Sides(NamedTuple):
    """The left and the right bound of a lanelet."""

    left: Line
    right: Line


def to_commonroad(road_map: RoadMap, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of a CommonRoad scenario, ``.xml``.

    Args:
      road_map: the map. Connections that no neighbour returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.

    Returns:
      A text; the same map gives the same text. x is east and y north of the grid's south-west
      corner, in metres. Lanelets are numbered from 1 in ascending order of row, column, heading and
      turn. The format demands a planning problem: from lanelet 1 to a lanelet that is farthest from
      there.

    Raises:
      InputError: for a map without any road, or bad measures.
    """
    scene = make_scene(road_map, streets)
    lanelets = scene.lanelets
    sides = _list_sides(scene)
    number = count(len(lanelets) + 1).__next__
    # One virtual sign has the speed limit of all lanelets.
    limit = number()
    speed = f"<additionalValue>{streets.speed:.9g}</additionalValue>"
    signs = [_sign(limit, _SPEED, sides[0].right[0], speed)]
    lights: list[str] = []
    intersections: list[str] = []
    # The reference to the sign or the light at the end of a lanelet, by the lanelet's index.
    rules: dict[int, str] = {}
    for approaches in scene.crossings.values():
        # All numbers are needed first, because the ways into a crossing refer to each other.
        incoming = {approach.node.heading: number() for approach in approaches}
        parts = ""
        for approach in approaches:
            # All turns from a side continue the same lanelets, which end at the crossing.
            entering = lanelets[approach.lanelets[0]].predecessors
            parts += _incoming(approach, scene, incoming)
            if approach.control == "light":
                rule = number()
                lights.append(_light(rule, approach.node.heading))
                rules |= dict.fromkeys(entering, f'<trafficLightRef ref="{rule}"/>')
            elif approach.control:
                rule = number()
                end_of_lane = sides[entering[0]].right[-1]
                signs.append(_sign(rule, _SIGNS[approach.control], end_of_lane))
                rules |= dict.fromkeys(entering, f'<trafficSignRef ref="{rule}"/>')
        intersections.append(f'<intersection id="{number()}">{parts}</intersection>')
    # A lanelet names its sign or light, so lanelets are written when all crossings are known.
    elements = []
    ways = {
        (*lanelet.movement.node, lanelet.movement.exit): index
        for index, lanelet in enumerate(lanelets)
    }
    for index, lanelet in enumerate(lanelets):
        # The oncoming lanelet enters where this one leaves, and leaves where this one enters. It
        # has the same left bound. A dead end has none.
        row, column, heading, turn = lanelet.movement
        oncoming = None
        if turn != BACK:
            oncoming = ways[row, column, (lanelet.movement.exit + 2) % 4, (heading + 2) % 4]
        reference = rules.get(index, "")
        elements.append(_lanelet(index, lanelet, oncoming, sides[index], reference, limit))
    elements += signs + lights + intersections
    elements += [_problem(number(), sides[0], _farthest(lanelets)), "</commonRoad>\n"]
    # The number of the scenario depends on its content, so the head comes last.
    content = "\n".join(elements)
    latitude, longitude = streets.origin
    benchmark = _number_of(content)
    return _HEAD.format(number=benchmark, latitude=latitude, longitude=longitude) + content


def _list_sides(scene: Scene) -> list[_Sides]:
    """Lists the bounds of all lanelets."""
    sides = [_Sides(*scene.bounds(lanelet)) for lanelet in scene.lanelets]
    for index, lanelet in enumerate(scene.lanelets):
        if lanelet.arms == 1:
            # Both ends of a dead end's left bound are the middle of the tile's side. They are moved
            # apart, because the outline of a lanelet must not touch itself. The lanelets before and
            # after it move with them.
            left, right = scene.bounds(lanelet)
            left[[0, -1]] += _APART * ((right - left) / abs(right - left))[[0, -1]]
            sides[index].left[:] = left
            for before in lanelet.predecessors:
                sides[before].left[-1] = left[0]
            for after in lanelet.successors:
                sides[after].left[0] = left[-1]
    return sides


def _sign(number: int, kind: str, position: complex, value: str = "") -> str:
    """Returns the element of a sign. A sign with a value is virtual."""
    return (
        f'<trafficSign id="{number}"><trafficSignElement><trafficSignID>{kind}</trafficSignID>'
        f"{value}</trafficSignElement><position>{_point(position)}</position>"
        f"<virtual>{'true' if value else 'false'}</virtual></trafficSign>"
    )


def _light(number: int, heading: int) -> str:
    """Returns the element of a traffic light.

    North and south are green while the others are red.
    """
    phases = ""
    for color, duration in _CYCLE_FROM_RED if heading % 2 else _CYCLE:
        phases += (
            f"<cycleElement><duration>{duration}</duration><color>{color}</color></cycleElement>"
        )
    return (
        f'<trafficLight id="{number}"><cycle>{phases}</cycle>'
        "<direction>all</direction><active>true</active></trafficLight>"
    )


def _incoming(approach: Approach, scene: Scene, incoming: dict[int, int]) -> str:
    """Returns one way into an intersection, from which the lanelets of all turns lead.

    `incoming` are the numbers of the ways by their headings.
    """
    heading = approach.node.heading
    entering = scene.lanelets[approach.lanelets[0]].predecessors
    parts = _references("incomingLanelet", entering)
    for index in approach.lanelets:
        parts += _references(_SUCCESSORS[scene.lanelets[index].movement.turn], [index])
    # Who comes from the right has a heading that is a quarter turn to the left.
    from_right = (heading + 3) % 4
    if from_right in incoming:
        parts += f'<isLeftOf ref="{incoming[from_right]}"/>'
    return f'<incoming id="{incoming[heading]}">{parts}</incoming>'


def _references(name: str, lanelets: list[int]) -> str:
    """Returns references to lanelets. The number of a lanelet is its index and 1."""
    return "".join(f'<{name} ref="{index + 1}"/>' for index in lanelets)


def _lanelet(
    index: int, lanelet: Lanelet, oncoming: int | None, sides: _Sides, rule: str, limit: int
) -> str:
    """Returns the element of a lanelet.

    `oncoming` is the index of the lanelet in the other direction, and `limit` the number of the
    sign with the speed limit.
    """
    parts = _bound("leftBound", sides.left, "dashed" if lanelet.arms == 2 else "no_marking")
    parts += _bound("rightBound", sides.right, "no_marking" if lanelet.arms > 2 else "solid")
    parts += _references("predecessor", lanelet.predecessors)
    parts += _references("successor", lanelet.successors)
    if oncoming is not None:
        parts += f'<adjacentLeft ref="{oncoming + 1}" drivingDir="opposite"/>'
    if rule:
        ends = _point(sides.left[-1]) + _point(sides.right[-1])
        parts += f"<stopLine>{ends}<lineMarking>solid</lineMarking>{rule}</stopLine>"
    return (
        f'<lanelet id="{index + 1}">{parts}'
        "<laneletType>urban</laneletType><userOneWay>vehicle</userOneWay>"
        f'<trafficSignRef ref="{limit}"/>{rule}</lanelet>'
    )


def _farthest(lanelets: list[Lanelet]) -> int:
    """Returns the index of a lanelet that is farthest from the first one.

    A breadth-first search reaches it last.
    """
    reached = {0}
    queue = [0]
    for index in queue:
        # The queue grows during the loop, until it has all lanelets that can be reached.
        new = [other for other in lanelets[index].successors if other not in reached]
        reached.update(new)
        queue += new
    return queue[-1]


def _number_of(content: str) -> int:
    """Returns the number of a map in the ID of its scenario, from 1 to 2**40.

    Tools for CommonRoad keep results by that ID, so different scenarios need different numbers. Of
    10,000 scenarios, two have the same number with a probability of 0.005 %.
    """
    return 1 + int.from_bytes(sha256(content.encode()).digest()[:5])


def _bound(side: str, line: Line, marking: str) -> str:
    points = "".join(map(_point, line.tolist()))
    return f"<{side}>{points}<lineMarking>{marking}</lineMarking></{side}>"


def _point(position: complex) -> str:
    return f"<point><x>{position.real:.7f}</x><y>{position.imag:.7f}</y></point>"


def _problem(number: int, start: _Sides, goal: int) -> str:
    """Returns a planning problem to the lanelet with an index.

    It starts at the first chord of another one, and the goal has to be reached within an hour.
    """
    first, second = np.mean(start, axis=0)[:2]
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
    goal_position = f"<position>{_references('lanelet', [goal])}</position>"
    return (
        f'<planningProblem id="{number}"><initialState>{position}{state}</initialState>'
        f"<goalState>{time}{goal_position}</goalState></planningProblem>"
    )
