"""RoadTraffic: robots that share a town, from lane to lane, until they reach goals or block each other.

The model is that of `gridlock_number`: the lane of a tile has slots, a robot chooses its turn when
it enters a lane, and it moves only into a slot that was free before the step.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float32, Int, Int32, Key

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import clip_to_int32, flag, instance, real, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import REQUIRED, Record, option, static, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive._environment import Environment, Transition, checks_first, draw_level
from elitelanes_jax.drive._traffic_levels import TrafficLevels, check_traffic_levels
from elitelanes_jax.drive._traffic_rules import TrafficRule, check_rule, way_number
from elitelanes_jax.network.bits import randint, random_bits, split
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import vary_together

WAIT = 3
"""The action of a robot that waits. The others are turns: 0 right, 1 straight, 2 left."""


@pytree
@dataclass(frozen=True)
class RoadTrafficParams(Record):
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
      gridlock_cost: the cost for each robot that comes into gridlock, once.
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

    @property
    def max_steps_in_episode(self) -> Numeric:
        """The limit, by the name in Gymnax."""
        return self.limit


class RoadTrafficState(NamedTuple):
    """The state of an episode with R robots. Lanes are numbers of `TrafficLevels`.

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
      gridlocked: whether it can never move again.
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
    Streets are those of `TrafficLevels`, from the lane in question on. The load of a street is the
    share of its slots that are taken.

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
        robot moved.
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


class _Town:
    """The tables of one town: each is read at a lane or several, and then at a turn or the like."""

    def __init__(self, params: RoadTrafficParams, level: Array) -> None:
        self._levels, self._level = params.levels, level
        self.none = self._levels.onward.shape[1] - 1
        self.slots = params.slots

    def read(self, table: Array, *index: Array) -> Array:
        return jnp.asarray(table)[self._level, *index]

    def onward(self, lane: Array, turn: Array) -> Array:
        return self.read(self._levels.onward, lane, turn)

    def all_onward(self, lane: Array) -> Array:
        """Returns the lanes after each turn, ``[..., 3]``."""
        return self.read(self._levels.onward, lane)

    def turn_taken(self, lane: Array, turn: Array) -> Array:
        return self.read(self._levels.turn_taken, lane, turn)

    def beside(self, lane: Array) -> Array:
        """Returns the lanes of the same tile by heading, ``[..., 4]``."""
        return self.read(self._levels.beside, lane)

    def heading(self, lane: Array) -> Array:
        return self.read(self._levels.node.heading, lane)

    def at_crossing(self, lane: Array) -> Array:
        return self.read(self._levels.at_crossing, lane)

    def street(self, lane: Array) -> tuple[Array, Array]:
        """Returns the first lane of the street from this lane on, and the lane after the last."""
        ends = self.read(self._levels.street, lane)
        return ends[..., 0], ends[..., 1]

    def part(self, lane: Array) -> tuple[Array, Array]:
        ends = self.read(self._levels.part, lane)
        return ends[..., 0], ends[..., 1]

    def distance(self, goal: Array, lane: Array) -> Array:
        return self.read(self._levels.distance, goal, lane).astype(jnp.int32)

    def lanes(self) -> Array:
        return jnp.asarray(self._levels.lanes)[self._level]

    def robot_at(self, state: RoadTrafficState) -> Int32[Array, " L*slots"]:
        """Returns the robot in each slot; R for none."""
        robots = state.lane.size
        empty = jnp.full((self.none + 1) * self.slots, robots, jnp.int32)
        slot = state.lane * self.slots + state.slot
        return empty.at[slot].set(jnp.arange(robots, dtype=jnp.int32))

    def at_line(self, state: RoadTrafficState) -> Bool[Array, " R"]:
        return state.slot == self.slots - 1

    def next_slot(self, state: RoadTrafficState) -> Int32[Array, " R"]:
        """Returns the slot that each robot moves to, as `robot_at` numbers slots."""
        onward = self.onward(state.lane, state.turn) * self.slots
        return jnp.where(self.at_line(state), onward, state.lane * self.slots + state.slot + 1)


@name_wrong_arguments
@runs_jax
@checks_first(level=clip_to_int32, params=instance(RoadTrafficParams))
@jax.jit
@divide_batches
def _reset_to_level(
    key: Key[Array, ""], level: Int[ArrayLike, ""], params: RoadTrafficParams
) -> tuple[RoadTrafficObservation, RoadTrafficState]:
    """Puts robots on random slots of a town, with random goals. The key is consumed.

    The first turns are those of shortest ways. Robots may be in gridlock from the start; the first
    step says so.

    Args:
      key: consumed.
      level: the index of the town in ``params.levels``, which is limited to their number.
      params: the options of the environment.
    """
    level = _check_index("level", level, len(params.levels.grid))
    town = _Town(params, level)
    placing, aiming = split(key)
    bits = random_bits(placing, (town.none * params.slots,))
    # Slots that do not exist come last. The lowest bit makes room for them.
    exists = jnp.arange(bits.size) < town.lanes() * params.slots
    order = jnp.argsort(jnp.where(exists, bits >> 1, np.uint32(2**31)))
    chosen = order[: params.robots].astype(jnp.int32)
    lane, slot = jnp.divmod(chosen, params.slots)
    goal = _draw_goals(aiming, town, lane)
    zero = jnp.zeros_like(lane)
    state = RoadTrafficState(
        level=level,
        lane=lane,
        slot=slot,
        turn=jnp.argmin(town.distance(goal[:, None], town.all_onward(lane)), axis=1).astype(
            jnp.int32
        ),
        goal=goal,
        arrived=zero,
        goals=zero,
        tiles=zero,
        gridlocked=jnp.zeros_like(lane, bool),
        steps=zero[0],
    )
    state = state._replace(gridlocked=_find_gridlocked(town, state, params))
    return _observe(state, params), state


def _check_index(name: str, index: Int[ArrayLike, ""], count: int) -> Array:
    """Returns the index of a level as int32, limited to their number."""
    array = jnp.asarray(index)
    if array.shape != () or not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError(
            name, "the index of a level, a whole number", f"{array.dtype} {list(array.shape)}"
        )
    return jnp.clip(array, 0, count - 1).astype(jnp.int32)


def _draw_goals(key: Array, town: _Town, lane: Array) -> Int32[Array, " R"]:
    """Draws a goal for each robot, uniformly among the other lanes of its part."""
    first, stop = town.part(lane)
    goal = first + randint(random_bits(key, lane.shape), stop - first - 1)
    # The own lane is left out.
    return goal + (goal >= lane).astype(jnp.int32)


@name_wrong_arguments
@runs_jax
@checks_first(params=instance(RoadTrafficParams))
@jax.jit
@divide_batches
def _reset(
    key: Key[Array, ""], params: RoadTrafficParams
) -> tuple[RoadTrafficObservation, RoadTrafficState]:
    """Puts robots on random slots of a town drawn uniformly from ``params.levels``.

    The key is consumed.
    """
    drawing, placing = split(key)
    return _reset_to_level(placing, draw_level(drawing, params.levels), params)


@name_wrong_arguments
@runs_jax
@checks_first(
    state=instance(RoadTrafficState), action=clip_to_int32, params=instance(RoadTrafficParams)
)
@jax.jit
@divide_batches
def _step(
    key: Key[Array, ""],
    state: RoadTrafficState,
    action: Int[ArrayLike, " R"],
    params: RoadTrafficParams,
) -> Transition:
    """Moves all robots at once.

    A robot moves to the next slot of its way if this slot was free before the step, it does not
    wait, and at a line the rule lets it go. A robot that reaches its goal gets another one. The
    episode terminates if robots are in gridlock: they wait for each other for ever.

    Args:
      key: draws the new goals; consumed.
      state: the state before.
      action: 3 to wait. Otherwise the turn at the end of the lane that the robot enters in this
        step: 0 right, 1 straight, 2 left; other numbers are clipped. If that turn is not open, the
        next open turn is taken, in the order right, straight, left, right. Within a lane, a turn
        only says that the robot moves on.
      params: the options of the environment.
    """
    _check_robots(state, params)
    action = jnp.asarray(action)
    if action.shape != state.lane.shape or not jnp.issubdtype(action.dtype, jnp.integer):
        expected = f"whole numbers [{state.lane.size}]"
        raise InputError("action", expected, f"{action.dtype} {list(action.shape)}")
    action = jnp.clip(action, 0, WAIT)
    town = _Town(params, state.level)
    robot_at = town.robot_at(state)
    next_slot = town.next_slot(state)
    wants = (robot_at[next_slot] == state.lane.size) & (action != WAIT)
    at_line = town.at_line(state)
    goes = jnp.where(at_line, _may_cross(town, state, robot_at, wants & at_line, params), wants)

    lane, slot = jnp.divmod(
        jnp.where(goes, next_slot, state.lane * params.slots + state.slot), params.slots
    )
    enters = goes & at_line
    reached = enters & (lane == state.goal)
    steps = state.steps + 1
    after = RoadTrafficState(
        level=state.level,
        lane=lane,
        slot=slot,
        turn=jnp.where(enters, town.turn_taken(lane, jnp.minimum(action, 2)), state.turn),
        goal=jnp.where(reached, _draw_goals(key, town, lane), state.goal),
        arrived=jnp.where(goes & (slot == params.slots - 1), steps, state.arrived),
        goals=state.goals + reached.astype(jnp.int32),
        tiles=state.tiles + enters.astype(jnp.int32),
        gridlocked=state.gridlocked,
        steps=steps,
    )
    after = after._replace(gridlocked=_find_gridlocked(town, after, params))

    nearer = town.distance(state.goal, state.lane) - town.distance(state.goal, lane)
    comes_into_gridlock = after.gridlocked & ~state.gridlocked
    reward = (
        params.progress_reward * nearer.astype(jnp.float32)
        + params.goal_reward * reached.astype(jnp.float32)
        - params.gridlock_cost * comes_into_gridlock.astype(jnp.float32)
    )
    terminated = after.gridlocked.any() & params.ends_in_gridlock
    truncated = ~terminated & (steps >= params.limit)
    info = RoadTrafficInfo(reached, after.goals, after.tiles, after.gridlocked)
    seen = _observe(after, params)
    return Transition(
        seen, after, jnp.asarray(reward, jnp.float32), terminated, truncated, info, seen
    )


def _check_robots(state: RoadTrafficState, params: RoadTrafficParams) -> None:
    if jnp.shape(state.lane) != (params.robots,):
        expected = f"that of one town with robots={params.robots}"
        raise InputError("state", expected, f"lanes {list(jnp.shape(state.lane))}")


def _may_cross(
    town: _Town, state: RoadTrafficState, robot_at: Array, wants: Array, params: RoadTrafficParams
) -> Bool[Array, " R"]:
    """Returns which robots may enter the next lane, among those at a line that want to."""
    rule = params.rule
    green = jnp.asarray(rule.green)
    phase = state.steps // rule.phase_steps % len(green)
    is_crossing = town.at_crossing(state.lane)
    can_enter = wants & (green[phase, town.heading(state.lane)] | ~is_crossing)

    others, came_before = _robots_beside(town, state, robot_at)
    gives_way = _gives_way(town, state, others, came_before, rule)
    if params.strict:
        is_there = (others < state.lane.size) & is_crossing[:, None]
        return can_enter & ~(gives_way & is_there).any(axis=1)
    other_can_enter = jnp.append(can_enter, False)[others]
    goes = can_enter & ~(gives_way & other_can_enter).any(axis=1)
    # If all robots at a tile give way to each other, the one that came first goes.
    nobody_goes = ~jnp.append(goes, False)[others].any(axis=1)
    is_first = ~(other_can_enter & came_before).any(axis=1)
    return goes | (can_enter & nobody_goes & is_first)


def _robots_beside(
    town: _Town, state: RoadTrafficState, robot_at: Array
) -> tuple[Int32[Array, "R 4"], Bool[Array, "R 4"]]:
    """Returns the robots at the lines of each robot's tile, and whether they came before it.

    R stands for no robot. The robot itself is among them.
    """
    others = robot_at[town.beside(state.lane) * town.slots + town.slots - 1]
    # No two robots at a tile have the same rank, because each came with another heading.
    rank = state.arrived * 4 + town.heading(state.lane)
    return others, jnp.append(rank, 0)[others] < rank[:, None]


def _gives_way(
    town: _Town, state: RoadTrafficState, others: Array, came_before: Array, rule: TrafficRule
) -> Bool[Array, "R 4"]:
    """Returns to which robots beside it each robot at a line gives way, if they want to go."""
    way = way_number(town.heading(state.lane), state.turn)
    yields = jnp.asarray(rule.yields)[way[:, None], jnp.append(way, 0)[others]]
    return yields & (came_before | ~jnp.asarray(rule.by_arrival))


def _find_gridlocked(
    town: _Town, state: RoadTrafficState, params: RoadTrafficParams
) -> Bool[Array, " R"]:
    """Returns which robots can never move again, whatever all robots choose."""
    robots = state.lane.size
    robot_at = town.robot_at(state)
    blocker = robot_at[town.next_slot(state)]
    if not params.strict:
        # A robot waits for one other at most. So it waits for ever if the line ahead has no head.
        return _line_heads(blocker) < robots
    others, came_before = _robots_beside(town, state, robot_at)
    gives_way = _gives_way(town, state, others, came_before, params.rule)
    waits_at = town.at_line(state) & town.at_crossing(state.lane)
    others = jnp.where(gives_way & waits_at[:, None], others, robots)
    return _never_move(jnp.append(blocker[:, None], others, axis=1))


def _line_heads(blocker: Int32[Array, " R"]) -> Int32[Array, " R"]:
    """Returns what follows at the end of the line of waiting robots before each robot.

    `blocker` is the robot that each one waits for. A robot that can move has R, which is then the
    end of its line, or itself. A circle has no end; any of its robots is returned. Each round
    doubles the robots of the line that are passed.
    """
    robots = blocker.size
    ahead = jnp.append(blocker, robots)
    for _ in range(robots.bit_length()):
        ahead = ahead[ahead]
    return ahead[:robots]


def _never_move(blockers: Int32[Array, "R K"]) -> Bool[Array, " R"]:
    """Returns which robots wait for a robot that never moves, itself included.

    The robots that can move are a least fixpoint: those that wait for nobody, then those that wait
    only for these, and so on. `blockers` has R for none.
    """
    robots = len(blockers)

    def round_of(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        stuck, _ = carry
        still = jnp.append(stuck, False)[blockers].any(axis=1)
        return still, (still != stuck).any()

    waits = (blockers < robots).any(axis=1)
    carry = vary_together((waits, waits.any()), blockers)
    stuck, _ = jax.lax.while_loop(lambda carry: carry[1], round_of, carry)
    return stuck


@name_wrong_arguments
@runs_jax
@checks_first(state=instance(RoadTrafficState), params=instance(RoadTrafficParams))
@divide_batches
def _observe(state: RoadTrafficState, params: RoadTrafficParams) -> RoadTrafficObservation:
    _check_robots(state, params)
    town = _Town(params, state.level)
    robots = state.lane.size
    robot_at = town.robot_at(state)
    is_taken = robot_at < robots
    own_lane_next = town.onward(state.lane, state.turn)
    after = town.all_onward(own_lane_next)
    is_open = after < town.none

    # The robots in all lanes before each one, so that a difference counts those of a street.
    in_lane = is_taken.reshape(-1, params.slots).sum(axis=1, dtype=jnp.int32)
    before = jnp.append(0, jnp.cumsum(in_lane))

    def load_of(lane: Array) -> tuple[Array, Array]:
        """Returns the load and the slots of the street from a lane on."""
        first, stop = town.street(lane)
        slots = (stop - first) * params.slots
        robots = (before[stop] - before[first]).astype(jnp.float32)
        return robots / jnp.maximum(slots, 1).astype(jnp.float32), slots

    next_load, next_slots = load_of(own_lane_next)
    load, slots = load_of(after)
    _, stop = town.street(after)
    following = town.all_onward(jnp.maximum(stop - 1, 0))
    following_load, _ = load_of(following)
    is_street = following < town.none

    goal_distance = town.distance(state.goal, own_lane_next)
    detour = town.distance(state.goal[:, None], after) + 1 - goal_distance[:, None]
    at_line = town.at_line(state)
    is_blocked = is_taken[town.next_slot(state)]
    crossing_ahead = at_line & town.at_crossing(state.lane)

    def by_turn(values: Array) -> Array:
        return jnp.where(is_open, values, 0).astype(jnp.float32)

    return RoadTrafficObservation(
        allowed=jnp.append(
            is_open & ~is_blocked[:, None], (is_blocked | crossing_ahead)[:, None], axis=1
        ),
        goal_distance=goal_distance.astype(jnp.float32),
        at_crossing=town.at_crossing(state.lane),
        next_at_crossing=town.at_crossing(own_lane_next),
        waited=jnp.where(at_line, state.steps - state.arrived, 0).astype(jnp.float32),
        next_load=next_load.astype(jnp.float32),
        next_slots=next_slots.astype(jnp.float32),
        next_robots=in_lane[town.beside(own_lane_next)].sum(axis=1).astype(jnp.float32),
        detour=by_turn(detour),
        taken=is_open & is_taken[after * params.slots],
        load=by_turn(load),
        slots=by_turn(slots),
        least_load=by_turn(jnp.where(is_street, following_load, 1).min(axis=2)),
        most_load=by_turn(jnp.where(is_street, following_load, 0).max(axis=2)),
        closes=_closes(town, state, robot_at, after),
    )


def _closes(
    town: _Town, state: RoadTrafficState, robot_at: Array, after: Array
) -> Bool[Array, "R 3"]:
    """Returns with which turns a robot would close a circle of waiting robots, if it alone moved.

    It would wait for a robot whose line ends at the slot that it has just taken.
    """
    robots = state.lane.size
    target = town.next_slot(state)
    # From the end of a lane a robot goes on by the turn that it has: the one it chooses on entry.
    by_turn = jnp.where(
        town.at_line(state)[:, None], after, town.onward(state.lane, state.turn)[:, None]
    )
    is_last_slot = (target + 1) % town.slots == 0
    then = jnp.where(is_last_slot[:, None], by_turn * town.slots, target[:, None] + 1)

    itself = jnp.arange(robots, dtype=jnp.int32)
    blocker = robot_at[target]
    head = _line_heads(jnp.where(blocker < robots, blocker, itself))
    last = jnp.append(head, robots)[robot_at[then]]
    waits_for_target = jnp.append(target, -1)[last] == target[:, None]
    can_move = blocker == robots
    return can_move[:, None] & (after < town.none) & waits_for_target & (last != itself[:, None])


RoadTraffic = Environment(_reset, _reset_to_level, _step, _observe, actions=4, shared=True)
"""Robots that share a town; see `step`, and `RoadTrafficParams` for its options."""
