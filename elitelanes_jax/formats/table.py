"""The metrics of many maps as one table."""

import csv
import io
from collections.abc import Mapping, Sequence

import numpy as np

from elitelanes_jax._util.types import AnyArray, Numeric, Plain
from elitelanes_jax.network.plain_metrics import plain_measure

Row = dict[str, Plain]
"""The name of a map, `file`, its `height` and `width` in tiles, and its metrics, which are numbers."""


def measure_maps(names: Sequence[str], grids: Sequence[AnyArray]) -> list[Row]:
    """Measures grids, codes ``[H, W]`` of any shapes, a row for each. `names` are those of their files.

    Raises:
      InputError: for a bad grid.
    """
    rows: list[Row] = []
    for name, grid in zip(names, grids, strict=True):
        metrics = plain_measure(grid)
        height, width = np.shape(grid)
        rows.append({"file": name, "height": height, "width": width, **shorten_coverage(metrics)})
    return rows


def shorten_coverage(metrics: Mapping[str, Numeric]) -> Row:
    """Returns metrics with the coverage, a float32, as its shortest decimal: 0.8, not 0.800000011920929."""
    return {name: float(str(np.float32(value))) if name == "coverage" else value for name, value in metrics.items()}


def table_to_csv(rows: Sequence[Row]) -> str:
    """Returns rows, such as those of `measure_maps`, as CSV with a header of all columns that any row has."""
    text = io.StringIO()
    columns = list(dict.fromkeys(name for row in rows for name in row))
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()
