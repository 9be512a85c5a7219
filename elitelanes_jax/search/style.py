"""Styles: settings of a search by name, as TOML files, the package's own and those of users alike."""

import tomllib
from collections.abc import Collection
from pathlib import Path

from elitelanes_jax._util.errors import InputError, reason, shorten, suggest
from elitelanes_jax._util.files import MIB, read_text
from elitelanes_jax._util.types import UserValue

FOLDER = Path(__file__).parent / "styles"
"""The folder with the package's own styles."""

STYLES = ("paper", "town")
"""Their names; `paper` is what searches do without a style."""


def read_style(style: UserValue, known: Collection[str] | None = None) -> dict[str, UserValue]:
    """Reads a style: the settings that it gives other values than their defaults.

    Args:
      style: the name of one of `STYLES`, or the path of a TOML file that ends in ``.toml``.
      known: the names of the settings that it may have; by default any.

    Returns:
      Values by name, not yet checked.

    Raises:
      InputError: for a name that no style has, a file that cannot be read or is no TOML, or an unknown setting.
    """
    text = str(style) if isinstance(style, str | Path) else ""
    if not text.endswith(".toml") and text not in STYLES:
        names = f"one of {', '.join(STYLES)}, or a file that ends in .toml"
        raise InputError(f"style: expected {names}, got {shorten(repr(style), 40)}{suggest(text, STYLES)}")
    file = Path(text) if text.endswith(".toml") else FOLDER / f"{text}.toml"
    try:
        settings = tomllib.loads(read_text(file, MIB))
    except OSError as error:
        raise InputError(f"style {text!r}: {reason(error)}") from None
    except ValueError as error:  # of TOML, or of UTF-8
        raise InputError(f"style {text!r}: expected TOML, got a file that is none: {shorten(str(error))}") from None
    for name in settings:
        if known is not None and name not in known:
            words = f"settings of a search, {', '.join(known)}"
            raise InputError(f"style {text!r}: expected {words}, got {shorten(repr(name), 40)}{suggest(name, known)}")
    return settings
