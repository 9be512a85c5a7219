"""RoadTraffic: robots that share a town, from lane to lane, until they reach goals or block each other.

The model is that of `gridlock_number`. The lane of a tile has slots. A robot chooses its turn when
it enters a lane, and it moves only into a slot that was free before the step.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Int32, Key

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import clip_to_int32, instance, is_whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.drive._environment import Environment, Transition, checks_first, draw_level
from elitelanes_jax.drive._road_traffic_records import (
    WAIT,
    RoadTrafficInfo,
    RoadTrafficObservation,
    RoadTrafficParams,
    RoadTrafficState,
)
from elitelanes_jax.drive._traffic_town import Town
from elitelanes_jax.drive._traffic_waits import closes_circle, find_gridlocked, may_cross
from elitelanes_jax.network.bits import randint, random_bits, split
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import rounded


@name_wrong_arguments
@runs_jax
@checks_first(params=instance(RoadTrafficParams))
def _reset_to_level(
    key: Key[Array, ""], level: Int[ArrayLike, ""], params: RoadTrafficParams
) -> tuple[RoadTrafficObservation, RoadTrafficState]:
    """Puts robots on random slots of a town, with random goals. The key is consumed.

    The first turns are those of shortest ways. Robots may be in gridlock from the start; the first
    step says so.

    Args:
      key: consumed.
      level: the index of the town in ``params.levels``, from 0. An array of JAX is limited to their
        number.
      params: the options of the environment.

    Raises:
      InputError: for a number that is not the index of a town.
    """
    count = len(params.levels.grid)
    # The value of an array of JAX is on the device, or unknown.
    number = level.item() if isinstance(level, np.ndarray) and level.ndim == 0 else level
    if is_whole(number) and not 0 <= number < count:
        raise InputError("level", f"the index of a level, 0 to {count - 1}", number)
    return _put_on_slots(key, clip_to_int32(level), params)


@jax.jit
@divide_batches
def _put_on_slots(
    key: Key[Array, ""], level: Int[ArrayLike, ""], params: RoadTrafficParams
) -> tuple[RoadTrafficObservation, RoadTrafficState]:
    level = _check_index(level, len(params.levels.grid))
    town = Town(params, level)
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
    state = state._replace(gridlocked=find_gridlocked(town, state, params))
    return _observe(state, params), state


def _check_index(level: Int[ArrayLike, ""], count: int) -> Array:
    """Returns the index of a level as int32, limited to their number."""
    array = jnp.asarray(level)
    if array.shape != () or not jnp.issubdtype(array.dtype, jnp.integer):
        got = f"{array.dtype} {list(array.shape)}"
        raise InputError("level", "the index of a level, a whole number", got)
    return jnp.clip(array, 0, count - 1).astype(jnp.int32)


def _draw_goals(key: Array, town: Town, lane: Array) -> Int32[Array, " R"]:
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

    A robot that does not wait moves to the next slot of its way if this slot was free before the
    step. At a line, the rule must also let it go. A robot that reaches its goal gets another one.
    The episode terminates if robots are in gridlock: they wait for each other for ever.

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
    town = Town(params, state.level)
    robot_at = town.robot_at(state)
    next_slot = town.next_slot(state)
    wants = (robot_at[next_slot] == state.lane.size) & (action != WAIT)
    at_line = town.at_line(state)
    goes = jnp.where(at_line, may_cross(town, state, robot_at, wants & at_line, params), wants)

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
    after = after._replace(gridlocked=find_gridlocked(town, after, params))

    nearer = town.distance(state.goal, state.lane) - town.distance(state.goal, lane)
    comes_into_gridlock = after.gridlocked & ~state.gridlocked
    # A product by 1, 0 or -1 is exact. Any other is rounded before it is added, see `rounded`.
    progress = params.progress_reward * nearer.astype(jnp.float32)
    progress = jnp.where(jnp.abs(nearer) <= 1, progress, rounded(progress))
    reward = (
        progress
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


@name_wrong_arguments
@runs_jax
@checks_first(state=instance(RoadTrafficState), params=instance(RoadTrafficParams))
@jax.jit
@divide_batches
def _observe(state: RoadTrafficState, params: RoadTrafficParams) -> RoadTrafficObservation:
    _check_robots(state, params)
    town = Town(params, state.level)
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
        closes=closes_circle(town, state, robot_at, after),
    )


RoadTraffic = Environment(_reset, _reset_to_level, _step, _observe, actions=4, shared=True)
"""The environment of robots that share a town.

`RoadTrafficParams` has its options, and `RoadTraffic.step` says what an action does.
"""
