"""Datasets for semantic segmentation: maps of mixed sizes, drawn, labelled and split, as training reads them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
