"""Maps and tasks in the text formats of MovingAI's benchmarks, for planners of one robot or many.

Sturtevant, "Benchmarks for grid-based pathfinding", IEEE Transactions on Computational Intelligence
and AI in Games,
2012. A step goes to one of eight neighbours; a diagonal one needs both cells beside it free, and is
  sqrt(2) long.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, text_name, whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax.lanes.curves import on_road
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import no_road_error
from elitelanes_jax.network.checks import check_grid

_STARTS = 10  # of each, as many goals
_BUCKET = 4  # lengths that share a bucket
_MOST_CELLS = 2**25  # a path's length for each takes 4 GB of memory


class MovingAI(NamedTuple):
    """The files of a map.

    Attributes:
      grid: the file of the map, whose cells are ``.`` on the road and ``@`` elsewhere.
      tasks: 100 starts and goals, or as many as there are, with the lengths of their shortest
        paths, the short ones first.
    """

    grid: str
    tasks: str


@name_wrong_arguments
def to_movingai(codes: ArrayLike, name: str, cells: int = 5) -> MovingAI:
    """Writes a map and tasks on it. The tasks are drawn at random, and are the same for the same map.

    Args:
      codes: integer codes ``[H, W]``.
      name: the name of the map's file, for the tasks.
      cells: the number of cells along a tile's side, 5 to 256; with 5 the road is 3 wide.

    Raises:
      InputError: for a bad grid, one without a road, a bad name, or a bad number of cells, or over
        2**25 in all.
    """
    # Readers of tasks split their lines at spaces of any kind, and know no quotes.
    if check_named("name", text_name, name).split() != [name]:
        raise InputError(
            f"name: expected a name without spaces, as in MovingAI's tasks, got {shorten(repr(name))}"
        )
    road = _road_cells(codes, cells)
    if not road.any():
        raise no_road_error()
    height, width = road.shape
    rows = "".join("".join(row) + "\n" for row in np.where(road, ".", "@").tolist())
    lines = [
        "\t".join(
            map(str, (int(length // _BUCKET), name, width, height, *start, *goal, f"{length:.8f}"))
        )
        + "\n"
        for length, start, goal in _tasks(road)
    ]
    return MovingAI(
        f"type octile\nheight {height}\nwidth {width}\nmap\n{rows}", "version 1\n" + "".join(lines)
    )


def _road_cells(codes: ArrayLike, cells: int) -> Bool[NDArray, "H W"]:
    """Returns whether the centre of each cell is on the road; the first row is north.

    With 5 `cells` or more along a tile's side, cells of neighbours that are not linked do not
    touch.

    Raises:
      InputError: for a bad grid, `cells` that are not 5 to 256, or over `_MOST_CELLS` in all.
    """
    cells = check_named("cells", whole(5, 256), cells)
    links = linked_codes(np.asarray(check_grid(codes)))
    if links.size * cells**2 > _MOST_CELLS:
        raise InputError(
            f"cells: expected at most {_MOST_CELLS:,} in all, got {links.size * cells**2:,}"
        )
    centres = (np.arange(cells) + 0.5) / cells
    tiles = on_road(np.arange(16)[:, None, None], centres, centres[:, None])
    height, width = links.shape
    return np.asarray(tiles[links].swapaxes(1, 2).reshape(height * cells, width * cells))


def _tasks(road: Bool[NDArray, "H W"]) -> list[tuple[float, list[int], list[int]]]:
    """Draws starts and goals, (column, row), and computes the lengths of their shortest paths."""
    rng, cells = np.random.default_rng(0), np.argwhere(road)[:, ::-1].tolist()
    starts = rng.choice(len(cells), min(_STARTS, len(cells)), replace=False)
    tasks = []
    for start, lengths in zip(starts, _path_lengths(road, starts), strict=True):
        goals = np.flatnonzero(np.isfinite(lengths) & (lengths > 0))
        drawn = rng.choice(goals, min(_STARTS, len(goals)), replace=False)
        tasks += [(float(lengths[goal]), cells[start], cells[goal]) for goal in drawn]
    return sorted(tasks)


def _path_lengths(road: Bool[NDArray, "H W"], starts: NDArray[np.int_]) -> Float[NDArray, "S N"]:
    """Returns the lengths of shortest paths from some cells of the road to all, by their indices in its list."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    index = np.cumsum(road).reshape(road.shape) - 1
    free = np.pad(road, 1)  # so that no step leaves the map
    cells, steps = np.argwhere(road), []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        entered = cells + np.array([[[down, right]], [[down, 0]], [[0, right]]])
        able = free[tuple(np.moveaxis(entered + 1, -1, 0))].all(axis=0)
        ends = index[tuple(cells[able].T)], index[tuple(entered[0, able].T)]
        steps.append((np.full(able.sum(), np.hypot(down, right)), *ends))
    lengths, first, second = map(np.concatenate, zip(*steps, strict=True))
    graph = coo_array((lengths, (first, second)), (len(cells), len(cells)))
    return np.asarray(dijkstra(graph.tocsr(), directed=False, indices=starts))
