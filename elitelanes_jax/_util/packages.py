"""The versions of this package and of others, and imports of packages that may not be installed."""

import platform
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as read_version
from types import ModuleType

from elitelanes_jax._util.errors import MissingPackageError

__version__ = "0.1.0"

# Reading a version takes 2 ms, and a command asks for five of them several times.
version = cache(read_version)

# The names of packages with OpenCV; the first one that is installed counts.
_OPENCV = (
    "opencv-python-headless",
    "opencv-python",
    "opencv-contrib-python-headless",
    "opencv-contrib-python",
)

EXTRAS = {
    "anywidget": "widget",
    "distributed": "dask",
    "matplotlib": "plots",
    "networkx": "exports",
    "pyarrow": "shards",
    "pycocotools": "coco",
    "submitit": "cluster",
}
"""The extra that brings a package, by the name of the package's module."""


def installed_versions(*others: str) -> dict[str, str]:
    """Returns the versions that results depend on, by name, and those of other packages.

    The version of a missing package is "none".
    """
    versions = {"elitelanes_jax": __version__, "python": platform.python_version()}
    versions |= {name: version(name) for name in ("jax", "jaxlib", "numpy")}
    versions["opencv"] = next(filter(None, map(_version, _OPENCV)), "unknown")
    for name in others:
        versions.setdefault(name, _version(name) or "none")
    return versions


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def import_optional(module: str, need: str, package: str | None = None) -> ModuleType:
    """Imports a module that may not be installed.

    The error has the text `need`, which ends with the package's name. It says how to install
    `package`, by default the module, and which extra of this package brings it.
    """
    try:
        return import_module(module)
    except ImportError:
        extra = EXTRAS.get(module.partition(".")[0])
        hint = "" if extra is None else f", or the extra {extra} of elitelanes_jax"
        raise MissingPackageError(need, "", f"pip install {package or module}{hint}") from None
