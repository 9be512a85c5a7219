"""The explorer: a page, or a widget in a notebook, that shows archives and maps and edits maps."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
