"""The versions that results depend on."""

import platform

import cv2
import jax
import jaxlib
import numpy as np

from elitelanes_jax.version import __version__

__all__ = ["versions"]


def versions() -> dict[str, str]:
    """Versions by name."""
    return {
        "elitelanes_jax": __version__,
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
