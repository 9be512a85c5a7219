"""Road networks as grids of tile codes: kernels that measure, repair, transform and create them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
