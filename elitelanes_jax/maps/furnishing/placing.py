"""From a map to a furnished map: the same for the same codes, seed and specification."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap, as_map
from elitelanes_jax.maps.furnishing.scenery import place_scenery
from elitelanes_jax.maps.furnishing.signs import crossings, has_free_corners, place_light, place_signs
from elitelanes_jax.maps.furnishing.space import Space
from elitelanes_jax.maps.furnishing.spec import FurnishSpec, parse_furnish
from elitelanes_jax.maps.furnishing.tags import with_tags


def furnish(source: UserValue, spec: UserValue = "all", *, seed: int = 0) -> RoadMap:
    """Returns a map with objects by a specification, instead of the objects that it has.

    The objects depend on the codes, the specification and the seed only.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      spec: a `FurnishSpec`; or its settings by name; or a text or several, with ``signs`` for signs at every crossing,
        ``all`` for some of everything, ``unique_tags``, and settings such as ``duckies=6`` that override these words.
      seed: of the places of objects, 0 to 2**32 - 1.

    Raises:
      InputError: for a bad map or specification, a crossing that has no room for its signs, tag numbers that would be
        used twice with `unique_tags`, or numbers of objects that do not fit.
    """
    road_map = as_map(source)
    asked: FurnishSpec = check_named("furnish", parse_furnish, spec)
    return replace(road_map, objects=_objects(road_map.codes, asked, check_named("seed", whole(0, 2**32 - 1), seed)))


def _objects(codes: NDArray[np.int8], spec: FurnishSpec, seed: int) -> tuple[MapObject, ...]:
    space = Space(codes)
    found = crossings(codes)
    free = [crossing for crossing in found if has_free_corners(codes, crossing)]
    random = np.random.default_rng([seed, 2**32 - 1])
    order, corners = random.permutation(len(free)), random.integers(4, size=len(free))
    lit = [int(index) for index in order[: round(spec.lights * len(free))]]
    if spec.signs != "none":
        signs = place_signs(found, set(free), spec.signs, {free[index] for index in lit})
        for sign in with_tags(signs, unique=spec.unique_tags):
            space.add(sign)
    for index in sorted(lit):
        space.add(place_light(free[index], int(corners[index])))
    place_scenery(space, spec, seed)
    return tuple(space.objects)
