"""Metrics of a road network: one grid in, scalars out (paper, section "Evaluation Metrics")."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array

from elitelanes_jax.checks import check_grid
from elitelanes_jax.codes import EAST, NORTH, SOUTH, WEST, alphabet_of
from elitelanes_jax.faces import faces
from elitelanes_jax.lattice import Lattice, links_of

__all__ = ["COUNTED", "Metrics", "counts_of", "measure", "metrics_of"]


class Metrics(NamedTuple):
    """What `measure` finds in a grid: int32 scalars, `coverage` a float32.

    The graph's nodes are the non-empty tiles, its edges the links: neighbouring tiles that both connect to each other.
    A connection that is not answered, or that leaves the grid, is unmatched.

    Attributes:
      components: connected components (paper: CO).
      cyclomatic: cyclomatic number, edges - tiles + components (CY).
      dead_ends: tiles with exactly one connection or with an unmatched one (DE).
      boundary_violations: tiles with a connection that leaves the grid (BV).
      bridges: cut-edges, edges whose removal adds a component.
      crossings: tiles with three or four connections (CR).
      adjacent_crossings: linked pairs of crossings, counted from both tiles, so 2 a pair.
      adjacent_crossing_score: sum of the connections of both tiles over linked pairs of crossings (ACV).
      adjacent_turns: pairs of turns that share a side, linked or not (AT).
      straight_score: sum of L² over maximal runs of L straight tiles of one orientation, lined up along it (SR).
      straights: tiles with two connections that face each other.
      turns: tiles with two connections that do not.
      crowded_crossings: pairs of tiles that share a side, linked or not, of which one is a crossing and the other a
        crossing or a turn; Duckietown's rules allow none.
      unlinked_neighbours: pairs of non-empty tiles that share a side without a link; likewise.
      tiles: non-empty tiles.
      empty_cells: cells with no connection.
      edges: links.
      mismatches: unmatched connections inside the grid.
      off_alphabet: tiles whose code is not in the alphabet given to `measure`; 0 where none is given.
      coverage: tiles / all cells, in [0, 1] (CV).
    """

    components: Array
    cyclomatic: Array
    dead_ends: Array
    boundary_violations: Array
    bridges: Array
    crossings: Array
    adjacent_crossings: Array
    adjacent_crossing_score: Array
    adjacent_turns: Array
    straight_score: Array
    straights: Array
    turns: Array
    crowded_crossings: Array
    unlinked_neighbours: Array
    tiles: Array
    empty_cells: Array
    edges: Array
    mismatches: Array
    off_alphabet: Array
    coverage: Array


COUNTED = Metrics._fields[:-1]
"""The metrics that are whole numbers: all but the coverage, which follows from the tiles."""


def measure(grid: Any, alphabet: Iterable[int] | None = None) -> Metrics:
    """All metrics of one grid; `jax.vmap` it for many.

    Args:
      grid: integer codes ``[H, W]``, repaired or not.
      alphabet: the codes that `off_alphabet` lets pass; all 16 by default.

    Returns:
      `Metrics` of scalars.

    Raises:
      InputError: for a bad grid (see `check_grid`) or alphabet.
    """
    return _measure(check_grid(grid), None if alphabet is None else alphabet_of(alphabet))


def counts_of(metrics: Metrics) -> Array:
    """The whole numbers side by side, int32 ``[..., M]`` in the order of `COUNTED`: one array to carry about."""
    # A sum of columns, as XLA joins short arrays on a CPU number by number: that was a sixth of a step of the tuned EA.
    units = np.eye(len(COUNTED), dtype=np.int32)
    return sum(jnp.asarray(getattr(metrics, name))[..., None] * unit for name, unit in zip(COUNTED, units, strict=True))


def metrics_of(counts: Array, cells: int) -> Metrics:
    """`Metrics` of arrays ``[...]`` from `counts_of` ``[..., M]``, of grids with so many cells."""
    columns = dict(zip(COUNTED, jnp.moveaxis(counts, -1, 0), strict=True))
    return Metrics(**columns, coverage=_share(columns["tiles"], cells))


def _share(tiles: Array, cells: int) -> Array:
    # Always true: a divisor known to the compiler would become a product with its reciprocal, which rounds otherwise.
    return tiles / jnp.where(tiles >= 0, cells, 1)


@partial(jax.jit, static_argnames="alphabet")
def _measure(grid: Array, alphabet: tuple[int, ...] | None) -> Metrics:
    lattice = Lattice(*grid.shape)
    padded = lattice.pad(grid)
    links = links_of(lattice, padded)
    dual = faces(lattice, links)

    rows, columns = lattice.rows(), lattice.columns()
    here = lattice.here(padded)
    north, east, south, west = (padded & side > 0 for side in (NORTH, EAST, SOUTH, WEST))
    connections = sum(side.astype(jnp.int8) for side in (north, east, south, west))
    outward = (
        (lattice.here(north) & (rows == 0)).astype(jnp.int8)
        + (lattice.here(east) & (columns == lattice.width - 1))
        + (lattice.here(south) & (rows == lattice.height - 1))
        + (lattice.here(west) & (columns == 0))
    )
    answered = (
        links.east.astype(jnp.int8)
        + links.south
        + (lattice.here(west) & lattice.west(east))
        + (lattice.here(north) & lattice.north(south))
    )
    own = lattice.here(connections)
    crossing = connections >= 3
    east_pair = links.east & lattice.here(crossing) & lattice.east(crossing)
    south_pair = links.south & lattice.here(crossing) & lattice.south(crossing)
    turn = (connections == 2) & (north != south)
    along, upright = here == (EAST | WEST), here == (NORTH | SOUTH)
    busy = crossing | turn

    def pairs(tiles: Array) -> Array:
        mine = lattice.here(tiles)
        return (mine & lattice.east(tiles)).astype(jnp.int8) + (mine & lattice.south(tiles))

    def crowds(neighbour: Callable[[Array], Array]) -> Array:
        mine, theirs = lattice.here(crossing), neighbour(crossing)
        return (mine & neighbour(busy)) | (theirs & lattice.here(busy))

    area, side = lattice.height * lattice.width, max(lattice.height, lattice.width)
    count = _sums(
        {
            "tiles": (here > 0, 1),
            "edges": (links.east.astype(jnp.int8) + links.south, 2),
            "cyclomatic": (dual.first, 1),
            "bridges": (dual.east_bridge.astype(jnp.int8) + dual.south_bridge, 2),
            "mismatches": (own - answered - outward, 4),
            "dead_ends": ((own == 1) | (own != answered), 1),
            "boundary_violations": (outward > 0, 1),
            "crossings": (lattice.here(crossing), 1),
            "crossing_pairs": (east_pair.astype(jnp.int8) + south_pair, 2),
            "crossing_score": (
                jnp.where(east_pair, own + lattice.east(connections), 0)
                + jnp.where(south_pair, own + lattice.south(connections), 0),
                16,
            ),
            "turn_pairs": (pairs(turn), 2),
            "straight_score": (
                _odd_numbers(along, 1, lattice.width) + _odd_numbers(upright, lattice.stride, lattice.height),
                2 * side,
            ),
            "straights": (along | upright, 1),
            "turns": (lattice.here(turn), 1),
            "crowded_crossings": (crowds(lattice.east).astype(jnp.int8) + crowds(lattice.south), 2),
            "neighbours": (pairs(padded > 0), 2),
            "off_alphabet": (_foreign(here, alphabet) & (columns < lattice.width), 1),
        },
        area,
    )
    return Metrics(
        components=count["tiles"] - count["edges"] + count["cyclomatic"],
        cyclomatic=count["cyclomatic"],
        dead_ends=count["dead_ends"],
        boundary_violations=count["boundary_violations"],
        bridges=count["bridges"],
        crossings=count["crossings"],
        adjacent_crossings=2 * count["crossing_pairs"],
        adjacent_crossing_score=count["crossing_score"],
        adjacent_turns=count["turn_pairs"],
        straight_score=count["straight_score"],
        straights=count["straights"],
        turns=count["turns"],
        crowded_crossings=count["crowded_crossings"],
        unlinked_neighbours=count["neighbours"] - count["edges"],
        tiles=count["tiles"],
        empty_cells=area - count["tiles"],
        edges=count["edges"],
        mismatches=count["mismatches"],
        off_alphabet=count["off_alphabet"],
        coverage=_share(count["tiles"], area),
    )


def _foreign(here: Array, alphabet: tuple[int, ...] | None) -> Array:
    foreign = jnp.zeros(here.shape, bool)
    for code in range(16):
        if alphabet is not None and code not in alphabet:
            foreign |= here == code
    return foreign


def _odd_numbers(straight: Array, step: int, longest: int) -> Array:
    """1, 3, 5, ... along each run of straight tiles, 0 elsewhere: over a run of L they add up to L².

    The length of the run up to each tile doubles its reach a round: a tile that has found `reach` straight
    tiles adds what the tile that many steps back has found.
    """
    length = straight.astype(jnp.int8 if longest <= 64 else jnp.int32)
    reach = 1
    while reach < longest:
        back = jnp.pad(length[: -reach * step], (reach * step, 0))
        length = length + jnp.where(length == reach, back, 0)
        reach *= 2
    return jnp.where(straight, 2 * length - 1, 0)


def _sums(terms: dict[str, tuple[Array, int]], cells: int) -> dict[str, Array]:
    """The sum of each vector, given the most that one place can hold.

    As many counters as fit, the widest first, are laid side by side in the bits of one word and summed together:
    reductions are what a small grid's metrics spend their time on.
    """
    words: list[list[tuple[str, int, int]]] = []  # of (name, lowest bit, bits)
    widths = {name: (most * cells).bit_length() for name, (_, most) in terms.items()}
    for name, bits in sorted(widths.items(), key=lambda item: -item[1]):
        for word in words:
            used = word[-1][1] + word[-1][2]
            if used + bits <= 32:
                word.append((name, used, bits))
                break
        else:
            words.append([(name, 0, bits)])
    sums = {}
    for word in words:
        total = sum(terms[name][0].astype(jnp.uint32) << low for name, low, _ in word).sum()
        for name, low, bits in word:
            sums[name] = (total >> low & np.uint32(2**bits - 1)).astype(jnp.int32)
    return sums
