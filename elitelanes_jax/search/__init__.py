"""A search: its options, the run itself, its result, and the choice of maps among the elites."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
