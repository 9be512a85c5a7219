"""Optimisers on one convention (see `base`): each a factory from a problem and a configuration."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
