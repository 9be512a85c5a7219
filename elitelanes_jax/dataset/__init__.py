"""Datasets for semantic segmentation: maps of mixed sizes, drawn, labelled and split for training."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
