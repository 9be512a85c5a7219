"""Datasets for semantic segmentation: maps of mixed sizes, drawn, labelled and split, as training reads them."""

from elitelanes_jax.dataset.make import make_dataset
from elitelanes_jax.dataset.settings import Settings

__all__ = ["Settings", "make_dataset"]
