"""A search: its options, the run itself, its result, and the choice of maps among the elites."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
