"""The object of a search: features, niches, constraints, and the problem made of them."""
