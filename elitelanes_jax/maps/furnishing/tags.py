"""Tag numbers of signs: those that Duckietown's database of tags, ``apriltagsDB.yaml``, has for each kind."""

from math import dist, inf

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.objects import MapObject

SIGN_TAGS: dict[str, tuple[int, ...]] = {
    "sign_stop": (1, *range(20, 39), *range(162, 197)),
    "sign_4_way_intersect": (8, *range(13, 20), *range(44, 57), *range(197, 200), *range(231, 235), *range(262, 265)),
    "sign_right_T_intersect": (9, *range(57, 61), *range(132, 142), 235, 238, 241, 244, 260, 261),
    "sign_left_T_intersect": (10, *range(61, 65), *range(152, 162), 237, 240, 242, 245, 248, 249),
    "sign_T_intersect": (11, *range(65, 69), *range(142, 152), 236, 239, 243, 246, 247),
    "sign_t_light_ahead": (*range(74, 95), *range(200, 230)),
}
"""The tag numbers of each kind of sign."""


def with_tags(signs: list[MapObject], *, unique: bool) -> list[MapObject]:
    """Returns signs with tag numbers: each number of a kind once, in order.

    If a kind has more signs than numbers, each further sign gets the number whose nearest use is farthest away; of
    several, the lowest.

    Args:
      signs: without tags.
      unique: whether that is refused.

    Raises:
      InputError: if it is.
    """
    used: dict[str, dict[int, list[tuple[float, float]]]] = {kind: {} for kind in SIGN_TAGS}
    tagged = []
    for sign in signs:
        numbers, uses = SIGN_TAGS[sign.kind], used[sign.kind]
        if unique and len(uses) == len(numbers):
            count = sum(one.kind == sign.kind for one in signs)
            raise InputError(f"unique_tags: expected at most {len(numbers)} of {sign.kind}, got {count}")
        place = (sign.x, sign.y)
        tag = max(numbers, key=lambda number: min((dist(place, other) for other in uses.get(number, ())), default=inf))
        uses.setdefault(tag, []).append(place)
        tagged.append(sign._replace(tag=tag))
    return tagged
