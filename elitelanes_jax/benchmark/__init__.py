"""A benchmark of quality-diversity search: road networks, with a certified optimum for each niche."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
