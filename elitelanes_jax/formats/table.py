"""The metrics of many maps as one table."""

import csv
from collections.abc import Mapping, Sequence
from types import SimpleNamespace

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, text_name
from elitelanes_jax._util.types import ArrayOrRows, Numeric, OptionValue
from elitelanes_jax.network.plain_metrics import plain_measure

Row = dict[str, OptionValue]
"""The measurements of a map.

These are its name, `file`, its `height` and `width` in tiles, and its metrics, which are numbers.
"""


def measure_maps(names: Sequence[str], grids: Sequence[ArrayOrRows]) -> list[Row]:
    """Measures grids, a row of the table for each.

    Grids are codes ``[H, W]`` of any shapes. `names` are those of their files.

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
    """Returns metrics with the coverage as its shortest decimal.

    The coverage is a float32. It becomes 0.8, not 0.800000011920929.
    """
    return {
        name: float(str(np.float32(value))) if name == "coverage" else value
        for name, value in metrics.items()
    }


@name_wrong_arguments
def table_to_csv(rows: Sequence[Row]) -> str:
    """Returns rows as CSV with a header of all columns that any row has.

    A row has values by name, such as the `metrics` of a `RoadMap`.

    Raises:
      InputError: for the name of a file that UTF-8 cannot hold.
    """
    # The rows may be a generator, and they are read more than once.
    rows = list(rows)
    for row in rows:
        if "file" in row:
            check_named("file", text_name, row["file"])
    lines: list[str] = []
    # Columns are in the order in which rows first have them.
    columns = list(dict.fromkeys(name for row in rows for name in row))
    # Of line breaks, the writer quotes only those in its own line end. Readers end lines at a
    # carriage return too, so this line end has both. Afterwards each line ends with a line feed
    # alone.
    table = csv.DictWriter(SimpleNamespace(write=lines.append), columns, lineterminator="\r\n")
    table.writeheader()
    table.writerows(rows)
    return "".join(line.removesuffix("\r\n") + "\n" for line in lines)
