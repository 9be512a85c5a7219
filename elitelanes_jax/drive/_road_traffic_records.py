"""The records of RoadTraffic: its options, and the state, observations and metrics of an episode."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float32, Int32

from elitelanes_jax._util.checks import flag, real, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import REQUIRED, option, static, traced
from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive._environment import EnvironmentParams
from elitelanes_jax.drive._traffic_levels import TrafficLevels, check_traffic_levels
from elitelanes_jax.drive._traffic_rules import TrafficRule, check_rule
from elitelanes_jax.network.pytrees import pytree

WAIT = 3
"""The action of a robot that waits. The others are turns: 0 right, 1 straight, 2 left."""


@pytree
@dataclass(frozen=True)
class RoadTrafficParams(EnvironmentParams):
    """Options of `RoadTraffic`. A pytree: numbers may be arrays, mapped by `jax.vmap`.

    Attributes:
      levels: the towns, from which `reset` draws; `make_traffic_levels` makes them.
      robots: R, the number of robots; static. Each town needs as many slots.
      slots: the robots that find room one behind another in the lane of a tile, 1 to 1000; static.
      rule: who goes first on a tile, a `TrafficRule` or a name of `traffic_rule`.
      strict: whether a robot also gives way to a robot that cannot move; static. Then robots may
        wait for each other in more ways than in a circle of full lanes.
      limit: steps after which an episode is truncated.
      ends_in_gridlock: whether robots in gridlock terminate the episode; static.
      progress_reward: the reward for each tile that a robot comes nearer to its goal. A tile
        further away costs as much.
      goal_reward: the additional reward for reaching a goal.
      gridlock_cost: the cost for each robot that comes into gridlock, once. A gridlock that exists
        after a reset costs nothing.
    """

    levels: TrafficLevels = option(REQUIRED, check_traffic_levels)
    robots: int = static(16, whole(1))
    slots: int = static(1, whole(1, 1000))
    rule: TrafficRule = option("allway_stop", check_rule)
    strict: bool = static(False, flag)
    limit: Numeric = traced(320, whole(1))
    ends_in_gridlock: bool = static(True, flag)
    progress_reward: Numeric = traced(0.1, real(-1e6, 1e6))
    goal_reward: Numeric = traced(0.0, real(-1e6, 1e6))
    gridlock_cost: Numeric = traced(10.0, real(-1e6, 1e6))

    def check_together(self) -> None:
        """Checks that all robots find room in every town."""
        if isinstance(self.levels.lanes, jax.core.Tracer):
            return
        lanes = np.asarray(self.levels.lanes)
        room = int(lanes.min()) * self.slots
        if self.robots > room:
            raise InputError(
                "robots",
                f"at most {room}, the slots of levels[{lanes.argmin()}]",
                str(self.robots),
            )


class RoadTrafficState(NamedTuple):
    """The state of an episode with R robots. Lanes are numbers of `TrafficLevels`.

    A state belongs to the levels and the slots with which it was reset.

    Attributes:
      level: the index of the town in ``params.levels``.
      lane: the lane of each robot.
      slot: its slot there, from 0; the last slot is at the line, where the lane ends.
      turn: its turn at the end of the lane.
      goal: the lane that it drives to.
      arrived: the steps of the episode when it came to the line of its lane. It has no meaning
        before.
      goals: the goals that it has reached.
      tiles: the lanes that it has entered.
      gridlocked: whether it is in gridlock, and can never move again.
      steps: the number of steps so far.
    """

    level: Int32[Array, ""]
    lane: Int32[Array, " R"]
    slot: Int32[Array, " R"]
    turn: Int32[Array, " R"]
    goal: Int32[Array, " R"]
    arrived: Int32[Array, " R"]
    goals: Int32[Array, " R"]
    tiles: Int32[Array, " R"]
    gridlocked: Bool[Array, " R"]
    steps: Int32[Array, ""]


class RoadTrafficObservation(NamedTuple):
    """The observations of R robots.

    The next lane is the one that a robot enters at the end of its own. An action is the turn at the
    end of the next lane, and the fields with a 3 are by this turn. They are 0 where it is not open.
    A street from a lane on has this lane and all lanes before the next crossing, see
    `TrafficLevels`. The load of a street is the share of its slots that are taken.

    Attributes:
      allowed: which actions make sense: the turns that are open, if the next slot is free; to wait,
        if it is taken or a crossing is ahead. A flattened observation begins with these four.
      goal_distance: the tiles from the next lane to the goal.
      at_crossing: whether the robot's own lane ends at a crossing.
      next_at_crossing: whether the next lane ends at a crossing.
      waited: the steps since the robot came to the line of its lane.
      next_load: the load of the street from the next lane on.
      next_slots: the slots of this street.
      next_robots: the robots in all lanes of the next tile.
      detour: the tiles by each turn, beyond a shortest way.
      taken: whether the first slot after each turn is taken.
      load: the load of the street after each turn.
      slots: the slots of this street.
      least_load: the least load of the streets after this one.
      most_load: the largest load of the streets after this one.
      closes: whether the robot would close a circle of waiting robots with this turn, if no other
        robot moved. Robots that give way to each other do not count.
    """

    allowed: Bool[Array, "R 4"]
    goal_distance: Float32[Array, " R"]
    at_crossing: Bool[Array, " R"]
    next_at_crossing: Bool[Array, " R"]
    waited: Float32[Array, " R"]
    next_load: Float32[Array, " R"]
    next_slots: Float32[Array, " R"]
    next_robots: Float32[Array, " R"]
    detour: Float32[Array, "R 3"]
    taken: Bool[Array, "R 3"]
    load: Float32[Array, "R 3"]
    slots: Float32[Array, "R 3"]
    least_load: Float32[Array, "R 3"]
    most_load: Float32[Array, "R 3"]
    closes: Bool[Array, "R 3"]


class RoadTrafficInfo(NamedTuple):
    """Metrics of R robots after a step.

    Attributes:
      reached: bool, the robot has reached its goal in this step.
      goals: int32, the goals that it has reached so far.
      tiles: int32, the lanes that it has entered so far.
      gridlocked: bool, it can never move again.
    """

    reached: Bool[Array, " R"]
    goals: Int32[Array, " R"]
    tiles: Int32[Array, " R"]
    gridlocked: Bool[Array, " R"]
