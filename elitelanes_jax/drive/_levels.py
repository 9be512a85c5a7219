"""Levels: a map with a start and a goal, as arrays that environments carry."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Int8, Int32, Key, UInt8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, clip_to_int32, whole
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import ArrayOrRows, UserValue
from elitelanes_jax.drive._distances import UNREACHABLE, distances, lane_nodes, shortest_ways
from elitelanes_jax.drive._objects import Objects, make_objects
from elitelanes_jax.drive.lanes import check_lane
from elitelanes_jax.formats.road_map import RoadMap, as_maps
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import LaneNode, movements_of
from elitelanes_jax.network.bits import check_key, randint, random_bits, split
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CONNECTIONS, SIDES
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import vary_together


class Level(NamedTuple):
    """A task on a map. In a batch every shape starts with N.

    Fields belong together: with another goal or start, `ways` and `shortest` would be others.

    Attributes:
      grid: int8 ``[H, W]``, the codes of links alone: each connection is returned by the neighbour.
      start: the node where the episode starts; its heading is the one with which its tile was
        entered.
      goal: the node to be reached, with its heading.
      shortest: int32, the tiles from the start to the goal.
      ways: uint8 ``[H, W]``, the turns of a shortest way to the goal from every node, two bits for
        each heading.
      objects: the objects of the map, for the cameras and collisions of `LaneDrive`; None without
        any.
    """

    grid: Int8[Array, "H W"]
    start: LaneNode
    goal: LaneNode
    shortest: Int32[Array, ""]
    ways: UInt8[Array, "H W"]
    objects: Objects | None = None


@name_wrong_arguments
@runs_jax
def random_level(
    key: Key[Array, ""],
    grid: Int[Array | np.ndarray, "H W"],
    *,
    least: Int[ArrayLike, ""] = 1,
    most: Int[ArrayLike, ""] = UNREACHABLE,
) -> Level:
    """Returns a level with a uniformly drawn goal and a random start.

    The start is `least` to `most` tiles away from the goal.

    Args:
      key: consumed.
      grid: integer codes ``[H, W]`` with at least one movement; for traced codes see
        `measure`.
      least: the fewest tiles from the start to the goal. If all nodes are nearer, the start is one
        of the furthest nodes.
      most: the most tiles from the start to the goal. If no node has `least` to `most` tiles, the
        start is one of the nearest nodes with `least` tiles or more.

    Raises:
      InputError: for a bad grid, a grid without a lane, or a distance that is no whole number.
    """
    codes = check_grid(grid)
    check_lane(codes)
    least, most = _check_distance("least", least), _check_distance("most", most)
    return _random_level(key, codes, least, most)


def _check_distance(name: str, tiles: UserValue) -> Int[ArrayLike, ""]:
    """Returns a distance in tiles, a whole number or an integer array ``[]``, that fits 32 bits."""
    distance = clip_to_int32(tiles)
    if np.ndim(distance) or not jnp.issubdtype(jnp.result_type(distance), jnp.integer):
        raise InputError(name, "a whole number", quote(tiles))
    return distance


@divide_batches
def _random_level(
    key: Array, grid: ArrayOrRows, least: Int[ArrayLike, ""], most: Int[ArrayLike, ""]
) -> Level:
    links = jnp.asarray(linked_codes(grid))
    width = links.shape[1]
    bits = random_bits(key, (2,))
    # A goal that no movement leads to could never be reached.
    onward = jnp.asarray(CONNECTIONS)[links] >= 2
    # Some movement leads to a node if the tile behind it connects to another tile, too.
    has_movement_behind = [jnp.roll(onward, (side.down, side.right), (0, 1)) for side in SIDES]
    led_to = lane_nodes(links) & jnp.stack(has_movement_behind, axis=-1)
    goal = _draw(bits[0], led_to, width)
    away = distances(links, goal)
    # The goal itself has distance 0, and is no start.
    reachable = (away > 0) & (away < UNREACHABLE)
    # Bounds that no node meets are widened: `least` to the furthest node, and `most` to the nearest
    # node beyond `least`.
    furthest = jnp.where(reachable, away, 0).max()
    enough = reachable & (away >= jnp.minimum(least, furthest))
    nearest = jnp.where(enough, away, UNREACHABLE).min()
    start = _draw(bits[1], enough & (away <= jnp.maximum(most, nearest)), width)
    shortest = away[start.row, start.column, start.heading]
    return Level(links, start, goal, shortest, shortest_ways(links, goal))


def _draw(bits: Array, among: Array, width: int) -> LaneNode:
    """Draws a node uniformly; the last node if none is True."""
    # The k-th of all True nodes is the first one where the running count is k.
    flat = among.reshape(-1)
    count = jnp.cumsum(flat)
    number = randint(bits, jnp.maximum(count[-1], 1)) + 1
    # JAX 0.7 looks up only arrays that differ between the same devices.
    index = jnp.searchsorted(*vary_together((count, number))).astype(jnp.int32)
    index = jnp.minimum(index, flat.size - 1)
    return LaneNode(index // (4 * width), index // 4 % width, index % 4)


@name_wrong_arguments
@runs_jax
def make_levels(
    key: Key[Array, ""],
    grids: UserValue,
    count: int | None = None,
    *,
    least: int = 1,
    most: int = UNREACHABLE,
) -> Level:
    """Draws many levels on maps (see `random_level`).

    Args:
      key: consumed.
      grids: M maps of one size, as `as_maps` takes them: integer codes ``[M, H, W]``, or
        `RoadMap`s.
      count: N, the number of levels; by default M. Level i is on map i modulo M.
      least: the fewest tiles from the start to the goal, 1 or more; see `random_level`.
      most: the most tiles from the start to the goal, 1 or more; see `random_level`.

    Returns:
      A batch of N levels with the objects of the maps. In each a way leads from the start to the
      goal.

    Raises:
      InputError: for anything but a key, a bad grid, grids of several sizes, a map without any
        lane, or a number out of its range.
    """
    check_key(key)
    return draw_levels(key, check_maps("grids", grids), count, least=least, most=most)


@runs_jax
def draw_levels(
    key: Key[Array, ""],
    road_maps: list[RoadMap],
    count: int | None = None,
    *,
    least: int = 1,
    most: int = UNREACHABLE,
) -> Level:
    """Does what `make_levels` does, on maps that `check_maps` has checked."""
    total = len(road_maps) if count is None else check_named("count", whole(1), count)
    least, most = check_named("least", whole(1), least), check_named("most", whole(1), most)
    codes = np.stack([road_map.codes for road_map in road_maps], dtype=np.int8)
    # Maps take turns, so that each has nearly the same number of levels.
    map_of_level = np.arange(total) % len(road_maps)
    levels = _random_levels(split(key, total), codes[map_of_level], least, most)
    objects = jax.tree.map(lambda part: part[map_of_level], make_objects(road_maps))
    return levels._replace(objects=objects)


def check_maps(name: str, sources: UserValue) -> list[RoadMap]:
    """Returns maps of one size with lanes, in any form that `as_maps` takes.

    Messages start with `name`.

    Raises:
      InputError: as `make_levels` does for its grids.
    """
    road_maps = check_named(name, as_maps, sources)
    if not road_maps:
        raise InputError(name, "one or more of one size", "none")
    if len({road_map.codes.shape for road_map in road_maps}) > 1:
        raise InputError(name, "one or more of one size", "several sizes")
    for index, road_map in enumerate(road_maps):
        if not movements_of(road_map.codes).row.size:
            raise InputError(f"{name}[{index}]", "a map with a lane", "one without any movement")
    return road_maps


_random_levels = jax.jit(jax.vmap(_random_level, (0, 0, None, None)))


def check_batch(levels: UserValue) -> Level:
    """Checks that a value is a batch of one or more levels, but not the levels; returns a copy."""
    batch = _check_axes(levels, 3, "a batch of levels (see make_levels)")
    if not batch.grid.shape[0]:
        raise InputError("", "one or more levels", "none")
    return batch


def check_single(level: UserValue) -> Level:
    """Checks that a value is one level, but not the level; returns a copy."""
    return _check_axes(level, 2, "one level (see random_level)")


def _check_axes(level: UserValue, axes: int, expected: str) -> Level:
    """Returns a copy of a level or a batch, as `frozen_copy` makes it."""
    if isinstance(level, Level):
        if np.ndim(level.grid) == axes:
            # JAX may read arrays after the call.
            copy: Level = jax.tree.map(frozen_copy, level)
            return copy
        got = f"one of shape {np.shape(level.grid)}"
    elif hasattr(level, "shape"):
        # A message does not name the type of a tracer.
        got = "an array"
    else:
        got = type(level).__name__
    raise InputError("", expected, got)
