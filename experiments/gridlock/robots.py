"""Robots that share a town, in the model of the gridlock number: a lane of a tile holds one robot.

A robot chooses its turn when it enters a lane, and moves only into a lane that was free before the step. If ways across
a crossing conflict, a rule says who waits. Lanes are numbered (row x columns + column) x 4 + heading.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float32, Int, Int32, Key

from elitelanes_jax.drive import LaneNode, distances, lane_nodes, movements

__all__ = [
    *("RULES", "WAIT", "Rule", "Seen", "Town", "Traffic", "is_gridlock", "line_heads", "make_town", "move", "observe"),
    "place",
]

WAIT = 3
"""The choice that is no turn: 0 right, 1 straight, 2 left."""


class Rule(NamedTuple):
    """Who goes first at a crossing.

    Attributes:
      yields: whether a way gives way to another one. A way is its heading x 3 + its turn.
      by_arrival: whether it gives way only to robots that came earlier.
    """

    yields: Bool[np.ndarray, "12 12"]
    by_arrival: bool


def _conflicts() -> Bool[np.ndarray, "12 12"]:
    """Returns which ways across a tile cross or meet."""
    heading, turn = np.divmod(np.arange(12), 3)
    # Eight points around the tile, clockwise: on each side one where ways enter, and one where they leave.
    enters, leaves = 2 * ((heading + 2) % 4), 2 * ((heading + 1 - turn) % 4) + 1
    enters_between, leaves_between = (
        (points - enters[:, None]) % 8 < (leaves - enters)[:, None] % 8 for points in (enters, leaves)
    )
    return (enters[:, None] != enters) & ((enters_between != leaves_between) | (leaves[:, None] == leaves))


def _is_from_the_right() -> Bool[np.ndarray, "12 12"]:
    """Returns which ways have another one on their right, or ahead of a left turn."""
    heading, turn = np.divmod(np.arange(12), 3)
    side = (heading - heading[:, None]) % 4
    return (side == 3) | ((side == 2) & (turn[:, None] == 2) & (turn < 2))


RULES = {
    "all-way stop": Rule(_conflicts(), by_arrival=True),
    "right before left": Rule(_conflicts() & _is_from_the_right(), by_arrival=False),
}


class Town(NamedTuple):
    """A town of N lanes. Some of them do not exist, see `exists`.

    Attributes:
      onward: the lane after each turn, N for none.
      distance: the tiles from each lane to each goal.
      exists: whether the lane is one of the town.
      at_crossing: whether the lane ends at a crossing.
      ahead: the next lane before the next crossing, N for none.
      last: the last lane before the next crossing, and of a lane that does not exist the lane itself.
      lanes: the number of lanes from each lane to the last one, with both.
    """

    onward: Int32[Array, "N 3"]
    distance: Int32[Array, "N N"]
    exists: Bool[Array, " N"]
    at_crossing: Bool[Array, " N"]
    ahead: Int32[Array, " N"]
    last: Int32[Array, " N"]
    lanes: Int32[Array, " N"]


def make_town(codes: Int[ArrayLike, "H W"]) -> Town:
    """Makes the lanes of a town without dead ends."""
    height, width = np.shape(codes)
    count = 4 * height * width
    row, column, heading = np.indices((height, width, 4)).reshape(3, -1)
    leaves = (heading[:, None] + 1 - np.arange(3)) % 4
    after = (row[:, None] + np.array([-1, 0, 1, 0])[leaves]) * width + column[:, None] + np.array([0, 1, 0, -1])[leaves]
    onward = np.where(np.asarray(movements(codes)).reshape(count, 3), 4 * after + leaves, count)
    exists = np.asarray(lane_nodes(codes))
    at_crossing = np.repeat(exists.sum(axis=2).ravel() > 2, 4)
    ahead = np.where(at_crossing, count, onward.min(axis=1))
    last, lanes = np.arange(count), np.ones(count, int)
    for _ in range(count):
        more = np.append(ahead, count)[last] < count
        last, lanes = np.where(more, ahead[last], last), lanes + more
    to_goal = jax.vmap(lambda goal: distances(codes, goal).reshape(-1))(LaneNode(row, column, heading))
    return Town(*map(jnp.asarray, (onward, to_goal.T, exists.ravel(), at_crossing, ahead, last, lanes)))


class Traffic(NamedTuple):
    """R robots in a town. All fields are int32 ``[R]``, except the time.

    Attributes:
      lane: where each robot is.
      turn: its turn at the end of this lane.
      goal: the lane that it drives to; from there on it has a new one.
      came: the time when it entered its lane.
      time: the steps since the start.
    """

    lane: Array
    turn: Array
    goal: Array
    came: Array
    time: Array


def place(key: Key[Array, ""], town: Town, robots: int) -> Traffic:
    """Places robots on random lanes, with random goals. Their first turns lead along shortest ways."""
    placing, aiming = jax.random.split(key)
    lane = _draw(placing, town, robots, replace=False)
    goal = _draw(aiming, town, robots, replace=True)
    ahead = jnp.pad(town.distance, ((0, 1), (0, 0)), constant_values=2**30)[town.onward[lane], goal[:, None]]
    zero = jnp.zeros(robots, jnp.int32)
    return Traffic(lane, jnp.argmin(ahead, axis=1), goal, zero, zero[0])


def _draw(key: Array, town: Town, count: int, *, replace: bool) -> Array:
    return jax.random.choice(key, town.exists.size, (count,), replace, town.exists / town.exists.sum())


class Seen(NamedTuple):
    """What R robots see before they choose. The lane that a robot enters next is its own one here.

    Attributes:
      here: the tiles to the goal / 8; whether the robot is at a crossing; the steps that it waits / 16; whether the own
        lane ends at a crossing; the share of robots on the lanes of its street; these lanes / 4; the robots at the tile
        at the end of the own lane / 4.
      turns: for each turn at this end: the tiles more than by a shortest way / 8; whether a robot is in the lane after
        it; the share of robots on the lanes of the street after it; these lanes / 4; the least and the largest such
        share of the streets after this one.
      closes: whether the line of robots that wait after each turn would close, because its head waits for the own lane.
      allowed: whether each choice is possible: the turns, and to wait.
    """

    here: Float32[Array, "R 7"]
    turns: Float32[Array, "R 3 6"]
    closes: Bool[Array, "R 3"]
    allowed: Bool[Array, "R 4"]


def observe(town: Town, traffic: Traffic) -> Seen:
    """Returns what robots see. A robot that cannot move has no choice but to wait."""
    none = town.exists.size
    onward = jnp.pad(town.onward, ((0, 1), (0, 0)), constant_values=none)
    at_crossing = jnp.append(town.at_crossing, False)
    distance = jnp.pad(town.distance, ((0, 1), (0, 0)))
    is_taken = jnp.zeros(none + 1, bool).at[traffic.lane].set(True)
    lanes = jnp.append(town.lanes, 1)
    # Each round doubles the lanes of a street on which robots are counted.
    robots, ahead = is_taken.astype(jnp.int32), jnp.append(town.ahead, none)
    for _ in range(none.bit_length()):
        robots, ahead = robots + robots[ahead], ahead[ahead]
    share = robots / lanes
    around = jnp.append(is_taken[:-1].reshape(-1, 4).sum(axis=1), 0)

    own = onward[traffic.lane, traffic.turn]
    left = distance[own, traffic.goal]
    after = onward[own]
    further = onward[jnp.append(town.last, none)[after]]
    shares = jnp.where(further < none, share[further], jnp.nan)
    waits = (traffic.time - traffic.came).clip(0, 16) / 16
    here = [left / 8, at_crossing[traffic.lane], waits, at_crossing[own]]
    here += [share[own], lanes[own] / 4, around[own // 4] / 4]
    extra = (distance[after, traffic.goal[:, None]] + 1 - left[:, None]).clip(0, 32) / 8
    turns = [extra, is_taken[after], share[after], lanes[after] / 4]
    turns += [jnp.nanmin(shares, axis=2), jnp.nanmax(shares, axis=2)]
    # After its own move, a robot is no longer the head of a line.
    head = line_heads(town, traffic)[after]
    onward_of = jnp.full(none + 1, none).at[traffic.lane].set(own)
    is_open = after < none
    return Seen(
        here=jnp.stack(here, axis=-1).astype(jnp.float32),
        turns=jnp.where(is_open[..., None], jnp.stack(turns, axis=-1), 0).astype(jnp.float32),
        closes=is_taken[after] & (head != traffic.lane[:, None]) & (onward_of[head] == own[:, None]),
        allowed=jnp.append(
            is_open & ~is_taken[own][:, None], (is_taken[own] | at_crossing[traffic.lane])[:, None], axis=1
        ),
    )


def line_heads(town: Town, traffic: Traffic) -> Int32[Array, " N+1"]:
    """Returns the lane at the head of the line of waiting robots from each lane on. A lane without a robot is its own.

    The robot at the head of a line can move. A line without a head, a gridlock, has any of its lanes.
    """
    none = town.exists.size
    onward = town.onward[traffic.lane, traffic.turn]
    is_taken = jnp.zeros(none + 1, bool).at[traffic.lane].set(True)
    head = jnp.arange(none + 1).at[traffic.lane].set(jnp.where(is_taken[onward], onward, traffic.lane))
    for _ in range(traffic.lane.size.bit_length()):
        head = head[head]
    return head


def is_gridlock(town: Town, traffic: Traffic) -> Bool[Array, " R"]:
    """Returns which robots can never move again, because their line has no head."""
    onward = town.onward[traffic.lane, traffic.turn]
    waits_for = jnp.full(town.exists.size + 1, -1).at[traffic.lane].set(onward)
    head = line_heads(town, traffic)[traffic.lane]
    return waits_for[waits_for[head]] >= 0


def move(
    key: Key[Array, ""], town: Town, traffic: Traffic, choice: Int32[Array, " R"], rule: Rule
) -> tuple[Traffic, Bool[Array, " R"]]:
    """Moves the robots by one step; the key is consumed.

    A choice is `WAIT`, or the turn at the end of the next lane, for a robot that can move. Returns also which robots
    reached their goal.
    """
    robots = choice.size
    wants = choice != WAIT
    robot_at = jnp.full(town.exists.size, robots).at[traffic.lane].set(jnp.arange(robots)).reshape(-1, 4)
    way = traffic.lane % 4 * 3 + traffic.turn
    # No two robots at a tile have the same rank, because each came by another lane.
    rank = traffic.came * 4 + traffic.lane % 4
    others = robot_at[traffic.lane // 4]
    other_wants = jnp.append(wants, False)[others]
    other_rank = jnp.append(rank, 0)[others]
    came_before = other_wants & (other_rank < rank[:, None])
    has_way = other_wants & jnp.asarray(rule.yields)[way[:, None], jnp.append(way, 0)[others]]
    goes = wants & ~(has_way & came_before if rule.by_arrival else has_way).any(axis=1)
    # If all robots at a tile give way to each other, the first one goes.
    nobody = ~jnp.append(goes, False)[others].any(axis=1)
    goes |= wants & nobody & ~came_before.any(axis=1)

    lane = jnp.where(goes, town.onward[traffic.lane, traffic.turn], traffic.lane)
    reached = goes & (lane == traffic.goal)
    goal = jnp.where(reached, _draw(key, town, robots, replace=True), traffic.goal)
    time = traffic.time + 1
    return Traffic(
        lane=lane,
        turn=jnp.where(goes, choice, traffic.turn),
        goal=goal,
        came=jnp.where(goes, time, traffic.came),
        time=time,
    ), reached
