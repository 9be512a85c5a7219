"""Objects of a map, with a place and a direction each.

Objects are signs, lights, buildings, vehicles and duckies.
"""

import re
from collections.abc import Iterable, Mapping
from math import cos, hypot, sin
from typing import NamedTuple

from elitelanes_jax._util.checks import check_named, is_flag, is_real, is_whole
from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.tags import LARGEST_TAG

BEYOND = 1.0
"""How far from the map an object may be, in tiles: signs at a map's border are outside it."""

# Positions may be farther by this, in tiles, because other formats round them to a millionth of a
# metre, and have tiles of 0.01 m or larger.
_ROUNDED = 1e-4

NEAR = 0.02
"""Metres ahead of a camera under which no object is drawn."""

OPAQUE = 128
"""The least opacity, of 255, of the pixels of a picture that belong to its object."""

MOST_OBJECTS = 2**18
"""The most objects of a map."""


class ObjectKind(NamedTuple):
    """The size of a kind of object, in metres.

    An object of another height has a footprint that is larger or smaller in proportion.

    Attributes:
      height: the default height.
      length: the length of the footprint at that height, along the object's direction.
      width: the width of the footprint at that height, across the object's direction.
      is_round: whether the footprint is a disc, with `length` as its diameter, instead of a
        rectangle.
    """

    height: float
    length: float
    width: float
    is_round: bool = False


# Heights are those of most objects in duckietown-world's maps, and proportions are those of its
# meshes. There a house has 0.5 m, a building 0.6 m and a bus 0.18 m. Here they are lower, because
# they must fit on a tile between signs. Street name signs have the widest size of the manual, 7.2
# inches.
_SIGN = ObjectKind(0.18, 0.056, 0.072)
_SIGNS = (
    "stop", "4_way_intersect", "right_T_intersect", "left_T_intersect", "T_intersect",
    "t_light_ahead", "yield", "do_not_enter", "no_left_turn", "no_right_turn", "oneway_left",
    "oneway_right", "duck_crossing", "pedestrian", "parking", "blank",
)  # fmt: skip

OBJECT_KINDS: dict[str, ObjectKind] = {
    "duckie": ObjectKind(0.08, 0.088, 0.088, is_round=True),
    "cone": ObjectKind(0.08, 0.05, 0.05, is_round=True),
    "barrier": ObjectKind(0.08, 0.285, 0.057),
    "duckiebot": ObjectKind(0.12, 0.18, 0.132),
    "bus": ObjectKind(0.12, 0.44, 0.137),
    "truck": ObjectKind(0.2, 0.363, 0.157),
    "tree": ObjectKind(0.25, 0.142, 0.142, is_round=True),
    "house": ObjectKind(0.2, 0.271, 0.352),
    "building": ObjectKind(0.36, 0.384, 0.254),
    "trafficlight": ObjectKind(0.4, 0.097, 0.086),
    "checkerboard": ObjectKind(0.17, 0.171, 0.171),
    "floor_tag": ObjectKind(0.0, 0.065, 0.065),
    **{f"sign_{name}": _SIGN for name in _SIGNS},
    "sign_street_name": ObjectKind(0.18, 0.056, 0.183),
    "other": ObjectKind(0.1, 0.1, 0.1),
}
"""The kinds of objects by name, each with its size in metres.

A kind has a `height`, the `length` of its footprint along the object's direction, the `width`
across it, and `is_round` if the footprint is a disc.

Names are those of gym-duckietown and duckietown-world, except for "other".
"""

OTHER = "other:"
"""What the kind of an object begins with if it is not one of `OBJECT_KINDS`."""

_OTHER_KIND = re.compile(OTHER + r"\w[\w.-]{0,63}")


class MapObject(NamedTuple):
    """An object of a map.

    Its coordinates are those of lanes and poses in `elitelanes_jax.drive`. x points east and y
    south from the north-west corner of the map, in tiles. Angles are counter-clockwise as seen from
    above; 0 is east.

    Attributes:
      kind: one of `OBJECT_KINDS`; or "other:" and a name that an imported map has, such as
        "other:helicopter".
      x: the position of the footprint's centre, in tiles east of the map's north-west corner.
      y: tiles south of that corner.
      angle: the direction of the object's front, in radians. A vehicle drives in this direction.
        The printed side of a sign faces it: whoever drives east reads a sign with the angle pi. The
        arm of a traffic light points in it; `x` and `y` are those of its stand.
      height: metres; 0 for tags on the floor.
      tag: the number of its AprilTag in the family 36h11, 0 to 586; None without a tag.
      static: whether it stays where it is. gym-duckietown moves other duckies, robots and
        checkerboards.
    """

    kind: str
    x: float
    y: float
    angle: float
    height: float
    tag: int | None = None
    static: bool = True

    @property
    def footprint(self) -> tuple[float, float]:
        """Length and width in metres, along and across its direction, at its height."""
        usual = OBJECT_KINDS[base_kind(self.kind)]
        scale = self.height / usual.height if usual.height else 1.0
        return usual.length * scale, usual.width * scale

    @property
    def is_round(self) -> bool:
        """Whether the footprint is a disc."""
        return OBJECT_KINDS[base_kind(self.kind)].is_round

    @property
    def radius(self) -> float:
        """Radius in metres of the smallest disc around the footprint."""
        length, width = self.footprint
        return length / 2 if self.is_round else hypot(length, width) / 2


def corners_of(
    x: float, y: float, half_length: float, half_width: float, angle: float
) -> list[tuple[float, float]]:
    """Returns the four corners of a rectangle, in its units, with y to the south.

    `x` and `y` are its middle. `angle` is counter-clockwise from east, in radians, as seen from
    above.
    """
    east, south = cos(angle), -sin(angle)
    corners = []
    for ahead, aside in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        length, width = ahead * half_length, aside * half_width
        corners.append((x + length * east - width * south, y + length * south + width * east))
    return corners


class Standing(NamedTuple):
    """An object and how it looks from its front.

    Attributes:
      thing: the object.
      picture: a PNG file with transparency, from the floor to the object's height.
      width: the width of the picture in metres.
      colour: the mean red, green and blue of its opaque pixels, 0 to 1.
    """

    thing: MapObject
    picture: bytes
    width: float
    colour: tuple[float, float, float]


def base_kind(kind: str) -> str:
    """Returns the name in `OBJECT_KINDS` of a kind: "other" for "other:helicopter"."""
    return kind.partition(":")[0]


def check_kind(kind: UserValue) -> str:
    """Returns the name of a kind of object; raises an `InputError` for an unknown one."""
    hint = ""
    if isinstance(kind, str):
        if kind in OBJECT_KINDS:
            return kind
        if _OTHER_KIND.fullmatch(kind):
            name = kind.removeprefix(OTHER)
            # Duckietown's files have the name alone, and would be read as the known kind, or as
            # nothing.
            if name not in OBJECT_KINDS and name.lower() != "null":
                return kind
            raise InputError("kind", f"after {OTHER} a name that no known kind has", repr(kind))
        # A misspelt kind gets a suggestion. Any other name may be meant as a kind with the prefix
        # "other:".
        hint = suggest(kind, list(OBJECT_KINDS))
        if not hint and _OTHER_KIND.fullmatch(OTHER + kind):
            hint = f"is it {OTHER}{kind}?"
    raise InputError("kind", f"one of {', '.join(OBJECT_KINDS)}", quote(kind, 40), hint)


def nearest_view(angles: Iterable[int], angle: float) -> int:
    """Returns the first of the views of an object that are nearest to an angle, all in degrees."""
    # The difference of two angles is at most half a turn.
    return min(angles, key=lambda view: abs((view - angle + 180) % 360 - 180))


def check_objects(values: UserValue, height: int, width: int) -> tuple[MapObject, ...]:
    """Returns the objects of a map of `height` rows and `width` columns, checked.

    `values` is a list or tuple of `MapObject`, or of mappings from its fields' names, as map files
    have them.

    Raises:
      InputError: for an unknown kind or field, a position over `BEYOND` tiles outside the map, an
        angle outside -7 to 7 radians, a height outside 0.001 to 10 m, or a tag out of range; the
        message names the object's index and field.
    """
    if not isinstance(values, list | tuple) or isinstance(values, MapObject):
        raise InputError("objects", "a list of objects", quote(values))
    if len(values) > MOST_OBJECTS:
        raise InputError("objects", f"at most {MOST_OBJECTS:,}", f"{len(values):,}")
    return tuple(
        check_named(f"objects: object {index}", check_object, value, height, width)
        for index, value in enumerate(values)
    )


def object_values(thing: MapObject) -> dict[str, Plain]:
    """Returns the fields of an object in a map file.

    Fields with a default, such as the tag and `static`, are left out if they have this default.
    """
    defaults = MapObject._field_defaults
    return {
        name: value
        for name, value in thing._asdict().items()
        if name not in defaults or value != defaults[name]
    }


def check_object(value: UserValue, height: int, width: int) -> MapObject:
    """Returns an object of a map, checked as `check_objects` does.

    The map has `height` rows and `width` columns.
    """
    values = value._asdict() if isinstance(value, MapObject) else value
    if not isinstance(values, Mapping) or "kind" not in values:
        raise InputError("", '{"kind": ..., "x": ..., "y": ...}', quote(value))
    fields = MapObject._fields
    for name in values:
        if name not in fields:
            expected = f"the fields {', '.join(fields)}"
            raise InputError("", expected, quote(name), suggest(name, fields))
    kind = check_kind(values["kind"])
    usual = OBJECT_KINDS[base_kind(kind)].height
    # Tags on the floor have no height, so only 0 fits.
    lowest, highest = (0.001, 10) if usual else (0, 0)
    x = _number("x", values.get("x"), -BEYOND, width + BEYOND, "tiles", slack=_ROUNDED)
    y = _number("y", values.get("y"), -BEYOND, height + BEYOND, "tiles", slack=_ROUNDED)
    angle = _number("angle", values.get("angle", 0.0), -7, 7, "radians")
    object_height = _number("height", values.get("height", usual), lowest, highest, "metres")
    tag, static = values.get("tag"), values.get("static", True)
    if tag is not None:
        if not (is_whole(tag) and 0 <= tag <= LARGEST_TAG):
            got = quote(tag, 40)
            raise InputError("tag", f"a number of the family 36h11, 0 to {LARGEST_TAG}", got)
        tag = int(tag)
    if not is_flag(static):
        raise InputError("static", "true or false", quote(static, 40))
    return MapObject(kind, x, y, angle, object_height, tag, bool(static))


def _number(
    name: str, value: UserValue, least: float, most: float, unit: str, *, slack: float = 0.0
) -> float:
    if not is_real(value) or not least - slack <= value <= most + slack:
        raise InputError(name, f"{unit} from {least:g} to {most:g}", quote(value, 40))
    return float(value)
