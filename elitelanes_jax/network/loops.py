"""The shortest loop of a road network, in Python alone."""

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.types import ArrayOrRows
from elitelanes_jax.network.checks import known_grid
from elitelanes_jax.network.links import Cell, linked_neighbours


@name_wrong_arguments
def gridlock_loop(codes: ArrayOrRows) -> list[Cell]:
    """Returns the shortest loop of a map: the first one that robots can fill.

    `gridlock_number` is its number of tiles - 1, for one robot a tile.

    Args:
      codes: integer codes ``[H, W]``, repaired or not. A connection that the neighbour does not
        return is no link.

    Returns:
      The tiles as (row, column), clockwise; none for a map without a loop. The first tile is the
      northernmost one, and of several the westernmost. Of several shortest loops, the one whose
      list of tiles is least comes first, as Python compares lists.

    Raises:
      InputError: for a bad grid, or traced codes.
    """
    links = linked_neighbours(known_grid(codes, "codes"))
    loop: list[Cell] = []
    # The first tile of a loop leads east and south. The loop's other tiles come after it.
    for first in links:
        east, south = (first[0], first[1] + 1), (first[0] + 1, first[1])
        if east in links[first] and south in links[first]:
            # Only a shorter loop may replace one that was found before.
            most = len(loop) - 2 if loop else len(links)
            loop = _close(links, first, east, south, most) or loop
    return loop


def _close(
    links: dict[Cell, list[Cell]], first: Cell, east: Cell, south: Cell, most: int
) -> list[Cell]:
    """Returns the least of the shortest loops with a first tile and both its neighbours.

    There is none if these have more than `most` tiles.
    """
    steps_to_south = {south: 0}
    waiting = [south]
    for tile in waiting:
        steps = steps_to_south[tile] + 1
        # A loop of `most` tiles has `most` - 2 steps from one neighbour to the other.
        if tile == east or steps > most - 2:
            break
        for other in links[tile]:
            if other > first and other not in steps_to_south:
                steps_to_south[other] = steps
                waiting.append(other)
    if east not in steps_to_south:
        return []
    loop = [first, east]
    while loop[-1] != south:
        steps = steps_to_south[loop[-1]] - 1
        loop.append(min(tile for tile in links[loop[-1]] if steps_to_south.get(tile) == steps))
    return loop
