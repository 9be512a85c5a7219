"""From photographs of tiles to a tile set, and to the map of a laid floor. This room uses OpenCV."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
