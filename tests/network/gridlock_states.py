"""All states of robots on a network, visited one by one: which are in gridlock, and which of these can be reached."""

from typing import NamedTuple

import numba
import numpy as np

from elitelanes_jax.lanes.movements import lane_graph


class Counts(NamedTuple):
    """The states of a number of robots; those in gridlock; of these, those that follow a state without gridlock."""

    states: int
    gridlocks: int
    reached: int


def count_states(codes, robots, slots=1):
    """Visits all states: each robot has a slot of a lane of its own, and in the last slot has chosen a movement."""
    graph = lane_graph(codes)
    lanes = len(graph.nodes.row)
    # Within a lane, a robot moves on from slot to slot.
    steps = [(slot, slot + 1) for slot in range(lanes * slots) if slot % slots < slots - 1]
    steps += [(start * slots + slots - 1, end * slots) for start, end in graph.edges.tolist()]
    slot, onward = np.array(sorted(steps)).T.copy()
    bounds = np.arange(lanes * slots + 1)
    arrivals = np.argsort(onward, kind="stable")
    first, first_arrival = np.searchsorted(slot, bounds), np.searchsorted(onward[arrivals], bounds)
    return Counts(*visit(slot, onward, first, arrivals, first_arrival, robots))


@numba.njit
def visit(slot, onward, first, arrivals, first_arrival, robots):
    """Visits all states of robots.

    A movement leads from `slot` to `onward`. Those of slot i are first[i] to first[i + 1] - 1, in the order of slots;
    those that lead into it are in `arrivals` in the same way.
    """
    robot_in = np.full(len(first), -1)
    chosen = np.full(robots, -1)
    states = gridlocks = reached = 0
    robot = 0
    while robot >= 0:
        if chosen[robot] < 0:
            # It starts in the slot after that of the robot before.
            chosen[robot] = first[slot[chosen[robot - 1]] + 1] if robot else 0
        else:
            robot_in[slot[chosen[robot]]] = -1
            chosen[robot] += 1
        if chosen[robot] == len(slot):
            chosen[robot] = -1
            robot -= 1
            continue
        robot_in[slot[chosen[robot]]] = robot
        if robot + 1 < robots:
            robot += 1
            continue
        states += 1
        if is_gridlock(chosen, robot_in, onward):
            gridlocks += 1
            reached += follows_another_state(chosen, robot_in, slot, onward, arrivals, first_arrival)
    return states, gridlocks, reached


@numba.njit
def is_gridlock(chosen, robot_in, onward):
    """Whether some robots wait for each other in a circle: the line of one that waits for it never ends."""
    for robot in range(len(chosen)):
        ahead = robot
        for _ in range(len(chosen)):
            ahead = robot_in[onward[chosen[ahead]]]
            if ahead < 0:
                break
        if ahead >= 0:
            return True
    return False


@numba.njit
def follows_another_state(chosen, robot_in, slot, onward, arrivals, first_arrival):
    """Whether one robot's last movement leads here from a state that is no gridlock."""
    for robot in range(len(chosen)):
        movement = chosen[robot]
        here = slot[movement]
        for index in range(first_arrival[here], first_arrival[here + 1]):
            arrival = arrivals[index]
            before = slot[arrival]
            if robot_in[before] >= 0:
                continue
            robot_in[here], robot_in[before], chosen[robot] = -1, robot, arrival
            was_gridlock = is_gridlock(chosen, robot_in, onward)
            robot_in[before], robot_in[here], chosen[robot] = -1, robot, movement
            if not was_gridlock:
                return True
    return False
