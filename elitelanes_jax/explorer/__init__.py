"""The explorer: one page, or a widget in a notebook, to look through archives and maps and to draw maps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
