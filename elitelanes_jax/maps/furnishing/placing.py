"""From a map to a furnished map: the same for the same codes and arguments."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.objects import check_objects
from elitelanes_jax.formats.road_map import RoadMap, as_map
from elitelanes_jax.lanes.curves import LANE_OFFSET, check_lane_offset
from elitelanes_jax.maps.furnishing.scenery import place_scenery, scenery_kinds
from elitelanes_jax.maps.furnishing.signs import (
    LIGHT,
    crossings,
    has_free_corners,
    place_light,
    place_signs,
    sign_kinds,
)
from elitelanes_jax.maps.furnishing.space import Space
from elitelanes_jax.maps.furnishing.spec import FurnishSpec, parse_furnish
from elitelanes_jax.maps.furnishing.street_names import (
    STREET_NAME,
    Tags,
    place_street_names,
)
from elitelanes_jax.network.codes import CROSSINGS


@name_wrong_arguments
def furnish(
    source: UserValue, spec: UserValue = "all", *, seed: int = 0, lane_offset: float = LANE_OFFSET
) -> RoadMap:
    """Returns a map with objects by a specification, instead of the objects that it has.

    The objects depend on the arguments and the map's codes only.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      spec: settings by name, such as ``{"duckies": 6}``; or a text or several, with ``signs`` for
        signs at every crossing, ``street_names``, ``all`` for some of everything, ``unique_tags``,
        settings such as ``duckies=6`` that override these words, and a file .toml, .json or .yaml
        with objects of your own.
      seed: the seed of the positions of objects, 0 to 2**32 - 1.
      lane_offset: tiles from the road's middle to the centre of a lane, over 0 and under 0.5. A
        tile set may have its own, `TileSet.lane_offset`.

    Raises:
      InputError: for a bad map or specification, a crossing that has no room for its signs, tag
        numbers that would be used twice with `unique_tags`, objects of your own outside the map or
        where a sign has to be, numbers of objects that do not fit, or a `lane_offset` out of its
        range.
    """
    road_map = as_map(source)
    asked: FurnishSpec = check_named("furnish", parse_furnish, spec)
    lane_offset = check_named("lane_offset", check_lane_offset, lane_offset)
    seed = check_named("seed", SEED, seed)
    space = Space(road_map.codes)
    tags = Tags(unique=asked.unique_tags)
    # The user's objects come first. They stay as they are, and all others keep clear of them.
    for thing in check_objects(asked.objects, *road_map.codes.shape):
        space.add(thing)
        tags.use(thing)
    # Signs and lights have fixed places, so they come before everything that can move.
    _place_controls(space, asked, tags, seed)
    if asked.street_names != "none":
        place_street_names(space, asked.street_names, tags)
    place_scenery(space, asked, seed, lane_offset)
    return replace(road_map, objects=tuple(space.objects))


def placed_kinds(spec: FurnishSpec, codes: Collection[int]) -> set[str]:
    """Returns the kinds that `furnish` may place, besides the user's objects, on maps of some codes.

    A map may get no object of a kind, because its crossings have no room for signs, or because the
    number of objects for its cells is rounded to 0.
    """
    kinds = scenery_kinds(spec)
    if spec.street_names != "none":
        kinds.add(STREET_NAME)
    crossing_codes = set(CROSSINGS).intersection(codes)
    if not crossing_codes:
        return kinds
    if spec.lights:
        kinds.add(LIGHT)
    if spec.signs != "none":
        for code in crossing_codes:
            kinds |= sign_kinds(code, spec.lights)
    return kinds


def _place_controls(space: Space, spec: FurnishSpec, tags: Tags, seed: int) -> None:
    """Adds the signs and the lights of crossings.

    Raises `InputError` if an object is in the way of one.
    """
    arms = crossings(space.codes)
    free = [crossing for crossing in arms if has_free_corners(space.codes, crossing)]
    # Scenery draws from `[seed, 0]` and so on. This stream differs from all of them.
    random = np.random.default_rng([seed, 2**32 - 1])
    # All numbers are drawn in any case, so another share of lights keeps the corners and the order.
    order = random.permutation(len(free))
    corners = random.integers(4, size=len(free))
    with_light = np.sort(order[: round(spec.lights * len(free))]).tolist()
    controls = []
    # Where a crossing has a light, its signs say that the light is ahead.
    if spec.signs != "none":
        lit = {free[index] for index in with_light}
        for sign in place_signs(arms, set(free), spec.signs, lit):
            controls.append(tags.give(sign))
    for index in with_light:
        controls.append(place_light(free[index], int(corners[index])))
    # Signs and lights cannot be moved out of the way of an object of the user.
    for thing in controls:
        if not space.is_clear(thing):
            raise InputError(
                "objects", f"none in the way of {thing.kind} at x {thing.x:g}, y {thing.y:g}", "one"
            )
        space.add(thing)
