"""Road networks as grids of tile codes: kernels that measure, repair, turn and make them."""
