"""A benchmark of quality-diversity search: road networks, with a certified optimum for each niche."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
