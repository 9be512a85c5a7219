"""Which robots of RoadTraffic wait for each other: at a crossing, in a line, and for ever."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int32

from elitelanes_jax.drive._road_traffic_records import RoadTrafficParams, RoadTrafficState
from elitelanes_jax.drive._traffic_rules import TrafficRule, way_number
from elitelanes_jax.drive._traffic_town import Town
from elitelanes_jax.network.xla import vary_together


def may_cross(
    town: Town, state: RoadTrafficState, robot_at: Array, wants: Array, params: RoadTrafficParams
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
    town: Town, state: RoadTrafficState, robot_at: Array
) -> tuple[Int32[Array, "R 4"], Bool[Array, "R 4"]]:
    """Returns the robots at the lines of each robot's tile, and whether they came before it.

    R means no robot. The result includes the robot itself.
    """
    others = robot_at[town.beside(state.lane) * town.slots + town.slots - 1]
    # No two robots at a tile have the same rank, because each came with another heading.
    rank = state.arrived * 4 + town.heading(state.lane)
    return others, jnp.append(rank, 0)[others] < rank[:, None]


def _gives_way(
    town: Town, state: RoadTrafficState, others: Array, came_before: Array, rule: TrafficRule
) -> Bool[Array, "R 4"]:
    """Returns to which robots beside it each robot at a line gives way, if they want to go."""
    way = way_number(town.heading(state.lane), state.turn)
    yields = jnp.asarray(rule.yields)[way[:, None], jnp.append(way, 0)[others]]
    return yields & (came_before | ~jnp.asarray(rule.by_arrival))


def find_gridlocked(
    town: Town, state: RoadTrafficState, params: RoadTrafficParams
) -> Bool[Array, " R"]:
    """Returns which robots are in gridlock: they wait for each other for ever.

    No choice and no light can free them. A robot that waits for a light alone is not in gridlock.
    """
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


def closes_circle(
    town: Town, state: RoadTrafficState, robot_at: Array, after: Array
) -> Bool[Array, "R 3"]:
    """Returns with which turns a robot would close a circle of waiting robots, if it alone moved.

    It would wait for a robot whose line ends at the slot that it has just taken. Robots that give
    way to each other do not count.
    """
    robots = state.lane.size
    target = town.next_slot(state)
    # At the end of its lane, a robot chooses its next turn. Within the lane, it keeps its turn.
    by_turn = jnp.where(
        town.at_line(state)[:, None], after, town.onward(state.lane, state.turn)[:, None]
    )
    is_last_slot = (target + 1) % town.slots == 0
    slot_after = jnp.where(is_last_slot[:, None], by_turn * town.slots, target[:, None] + 1)

    itself = jnp.arange(robots, dtype=jnp.int32)
    blocker = robot_at[target]
    head = _line_heads(jnp.where(blocker < robots, blocker, itself))
    last_robot = jnp.append(head, robots)[robot_at[slot_after]]
    waits_for_target = jnp.append(target, -1)[last_robot] == target[:, None]
    can_move = (blocker == robots)[:, None]
    return can_move & (after < town.none) & waits_for_target & (last_robot != itself[:, None])
