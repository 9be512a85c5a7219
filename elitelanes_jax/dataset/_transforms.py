"""The ranges of views of a map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from elitelanes_jax._util.checks import check_unique, flag, is_whole, real, whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.records import Record, option
from elitelanes_jax._util.types import UserValue


def _parse_scale(scale: UserValue) -> tuple[float, float]:
    pair = scale.split("..") if isinstance(scale, str) else scale if isinstance(scale, Sequence) else [scale]
    factors = [real(0.25, 4)(factor) for factor in pair]
    if len(factors) not in (1, 2) or factors[0] > factors[-1]:
        raise InputError(f"expected a factor, or the smallest and the largest such as 0.5..1.5, got {scale!r}")
    return factors[0], factors[-1]


def _check_crop(crop: UserValue) -> int:
    return 0 if crop == "0" or (is_whole(crop) and crop == 0) else whole(16, 2**15 - 1)(crop)


@dataclass(frozen=True)
class Transforms(Record):
    """The ranges of views; each value is drawn uniformly from its range. By default nothing varies.

    Attributes:
      quarter_turns: whether maps are rotated by quarter turns.
      rotation: largest free rotation in degrees, either way, 0 to 180.
      scale: smallest and largest factor, 0.25 to 4.
      perspective: largest shift of each corner, as a share of the map's side, 0 to 0.2: a camera not quite overhead.
      crop: side in pixels of a square window in the map, 16 or more, or 0 for the whole picture.
      light: largest change of brightness, either way, as a share, 0 to 1.
      contrast: largest change of contrast, either way, as a share, 0 to 1.
      colour: largest change of each channel alone, either way, as a share, 0 to 1.
      blur: largest standard deviation of a Gaussian blur in pixels, 0 to 20.
      noise: largest standard deviation of Gaussian noise in grey levels, 0 to 64.
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


STANDARD = Transforms(True, 5, (0.9, 1.1), 0.04, light=0.2, contrast=0.2, colour=0.06, blur=0.8, noise=2)
"""Roughly the views of a camera over a real floor."""


GEOMETRY = ("quarter_turns", "rotation", "scale", "perspective", "crop")
"""The fields of `Transforms` for the camera's position. The others change light and pixels."""


def parse_transforms(texts: UserValue) -> Transforms:
    """Reads transforms such as ``["standard", "noise=0"]`` or ``["quarter-turns", "scale=0.5..1.5"]``.

    Args:
      texts: words, one or several: ``standard`` for `STANDARD`, ``none``, ``quarter-turns``, or ``NAME=NUMBER`` with a
        field of `Transforms`, for ``scale`` also ``scale=LOW..HIGH``; ``standard`` and ``none`` come first. Or a
        mapping of a transform's fields, or a `Transforms`.

    Raises:
      InputError: for anything else, or a number out of its range.
    """
    if isinstance(texts, Transforms):
        return texts
    if isinstance(texts, Mapping):
        return Transforms().replace(**{str(name): value for name, value in texts.items()})
    words = [texts] if isinstance(texts, str) else texts
    if not isinstance(words, Sequence) or not all(isinstance(word, str) for word in words):
        raise InputError(f"transforms: expected words such as 'standard' or 'noise=0', got {shorten(repr(texts))}")
    transforms, numbers = Transforms(), [name for name in Transforms.options() if name != "quarter_turns"]
    check_unique("transforms", "transform", [text.partition("=")[0] for text in words])
    late = set(words[1:]) & {"none", "standard"}
    if late:
        raise InputError(f"transforms: expected {late.pop()} alone or first, because it sets all transforms")
    for text in words:
        name, equals, value = text.partition("=")
        if text in ("none", "standard"):
            transforms = STANDARD if text == "standard" else Transforms()
        elif text == "quarter-turns":
            transforms = transforms.replace(quarter_turns=True)
        elif equals and name in numbers:
            transforms = transforms.replace(**{name: value})
        else:
            known = ", ".join(("none", "standard", "quarter-turns", *(f"{number}=..." for number in numbers)))
            raise InputError(f"transforms: expected some of {known}, got {text!r}")
    return transforms
