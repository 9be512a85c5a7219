"""The options of a camera on a robot, for datasets of its views."""

from dataclasses import dataclass

from elitelanes_jax._util.checks import real, whole
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.dataset._transforms import parse_words


@dataclass(frozen=True)
class Viewpoints(Record):
    """Poses on the lanes of a map, and the camera there, by default gym-duckietown's.

    Attributes:
      rows: of a picture, in pixels, 16 to 4096.
      columns: of a picture, in pixels, 16 to 4096.
      offset: largest distance from the lane's centre in tiles, either way, 0 to 0.2.
      heading: largest angle from the lane's direction in degrees, either way, 0 to 180.
      height: of the camera above the ground in metres, 0.01 to 10.
      forward: metres from the middle between the wheels ahead to the camera, -1 to 1.
      pitch: degrees downwards, 0 to 90.
      field_of_view: degrees, from the upper to the lower edge, 1 to 170.
      wobble: largest change of height, pitch and field of view, either way, as a share, 0 to 0.5.
      lines: largest shift of the white lines, outwards or inwards, in tiles, 0 to 0.08. The middle of the road and the
        tile's edges stay, and what lies between is stretched: line positions and widths differ between labs.
    """

    rows: int = option(480, whole(16, 4096))
    columns: int = option(640, whole(16, 4096))
    offset: float = option(0.1, real(0, 0.2))
    heading: float = option(30.0, real(0, 180))
    height: float = option(0.108, real(0.01, 10))
    forward: float = option(0.066, real(-1, 1))
    pitch: float = option(19.15, real(0, 90))
    field_of_view: float = option(75.0, real(1, 170))
    wobble: float = option(0.05, real(0, 0.5))
    lines: float = option(0.0, real(0, 0.08))


def parse_viewpoints(texts: UserValue) -> Viewpoints:
    """Reads options such as ``["rows=120", "columns=160", "heading=45"]``; all have defaults.

    Args:
      texts: words, one or several, a mapping of numbers by name, or a `Viewpoints`.

    Raises:
      InputError: for anything but ``NAME=NUMBER`` with a field of `Viewpoints`, or a number out of its range.
    """
    return parse_words("camera", Viewpoints(), texts, "setting", "'rows=120'")
