"""Maps as files of this and other programs: a module a format, each with functions of a grid of codes.

Any grid is taken; codes that a format cannot hold are refused, and the cells are named.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
