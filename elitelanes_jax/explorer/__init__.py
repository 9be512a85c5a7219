"""The explorer: a page, or a widget in a notebook, that shows archives and maps and edits maps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
