"""The objects of Duckietown's map files.

There are four ways to say where an object is. A ``pose`` is in metres from the south-west corner of
the map. A ``place`` is in metres from the middle of a tile, with tiles counted from that corner. An
``attach`` is one of eight slots around a tile's south-west corner. A ``pos`` is in tiles from the
north-west corner, with y to the south, as the comments in the maps say, and ``rotate`` is
counter-clockwise.

Objects are written with a ``pose``: duckietown-world 6.4.3 and gym-duckietown 6.1.34 agree on it.
Both programs move a ``pos`` one tile to the south and turn it the other way. They differ on maps
that are not square.
"""

from collections.abc import Mapping, Sequence
from math import cos, degrees, pi, radians, remainder, sin

from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.errors import InputError, brief, shorten
from elitelanes_jax._util.types import Plain
from elitelanes_jax.formats._yaml_values import FALSE, real_of, table_of, whole_of
from elitelanes_jax.formats.objects import OBJECT_KINDS, OTHER, MapObject, base_kind, check_kind
from elitelanes_jax.formats.tags import STREET_NAMES, TAG_FAMILY, TAG_SIZE

# The words that readers of YAML take for a truth value or for nothing.
_YAML_WORDS = ("null", "true", "false", "yes", "no", "on", "off", "y", "n")

# Two kinds have other names in duckietown-world.
_KIND_OF_MAP_NAME = {"sign_1_way_left": "sign_oneway_left", "sign_1_way_right": "sign_oneway_right"}

# A street name sign is written as a blank sign, because gym-duckietown needs a picture of each sign,
# and it has no picture of a street name.
_STREET_NAME, _BLANK = "sign_street_name", "sign_blank"

# The position of each slot: metres east and north of the tile's south-west corner.
_LONG, _SHORT = 0.09, 0.035
_SLOTS = (
    (_LONG, _SHORT),
    (_SHORT, _LONG),
    (-_SHORT, _LONG),
    (-_LONG, _SHORT),
    (-_LONG, -_SHORT),
    (-_SHORT, -_LONG),
    (_SHORT, -_LONG),
    (_LONG, -_SHORT),
)

# Duckietown places a traffic light at the middle of its mesh, facing a quarter turn to the left of
# its arm. This is the distance from there to its stand, as a share of the height.
_STAND = 0.27 / 0.4


def write_objects(objects: Sequence[MapObject], rows: int, tile_size: float) -> str:
    """Returns the text of the objects of a map file; "" without objects.

    `rows` is the height of the map in tiles.
    """
    if not objects:
        return ""
    lines = ["objects:"]
    for index, item in enumerate(objects):
        kind = _BLANK if item.kind == _STREET_NAME else item.kind.removeprefix(OTHER)
        x, y, angle = _written_pose(item, rows, tile_size)
        turned = _number(degrees(remainder(angle, 2 * pi)))
        # Only signs and floor tags may have tags in duckietown-world.
        has_tag = item.kind == "floor_tag" or item.kind.startswith("sign_")
        # The index makes each name unique.
        lines.append(f"  {_yaml_text(f'{kind}_{index}')}:")
        lines.append(f"    kind: {_yaml_text(kind)}")
        lines.append(
            f"    pose: {{~SE2Transform: {{p: [{_number(x)}, {_number(y)}], theta_deg: {turned}}}}}"
        )
        if item.height > 0:
            lines.append(f"    height: {_number(item.height)}")
        if item.tag is not None and has_tag:
            tag = f"family: {TAG_FAMILY}, size: {TAG_SIZE}, tag_id: {item.tag}"
            lines.append(f"    tag: {{~TagInstance: {{{tag}}}}}")
        if not item.static:
            lines.append("    static: false")
    return "".join(f"{line}\n" for line in lines)


def _written_pose(item: MapObject, rows: int, tile_size: float) -> tuple[float, float, float]:
    """Returns x and y in metres from the south-west corner, and the angle, as a file has them."""
    x, y, angle = item.x * tile_size, (rows - item.y) * tile_size, item.angle
    if item.kind == "trafficlight":
        offset = _STAND * item.height
        return x + offset * cos(angle), y + offset * sin(angle), angle + pi / 2
    return x, y, angle


def _yaml_text(text: str) -> str:
    """Returns a text of letters, digits, dots and dashes as YAML has it.

    The text is in quotes if YAML could read it as something else.
    """
    if text[0].isdigit() or text.lower() in _YAML_WORDS:
        return f"'{text}'"
    return text


def read_objects(values: Plain, rows: int, tile_size: float) -> list[MapObject]:
    """Reads what a map file has under "objects", a list or a table by names.

    Raises:
      InputError: for anything else, or an object that cannot be read; the message names the object.
    """
    named = dict(enumerate(values)) if isinstance(values, list) else values
    if not isinstance(named, dict):
        raise InputError("objects", "a list or a table of objects", brief(values))
    objects = []
    for name, value in named.items():
        objects.append(
            check_named(f"objects: {shorten(str(name), 40)}", _read, value, rows, tile_size)
        )
    return objects


def _read(value: Plain, rows: int, tile_size: float) -> MapObject:
    if not isinstance(value, dict) or not isinstance(value.get("kind"), str):
        raise InputError("", '{"kind": ...}', brief(value))
    name = str(value["kind"])
    if name in _KIND_OF_MAP_NAME or name in OBJECT_KINDS:
        kind = _KIND_OF_MAP_NAME.get(name, name)
    else:
        kind = check_kind(OTHER + name)
    x, y, angle = _pose(value, rows, tile_size)
    usual = OBJECT_KINDS[base_kind(kind)].height
    if usual and "scale" in value and "height" not in value:
        # The scale is that of a mesh of gym-duckietown, whose size is not in the file.
        raise InputError("scale", "a height in metres instead", "a scale")
    height = real_of(value, "height", usual) if usual else 0.0
    # This is the inverse of `_written_pose`.
    if kind == "trafficlight":
        angle -= pi / 2
        offset = _STAND * height / tile_size
        x, y = x - offset * cos(angle), y + offset * sin(angle)
    tag = None
    if "tag" in value:
        tag = whole_of(table_of(value["tag"], "~TagInstance"), "tag_id")
    # A blank sign with the tag of a street name is a street name sign, see `_STREET_NAME`.
    if kind == _BLANK and tag in STREET_NAMES:
        kind = _STREET_NAME
    return MapObject(
        kind, x, y, remainder(angle, 2 * pi), height, tag, value.get("static") not in FALSE
    )


def _pose(value: Mapping[str, Plain], rows: int, tile_size: float) -> tuple[float, float, float]:
    """Returns x, y and the angle of an object."""
    rotate = radians(real_of(value, "rotate", 0.0))
    if "attach" in value:
        # The slot comes before the pose, because an attached object may also have a pose. Only the
        # angle of that pose counts.
        attach = table_of(value, "attach")
        column, row = _pair(attach, "tile")
        slot = whole_of(attach, "slot")
        if slot not in range(len(_SLOTS)):
            got = shorten(str(slot), 40)
            raise InputError("slot", f"a whole number, 0 to {len(_SLOTS) - 1}", got)
        east, north = _SLOTS[slot]
        if "pose" in value:
            rotate = _angle(table_of(value["pose"], "~SE2Transform"))
    elif "pos" in value:
        # A `pos` is already in tiles from the north-west corner.
        x, y = _pair(value, "pos")
        return x, y, rotate
    elif "pose" in value:
        column, row = 0.0, 0.0
        east, north, rotate = _transform(value["pose"])
    elif "place" in value:
        place = table_of(value, "place")
        tile_column, tile_row = _pair(place, "tile")
        column, row = tile_column + 0.5, tile_row + 0.5
        east, north, rotate = _transform(place.get("relative"))
    else:
        raise InputError("", "a pose, pos, place or attach", "none")
    return column + east / tile_size, rows - row - north / tile_size, rotate


def _transform(value: Plain) -> tuple[float, float, float]:
    """Returns x and y in metres, and the angle."""
    transform = table_of(value, "~SE2Transform")
    x, y = _pair(transform, "p", (0.0, 0.0))
    return x, y, _angle(transform)


def _angle(transform: Mapping[str, Plain]) -> float:
    """Returns the angle of a transform in radians."""
    if "theta" in transform:
        return real_of(transform, "theta")
    return radians(real_of(transform, "theta_deg", 0.0))


def _pair(
    values: Mapping[str, Plain], name: str, default: tuple[float, float] | None = None
) -> tuple[float, float]:
    """Returns two numbers under a name. A third one, a height, is ignored."""
    listed = values.get(name, default)
    if not isinstance(listed, list | tuple) or len(listed) not in (2, 3):
        raise InputError(name, "two numbers", brief(listed, 40))
    return real_of({name: listed[0]}, name), real_of({name: listed[1]}, name)


def _number(value: float) -> str:
    """Returns a number with six decimals at most."""
    # Adding 0.0 turns -0.0 into 0.0.
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").removesuffix(".") or "0"
