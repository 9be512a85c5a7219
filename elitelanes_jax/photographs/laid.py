"""A laid floor as it was read from a photograph, compared with the map that was planned."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.codes import KIND_OF, SIDES, rotate_codes
from elitelanes_jax.photographs._areas import Area
from elitelanes_jax.photographs._judging import SURE
from elitelanes_jax.photographs._views import Points
from elitelanes_jax.photographs.proposals import Proposal


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

    @property
    def remedy(self) -> str:
        """What to do with the tile, in a few words."""
        if not self.planned:
            return "lift"
        if KIND_OF[self.planned] != KIND_OF[self.laid]:
            return f"lay {KIND_OF[self.planned]}"
        turns = next(turns for turns in range(4) if rotate_codes(self.laid, turns) == self.planned)
        return ("", "turn left", "turn around", "turn right")[turns]

    def __str__(self) -> str:
        """Returns a line of text that names the cell and says what differs."""
        place = describe_cell(self.row, self.column)
        if KIND_OF[self.planned] == KIND_OF[self.laid]:
            return f"{place}: expected {_tile(self.planned)}, got it turned: {_sides(self.laid)}"
        return f"{place}: expected {_tile(self.planned)}, got {_tile(self.laid)}"


class LaidFloor(NamedTuple):
    """The map of a laid floor, in the direction of its plan.

    Attributes:
      codes: int8 ``[H, W]``.
      unsure: the row and the column, from 0, of each cell whose code is unsure.
      differences: what differs from the plan, by row and column.
      turns: the quarter turns counter-clockwise from the photograph's direction to this one.
      area: the part of the map that is photographed.
    """

    codes: NDArray[np.int8]
    unsure: list[list[int]]
    differences: list[Difference]
    turns: int
    area: Area

    def seen(self, places: Points) -> Points:
        """Returns where positions ``[..., 2]`` of the map are on the floor as it is photographed."""
        x, y = np.moveaxis(places - self.area.first, -1, 0)
        height, width = self.area.shape
        for _ in range(self.turns):
            x, y, height, width = height - y, x, width, height
        return np.stack([x, y], axis=-1)


def read_laid(proposal: Proposal, plan: NDArray[np.int8] | None = None) -> LaidFloor:
    """Returns the map of the floor that a proposal found, compared with a plan.

    The floor has the shape of the plan, or of the plan without its empty border. A photograph may
    be taken from any side of the floor. The direction that agrees most with the plan counts.

    Raises:
      InputError: for a plan of another shape.
    """
    codes = np.array(proposal.codes, np.int8)
    shape = len(codes), codes.shape[1]
    if plan is None:
        area, turns = Area.whole(shape), 0
    else:
        area = Area.shown(plan, shape)
        turns = turn_to_plan(codes, area.cut(plan))
    laid = area.put_back(turn_floor(codes, turns), 0)
    sure = area.put_back(np.rot90(np.array(proposal.sure), turns), 1.0)
    unsure = np.argwhere(sure < SURE).tolist()
    differences = [] if plan is None else find_differences(laid, plan)
    return LaidFloor(laid, unsure, differences, turns, area)


def turn_to_plan(codes: NDArray[np.int8], plan: NDArray[np.int8]) -> int:
    """Returns the quarter turns counter-clockwise that bring a floor's codes nearest to a plan's.

    Args:
      codes: the codes of the floor ``[H, W]``, seen from any side.
      plan: codes ``[H, W]`` or, turned, ``[W, H]``.

    Raises:
      InputError: for another shape.
    """
    agree = {}
    for turns in range(4):
        turned = turn_floor(codes, turns)
        if turned.shape == plan.shape:
            agree[turns] = int((turned == plan).sum())
    if not agree:
        got = f"{plan.shape[0]} x {plan.shape[1]}"
        raise InputError("plan", f"{codes.shape[0]} x {codes.shape[1]} tiles like the floor", got)
    return max(agree, key=lambda turns: agree[turns])


def turn_floor(codes: NDArray[np.int8], turns: int) -> NDArray[np.int8]:
    """Turns a floor's codes ``[H, W]`` counter-clockwise by quarters."""
    return np.asarray(rotate_codes(np.rot90(codes, turns), turns), np.int8)


def find_differences(codes: NDArray[np.int8], plan: NDArray[np.int8]) -> list[Difference]:
    """Returns the cells where a floor differs from a plan of the same shape ``[H, W]``.

    Cells are sorted by row and column.
    """
    return [
        Difference(row, column, int(plan[row, column]), int(codes[row, column]))
        for row, column in np.argwhere(codes != plan).tolist()
    ]


def _tile(code: int) -> str:
    return f"{_named(code)} that opens {_sides(code)}" if code else "no tile"


def _named(code: int) -> str:
    kind = KIND_OF[code]
    return f"an {kind}" if kind == "end" else f"a {kind}"


def _sides(code: int) -> str:
    return "".join(side.letter for side in SIDES if code & side.bit)
