"""The options of a robot's camera, and what varies between its views.

These records need no JAX. `elitelanes_jax.drive._camera` registers them as pytrees.
"""

from dataclasses import dataclass
from math import atan, degrees, radians, tan

from elitelanes_jax._util.checks import none_or, real, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record, number_or_array, static, traced
from elitelanes_jax._util.types import Numbers, Numeric, UserValue
from elitelanes_jax._util.words import parse_words

STEEPEST, WIDEST = 90, 175
"""The largest pitch and field of view in degrees after a wobble.

A camera looks straight down at 90, and straight up at -90. At 180, the picture would have no focal
length.
"""

_check_colour = real(0, 255)
_check_distortion = real(-10, 10)


def _colour(value: UserValue) -> tuple[Numeric, ...]:
    if not isinstance(value, tuple | list) or len(value) != 3:
        raise InputError("", "three numbers, 0 to 255, for red, green and blue", quote(value))
    return tuple(map(number_or_array(_check_colour), value))


def _pair(value: UserValue) -> tuple[Numeric, ...]:
    pair = value.split(",") if isinstance(value, str) else value
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError("", "two numbers, k1 and k2", quote(value))
    return tuple(map(number_or_array(_check_distortion), pair))


@dataclass(frozen=True)
class Camera(Record):
    """Options of the camera, by default those of gym-duckietown.

    A camera is a pytree: numbers may be arrays, mapped by `jax.vmap`.

    Attributes:
      height: metres above the ground.
      forward: metres ahead of the middle between the wheels.
      pitch: degrees downwards.
      field_of_view: degrees, from the upper to the lower edge.
      distortion: k1, k2 of the radial distortion x (1 + k1 r² + k2 r⁴), r in focal lengths; None
        for none. Pixels farther out than any point is moved show the farthest point.
      light: factor of all colours.
      noise: standard deviation of each colour, of 255; None for none.
      ground: red, green and blue beyond the map.
      sky: red, green and blue above the horizon.
      rows: the height of the picture in pixels; static.
      columns: the width of the picture in pixels; static.
      objects: the most standing objects that are shown, the nearest ones, and in `views` also the
        most objects on the floor; None for all; static.
    """

    height: Numeric = traced(0.108, real(0, 10, exclusive=True))
    forward: Numeric = traced(0.066, real(-1, 1))
    pitch: Numeric = traced(19.15, real(-90, 90))
    field_of_view: Numeric = traced(75.0, real(1, 170))
    distortion: Numbers | None = traced(None, none_or(_pair), _check_distortion)
    light: Numeric = traced(1.0, real(0, 10))
    noise: Numeric | None = traced(None, none_or(real(0, 255)))
    ground: Numbers = traced((86.0, 118.0, 72.0), _colour, _check_colour)
    sky: Numbers = traced((115.0, 210.0, 255.0), _colour, _check_colour)
    rows: int = static(48, whole(1, 4096))
    columns: int = static(64, whole(1, 4096))
    objects: int | None = static(8, none_or(whole(1, 64)))


@dataclass(frozen=True)
class PoseRanges(Record):
    """The ranges of poses on the lanes of a map, and of what differs between robots and labs.

    Attributes:
      offset: largest distance from the lane's centre in tiles, either way, 0 to 0.2.
      heading: largest angle from the lane's direction in degrees, either way, 0 to 180.
      wobble: largest change of the camera's height, pitch and field of view, either way, as a
        share, 0 to 0.5.
      lines: largest stretch of a tile at its white lines, in tiles, 0 to 0.08. With 0.07 the lines
        shift outwards by up to 0.04 and inwards by up to 0.13. The middle of the road and the
        tile's edges stay.
    """

    offset: Numeric = traced(0.1, real(0, 0.2))
    heading: Numeric = traced(30.0, real(0, 180))
    wobble: Numeric = traced(0.05, real(0, 0.5))
    lines: Numeric | None = traced(None, none_or(real(0, 0.08)))


@dataclass(frozen=True)
class Variation(PoseRanges):
    """The ranges of views.

    Each value of a picture is drawn uniformly from its range. None leaves a step out. A variation
    is a pytree: a number may also be an array ``[batch]``, with a range for each picture.

    Attributes:
      horizon: share of the pictures with the sky of one of gym-duckietown's horizons, 0 to 1.
      haze: largest difference between the sky at the picture's upper edge and at the horizon, in
        grey levels of each colour, either way, 0 to 128.
      background: share of the pictures with random patterns instead of plain ground and sky, 0 to
        1.
      shadow: largest share of the light that a shadow takes, 0 to 1.
      vignette: largest share of the light that the corners lose, 0 to 1.
      gamma: largest change of the tone curve's exponent, either way, as a power of 2, 0 to 2.
      saturation: largest change of the colours' distance from grey, either way, as a share, 0 to 1.
      warmth: largest change of red against blue, either way, as a share, 0 to 0.5.
      light: largest change of brightness, either way, as a share, 0 to 1.
      contrast: largest change of contrast, either way, as a share, 0 to 1.
      colour: largest change of each channel alone, either way, as a share, 0 to 1.
      motion: longest motion blur in pixels, 0 to 2.9.
      blur: largest standard deviation of a Gaussian blur in pixels, 0 to 1.
      noise: largest standard deviation of noise in grey levels, 0 to 64.
    """

    horizon: Numeric | None = traced(None, none_or(real(0, 1)))
    haze: Numeric | None = traced(None, none_or(real(0, 128)))
    background: Numeric | None = traced(None, none_or(real(0, 1)))
    shadow: Numeric | None = traced(None, none_or(real(0, 1)))
    vignette: Numeric | None = traced(None, none_or(real(0, 1)))
    gamma: Numeric | None = traced(None, none_or(real(0, 2)))
    saturation: Numeric | None = traced(None, none_or(real(0, 1)))
    warmth: Numeric | None = traced(None, none_or(real(0, 0.5)))
    light: Numeric | None = traced(None, none_or(real(0, 1)))
    contrast: Numeric | None = traced(None, none_or(real(0, 1)))
    colour: Numeric | None = traced(None, none_or(real(0, 1)))
    motion: Numeric | None = traced(None, none_or(real(0, 2.9)))
    blur: Numeric | None = traced(None, none_or(real(0, 1)))
    noise: Numeric | None = traced(None, none_or(real(0, 64)))

    @classmethod
    def varied(cls) -> "Variation":
        """Returns the ranges of ``dataset --transform varied``, without its compression."""
        return cls(
            horizon=1,
            background=0.8,
            shadow=0.6,
            vignette=0.5,
            gamma=0.6,
            saturation=0.5,
            warmth=0.2,
            light=0.3,
            contrast=0.4,
            colour=0.1,
            motion=2,
            blur=0.8,
            noise=8,
        )


@dataclass(frozen=True)
class LaneCamera(Camera, PoseRanges):
    """A camera at random poses on the lanes of maps, as datasets have it.

    All objects are shown.
    """

    rows: int = static(480, whole(16, 4096))
    columns: int = static(640, whole(16, 4096))
    objects: int | None = static(None, none_or(whole(1, 64)))


_WORDS = (
    *("rows", "columns", "offset", "heading", "height", "forward", "pitch", "field_of_view"),
    *("distortion", "wobble", "lines"),
)


def parse_camera(value: UserValue) -> LaneCamera:
    """Reads a camera from words such as ``["rows=120", "columns=160"]``.

    Also takes a mapping of fields, or a `LaneCamera`. No field is an array, because a dataset has
    one camera. Raises `InputError`.
    """
    camera = parse_words("camera", LaneCamera(), value, "setting", "'rows=120'", names=_WORDS)
    for name, setting in camera.values().items():
        if hasattr(setting, "dtype"):
            raise InputError(name, "a number", quote(setting))
    return camera


def sees_ground(camera: LaneCamera) -> bool:
    """Returns whether the lower edge of a picture may be below the horizon, after any wobble."""
    pitch = max(camera.pitch * (1 - camera.wobble), camera.pitch * (1 + camera.wobble))
    below_axis = min(camera.field_of_view * (1 + camera.wobble), WIDEST) / 2
    if camera.distortion is not None:
        # A lens moves a ray outwards by a factor of at most 9 / 4, see `_camera._undistort`.
        below_axis = degrees(atan(9 / 4 * tan(radians(below_axis))))
    return bool(pitch + below_axis > 0)
