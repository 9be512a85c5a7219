"""Fixed cells: cells that every map keeps, such as a city's roads and buildings."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int8

from elitelanes_jax._util.cells import describe_cell, describe_size
from elitelanes_jax._util.checks import is_whole, items_of, path
from elitelanes_jax._util.errors import InputError, brief, reason, shorten
from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import SIDES


class FixedCells(NamedTuple):
    """The fixed cells of a grid; hashable.

    Attributes:
      shape: (height, width) of the grid.
      codes: the code of each fixed cell, None for each free cell, row by row.
    """

    shape: tuple[int, int]
    codes: tuple[int | None, ...]

    @property
    def fixed(self) -> Bool[np.ndarray, "H W"]:
        """Whether each cell is fixed."""
        return np.array([code is not None for code in self.codes]).reshape(self.shape)

    @property
    def grid(self) -> Int8[np.ndarray, "H W"]:
        """The codes of the fixed cells, 0 elsewhere."""
        return np.array([code or 0 for code in self.codes], np.int8).reshape(self.shape)

    @property
    def rows(self) -> list[list[int | None]]:
        """The rows that `parse_fixed_cells` reads."""
        width = self.shape[1]
        return [
            list(self.codes[start : start + width]) for start in range(0, len(self.codes), width)
        ]


def parse_fixed_cells(cells: UserValue) -> FixedCells:
    """Reads fixed cells from rows or a file.

    Args:
      cells: rows ``[H][W]`` of codes, with None for a free cell and 0 for a cell without roads; or
        an array, in which masked cells are free; or a `FixedCells`; or the path of a JSON file with
        the rows, alone or under the key ``codes``, with null for None.

    Raises:
      InputError: if the file cannot be read, the cells are no table of codes, or a fixed cell has a
        road that leaves the grid or that a fixed neighbour does not return.
    """
    if isinstance(cells, FixedCells):
        return cells
    name = "fix"
    if isinstance(cells, str | Path):
        name, cells = str(cells), _read_rows(path(cells))
    if isinstance(cells, np.ma.MaskedArray):
        # The list has None for each masked cell.
        cells = cells.tolist()
    elif hasattr(cells, "shape"):
        cells = np.asarray(cells).tolist()
    try:
        rows = [list(items_of(row)) for row in items_of(cells)]
    except TypeError:
        got = brief(cells)
        raise InputError(name, "rows of tile codes, or null for free cells", got) from None
    lengths = sorted({len(row) for row in rows})
    if len(lengths) != 1:
        got = f"{len(rows)} rows of {shorten(' or '.join(map(str, lengths)) or '0')}"
        raise InputError(name, "rows of one length", got)
    try:
        shape = check_shape((len(rows), lengths[0]), new=True)
    except InputError as error:
        raise error.within(name) from None
    for row, column in np.ndindex(*shape):
        code = rows[row][column]
        if code is not None and not (is_whole(code) and 0 <= code <= 15):
            got = f"{brief(code)} at {describe_cell(row, column)}"
            raise InputError(name, "tile codes 0 to 15, or null for a free cell", got)
    codes = np.array([[-1 if code is None else code for code in row] for row in rows], int)
    _check_sides(name, codes)
    return FixedCells(shape, tuple(None if code < 0 else code for code in codes.ravel().tolist()))


def check_fits(cells: FixedCells, shape: tuple[int, int]) -> None:
    """Raises `InputError` for fixed cells of grids of another shape."""
    if cells.shape != shape:
        raise InputError(
            "fix", f"cells of a map of {describe_size(shape)}", describe_size(cells.shape)
        )


def _read_rows(file: str | Path) -> Plain:
    try:
        content = read_json(file)
    except OSError as error:
        raise InputError(file, "", reason(error)) from None
    except InputError:
        # The error names the file.
        raise
    except (ValueError, RecursionError) as error:
        # The file is no text, no JSON, or has a number with too many digits.
        raise InputError(file, "JSON", error) from None
    if isinstance(content, dict) and "codes" in content:
        content = content["codes"]
    if not isinstance(content, list):
        raise InputError(file, "rows of tile codes, or null for free cells", brief(content))
    return content


def _check_sides(name: str, codes: Int[np.ndarray, "H W"]) -> None:
    """Checks that no road leaves the grid or ends at a fixed neighbour.

    A free cell is -1, all bits.
    """
    height, width = codes.shape
    for side in SIDES:
        # The padding has no roads, so a road that leaves the grid is not returned.
        beside = np.pad(codes, 1)[1 + side.down :, 1 + side.right :][:height, :width]
        wrong = np.argwhere((codes >= 0) & (codes & side.bit > 0) & (beside & side.opposite == 0))
        for row, column in wrong.tolist():
            position = f"{side.name} at {describe_cell(row, column)}"
            next_row, next_column = row + side.down, column + side.right
            if not (0 <= next_row < height and 0 <= next_column < width):
                expected = "roads within the grid"
                got = f"one that leaves it to the {position}"
            else:
                expected = "fixed neighbours to agree"
                neighbour = describe_cell(next_row, next_column)
                got = f"a road to the {position} that {neighbour} does not return"
            raise InputError(name, expected, got)
