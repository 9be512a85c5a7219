"""The town of a state of RoadTraffic: its tables, and where its robots are."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int32

from elitelanes_jax.drive._road_traffic_records import RoadTrafficParams, RoadTrafficState


class Town:
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
        return self.read(self._levels.lanes)

    def robot_at(self, state: RoadTrafficState) -> Int32[Array, " LS"]:
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
