"""Compares a floor that was laid with the map that was planned."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import KIND_OF, SIDES, rotate_codes


class Difference(NamedTuple):
    """A cell where the floor differs from the plan.

    Attributes:
      row: the row of the cell in the plan, from 0.
      column: the column of the cell in the plan, from 0.
      planned: the code in the plan.
      laid: the code of the tile on the floor.
    """

    row: int
    column: int
    planned: int
    laid: int

    def __str__(self) -> str:
        """Returns a line of text about it; rows and columns are counted from 1."""
        place = f"row {self.row + 1}, column {self.column + 1}"
        if KIND_OF[self.planned] == KIND_OF[self.laid]:
            kind, planned = KIND_OF[self.planned], _sides(self.planned)
            return (
                f"{place}: expected a {kind} that opens {planned}, "
                f"got it turned: {_sides(self.laid)}"
            )
        return f"{place}: expected {_tile(self.planned)}, got {_tile(self.laid)}"


def turn_to_plan(codes: ArrayLike, plan: ArrayLike) -> int:
    """Returns the quarter turns counter-clockwise that bring a floor's codes nearest to a plan's.

    Args:
      codes: the codes of the floor ``[H, W]``, seen from any side.
      plan: codes ``[H, W]`` or, turned, ``[W, H]``.

    Raises:
      InputError: for another shape.
    """
    floor, planned = np.asarray(check_grid(codes)), np.asarray(check_grid(plan))
    agree = {}
    for turns in range(4):
        turned = turn_floor(floor, turns)
        if turned.shape == planned.shape:
            agree[turns] = int((turned == planned).sum())
    if not agree:
        got = f"{planned.shape[0]} x {planned.shape[1]}"
        raise InputError(
            f"plan: expected {floor.shape[0]} x {floor.shape[1]} tiles like the floor, got {got}"
        )
    return max(agree, key=lambda turns: agree[turns])


@name_wrong_arguments
def turn_floor(codes: ArrayLike, turns: int) -> NDArray[np.int8]:
    """Turns a floor's codes ``[H, W]`` counter-clockwise by quarters."""
    turns = check_named("turns", whole(0), turns)
    return np.asarray(rotate_codes(np.rot90(np.asarray(check_grid(codes)), turns), turns), np.int8)


def find_differences(codes: ArrayLike, plan: ArrayLike) -> list[Difference]:
    """Returns the cells where a floor differs from a plan of the same shape ``[H, W]``.

    Cells are sorted by row and column.
    """
    floor, planned = np.asarray(check_grid(codes)), np.asarray(check_grid(plan))
    return [
        Difference(row, column, int(planned[row, column]), int(floor[row, column]))
        for row, column in np.argwhere(floor != planned).tolist()
    ]


def _tile(code: int) -> str:
    return f"{KIND_OF[code]} that opens {_sides(code)}" if code else "no tile"


def _sides(code: int) -> str:
    return "".join(side.letter for side in SIDES if code & side.bit)
