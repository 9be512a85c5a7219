"""A benchmark of quality-diversity search on road networks.

Each niche has a certified optimum.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
