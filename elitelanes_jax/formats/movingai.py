"""Maps and tasks in the text formats of MovingAI's benchmarks, for planners of one robot or many.

Sturtevant, "Benchmarks for grid-based pathfinding", IEEE Transactions on Computational Intelligence
and AI in Games, 2012. A step goes to one of eight neighbours. A diagonal step is sqrt(2) long, and
both cells beside it must be free.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.checks import check_named, text_name, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax.lanes.curves import on_road
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import no_road_error
from elitelanes_jax.network.checks import known_grid

# The number of starts, and of goals from each start.
_STARTS, _GOALS = 10, 10
# The range of path lengths in a bucket, as the format defines it.
_BUCKET = 4
# The most cells of a map. The lengths of the paths to all of them take 4 GB of memory.
_MOST_CELLS = 2**25


class MovingAI(NamedTuple):
    """The files of a map.

    Attributes:
      grid: the file of the map, whose cells are ``.`` on the road and ``@`` elsewhere.
      tasks: 100 starts and goals, or as many as there are, with the lengths of their shortest
        paths, the short ones first.
    """

    grid: str
    tasks: str


def to_movingai(codes: ArrayLike, name: str, cells: int = 5) -> MovingAI:
    """Writes a map and tasks on it.

    The tasks are drawn at random, and are the same for the same map.

    Args:
      codes: integer codes ``[H, W]``.
      name: the name of the map's file, for the tasks.
      cells: the number of cells along a tile's side, 5 to 256; with 5 the road is 3 wide.

    Raises:
      InputError: for a bad grid, one without a road, a bad name, or a bad number of cells, or over
        2**25 in all.
    """
    # Readers split the lines of tasks at spaces of any kind, and know no quotes.
    if check_named("name", text_name, name).split() != [name]:
        raise InputError("name", "a name without spaces, as in MovingAI's tasks", quote(name))
    road = _road_cells(codes, cells)
    if not road.any():
        raise no_road_error()
    height, width = road.shape
    grid = [f"type octile\nheight {height}\nwidth {width}\nmap\n"]
    for row in np.where(road, ".", "@").tolist():
        grid.append("".join(row) + "\n")
    tasks = ["version 1\n"]
    for task in _draw_tasks(road):
        bucket = int(task.length // _BUCKET)
        columns = [bucket, name, width, height, *task.start, *task.goal, f"{task.length:.8f}"]
        tasks.append("\t".join(map(str, columns)) + "\n")
    return MovingAI("".join(grid), "".join(tasks))


def _road_cells(codes: ArrayLike, cells: int) -> Bool[NDArray, "H W"]:
    """Returns whether the centre of each cell is on the road; the first row is north.

    With 5 `cells` or more along a tile's side, cells of neighbours that are not linked do not
    touch.

    Raises:
      InputError: for a bad grid, `cells` that are not 5 to 256, or over `_MOST_CELLS` in all.
    """
    cells = check_named("cells", whole(5, 256), cells)
    links = linked_codes(known_grid(codes))
    if links.size * cells**2 > _MOST_CELLS:
        raise InputError("cells", f"at most {_MOST_CELLS:,} in all", f"{links.size * cells**2:,}")
    centres = (np.arange(cells) + 0.5) / cells
    # Tiles of one code look the same, so each code is computed once and then looked up.
    tiles = on_road(np.arange(16)[:, None, None], centres, centres[:, None])
    height, width = links.shape
    # The indices (tile row, tile column, cell row, cell column) become (tile row, cell row, tile
    # column, cell column).
    return np.asarray(tiles[links].swapaxes(1, 2).reshape(height * cells, width * cells))


class _Task(NamedTuple):
    """A task: the length of its shortest path in cells, its start and its goal.

    The start and the goal are column and row.
    """

    length: float
    start: list[int]
    goal: list[int]


def _draw_tasks(road: Bool[NDArray, "H W"]) -> list[_Task]:
    """Draws starts and goals, and computes the lengths of their shortest paths.

    The tasks are sorted, the shortest path first.
    """
    # The seed is fixed, so the same map has the same tasks.
    rng = np.random.default_rng(0)
    # A task has the column first, then the row.
    cells = np.argwhere(road)[:, ::-1].tolist()
    starts = rng.choice(len(cells), min(_STARTS, len(cells)), replace=False)
    tasks = []
    for start, lengths in zip(starts, _path_lengths(road, starts), strict=True):
        # A goal is in the same part of the network as the start, and is not the start itself.
        reached = np.flatnonzero(np.isfinite(lengths) & (lengths > 0))
        for goal in rng.choice(reached, min(_GOALS, len(reached)), replace=False):
            tasks.append(_Task(float(lengths[goal]), cells[start], cells[goal]))
    return sorted(tasks)


def _path_lengths(road: Bool[NDArray, "H W"], starts: NDArray[np.int_]) -> Float[NDArray, "S N"]:
    """Returns the lengths of shortest paths from S cells of the road to all N cells.

    Cells have indices row by row. `starts` are such indices.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    # The index of each cell of the road among all of them, row by row.
    index = np.cumsum(road).reshape(road.shape) - 1
    # Around the map is a border that is not free, so no step leaves the map.
    free = np.pad(road, 1)
    cells = np.argwhere(road)
    steps = []
    # Four of the eight directions are enough, because the graph is undirected.
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        # These cells must all be free: the goal of a step and the two cells beside it. Beside a
        # straight step they are its start and its goal.
        entered = cells + np.array([[[down, right]], [[down, 0]], [[0, right]]])
        # The border shifts all indices by 1.
        is_free = free[tuple(np.moveaxis(entered + 1, -1, 0))].all(axis=0)
        starts_of_steps = index[tuple(cells[is_free].T)]
        goals_of_steps = index[tuple(entered[0, is_free].T)]
        lengths_of_steps = np.full(is_free.sum(), np.hypot(down, right))
        steps.append((lengths_of_steps, starts_of_steps, goals_of_steps))
    lengths, first, second = map(np.concatenate, zip(*steps, strict=True))
    graph = coo_array((lengths, (first, second)), (len(cells), len(cells)))
    return np.asarray(dijkstra(graph.tocsr(), directed=False, indices=starts))
