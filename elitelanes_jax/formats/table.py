"""The metrics of many maps as one table, CSV or JSON."""

import csv
import io
import json
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.metrics import measure

__all__ = ["Row", "measure_maps", "table_to_csv", "table_to_json"]

Row = dict[str, str | int | float]
"""The name of a map, `file`, its `height` and `width` in tiles, and its metrics."""


def measure_maps(names: Sequence[str], grids: Sequence[Any]) -> list[Row]:
    """Measures grids, a row each; those of one shape in one compiled call.

    A float32 becomes the shortest decimal that is it, 0.54320985 rather than 0.5432098507881165.

    Args:
      names: of the grids, such as their files.
      grids: as many, integer codes ``[H, W]`` of any shapes.

    Raises:
      InputError: for a bad grid (see `check_grid`).
    """
    checked = [np.asarray(check_grid(grid)) for grid in grids]
    figures: list[dict[str, Any]] = [{} for _ in checked]
    for shape in dict.fromkeys(grid.shape for grid in checked):
        places = [place for place, grid in enumerate(checked) if grid.shape == shape]
        metrics = jax.device_get(jax.vmap(measure)(np.stack([checked[place] for place in places])))
        for number, place in enumerate(places):
            figures[place] = {name: _shortest(values[number]) for name, values in metrics._asdict().items()}
    return [
        {"file": name, "height": grid.shape[0], "width": grid.shape[1]} | figure
        for name, grid, figure in zip(names, checked, figures, strict=True)
    ]


def _shortest(value: np.generic) -> int | float:
    return float(str(value)) if isinstance(value, np.floating) else value.item()


def table_to_csv(rows: Sequence[Row]) -> str:
    """Writes rows, such as those of `measure_maps`, as CSV with a head of all columns that any row has."""
    text = io.StringIO()
    columns = list(dict.fromkeys(name for row in rows for name in row))
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def table_to_json(rows: Sequence[Row]) -> str:
    """Writes rows of `measure_maps` as a JSON list of objects, one a line."""
    return "[\n" + ",\n".join("  " + json.dumps(row) for row in rows) + "\n]\n"
