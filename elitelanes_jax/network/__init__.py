"""Road networks as grids of tile codes: kernels that measure, repair, transform and create them."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
