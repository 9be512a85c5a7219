"""Packages that only some commands and functions need, each in an extra of the project's."""

from importlib import import_module
from typing import Any

from elitelanes_jax.errors import InputError

__all__ = ["optional"]


def optional(module: str, need: str, extra: str) -> Any:
    """Imports a module that may not be installed.

    Args:
      module: its name.
      need: what needs it, in words that end with the package's name.
      extra: of the project's, that brings it.

    Raises:
      InputError: that says how to install it, if it is not there.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError(f"{need}: pip install 'elitelanes_jax[{extra}]'") from None
