"""Robots on the streets of a town: the fewest that fill a cycle, and how many full cycles to expect.

A street leads from crossing to crossing, in one direction. Robots wait on streets and keep crossings
clear, so a town jams when the streets of a cycle are full.
"""

from functools import cache, partial
from math import pi
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float32, Int8, Int32, Real, Shaped

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, is_real, real
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, ArrayOrRows, Pytree
from elitelanes_jax.network.checks import check_grid, is_traced
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.records import LONGEST_DETOUR
from elitelanes_jax.network.sharding import divide_batches

# Lengths in millimetres. The first two are a waiting car of SUMO with the gap to the next car, and
# this gap. The third is the distance from the lane to the middle of the road. The last is how much
# of a street its two crossings take: half a road and the radius of the corners at each end.
_CAR, _GAP, _LANE, _CROSSINGS = 7500, 2500, 1600, 14_400

# What a right turn, no turn and a left turn add to a heading, which counts clockwise.
_TURNS = np.array([1, 0, -1])

# The time on a crossing is that on 20 m of street.
_METRES_OF_CROSSING = 20.0

# More robots than find room in any town.
_ENDLESS = 2**29


@name_wrong_arguments
@runs_jax
def gridlock_gamma(codes: ArrayOrRows, *, tile_size: float = 16.0) -> Int32[Array, ""]:
    """Returns the least number of robots that fill a cycle of streets; `jax.vmap` it for many maps.

    If robots keep crossings clear, fewer robots do not jam. Exceptions are streets whose room is
    used up to the last metre: SUMO's first car waits 1 m before the end, which the formula does not
    count. ``docs/gridlock.md`` has a study. Unlike `gridlock_number`, gamma counts the room between
    the crossings, which is shorter than the way from crossing to crossing.

    A street holds at least one robot. Rings without a crossing are no streets, and roads to dead
    ends are left out. Without a cycle of streets gamma is 0.

    Args:
      codes: integer codes ``[H, W]``, repaired or not. A connection that the neighbour does not
        return is no link.
      tile_size: side of a tile in metres, 15 to 100, for cars of SUMO: 5 m long, 2.5 m apart, on
        lanes of 3.2 m. The default is about right for Duckietown too: there robots of 18 cm have
        gaps of 9 cm.

    Raises:
      InputError: for a bad grid, one with a side over 32, or a bad size of tiles.
    """
    return _gamma(_check_town(codes), tile_size=_check_size(tile_size))


@name_wrong_arguments
@runs_jax
def gridlock_potential(
    codes: ArrayOrRows, robots: Real[ArrayLike, ""], *, tile_size: float = 16.0
) -> Float32[Array, ""]:
    """Returns the expected number of full cycles of streets; `jax.vmap` it for many maps.

    It is -log det(I - diag(p) T). p is the chance that a street is full. T has the shares of the
    streets onto which robots turn at its end. The series of the logarithm sums the chances of all
    closed ways along full streets, as Ihara's zeta function counts closed ways in a graph.

    Robots drive between all pairs of streets by ways over fewest streets, all of them alike. A pair
    counts as much as the product of both lengths. The robots on a street have a Poisson
    distribution. Their mean is in proportion to the street's flow times its length and 20 m for the
    crossing; the means sum up to `robots`. Streets and their room are those of `gridlock_gamma`.

    Small numbers keep their digits, and the derivative by `robots` is exact. The last digits depend
    on the machine and the batch. Below 1e-38 the result may be 0. It is infinite where all streets
    of a cycle are sure to be full. There the derivative is NaN.

    Args:
      codes: integer codes ``[H, W]``, repaired or not.
      robots: the number of robots, 0 or more. A negative number counts as 0.
      tile_size: side of a tile in metres, as for `gridlock_gamma`.

    Raises:
      InputError: for a bad grid, one with a side over 32, a bad size of tiles, or robots that are
        no number.
    """
    size = _check_size(tile_size)
    _check_robots(robots)
    return _potential(_check_town(codes), jnp.asarray(robots, jnp.float32), tile_size=size)


def _check_robots(robots: ArrayLike) -> None:
    """Checks a number of robots, which may be infinite or traced."""
    is_number = is_real(robots) or (hasattr(robots, "dtype") and not np.ndim(robots))
    if not is_number or (not is_traced(robots) and np.isnan(robots).any()):
        raise InputError("robots", "a number", quote(robots))


def _check_town(codes: ArrayOrRows) -> AnyArray:
    grid = check_grid(codes, "codes")
    if max(grid.shape) > LONGEST_DETOUR:
        expected = f"sides of at most {LONGEST_DETOUR} for streets"
        raise InputError("codes", expected, grid.shape)
    return grid


def _check_size(tile_size: float) -> float:
    return check_named("tile_size", real(15, 100, unit="metres"), tile_size)


class _Streets(NamedTuple):
    """The streets of a town. N is 4 x cells: a street has the index of the lane where it ends.

    A lane is a tile and the heading with which robots enter it. Other indices are no street.

    Attributes:
      onward: the streets that follow, by turn; N for none.
      before: the streets that a robot comes from, by the turn that it took; N for none.
      metres: the length, 0 for no street.
      capacity: the robots that find room.
    """

    onward: Int32[Array, "N 3"]
    before: Int32[Array, "N 3"]
    metres: Float32[Array, " N"]
    capacity: Int32[Array, " N"]


@cache
def _lanes(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lane after each lane, and the lane before it, by turn: right, straight, left.

    Both are int32 ``[N, 3]``, N for a lane outside the grid.
    """
    heading, row, column = np.indices((4, height, width)).reshape(3, -1, 1)
    down, right = (np.array([getattr(side, name) for side in SIDES]) for name in ("down", "right"))

    def lane(heading: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        index = (heading * height + row) * width + column
        return np.where(inside, index, 4 * height * width).astype(np.int32)

    after, earlier = (heading + _TURNS) % 4, (heading - _TURNS) % 4
    return (
        lane(after, row + down[after], column + right[after]),
        lane(earlier, row - down[heading], column - right[heading]),
    )


def links_on_loops(grid: Int8[Array, "H W"]) -> Bool[Array, "4 H W"]:
    """Returns which tiles are linked on each side, without the roads that lead to dead ends."""
    height, width = grid.shape

    def beside(cells: Array) -> Array:
        padded = jnp.pad(cells, 1)
        corners = [(1 + side.down, 1 + side.right) for side in SIDES]
        return jnp.stack([padded[down:, right:][:height, :width] for down, right in corners])

    def is_end(links: Array) -> Array:
        return links.sum(axis=0, dtype=jnp.int32) == 1

    def shorten(links: Array) -> Array:
        ends = is_end(links)
        return links & ~ends[None] & ~beside(ends)

    bits, opposite = (
        np.array([getattr(side, name) for side in SIDES], np.int8)[:, None, None]
        for name in ("bit", "opposite")
    )
    links = (grid[None] & bits > 0) & (beside(grid) & opposite > 0)
    return lax.while_loop(lambda links: is_end(links).any(), shorten, links)


def _find_streets(grid: Int8[Array, "H W"], tile_size: float) -> _Streets:
    after, earlier = _lanes(*grid.shape)
    count = len(after)
    index = np.arange(count, dtype=np.int32)
    heading, cell = np.divmod(index[:, None], count // 4)
    links = links_on_loops(grid).reshape(4, -1)
    # A robot enters a tile by the side behind it, and leaves by the side of its new heading.
    moves = links[(heading + 2) % 4, cell] & links[(heading + _TURNS) % 4, cell]
    came = jnp.pad(moves, ((0, 1), (0, 0)))[earlier, np.arange(3)]

    # Between crossings, each lane leads to one other. Each round doubles the steps that are made.
    is_passage = moves.sum(axis=1, dtype=jnp.int32) == 1
    right, left = (round(500 * pi * (tile_size / 2 + side * _LANE / 1000)) for side in (-1, 1))
    tile = round(1000 * tile_size)
    lengths = np.array([[right, tile, left]], np.int32)
    way = jnp.where(is_passage[:, None] & moves, lengths, 0).sum(axis=1, dtype=jnp.int32)
    end = jnp.where(is_passage, jnp.where(moves, after, count).min(axis=1), index)
    for _ in range((count - 1).bit_length()):
        way, end = way + way[end], end[end]

    # A street begins after a crossing, and has the index of its last lane.
    begins = (came & ~jnp.pad(is_passage, (0, 1))[earlier]).any(axis=1)
    first = jnp.full(count + 1, -1, jnp.int32).at[jnp.where(begins, end, count)].max(index)[:count]
    is_street = first >= 0
    millimetres = jnp.where(is_street, way[first] + tile - _CROSSINGS, 0)
    onward = jnp.where(
        moves & is_street[:, None], jnp.pad(end, (0, 1), constant_values=count)[after], count
    )
    before = jnp.where(came & begins[:, None], earlier, count)[first]
    return _Streets(
        onward=onward,
        before=jnp.where(is_street[:, None], before, count),
        metres=millimetres.astype(jnp.float32) / 1000,
        capacity=jnp.where(is_street, jnp.maximum((millimetres + _GAP) // _CAR, 1), 0),
    )


def _of_onward(streets: _Streets, table: Shaped[Array, "N N"]) -> Shaped[Array, "N 3 N"]:
    """Returns the rows of a table of streets that follow each street, by turn; 0 for none."""
    return jnp.pad(table, ((0, 1), (0, 0)))[streets.onward]


@partial(jax.jit, static_argnames="tile_size")
@divide_batches
def _gamma(grid: Int8[Array, "H W"], *, tile_size: float) -> Int32[Array, ""]:
    streets = _find_streets(grid, tile_size)
    # Where no street follows, the room is endless.
    room = jnp.pad(streets.capacity, (0, 1), constant_values=_ENDLESS)[streets.onward][:, :, None]
    itself = np.eye(len(streets.capacity), dtype=bool)

    def extend(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        robots, _ = carry
        # A way that has arrived needs no more robots.
        further = _of_onward(streets, jnp.where(itself, 0, robots))
        fewer = jnp.minimum(room + further, _ENDLESS).min(axis=1)
        return fewer, (fewer != robots).any()

    # For each pair of streets: the robots that fill a way from one street, without it, to another.
    none = streets.capacity[0] & 0
    carry = (jnp.full(itself.shape, _ENDLESS, jnp.int32) | none, none == 0)
    robots, _ = lax.while_loop(lambda carry: carry[1], extend, carry)
    gamma = jnp.diagonal(robots).min()
    return jnp.where(gamma < _ENDLESS, gamma, 0)


@partial(jax.jit, static_argnames="tile_size")
@divide_batches
def _potential(
    grid: Int8[Array, "H W"], robots: Float32[Array, ""], *, tile_size: float
) -> Float32[Array, ""]:
    streets = _find_streets(grid, tile_size)
    return _expected_cycles(robots, streets, _flows(streets))


def _flows(streets: _Streets) -> Float32[Array, "N 3"]:
    """Returns what passes from each street to the next ones, by turn."""
    metres = streets.metres
    # For each street and each goal: the steps over fewest streets, -1 for none, and the number of
    # ways. In round k, the front has the ways of k steps.
    itself = jnp.eye(metres.size, dtype=bool) & (metres > 0)[None]
    start = itself.astype(jnp.float32)

    def step_back(
        carry: tuple[Array, Array, Array, Array],
    ) -> tuple[Array, Array, Array, Array]:
        front, ways, steps, rounds = carry
        front = jnp.where(ways > 0, 0, _of_onward(streets, front).sum(axis=1))
        return front, ways + front, jnp.where(front > 0, rounds + 1, steps), rounds + 1

    _, ways, steps, rounds = lax.while_loop(
        lambda carry: jnp.any(carry[0] > 0),
        step_back,
        (start, start, itself.astype(jnp.int32) - 1, streets.capacity[0] & 0),
    )

    # Where there is no way, nothing flows.
    per_way = jnp.where(steps > 0, 1 / jnp.maximum(ways, 1), 0)

    # From the farthest streets on, robots go one step on. All ways have equally many.
    def step_on(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        flow, rounds = carry
        share = jnp.where(steps == rounds, flow * per_way, 0)
        arriving = jnp.pad(share, ((0, 1), (0, 0)))[streets.before].sum(axis=1)
        return flow + jnp.where(steps == rounds - 1, arriving * ways, 0), rounds - 1

    pairs = metres[:, None] * metres[None]
    flow, _ = lax.while_loop(lambda carry: carry[1] > 1, step_on, (pairs, rounds))
    is_nearer = _of_onward(streets, steps + 1) == steps[:, None]
    onward = (flow * per_way)[:, None] * _of_onward(streets, ways)
    return jnp.where(is_nearer, onward, 0).sum(axis=2)


def _poisson_tails(
    mean: Float32[Array, " N"], count: Float32[Array, " N"]
) -> tuple[Float32[Array, " N"], Float32[Array, " N"]]:
    """Returns the chances that a Poisson number is at least a count, and that it is less.

    The smaller of both is summed from its largest term on, so that it keeps its digits. The program
    compiles in a third of the time of one with JAX's incomplete gamma functions.
    """
    mean = jnp.maximum(mean, 1e-30)
    is_rare = mean < count
    largest = jnp.where(is_rare, count, count - 1)

    def add(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        term, total, step = carry
        term = term * jnp.where(is_rare, mean / (count + step), (count - step) / mean)
        return term, total + term, step + 1

    term = jnp.exp(largest * jnp.log(mean) - mean - lax.lgamma(largest + 1))
    carry = (jnp.ones_like(term), jnp.ones_like(term), count[0] * 0 + 1)
    terms = lax.while_loop(lambda carry: jnp.any(carry[0] > 1e-9 * carry[1]), add, carry)[1]
    chance = term * terms
    return jnp.where(is_rare, chance, 1 - chance), jnp.where(is_rare, 1 - chance, chance)


@jax.custom_jvp
def _expected_cycles(
    robots: Float32[Array, ""], streets: _Streets, flows: Float32[Array, "N 3"]
) -> Float32[Array, ""]:
    """Returns -log det(I - diag(p) T), see `gridlock_potential`."""
    passing = flows.sum(axis=1)
    is_used = passing > 0
    load = passing * (streets.metres + _METRES_OF_CROSSING)
    # Infinitely many robots times no load are no number.
    mean = jnp.minimum(robots, _ENDLESS) * load / jnp.maximum(load.sum(), 1)
    full, free = _poisson_tails(mean, jnp.maximum(streets.capacity, 1).astype(jnp.float32))
    shares = full[:, None] * flows / jnp.where(is_used, passing, 1)[:, None]
    count = passing.size
    matrix = (
        jnp.zeros((count, count + 1), jnp.float32)
        .at[np.arange(count)[:, None], streets.onward]
        .add(shares)
    )
    order = jnp.argsort(~is_used, stable=True)

    # Streets are taken out one by one, and the ways through each become direct. Sums of chances
    # alone keep all digits of small ones (Grassmann, Taksar and Heyman, 1985).
    def take_out(
        carry: tuple[Array, Array, Array, Array, Array],
    ) -> tuple[Array, Array, Array, Array, Array]:
        taken, left, matrix, ending, total = carry
        street = order[taken]
        left = left & (np.arange(count) != street)
        back, onward = matrix[street, street], jnp.where(left, matrix[street], 0)
        # This is 1 - back, without its loss of digits if back is near 1.
        leaving = ending[street] + onward.sum()
        total -= jnp.where(back < 0.5, jnp.log1p(-jnp.minimum(back, 0.5)), jnp.log(leaving))
        into = jnp.where(left & (matrix[:, street] > 0), matrix[:, street] / leaving, 0)
        matrix = matrix + into[:, None] * onward[None]
        return taken + 1, left, matrix, ending + into * ending[street], total

    ending = jnp.where(is_used, free, 1)
    used = is_used.sum(dtype=jnp.int32)
    # The total is made from the chances, so that inside `jax.shard_map` it is on the same devices.
    carry = (used * 0, is_used, matrix[:, :count], ending, ending[0] * 0)
    return lax.while_loop(lambda carry: carry[0] < used, take_out, carry)[-1]


@_expected_cycles.defjvp
def _(
    primals: tuple[Array, _Streets, Array], tangents: tuple[Array, Pytree, Pytree]
) -> tuple[Array, Array]:
    """Differentiates forwards by the robots, because such a loop has no derivative backwards."""
    robots, *town = primals
    value, slope = jax.jvp(
        lambda robots: _expected_cycles.fun(robots, *town), (robots,), (jnp.ones_like(robots),)
    )
    return value, slope * tangents[0]
