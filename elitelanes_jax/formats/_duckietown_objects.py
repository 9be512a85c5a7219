"""The objects of Duckietown's map files.

There are four ways to say where an object is. A ``pose`` is in metres from the south-west corner of the map. A
``place`` is in metres from the middle of a tile, with tiles counted from that corner. An ``attach`` is one of eight
slots around a tile's south-west corner. A ``pos`` is in tiles from the north-west corner, with y to the south, as the
comments in the maps say, and ``rotate`` is counter-clockwise.

Objects are written with a ``pose``: duckietown-world 6.4.3 and gym-duckietown 6.1.34 agree on it. A ``pos`` they move
by one tile to the south and turn the other way round, and on maps that are not square they differ.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import cos, degrees, isfinite, pi, radians, remainder, sin

from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.errors import InputError, brief, shorten
from elitelanes_jax._util.types import Plain
from elitelanes_jax.formats.objects import OBJECT_KINDS, OTHER, MapObject, base_kind, check_kind
from elitelanes_jax.formats.tags import STREET_NAMES, TAG_SIZE

TAG_FAMILY = "36h11"
"""The family of all tags."""

FALSE = [spell(word) for word in ("false", "no", "off") for spell in (str.lower, str.title, str.upper)]
"""What YAML 1.1 reads as false."""

# What readers of YAML take for a truth value or for nothing.
_YAML_WORDS = ("null", "true", "false", "yes", "no", "on", "off", "y", "n")

# As duckietown-world names them.
_OF_MAP = {"sign_1_way_left": "sign_oneway_left", "sign_1_way_right": "sign_oneway_right"}

# gym-duckietown needs a picture of each sign, and has none of street names.
_STREET_NAME, _BLANK = "sign_street_name", "sign_blank"

# Metres from the corner east and north, by slot.
_LONG, _SHORT = 0.09, 0.035
_SLOTS = (
    *((_LONG, _SHORT), (_SHORT, _LONG), (-_SHORT, _LONG), (-_LONG, _SHORT)),
    *((-_LONG, -_SHORT), (-_SHORT, -_LONG), (_SHORT, -_LONG), (_LONG, -_SHORT)),
)

# In Duckietown a traffic light is at the middle of its mesh and faces a quarter turn to the left of its arm. So far
# is its stand from there, by the height.
_STAND = 0.27 / 0.4


def write_objects(objects: Sequence[MapObject], rows: int, tile_size: float) -> str:
    """Returns the text of the objects of a map file; "" without objects. `rows` is the height of the map in tiles."""
    lines = []
    for index, thing in enumerate(objects):
        x, y, angle = thing.x * tile_size, (rows - thing.y) * tile_size, thing.angle
        if thing.kind == "trafficlight":
            offset = _STAND * thing.height
            x, y, angle = x + offset * cos(angle), y + offset * sin(angle), angle + pi / 2
        turned = _number(degrees(remainder(angle, 2 * pi)))
        kind = _BLANK if thing.kind == _STREET_NAME else thing.kind.removeprefix(OTHER)
        lines += [f"  {_yaml_text(f'{kind}_{index}')}:", f"    kind: {_yaml_text(kind)}"]
        lines += [f"    pose: {{~SE2Transform: {{p: [{_number(x)}, {_number(y)}], theta_deg: {turned}}}}}"]
        lines += [f"    height: {_number(thing.height)}"] * (thing.height > 0)
        if thing.tag is not None and (thing.kind == "floor_tag" or thing.kind.startswith("sign_")):
            lines.append(f"    tag: {{~TagInstance: {{family: {TAG_FAMILY}, size: {TAG_SIZE}, tag_id: {thing.tag}}}}}")
        lines += ["    static: false"] * (not thing.static)
    return "".join(f"{line}\n" for line in ("objects:", *lines)) if objects else ""


def _yaml_text(text: str) -> str:
    """Returns a text of letters, digits, dots and dashes as YAML has it, in quotes if it could be something else."""
    return f"'{text}'" if text[0].isdigit() or text.lower() in _YAML_WORDS else text


def read_objects(values: Plain, rows: int, tile_size: float) -> list[MapObject]:
    """Reads what a map file has under "objects", a list or a table by names.

    Raises:
      InputError: for anything else, or an object that cannot be read; the message names the object.
    """
    named = dict(enumerate(values)) if isinstance(values, list) else values
    if not isinstance(named, dict):
        raise InputError(f"objects: expected a list or a table of objects, got {brief(values)}")
    return [
        check_named(f"objects: {shorten(str(name), 40)}", _read, value, rows, tile_size)
        for name, value in named.items()
    ]


def _read(value: Plain, rows: int, tile_size: float) -> MapObject:
    if not isinstance(value, dict) or not isinstance(value.get("kind"), str):
        raise InputError(f'expected {{"kind": ...}}, got {brief(value)}')
    given = str(value["kind"])
    kind = _OF_MAP.get(given, given) if given in {*_OF_MAP, *OBJECT_KINDS} else check_kind(OTHER + given)
    x, y, angle = _pose(value, rows, tile_size)
    usual = OBJECT_KINDS[base_kind(kind)].height
    height = real_of(value, "height", usual) if usual else 0.0
    if kind == "trafficlight":
        angle -= pi / 2
        offset = _STAND * height / tile_size
        x, y = x - offset * cos(angle), y + offset * sin(angle)
    tag = whole_of(table_of(value["tag"], "~TagInstance"), "tag_id") if "tag" in value else None
    if kind == _BLANK and tag in STREET_NAMES:
        kind = _STREET_NAME
    return MapObject(kind, x, y, remainder(angle, 2 * pi), height, tag, value.get("static") not in FALSE)


def _pose(value: Mapping[str, Plain], rows: int, tile_size: float) -> tuple[float, float, float]:
    """Returns x, y and the angle of an object."""
    rotate = radians(real_of(value, "rotate", 0.0))
    if "attach" in value:  # before the pose, whose position it replaces
        attach = table_of(value, "attach")
        column, row = _pair(attach, "tile")
        slot = whole_of(attach, "slot")
        if slot not in range(len(_SLOTS)):
            raise InputError(f"slot: expected a whole number, 0 to {len(_SLOTS) - 1}, got {slot}")
        east, north = _SLOTS[slot]
        if "pose" in value:
            rotate = radians(real_of(table_of(value["pose"], "~SE2Transform"), "theta_deg", 0.0))
    elif "pos" in value:
        return *_pair(value, "pos"), rotate
    elif "pose" in value:
        column, row = 0.0, 0.0
        east, north, rotate = _transform(value["pose"])
    elif "place" in value:
        place = table_of(value, "place")
        column, row = (at + 0.5 for at in _pair(place, "tile"))
        east, north, rotate = _transform(place.get("relative"))
    else:
        raise InputError("expected a pose, pos, place or attach, got none")
    return column + east / tile_size, rows - row - north / tile_size, rotate


def _transform(value: Plain) -> tuple[float, float, float]:
    inner = table_of(value, "~SE2Transform")
    turned = real_of(inner, "theta") if "theta" in inner else radians(real_of(inner, "theta_deg", 0.0))
    return *_pair(inner, "p", (0.0, 0.0)), turned


def table_of(value: Plain, name: str) -> dict[str, Plain]:
    """Returns the table under a name; raises an `InputError` that starts with the name if there is none."""
    inner = value.get(name) if isinstance(value, dict) else None
    if not isinstance(inner, dict):
        raise InputError(f"{name}: expected a table, got {brief(inner, 40)}")
    return inner


def _pair(values: Mapping[str, Plain], name: str, default: tuple[float, float] | None = None) -> tuple[float, float]:
    listed = values.get(name, default)
    if not isinstance(listed, list | tuple) or len(listed) not in (2, 3):
        raise InputError(f"{name}: expected two numbers, got {brief(listed, 40)}")
    first, second = ({name: one} for one in listed[:2])
    return real_of(first, name), real_of(second, name)


def real_of(values: Mapping[str, Plain], name: str, default: float | None = None) -> float:
    """Returns the number under a name.

    Raises:
      InputError: if there is no finite number; the message starts with the name.
    """
    text = values.get(name, default)
    with suppress(TypeError, ValueError):
        if not isinstance(text, list | dict) and "_" not in str(text) and isfinite(number := float(text)):
            return number
    raise InputError(f"{name}: expected a number, got {brief(text, 40)}")


def whole_of(values: Mapping[str, Plain], name: str) -> int:
    """Returns the whole number under a name; raises as `real_of` does."""
    number = real_of(values, name)
    if not number.is_integer():
        raise InputError(f"{name}: expected a whole number, got {number:g}")
    return int(number)


def _number(value: float) -> str:
    """Returns a number with six decimals at most."""
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").removesuffix(".") or "0"
