"""Optimisers on one convention (see `base`): each a factory from a problem and a configuration."""
