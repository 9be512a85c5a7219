"""Optimisers on one convention, see `Optimizer`.

Each optimiser comes from a factory that takes a problem and a configuration.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
