"""Packages that only some commands and functions need."""

from importlib import import_module
from typing import Any

from elitelanes_jax.errors import MissingPackageError

__all__ = ["optional"]


def optional(module: str, need: str, package: str | None = None) -> Any:
    """Imports a module that may not be installed.

    Args:
      module: its name.
      need: what needs it, in words that end with the package's name.
      package: what is to be installed; by default of the module's name.

    Raises:
      MissingPackageError: that says how to install it, if it is not there.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingPackageError(f"{need}: pip install {package or module}") from None
