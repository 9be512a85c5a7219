"""Towns that robots share: their lanes with numbers, as tables that `RoadTraffic` reads."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int16, Int32
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.drive._distances import distances
from elitelanes_jax.drive._levels import check_maps
from elitelanes_jax.drive.lanes import TURN_TAKEN
from elitelanes_jax.lanes.movements import LaneGraph, LaneNode, lane_graph
from elitelanes_jax.network.codes import CONNECTIONS, SIDES
from elitelanes_jax.network.street_traffic import links_on_loops

MOST_LANES = 8192
"""The lanes of the largest town. Its distances take 128 MiB."""

# The goals whose distances are computed at once.
_CHUNK = 64

# A program of its own for each map would take a second to compile.
_to_goals = jax.jit(jax.vmap(distances, (None, 0)))
_links_on_loops = jax.jit(links_on_loops)


class TrafficLevels(NamedTuple):
    """N towns that robots share, see `make_traffic_levels`.

    A lane is a `LaneNode`: a tile and the heading with which it is entered. The lanes of a town are
    numbered along its streets. L is one more than the lanes of the largest town. The numbers from
    `lanes` on stand for no lane, and the last one, L - 1, is the one that tables have.

    A street leads from a crossing to the next one, in one direction. A loop without a crossing is a
    street, too. A part is a set of lanes that robots can reach from each other.

    Attributes:
      grid: int8 ``[N, H, W]``, the codes of links alone, without roads to dead ends.
      lanes: int32 ``[N]``, the number of lanes.
      node: the node of each lane, int32 ``[N, L]`` each.
      onward: int32 ``[N, L, 3]``, the lane after each turn; L - 1 if the turn is not open.
      turn_taken: int32 ``[N, L, 3]``, the turn that is taken for a wanted one: this one or the next
        open one, in the order right, straight, left, right.
      beside: int32 ``[N, L, 4]``, the lanes of the same tile by their heading; L - 1 for none.
      at_crossing: bool ``[N, L]``, whether the tile is a crossing.
      street: int32 ``[N, L, 2]``, the lanes of the street from this one on: the first number, and
        the one after the last. On a loop without a crossing these are all its lanes.
      part: int32 ``[N, L, 2]``, the lanes of its part: the first number, and the one after the last.
      distance: int16 ``[N, L, L]``, the tiles of a shortest way from the second lane to the first
        one; 32767 if there is none.
    """

    grid: Int8[Array, "N H W"]
    lanes: Int32[Array, " N"]
    node: LaneNode
    onward: Int32[Array, "N L 3"]
    turn_taken: Int32[Array, "N L 3"]
    beside: Int32[Array, "N L 4"]
    at_crossing: Bool[Array, "N L"]
    street: Int32[Array, "N L 2"]
    part: Int32[Array, "N L 2"]
    distance: Int16[Array, "N L L"]

    def at(self, index: Int[ArrayLike, ""]) -> Int32[Array, ""]:
        """Returns a level: the index of its town, because its tables are large."""
        return jnp.asarray(index)


FAR = np.int16(2**15 - 1)
"""The distance if there is no way."""


@name_wrong_arguments
@runs_jax
def make_traffic_levels(maps: UserValue) -> TrafficLevels:
    """Makes a level of each map, for `RoadTraffic`.

    Roads to dead ends are left out, because a robot that enters one can never leave it.

    Args:
      maps: N maps of one size, as `as_maps` takes them: integer codes ``[N, H, W]``, or
        `RoadMap`s. Objects are ignored.

    Raises:
      InputError: for a bad grid, grids of several sizes, a map without a loop, or one with over 8192
        lanes.
    """
    towns = []
    for index, road_map in enumerate(check_maps("maps", maps)):
        on_loops = np.asarray(_links_on_loops(jnp.asarray(road_map.codes, jnp.int8)))
        grid = sum(np.int8(side.bit) * links for side, links in zip(SIDES, on_loops, strict=True))
        if not grid.any():
            raise InputError(f"maps[{index}]", "a map with a loop", "one without any")
        graph = lane_graph(grid)
        count = len(graph.nodes.row)
        if count > MOST_LANES:
            raise InputError(f"maps[{index}]", f"at most {MOST_LANES} lanes", str(count))
        towns.append((grid, graph))
    size = 1 + max(len(graph.nodes.row) for _, graph in towns)
    levels = [_make_level(grid, graph, size) for grid, graph in towns]
    return jax.tree.map(lambda *fields: jnp.stack(fields), *levels)


def _make_level(grid: NDArray[np.int8], graph: LaneGraph, size: int) -> TrafficLevels:
    """Returns the tables of one town, with room for L = `size` lanes."""
    streets, parts = _list_streets(grid, graph)
    order = np.concatenate(streets)
    none = size - 1
    # The number of each lane of the graph.
    number = np.argsort(order)
    nodes = np.stack(graph.nodes, axis=1)[order]
    row, column, heading = nodes.T
    codes = grid[row, column]

    onward = np.full((len(order), 3), none)
    starts, ends = number[graph.edges.T]
    onward[starts, graph.movements.turn] = ends
    lane_at = np.full((*grid.shape, 4), none)
    lane_at[row, column, heading] = np.arange(len(order))

    at_crossing = CONNECTIONS[codes] > 2
    street, part = _ranges(streets), _ranges(parts)
    # On a street with a crossing at its end, only the lanes from this one on are ahead.
    ends_at_crossing = at_crossing[street[:, 1] - 1]
    street[:, 0] = np.where(ends_at_crossing, np.arange(len(order)), street[:, 0])

    def pad(table: np.ndarray, value: int) -> NDArray[np.int32]:
        rows = np.full((size, *table.shape[1:]), value, np.int32)
        rows[: len(table)] = table
        return rows

    distance = np.full((size, size), FAR)
    distance[: len(order), : len(order)] = _distances_between(grid, nodes)
    tables = {
        "grid": grid,
        "lanes": np.int32(len(order)),
        "node": LaneNode(*(pad(field, 0) for field in (row, column, heading))),
        "onward": pad(onward, none),
        "turn_taken": pad(TURN_TAKEN[codes, heading], 0),
        "beside": pad(lane_at[row, column], none),
        "at_crossing": pad(at_crossing, 0).astype(bool),
        "street": pad(street, 0),
        "part": pad(part, 0),
        "distance": distance,
    }
    return TrafficLevels(**jax.tree.map(jnp.asarray, tables))


def _list_streets(
    grid: NDArray[np.int8], graph: LaneGraph
) -> tuple[list[list[int]], list[list[int]]]:
    """Lists the lanes of each street in driving order, and the lanes of each part.

    The streets of a part are consecutive. The order of lanes is that of the graph otherwise.
    """
    onward: list[list[int]] = [[] for _ in graph.nodes.row]
    for start, end in graph.edges.tolist():
        onward[start].append(end)
    is_crossing = CONNECTIONS[grid[graph.nodes.row, graph.nodes.column]] > 2
    # A street begins after a crossing. Each lane belongs to the street that passes it.
    firsts = sorted(
        {end for start, ends in enumerate(onward) for end in ends if is_crossing[start]}
    )
    street_of: dict[int, list[int]] = {}
    for first in [*firsts, *range(len(onward))]:
        if first in street_of:
            continue
        street = [first]
        while not is_crossing[street[-1]] and (after := onward[street[-1]][0]) != first:
            street.append(after)
        street_of |= dict.fromkeys(street, street)

    streets: list[list[int]] = []
    parts = []
    passed: set[int] = set()
    for first in range(len(onward)):
        if first in passed:
            continue
        part = []
        for lane in _reached_from(first, onward):
            street = street_of[lane]
            if street[0] not in passed:
                passed.update(street)
                streets.append(street)
                part += street
        parts.append(part)
    return streets, parts


def _reached_from(first: int, onward: list[list[int]]) -> Iterator[int]:
    """Yields the lanes that robots reach from a lane.

    Without dead ends they can return, because a part with a crossing is strongly connected
    (M. Kotani and T. Sunada, "Zeta functions of finite graphs", 2000), and one without is a ring.
    """
    reached = {first}
    waiting = [first]
    while waiting:
        lane = waiting.pop()
        yield lane
        new = [after for after in onward[lane] if after not in reached]
        reached.update(new)
        waiting += new


def _ranges(groups: list[list[int]]) -> NDArray[np.int64]:
    """Returns the first number and the one after the last of each lane's group, ``[lanes, 2]``."""
    sizes = [len(group) for group in groups]
    stops = np.cumsum(sizes)
    return np.repeat(np.stack([stops - sizes, stops], axis=1), sizes, axis=0)


def _distances_between(grid: NDArray[np.int8], nodes: NDArray[np.int64]) -> NDArray[np.int16]:
    """Returns the tiles from the second lane to the first one, ``[lanes, lanes]``."""
    row, column, heading = nodes.T
    rows = []
    for first in range(0, len(nodes), _CHUNK):
        # The last chunk is filled with its last goal, so that one program serves all chunks.
        indices = np.minimum(np.arange(first, first + _CHUNK), len(nodes) - 1)
        goals = LaneNode(*jnp.asarray(nodes[indices].T, jnp.int32))
        tiles = np.asarray(_to_goals(grid, goals))[:, row, column, heading]
        rows.append(np.minimum(tiles, FAR).astype(np.int16))
    return np.concatenate(rows)[: len(nodes)]


def check_traffic_levels(levels: UserValue) -> TrafficLevels:
    """Checks that a value is a batch of levels for `RoadTraffic`; returns a copy."""
    if not isinstance(levels, TrafficLevels):
        got = "an array" if hasattr(levels, "shape") else type(levels).__name__
        raise InputError("", "levels (see make_traffic_levels)", got)
    if np.ndim(levels.grid) != 3 or not levels.grid.shape[0]:
        raise InputError("", "one or more levels", f"a grid of shape {np.shape(levels.grid)}")
    copy: TrafficLevels = jax.tree.map(frozen_copy, levels)
    return copy
