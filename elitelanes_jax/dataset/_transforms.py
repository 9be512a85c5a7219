"""The ranges of views of a map."""

from collections.abc import Sequence
from dataclasses import dataclass

from elitelanes_jax._util.checks import flag, real, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import UserValue
from elitelanes_jax._util.words import parse_words
from elitelanes_jax.drive.camera_options import Variation


def range_ends(value: UserValue) -> Sequence[UserValue]:
    """Returns the ends of a range: of a text such as ``8..14``, of a pair, or of a single value.

    A text that lacks an end has none.
    """
    if isinstance(value, str):
        ends = value.split("..")
        return ends if all(ends) else []
    if isinstance(value, Sequence):
        return value
    return [value]


def _parse_scale(scale: UserValue) -> tuple[float, float]:
    factors = [real(0.25, 4)(factor) for factor in range_ends(scale)]
    if len(factors) not in (1, 2) or factors[0] > factors[-1]:
        raise InputError(
            "", "a factor, or the smallest and the largest such as 0.5..1.5", quote(scale)
        )
    return factors[0], factors[-1]


def _check_crop(crop: UserValue) -> int:
    # A crop of 0 means the whole picture.
    return 0 if str(crop) == "0" else whole(16, 2**15 - 1)(crop)


@dataclass(frozen=True)
class Transforms(Record):
    """The ranges of views; each value is drawn uniformly from its range. By default nothing varies.

    Attributes:
      quarter_turns: whether maps are rotated by quarter turns.
      rotation: largest free rotation in degrees, either way, 0 to 180.
      scale: smallest and largest factor, 0.25 to 4; its logarithm is drawn uniformly.
      perspective: largest shift of each corner, as a share of the map's side, 0 to 0.2: a camera
        not quite overhead.
      crop: side in pixels of a square window in the map, 16 or more, or 0 for the whole picture.
      light: largest change of brightness, either way, as a share, 0 to 1.
      contrast: largest change of contrast, either way, as a share, 0 to 1.
      colour: largest change of each channel alone, either way, as a share, 0 to 1.
      blur: largest standard deviation of a Gaussian blur in pixels, 0 to 20.
      noise: largest standard deviation of Gaussian noise in grey levels, 0 to 64.
      background: share of the pictures with random patterns instead of plain ground and sky, 0 to
        1.
      shadow: largest share of the light that a shadow takes, 0 to 1.
      vignette: largest share of the light that the corners lose, 0 to 1.
      gamma: largest change of the tone curve's exponent, either way, as a power of 2, 0 to 2.
      saturation: largest change of the colours' distance from grey, either way, as a share, 0 to 1.
      warmth: largest change of red against blue, either way, as a share, 0 to 0.5: the colour
        temperature.
      motion: longest motion blur in pixels, 0 to 100.
      compression: lowest quality of JPEG, from 0 for no compression to 1 for a quality of 10.
    """

    quarter_turns: bool = option(False, flag)
    rotation: float = option(0.0, real(0, 180))
    scale: tuple[float, float] = option((1.0, 1.0), _parse_scale)
    perspective: float = option(0.0, real(0, 0.2))
    crop: int = option(0, _check_crop)
    light: float = option(0.0, real(0, 1))
    contrast: float = option(0.0, real(0, 1))
    colour: float = option(0.0, real(0, 1))
    blur: float = option(0.0, real(0, 20))
    noise: float = option(0.0, real(0, 64))
    background: float = option(0.0, real(0, 1))
    shadow: float = option(0.0, real(0, 1))
    vignette: float = option(0.0, real(0, 1))
    gamma: float = option(0.0, real(0, 2))
    saturation: float = option(0.0, real(0, 1))
    warmth: float = option(0.0, real(0, 0.5))
    motion: float = option(0.0, real(0, 100))
    compression: float = option(0.0, real(0, 1))


STANDARD = Transforms(
    True, 5, (0.9, 1.1), 0.04, light=0.2, contrast=0.2, colour=0.06, blur=0.8, noise=2
)
"""Roughly the views of a camera over a real floor."""

# The camera of environments has the same ranges, and some that only its views have.
VARIED = STANDARD.replace(
    compression=0.5,
    **{
        name: value
        for name, value in Variation.varied().values().items()
        if name in Transforms.options()
    },
)
"""Views that differ so much that a network that was trained on them works in other worlds."""

PRESETS = {"none": Transforms(), "standard": STANDARD, "varied": VARIED}
"""The words that set all transforms."""

GEOMETRY = ("quarter_turns", "rotation", "scale", "perspective", "crop")
"""The fields of `Transforms` for the camera's position. The others change light and pixels."""

VARIATION = (
    "background",
    "shadow",
    "vignette",
    "gamma",
    "saturation",
    "warmth",
    "motion",
    "compression",
)
"""The fields of `Transforms` whose values are drawn after all others.

Therefore they change no other value.
"""


def for_camera(transforms: Transforms) -> Transforms:
    """Returns transforms of light and pixels alone, for a camera, which has its own positions.

    Raises:
      InputError: if other fields of `GEOMETRY` are set than those of `STANDARD` together.
    """
    still, usual, asked = (
        {name: getattr(some, name) for name in GEOMETRY}
        for some in (Transforms(), STANDARD, transforms)
    )
    # The geometry of `STANDARD` is that of the default and of `VARIED`. It is dropped without an
    # error, because the user may not have asked for it.
    if asked not in (still, usual):
        changed = [name for name in GEOMETRY if asked[name] != still[name]]
        others = [name for name in changed if asked[name] != usual[name]]
        raise InputError(
            "transforms",
            "changes of light and pixels with a camera, which has its own positions",
            (others or changed)[0].replace("_", "-"),
        )
    return transforms.replace(**still)


def parse_transforms(texts: UserValue) -> Transforms:
    """Reads transforms from words such as ``["standard", "noise=0"]``.

    Another example is ``["quarter-turns", "scale=0.5..1.5"]``. The words are a name in `PRESETS`,
    which comes first, ``quarter-turns``, or ``NAME=NUMBER`` with a field of `Transforms`. Also
    takes a mapping of fields, or a `Transforms`. Raises `InputError`.
    """
    return parse_words(
        "transforms",
        Transforms(),
        texts,
        "transform",
        "'standard' or 'noise=0'",
        presets=PRESETS,
    )
