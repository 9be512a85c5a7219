"""The paper's results: its tables 1 to 3, for 12 x 12 tiles and 4 runs of each method."""

from typing import NamedTuple

__all__ = ["METHODS", "METRICS", "SHAPE", "TABLE", "Spread"]

SHAPE = (12, 12)
"""The size of the grids in the paper's tables."""

METHODS = {"ea": "EA", "gwo": "GWO", "map-elites": "MAP-Elites", "pso": "PSO", "wfc": "WFC"}
"""The paper's names of the methods, by our names, in the order of its tables."""

METRICS = {
    "components": "CO",
    "dead_ends": "DE",
    "cyclomatic": "CY",
    "boundary_violations": "BV",
    "adjacent_crossing_score": "ACV",
    "coverage": "CV",
    "crossings": "CR",
    "straight_score": "SR",
    "adjacent_turns": "AT",
}
"""The paper's names of the metrics, by our names, in the order of its tables."""


class Spread(NamedTuple):
    """Mean and standard deviation."""

    mean: float
    sigma: float


_TABLE = {
    "ea": [(1.25, 0.5), (0.75, 0.5), (25, 1.826), (0, 0), (81.25, 22.66), (1, 0), (40.5, 2.082), (41.5, 6.952), (30.25, 10.56)],
    "gwo": [(1, 0), (0.75, 0.957), (37.75, 3.862), (0, 0), (341.8, 38.06), (1, 0), (62.5, 4.796), (28.25, 3.948), (16.5, 6.191)],
    "map-elites": [(1.25, 0.5), (4.5, 3.873), (35.75, 7.455), (0, 0), (305.2, 95.66), (1, 0), (55.5, 8.963), (30.75, 16.88), (23.25, 6.994)],
    "pso": [(2.25, 0.957), (9.25, 1.5), (37, 0.816), (0, 0), (334.5, 19.16), (1, 0), (59.75, 1.5), (30.5, 5.26), (18.25, 9.465)],
    "wfc": [(4.75, 0.957), (26.25, 3.096), (9.5, 1), (26.25, 3.096), (0, 0), (1, 0), (30, 2.828), (36, 8.327), (87.75, 19.69)],
}  # fmt: skip

TABLE = {
    method: {metric: Spread(*cell) for metric, cell in zip(METRICS, row, strict=True)} for method, row in _TABLE.items()
}
"""The paper's figures by method and metric."""
