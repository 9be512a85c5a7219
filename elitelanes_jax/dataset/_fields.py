"""The fields of a sample's metadata.

The card, the columns of Parquet and Croissant are made from them.
"""

from collections.abc import Mapping
from typing import NamedTuple

from elitelanes_jax._util.types import Plain

WHOLE, NUMBER, TEXT = "whole", "number", "text"
"""The kinds of values."""


class Field(NamedTuple):
    """A field of the metadata.

    Attributes:
      name: its name.
      kind: the kind of its values, `WHOLE`, `NUMBER` or `TEXT`; None for a record.
      axes: the axes of an array of values.
      parts: the fields of a record.
    """

    name: str
    kind: str | None = NUMBER
    axes: int = 0
    parts: tuple["Field", ...] = ()


class FieldGroup(NamedTuple):
    """Fields that one text explains.

    Attributes:
      fields: some fields.
      about: the text, in Markdown.
    """

    fields: tuple[Field, ...]
    about: str


class Contents(NamedTuple):
    """What the samples of a dataset have in their records.

    Attributes:
      metrics: the names of the maps' metrics, and whether each is a whole number on all maps.
      camera: whether they are views from a robot.
      objects: whether objects are drawn.
    """

    metrics: dict[str, bool]
    camera: bool
    objects: bool

    def groups(self) -> list[FieldGroup]:
        """Returns the fields in the order of the metadata; no metrics are a record without parts."""
        metrics = [
            Field(name, WHOLE if counts else NUMBER) for name, counts in self.metrics.items()
        ]
        groups = [*_MAP, _group(_METRICS, _record("metrics", *metrics)), *_PICTURE]
        if self.camera:
            groups += _POSES
        if self.objects:
            box = Field("box", NUMBER, 1)
            parts = [Field("kind", TEXT), Field("instance", WHOLE), box, box._replace(name="whole")]
            parts.append(Field("visible"))
            if self.camera:
                parts.append(Field("distance"))
            groups.append(_group(OBJECTS, Field("objects", None, 1, tuple(parts))))
        return [*groups, _CLASSES]


def add_metrics(metrics: dict[str, bool], table: Mapping[str, Plain] | None) -> None:
    """Adds the metrics of a map to `Contents.metrics`."""
    for name, value in (table or {}).items():
        # A column has one type. A metric that is a fraction on one map is a column of fractions.
        metrics[name] = metrics.get(name, True) and isinstance(value, int)


def _group(about: str, *fields: Field) -> FieldGroup:
    return FieldGroup(fields, about)


def _record(name: str, *parts: Field) -> Field:
    return Field(name, None, 0, parts)


def _numbers(name: str, *names: str) -> Field:
    return _record(name, *map(Field, names))


_METRICS = "the metrics of the map; the command `elitelanes metrics` explains them"

_MAP = (
    _group(
        "the index of the sample in the dataset, from 0; its files have this number",
        Field("number", WHOLE),
    ),
    _group(
        "rows and columns: of the map in tiles, and of the picture in pixels",
        Field("size", WHOLE, 1),
        Field("pixels", WHOLE, 1),
    ),
    _group(
        "the tile code of each cell, 8·N + 4·E + 2·S + 1·W of the sides that are open",
        Field("codes", WHOLE, 2),
    ),
)

_PICTURE = (
    _group(
        "the map's fitness, lower is better, and its bin on each axis of the niches",
        Field("fitness"),
        Field("niche", WHOLE, 1),
    ),
    _group(
        "the seed of the search, and the index of the search's run that found the map",
        Field("map_seed", WHOLE, 1),
    ),
    _group(
        "the tile picture of each cell, and its quarter turns counter-clockwise",
        Field("tiles", TEXT, 2),
        Field("quarter_turns", WHOLE, 2),
    ),
    _group(
        "`matrix` maps points (x, y) of the plain map, in pixels from its top left corner, to "
        "points of the picture; the other values are the light, blur and noise of the picture",
        _record(
            "transform",
            Field("matrix", NUMBER, 2),
            Field("gains", NUMBER, 1),
            *map(Field, ("offset", "blur", "noise")),
            Field("noise_seed", WHOLE),
        ),
    ),
)

_LANE = ("d", "phi", "curvature")

_POSES = (
    _group(
        "the robot's distance to the left of its lane's centre in tiles, the angle in radians by "
        "which it is turned to the left of the lane, and the lane's curvature to the left, in 1 / "
        "tiles; of the lane of `movement`",
        *map(Field, _LANE),
    ),
    _group(
        "the robot's position on the map, `x` east and `y` south in tiles, and `theta`, "
        "counter-clockwise from east, in radians",
        _numbers("pose", "x", "y", "theta"),
    ),
    _group(
        "`d`, `phi` and `curvature` of the nearest lane that leads less than a quarter turn away "
        "from the robot's direction",
        _numbers("nearest", *_LANE),
    ),
    _group(
        "the movement that was drawn at random: the row and the column of a tile, the heading with "
        "which it is entered (0 north, 1 east, 2 south, 3 west), and the turn (0 right, 1 "
        "straight, 2 left)",
        _record("movement", *(Field(name, WHOLE) for name in ("row", "column", "heading", "turn"))),
    ),
    _group(
        "the camera's height and its distance ahead of the robot's middle in metres, its angles in "
        "degrees, the stretch of tiles at their white lines in tiles, the colour of the sky at the "
        "horizon, and k1 and k2 of a lens that distorts",
        _record(
            "camera",
            *map(Field, ("height", "forward", "pitch", "field_of_view", "lines")),
            Field("sky", WHOLE, 1),
            Field("distortion", NUMBER, 1),
        ),
    ),
    _group(
        "tiles from the road's middle to the centre of a lane, to which `d` refers, and the "
        "standard deviation of this offset in the tile set, if it was measured",
        Field("lane_offset"),
        Field("lane_offset_spread"),
    ),
)

_CLASSES = _group("the number of pixels of each label", Field("class_pixels", WHOLE, 1))

OBJECTS = """\
`objects` in the metadata lists the objects that are seen: `kind` (`category` in the layout imagefolder); `instance`
(`id`), the object's number in the mask of instances; `box` (`bbox`), x, y, width and height of what is seen, in pixels;
`whole`, the same for the whole object, as if nothing hid it; `visible`, the share of its pixels that is seen; and, in
views from a robot, `distance` in metres. Objects are background in labels and masks."""
"""The text of a card about objects."""
