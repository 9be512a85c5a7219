"""Datasets for semantic segmentation: maps of mixed sizes, drawn, labelled and split, as training reads them."""
