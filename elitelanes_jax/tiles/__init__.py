"""Tile pictures: sets of them, their masks, their seams, and maps drawn with them. OpenCV is used here."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
