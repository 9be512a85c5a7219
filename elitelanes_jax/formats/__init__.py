"""Maps as files of this and other programs, with a module for each format.

The modules have functions of a grid of codes. If a format cannot represent a code, the error names
the cells.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
