"""Imports of packages that only some functions need."""

from importlib import import_module
from types import ModuleType

from elitelanes_jax._util.errors import MissingPackageError


def import_optional(module: str, need: str, package: str | None = None) -> ModuleType:
    """Imports a module that may not be installed.

    Args:
      module: its name.
      need: what needs it, in words that end with the package's name.
      package: what to install; by default the module's name.

    Raises:
      MissingPackageError: if it is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingPackageError(f"{need}: pip install {package or module}") from None
