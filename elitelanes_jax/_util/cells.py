"""Names of cells and sizes of maps.

A cell is letters and a number for people, and an index in files and arrays.
"""

from collections.abc import Sequence


def column_name(column: int) -> str:
    """Returns the letters of a column: A to Z, then AA, AB and so on, as in a spreadsheet.

    `column` is the column's index, from 0.
    """
    letters = ""
    rest = column + 1
    while rest:
        # A letter is a digit of base 26 without a zero.
        rest, digit = divmod(rest - 1, 26)
        letters = chr(ord("A") + digit) + letters
    return letters


def cell_name(row: int, column: int) -> str:
    """Returns the name of a cell as people see it on a plan: letters for the column, and the row.

    Row 1 is the northern one.

    Args:
      row: the row's index, from 0.
      column: the column's index, from 0.
    """
    return f"{column_name(column)}{row + 1}"


def describe_cell(row: int, column: int) -> str:
    """Returns the name of a cell for a message, with its index in files: C2 ([1, 2])."""
    return f"{cell_name(row, column)} ([{row}, {column}])"


def describe_size(shape: Sequence[int]) -> str:
    """Returns the rows and columns of a map as messages have them, such as 6 x 7."""
    height, width = shape
    return f"{height} x {width}"
