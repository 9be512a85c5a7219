"""Styles: named options of a search, in TOML files of the package or of users."""

from collections.abc import Mapping
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import NamedTuple

from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.files import read_toml
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.problem.ranges import Range

FOLDER = Path(__file__).parent / "styles"
"""The folder of the package's own styles."""

STYLES = ("paper", "town")
"""The names of the package's own styles.

`paper` has no options, so it equals a search without a style.
"""


CROSSING = Range("crossings", Fraction(1), None)
"""The range that the style `town` adds for small maps that can have a crossing.

Without it, 18 of 50 towns of 8 x 8 are rings.
"""


class Style(NamedTuple):
    """A style that was read.

    Attributes:
      name: the name of the style, or the path of its file.
      options: values by name, not yet checked.
    """

    name: str
    options: Mapping[str, UserValue]


def read_style(style: UserValue) -> Style:
    """Reads a style: one of `STYLES`, the path of a file that ends in ``.toml``, or a `Style`.

    Raises:
      InputError: for an unknown name, or a file that cannot be read or is not TOML.
    """
    if isinstance(style, Style):
        return style
    text = str(style) if isinstance(style, str | Path) else ""
    if text in STYLES:
        return _read_own(text)
    if not text.endswith(".toml"):
        names = f"one of {', '.join(STYLES)}, or a file that ends in .toml"
        raise InputError("style", names, quote(style, 40), suggest(text, STYLES))
    return Style(text, read_toml(text, f"style {text!r}"))


@cache
def _read_own(name: str) -> Style:
    return Style(name, read_toml(FOLDER / f"{name}.toml", f"style {name!r}"))
