"""Optimisers on one convention (see `Optimizer`): each is a factory that takes a problem and a configuration."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
