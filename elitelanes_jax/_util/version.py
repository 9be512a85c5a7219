"""The version of the package, and of what its results depend on."""

import platform
from importlib.metadata import PackageNotFoundError, version

__version__ = "0.1.0"

# OpenCV comes under several names; the first that is installed counts.
_OPENCV = ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python")


def installed_versions() -> dict[str, str]:
    """Returns the versions that results depend on, by name."""
    found = {"elitelanes_jax": __version__, "python": platform.python_version()}
    found |= {name: version(name) for name in ("jax", "jaxlib", "numpy")}
    return found | {"opencv": next(filter(None, map(_version, _OPENCV)), "unknown")}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
