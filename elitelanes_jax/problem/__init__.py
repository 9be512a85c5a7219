"""The object of a search: features, niches, constraints, and the problem made of them."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
