"""Maps for other programs: a module a format, each a function of a grid of codes.

A grid here may be any: what a format cannot hold is refused, and the cells are named.
"""

__all__: list[str] = []
