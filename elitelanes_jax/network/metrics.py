"""The metrics of a road network, from one grid to scalars (paper, section "Evaluation Metrics")."""

from collections.abc import Callable, Iterable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float32, Int, Int8, Int32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import ArrayOrRows
from elitelanes_jax.network._faces import find_faces, find_links
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST, check_alphabet
from elitelanes_jax.network.records import METRIC_NAMES, Metrics
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import PaddedLayout, take


@name_wrong_arguments
@runs_jax
def measure(grid: ArrayOrRows, alphabet: Iterable[int] | None = None) -> Metrics:
    """Measures one grid; `jax.vmap` it for many.

    Under `jax.jit` and `jax.vmap` codes are not checked, and their four lowest bits are read.

    Args:
      grid: integer codes ``[H, W]``, repaired or not.
      alphabet: the codes that `off_alphabet` does not count; all 16 by default.

    Returns:
      `Metrics` of scalars.

    Raises:
      InputError: for a bad grid or alphabet.
    """
    return _measure(
        check_grid(grid), alphabet=None if alphabet is None else check_alphabet(alphabet)
    )


def stack_metrics(metrics: Metrics) -> Int32[Array, "... M"]:
    """Returns the metrics as columns, in the order of `METRIC_NAMES`."""
    # The columns are summed, because XLA on a CPU concatenates short arrays number by number. That
    # would take a sixth of a step of the tuned EA.
    count, axes = len(METRIC_NAMES), metrics.tiles.ndim
    units = np.eye(count, dtype=np.int32).reshape(count, *(1,) * axes, count)
    columns = (
        getattr(metrics, name)[..., None] * unit
        for name, unit in zip(METRIC_NAMES, units, strict=True)
    )
    return sum(columns, jnp.int32(0))


def unstack_metrics(features: Int32[Array, "... F"], cells: int) -> Metrics:
    """Returns `Metrics` of arrays ``[...]`` from the columns of `stack_metrics`.

    The grids have `cells` cells. Further columns are ignored.
    """
    columns = dict(zip(METRIC_NAMES, jnp.moveaxis(features, -1, 0), strict=False))
    return Metrics(**columns, coverage=_coverage(columns["tiles"], cells))


def _coverage(tiles: Int32[Array, "..."], cells: int) -> Float32[Array, "..."]:
    # A table gives the quotients, because a GPU divides less exactly than a processor. The features
    # of vacant slots may be any number, so the index is clipped.
    return take(
        np.arange(cells + 1, dtype=np.float32) / np.float32(cells), jnp.clip(tiles, 0, cells)
    )


@partial(jax.jit, static_argnames="alphabet")
@divide_batches
def _measure(grid: Int8[Array, "H W"], *, alphabet: tuple[int, ...] | None) -> Metrics:
    layout = PaddedLayout(*grid.shape)
    padded = layout.pad(grid)
    links = find_links(layout, padded)
    faces = find_faces(layout, padded, links)

    # A guard cell has the column `width`.
    rows, columns = np.divmod(np.arange(layout.size), layout.stride)
    # The four lowest bits of a traced code are read. Cutting them off here costs no time; before
    # the padding it would make `measure` 1.01 times as slow.
    here = layout.here(padded) & 15
    north, east, south, west = (padded & side > 0 for side in (NORTH, EAST, SOUTH, WEST))
    connections = _count(north, east, south, west)
    # Each connection of a tile leaves the grid, is returned by the neighbour, or is a mismatch.
    outward = _count(
        layout.here(north) & (rows == 0),
        layout.here(east) & (columns == layout.width - 1),
        layout.here(south) & (rows == layout.height - 1),
        layout.here(west) & (columns == 0),
    )
    returned = _count(
        links.east,
        links.south,
        layout.here(west) & layout.west(east),
        layout.here(north) & layout.north(south),
    )
    degree = layout.here(connections)
    crossing = connections >= 3
    east_pair = links.east & layout.here(crossing) & layout.east(crossing)
    south_pair = links.south & layout.here(crossing) & layout.south(crossing)
    turn = (connections == 2) & (north != south)
    along, upright = here == (EAST | WEST), here == (NORTH | SOUTH)
    busy = crossing | turn

    def pairs(tiles: Array) -> Array:
        mine = layout.here(tiles)
        return _count(mine & layout.east(tiles), mine & layout.south(tiles))

    def crowds(neighbour: Callable[[Array], Array]) -> Array:
        mine, theirs = layout.here(crossing), neighbour(crossing)
        return (mine & neighbour(busy)) | (theirs & layout.here(busy))

    area, side = layout.height * layout.width, max(layout.height, layout.width)
    # The straight score counts in odd numbers up to 2 * side - 1. Short sides need only bytes.
    counter = jnp.int8 if side <= 64 else jnp.int32
    # With each vector comes its largest possible element, which says how many bits its sum needs.
    counts = _sums(
        {
            "tiles": (here > 0, 1),
            "edges": (_count(links.east, links.south), 2),
            "cyclomatic": (faces.first, 1),
            "bridges": (_count(faces.east_bridge, faces.south_bridge), 2),
            "mismatches": (degree - returned - outward, 4),
            "dead_ends": ((degree == 1) | (degree != returned), 1),
            "boundary_violations": (outward > 0, 1),
            "crossings": (layout.here(crossing), 1),
            "adjacent_crossings": (_count(east_pair, south_pair), 2),
            "adjacent_crossing_score": (
                jnp.where(east_pair, degree + layout.east(connections), 0)
                + jnp.where(south_pair, degree + layout.south(connections), 0),
                16,
            ),
            "adjacent_turns": (pairs(turn), 2),
            "straight_score": (
                _odd_numbers(along, 1, layout.width, counter)
                + _odd_numbers(upright, layout.stride, layout.height, counter),
                2 * side,
            ),
            "straights": (along | upright, 1),
            "turns": (layout.here(turn), 1),
            "crowded_crossings": (_count(crowds(layout.east), crowds(layout.south)), 2),
            "neighbours": (pairs(padded & 15 > 0), 2),
            # Guard cells have code 0, which may be outside the alphabet, but they are not part of
            # the grid.
            "off_alphabet": (_outside_alphabet(here, alphabet) & (columns < layout.width), 1),
        },
        area,
    )
    # The others follow from these sums. The number of components is Euler's formula, see `_faces`.
    counts["components"] = counts["tiles"] - counts["edges"] + counts["cyclomatic"]
    # Each linked pair of crossings counts from both tiles.
    counts["adjacent_crossings"] *= 2
    counts["unlinked_neighbours"] = counts.pop("neighbours") - counts["edges"]
    counts["empty_cells"] = area - counts["tiles"]
    return Metrics(**counts, coverage=_coverage(counts["tiles"], area))


def _count(*flags: Bool[Array, " size"]) -> Int8[Array, " size"]:
    """Returns how many of the flags are True."""
    first, *others = (flag.astype(jnp.int8) for flag in flags)
    return sum(others, first)


def _outside_alphabet(
    here: Int8[Array, " size"], alphabet: tuple[int, ...] | None
) -> Bool[Array, " size"]:
    outside = jnp.zeros(here.shape, bool)
    for code in range(16):
        if alphabet is not None and code not in alphabet:
            outside |= here == code
    return outside


def _odd_numbers(
    straight: Bool[Array, " size"], step: int, longest: int, dtype: type
) -> Int[Array, " size"]:
    """Returns 1, 3, 5, ... along each run of straight tiles and 0 elsewhere.

    The sum over a run of L is L². The length of the run up to each tile is found in rounds that
    double its reach: a tile that has counted `reach` straight tiles adds the count of the tile that
    many steps back.
    """
    length = straight.astype(dtype)
    reach = 1
    while reach < longest:
        back = jnp.pad(length[: -reach * step], (reach * step, 0))
        length = length + jnp.where(length == reach, back, 0)
        reach *= 2
    return jnp.where(straight, 2 * length - 1, 0)


def _sums(terms: dict[str, tuple[Array, int]], cells: int) -> dict[str, Int32[Array, ""]]:
    """Sums each vector, whose largest possible element is given.

    Counters are packed into the bits of one word, the widest first, and summed together. On a small
    grid the sums take most of the time.
    """
    # Each word is a list of counters: a name, the lowest bit, and the number of bits.
    words: list[list[tuple[str, int, int]]] = []
    widths = {name: (most * cells).bit_length() for name, (_, most) in terms.items()}
    for name, bits in sorted(widths.items(), key=lambda item: -item[1]):
        for word in words:
            used = word[-1][1] + word[-1][2]
            if used + bits <= 32:
                word.append((name, used, bits))
                break
        else:
            words.append([(name, 0, bits)])
    # No sum exceeds its bits, so one sum of the packed words gives the sums of all counters.
    sums = {}
    for word in words:
        packed = sum(
            (terms[name][0].astype(jnp.uint32) << low for name, low, _ in word), jnp.uint32(0)
        )
        # With 64-bit types, a sum without a type is a uint64.
        total = jnp.sum(packed, dtype=jnp.uint32)
        for name, low, bits in word:
            sums[name] = (total >> low & np.uint32(2**bits - 1)).astype(jnp.int32)
    return sums
