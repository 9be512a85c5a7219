"""Robots that share a town, as the rules read: plain Python on nodes (row, column, heading), and NetworkX.

A robot is a dictionary of its lane, slot, turn, goal and the step when it came to its line ("arrived").
"""

import networkx as nx
from driving_oracle import lane_graph, turned

PHASES = ((0, 2), (), (1, 3), ())  # the headings that have green
PHASE_STEPS = 4


def town_graph(grid):
    """The graph of the lanes to which robots can come back."""
    graph = lane_graph(grid)
    for part in list(nx.strongly_connected_components(graph)):
        # A lane is on no circle if it is alone.
        if len(part) == 1:
            graph.remove_nodes_from(part)
    return graph


def ways_cross(way, other):
    """By their lines across the tile: robots keep right of the middle of each side."""
    points = {"in": ((0.75, 1), (0, 0.75), (0.25, 0), (1, 0.25)), "out": ((0.75, 0), (1, 0.75), (0.25, 1), (0, 0.25))}
    (a, b), (c, d) = ((points["in"][heading], points["out"][turned(heading, turn)]) for heading, turn in (way, other))

    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return a != c and (b == d or (side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0))


def yields(rule, way, other):
    """Whether one way gives way to another one."""
    if not ways_cross(way, other):
        return False
    if rule == "allway_stop":
        return True
    heading_between = (other[0] - way[0]) % 4
    return heading_between == 3 or (heading_between == 2 and way[1] == 2 and other[1] != 2)


def rank(robot):
    return robot["arrived"], robot["lane"][2]


class Traffic:
    """Robots in a town."""

    def __init__(self, graph, robots, rule, strict, slots):
        self.graph, self.robots, self.rule, self.strict, self.slots = graph, robots, rule, strict, slots

    def after(self, lane, turn):
        return next((end for _, end, way in self.graph.out_edges(lane, data="turn") if way == turn), None)

    def is_crossing(self, lane):
        return sum((*lane[:2], heading) in self.graph for heading in range(4)) > 2

    def at_line(self, robot):
        return robot["slot"] == self.slots - 1

    def next_cell(self, robot):
        if self.at_line(robot):
            return self.after(robot["lane"], robot["turn"]), 0
        return robot["lane"], robot["slot"] + 1

    def occupants(self):
        return {(robot["lane"], robot["slot"]): number for number, robot in enumerate(self.robots)}

    def beside(self, number):
        """The other robots at lines of the robot's tile."""
        tile = self.robots[number]["lane"][:2]
        return [
            other
            for other, robot in enumerate(self.robots)
            if other != number and robot["lane"][:2] == tile and self.at_line(robot)
        ]

    def gives_way(self, number, other):
        one, two = self.robots[number], self.robots[other]
        if not yields(self.rule, (one["lane"][2], one["turn"]), (two["lane"][2], two["turn"])):
            return False
        return self.rule != "allway_stop" or rank(two) < rank(one)

    def moving(self, waits, time):
        """The robots that move: `waits` do not want to."""
        taken = self.occupants()
        ready = {
            number
            for number, robot in enumerate(self.robots)
            if number not in waits and self.next_cell(robot) not in taken
        }
        goes, asking = set(), set()
        for number in ready:
            robot = self.robots[number]
            if not self.at_line(robot):
                goes.add(number)
                continue
            green = robot["lane"][2] in PHASES[time // PHASE_STEPS % 4]
            if self.rule != "traffic_light" or green or not self.is_crossing(robot["lane"]):
                asking.add(number)
        for number in asking:
            others = self.beside(number)
            if not self.strict:
                others = [other for other in others if other in asking]
            elif not self.is_crossing(self.robots[number]["lane"]):
                others = []
            if not any(self.gives_way(number, other) for other in others):
                goes.add(number)
        if not self.strict:
            for number in asking:
                tile = [number, *(other for other in self.beside(number) if other in asking)]
                if not goes.intersection(tile):
                    goes.add(min(tile, key=lambda other: rank(self.robots[other])))
        return goes

    def stuck(self):
        """Robots that can never move: slots get free from the heads of lines on."""
        taken = self.occupants()
        blockers = {}
        for number, robot in enumerate(self.robots):
            blockers[number] = {taken[cell] for cell in [self.next_cell(robot)] if cell in taken}
            if self.strict and self.at_line(robot) and self.is_crossing(robot["lane"]):
                blockers[number].update(other for other in self.beside(number) if self.gives_way(number, other))
        free = set()
        while more := [number for number in blockers if number not in free and blockers[number] <= free]:
            free.update(more)
        return set(blockers) - free

    def move(self, actions, time):
        """Moves robots by one step. Returns those that moved, and those that reached their goal."""
        goes = self.moving({number for number, action in enumerate(actions) if action == 3}, time)
        reached = set()
        for number in goes:
            robot = self.robots[number]
            enters = self.at_line(robot)
            robot["lane"], robot["slot"] = self.next_cell(robot)
            if enters:
                opens = [turn % 3 for turn in range(actions[number], actions[number] + 3)]
                robot["turn"] = next(turn for turn in opens if self.after(robot["lane"], turn))
                if robot["lane"] == robot["goal"]:
                    reached.add(number)
            if self.at_line(robot):
                robot["arrived"] = time + 1
        return goes, reached

    def street(self, lane):
        """The lanes from this one to the next crossing, or all lanes of a loop without a crossing."""
        lanes = [lane]
        while not self.is_crossing(lanes[-1]):
            (onward,) = self.graph[lanes[-1]]
            if onward == lane:
                break
            lanes.append(onward)
        return lanes

    def load(self, lane):
        lanes = self.street(lane)
        return sum(robot["lane"] in lanes for robot in self.robots) / len(lanes) / self.slots

    def seen_by(self, number, time, lengths):
        """What a robot observes, without `closes`. The tiles from lane to lane are `lengths`."""
        robot, taken = self.robots[number], self.occupants()
        lane = robot["lane"]
        onward = self.after(lane, robot["turn"])
        blocked = self.next_cell(robot) in taken
        distance = lengths[onward][robot["goal"]]
        seen = {
            "goal_distance": distance,
            "at_crossing": self.is_crossing(lane),
            "next_at_crossing": self.is_crossing(onward),
            "waited": (time - robot["arrived"]) * self.at_line(robot),
            "next_load": self.load(onward),
            "next_slots": len(self.street(onward)) * self.slots,
            "next_robots": sum(other["lane"][:2] == onward[:2] for other in self.robots),
            "allowed": [False, False, False, blocked or (self.at_line(robot) and self.is_crossing(lane))],
        }
        by_turn = ("detour", "taken", "load", "slots", "least_load", "most_load")
        seen |= {name: [0, 0, 0] for name in by_turn}
        for turn in range(3):
            after = self.after(onward, turn)
            if after is None:
                continue
            street = self.street(after)
            following = [self.load(lane) for lane in self.graph[street[-1]]]
            values = (
                lengths[after][robot["goal"]] + 1 - distance,
                (after, 0) in taken,
                self.load(after),
                len(street) * self.slots,
                min(following),
                max(following),
            )
            for name, value in zip(by_turn, values, strict=True):
                seen[name][turn] = value
            seen["allowed"][turn] = not blocked
        return seen
