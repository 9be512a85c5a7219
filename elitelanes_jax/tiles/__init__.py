"""Tile pictures: sets, masks, and maps drawn with them. This room uses OpenCV."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
