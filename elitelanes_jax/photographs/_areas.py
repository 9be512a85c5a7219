"""The part of a map that a floor shows.

The empty rows and columns at a map's border are outside of the floor, where nobody sees them.
"""

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.plain_metrics import road_box
from elitelanes_jax.photographs._views import Points, floor_corners, view_of

_Cell = TypeVar("_Cell", np.int8, np.float64)


class Area(NamedTuple):
    """A part of a map.

    Attributes:
      row: the first row of the part on the map, from 0.
      column: the first column of the part on the map, from 0.
      shape: the rows and columns of the part.
      map_shape: the rows and columns of the whole map.
      lacks_corner: whether a corner cell of the part is known to be empty.
    """

    row: int
    column: int
    shape: tuple[int, int]
    map_shape: tuple[int, int]
    lacks_corner: bool = False

    @staticmethod
    def whole(shape: tuple[int, int]) -> "Area":
        """Returns the whole of a map with these rows and columns."""
        return Area(0, 0, shape, shape)

    @staticmethod
    def of_roads(codes: NDArray[np.int8]) -> "Area":
        """Returns the part of a map ``[H, W]`` without its empty border."""
        rows, columns = road_box(codes)
        shape = rows.stop - rows.start, columns.stop - columns.start
        corners = codes[rows, columns][[0, 0, -1, -1], [0, -1, 0, -1]]
        lacks_corner = not corners.all()
        map_shape = len(codes), codes.shape[1]
        return Area(rows.start, columns.start, shape, map_shape, lacks_corner)

    @staticmethod
    def shown(codes: NDArray[np.int8], shape: tuple[int, int]) -> "Area":
        """Returns the part of a map ``[H, W]`` that a floor of some rows and columns shows.

        A floor with tiles in the map's empty border shows the whole map. The floor may be turned.
        """
        if sorted(shape) == sorted(codes.shape):
            return Area.whole((len(codes), codes.shape[1]))
        return Area.of_roads(codes)

    @property
    def is_whole(self) -> bool:
        """Whether the part is the whole map."""
        return self.shape == self.map_shape

    @property
    def first(self) -> Points:
        """The position of the part's first corner on the map, x and y in tiles ``[2]``."""
        return np.array([self.column, self.row], float)

    def cut(self, cells: NDArray[_Cell]) -> NDArray[_Cell]:
        """Returns the part's cells of a map's cells ``[H, W]``."""
        rows, columns = self.shape
        return cells[self.row : self.row + rows, self.column : self.column + columns]

    def put_back(self, cells: NDArray[_Cell], value: float) -> NDArray[_Cell]:
        """Returns the cells of the whole map. Those outside of the part have one value."""
        all_cells = np.full(self.map_shape, value, cells.dtype)
        self.cut(all_cells)[:] = cells
        return all_cells

    def corners_in(self, corners: Points, width: int, height: int) -> Points:
        """Returns the pixels of the part's corners ``[4, 2]`` from those of the whole map's.

        `width` and `height` are the photograph's.
        """
        view = view_of(corners, *self.map_shape, width, height)
        return view.pixels_of(floor_corners(*self.shape) + self.first)
