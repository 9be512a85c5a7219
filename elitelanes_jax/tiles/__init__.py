"""Tile pictures: sets, masks, and maps drawn with them. This room uses OpenCV."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
