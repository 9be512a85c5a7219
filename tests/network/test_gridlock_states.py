"""The theorem of the gridlock number against brute force: every state of robots on every network of a few shapes."""

from pathlib import Path

import numpy as np
import pytest
from gridlock_states import count_states
from knots import read_slots, smallest_closed_part, smallest_knot, smallest_knot_of_all_states

from elitelanes_jax.network import gridlock_number

NETWORKS = Path(__file__).parents[2] / "experiments" / "navigation" / "ued" / "networks"

STATES = {
    "5x5A": {2: 9_775, 3: 222_044, 4: 3_716_958, 5: 48_886_986, 6: 525_981_525},
    "6x6A": {2: 129_502, 3: 3_939_992, 4: 88_822_526, 5: 1_582_416_328},
    "5x5B": {2: 3_340_439, 3: 63_902_276, 4: 911_259_029},
}
"""The number of states on all networks of a space, by the number of robots."""


def read_networks(space):
    """One network of each class: those of a class are equal when rotated or mirrored."""
    height, width = map(int, space[:-1].split("x"))
    lines = (NETWORKS / f"{space}.txt").read_text().splitlines()[1:]
    return [np.array([int(code, 16) for code in line], np.int8).reshape(height, width) for line in lines]


def check_all_states(space, robots):
    """Gridlocks exist, and can be reached, if and only if there are more robots than the gridlock number."""
    total = 0
    for codes in read_networks(space):
        counts = count_states(codes, robots)
        total += counts.states
        assert (counts.gridlocks > 0) == (robots > int(gridlock_number(codes)))
        assert counts.reached == counts.gridlocks
    assert total == STATES[space][robots]


@pytest.mark.parametrize(
    ("space", "robots"), [("5x5A", 2), ("5x5A", 3), ("5x5A", 4), ("6x6A", 2), ("6x6A", 3), ("6x6A", 4)]
)
def test_all_states_of_few_robots(space, robots):
    check_all_states(space, robots)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("space", "robots"),
    [("5x5A", 5), ("5x5A", 6), ("6x6A", 5), ("5x5B", 2), ("5x5B", 3), ("5x5B", 4)],
)
def test_all_states_of_more_robots(space, robots):
    check_all_states(space, robots)


def test_lanes_with_two_slots():
    """Two loops of four tiles that share a side."""
    codes = np.array([[6, 7, 3], [12, 13, 9]], np.int8)
    number = int(gridlock_number(codes, slots=2))
    assert number == 7
    below, above = (count_states(codes, robots, slots=2) for robots in (number, number + 1))
    assert not below.gridlocks and above.gridlocks == above.reached > 0


def test_a_full_ring_is_a_gridlock_that_no_robot_can_enter():
    ring = np.array([[6, 3], [12, 9]], np.int8)
    counts = count_states(ring, int(gridlock_number(ring)) + 1)
    assert counts.gridlocks == 2 and not counts.reached


@pytest.mark.parametrize("rows", ["673 cd9", "673 aaa cd9", "6573 a6db cd59"])
def test_knots_of_small_networks_are_those_of_all_states(rows):
    codes = np.array([[int(code, 16) for code in row] for row in rows.split()], np.int8)
    turns = read_slots(codes)
    assert smallest_knot(turns) == smallest_knot_of_all_states(turns) < len(turns)


@pytest.mark.parametrize(
    ("space", "fewest", "most", "closed_parts"),
    [("5x5A", 10, 25, range(44, 47)), pytest.param("6x6A", 6, 29, range(64, 69), marks=pytest.mark.slow)],
)
def test_knots_are_smaller_than_closed_parts(space, fewest, most, closed_parts):
    slots = [read_slots(codes) for codes in read_networks(space)]
    knots = list(map(smallest_knot, slots))
    assert (min(knots), max(knots)) == (fewest, most)
    assert all(smallest_closed_part(turns) in closed_parts for turns in slots)
