"""Datasets for semantic segmentation.

Their maps have mixed sizes, and are drawn, labelled and split for training.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
