"""Maps as files of this and other programs: a module for each format, with functions of a grid of codes.

If a format cannot represent a code, the error names the cells.
"""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
