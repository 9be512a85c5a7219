"""Templates: cells of a map that are given, such as a city's roads and buildings."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.codes import SIDES
from elitelanes_jax.errors import InputError, reason, short

__all__ = ["Template", "read_template", "template_of"]


class Template(NamedTuple):
    """Given cells; hashable.

    Attributes:
      shape: (height, width).
      codes: a code or None for each cell, row by row.
    """

    shape: tuple[int, int]
    codes: tuple[int | None, ...]

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Bool ``[H, W]``: which cells are given."""
        return np.array([code is not None for code in self.codes]).reshape(self.shape)

    @property
    def grid(self) -> NDArray[np.int8]:
        """int8 ``[H, W]``: the given codes, 0 where none is."""
        return np.array([code or 0 for code in self.codes], np.int8).reshape(self.shape)


def template_of(cells: Any, shape: tuple[int, int], name: str = "fix") -> Template:
    """A template from rows of codes and None, None for a cell that is free.

    Args:
      cells: ``[H][W]``; 0 forbids roads in a cell.
      shape: (height, width) of the maps.
      name: to stand before messages.

    Raises:
      InputError: if it is no such table, has another shape, leads out of the grid, or contradicts itself.
    """
    if isinstance(cells, Template):
        cells = np.array(cells.codes, object).reshape(cells.shape)
    try:
        rows = [list(row) for row in (np.asarray(cells).tolist() if hasattr(cells, "shape") else cells)]
    except TypeError:
        got = short(repr(cells))
        raise InputError(f"{name}: expected rows of tile codes, or null for free cells, got {got}") from None
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        lengths = sorted({len(row) for row in rows})
        got = f"{len(rows)} rows of {' or '.join(map(str, lengths)) or 0}"
        raise InputError(f"{name}: expected the maps' {shape[0]} rows of {shape[1]} cells, got {got}")
    for row, column in np.ndindex(*shape):
        code = rows[row][column]
        if code is not None and (
            isinstance(code, bool) or not isinstance(code, int | np.integer) or not 0 <= code <= 15
        ):
            got = f"{short(repr(code))} at row {row}, column {column}"
            raise InputError(f"{name}: expected tile codes 0 to 15, or null for a free cell, got {got}")
    for row, column in np.ndindex(*shape):
        if rows[row][column] is not None:
            _check_sides(name, rows, row, column)
    return Template(shape, tuple(None if code is None else int(code) for line in rows for code in line))


def read_template(file: str | Path, shape: tuple[int, int]) -> Template:
    """A template from a JSON file: rows of codes and null, alone or under the key ``codes``.

    Raises:
      InputError: if the file cannot be read, or holds no template for maps of the shape.
    """
    try:
        content = json.loads(Path(file).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{file}: {reason(error)}") from None
    except (ValueError, RecursionError) as error:  # of the text, of JSON, of a number with too many digits
        raise InputError(f"{file}: expected JSON, got: {error}") from None
    if isinstance(content, dict) and "codes" in content:
        content = content["codes"]
    if not isinstance(content, list):
        raise InputError(f"{file}: expected rows of tile codes, or null for free cells")
    return template_of(content, shape, str(file))


def _check_sides(name: str, rows: list[list[Any]], row: int, column: int) -> None:
    for bit, word, down, right, answer in SIDES:
        other = (row + down, column + right)
        opens = bool(rows[row][column] & bit)
        if not (0 <= other[0] < len(rows) and 0 <= other[1] < len(rows[0])):
            if opens:
                place = f"at row {row}, column {column}"
                raise InputError(
                    f"{name}: expected roads within the grid, got one that leaves it to the {word} {place}"
                )
            continue
        theirs = rows[other[0]][other[1]]
        if theirs is not None and opens and not theirs & answer:
            raise InputError(
                f"{name}: expected given neighbours to agree, got a road to the {word} at row {row}, column {column} "
                f"that row {other[0]}, column {other[1]} does not answer"
            )
