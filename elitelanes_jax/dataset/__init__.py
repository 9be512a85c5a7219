"""Datasets for semantic segmentation: maps of mixed sizes, drawn, labelled and split for training."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
