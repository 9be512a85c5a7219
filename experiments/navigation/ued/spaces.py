"""Complete spaces of levels: every flawless network of a size, with every start and every goal.

    python -m experiments.navigation.ued.spaces

This command lists the networks of all spaces and writes a file for each to `networks/`. A file has one network of each
class of rotations and mirror images. Its first line has the numbers of classes and networks, and a checksum. The
numbers of networks equal those of the certificates (`experiments/search/results/certificates.md`).
"""

import hashlib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numba
import numpy as np
from jaxtyping import Array, Bool, Int, Int8, Int16, Int32, Key
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax.drive import UNREACHABLE, LaneNode, Level, RoadNav, RoadNavParams, distances, lane_nodes
from elitelanes_jax.drive import make_levels as some_levels
from elitelanes_jax.network import canonical_form, measure, mirror, rotate
from experiments.common import write

__all__ = [
    "SPACES",
    "Space",
    "draw",
    "levels_of",
    "list_networks",
    "make_space",
    "open_space",
    "read_networks",
    "with_symmetry",
]

SPACES = {"5x5B": (5, 5, False), "5x5A": (5, 5, True), "6x6A": (6, 6, True), "7x7A": (7, 7, True)}
"""Height, width and whether every cell is filled, by name. 5x5A is for tests and for the choice of settings."""

_FOLDER = Path(__file__).parent / "networks"


class Space(NamedTuple):
    """G networks with at most N nodes each. A level is a network, a start and a goal that can be reached from it.

    Attributes:
      grids: int8 ``[G, H, W]``, codes.
      cyclomatic: int32 ``[G]``, the cyclomatic numbers.
      nodes: int32 ``[G, N]`` each; a network with fewer nodes repeats its first one.
      onward: int32 ``[G, N, 3]``, the index of the node that each action leads to.
      choice: bool ``[G, N]``, whether several turns are open.
      distance: int16 ``[G, N, N]``, tiles from the start to the goal; 0 if the pair is no level.
      pairs: int32 ``[L]``, the places of all L levels in `distance`, flat.
    """

    grids: Int8[Array, "G H W"]
    cyclomatic: Int32[Array, " G"]
    nodes: LaneNode
    onward: Int32[Array, "G N 3"]
    choice: Bool[Array, "G N"]
    distance: Int16[Array, "G N N"]
    pairs: Int32[Array, " L"]


@numba.njit(cache=True)
def _is_connected(codes: NDArray[np.int8]) -> bool:
    height, width = codes.shape
    reached = np.zeros(codes.shape, np.bool_)
    for start in range(height * width):
        if codes[start // width, start % width] > 0:
            break
    stack, size = np.empty(height * width, np.int64), 1
    stack[0] = start
    reached[start // width, start % width] = True
    while size:
        size -= 1
        row, column = stack[size] // width, stack[size] % width
        for bit, down, right in ((8, -1, 0), (4, 0, 1), (2, 1, 0), (1, 0, -1)):
            if codes[row, column] & bit and not reached[row + down, column + right]:
                reached[row + down, column + right] = True
                stack[size] = (row + down) * width + column + right
                size += 1
    return bool((reached == (codes > 0)).all() and codes.any())


@numba.njit(cache=True)
def list_networks(height: int, width: int, fill: bool) -> NDArray[np.int8]:
    """Lists all flawless networks of a size, int8 ``[M, H, W]``, cell by cell with a step back at each fault.

    A network is flawless if it has one component and no dead end, boundary violation, mismatch, linked crossings or
    adjacent turns.
    """
    connections = np.array([0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4])
    is_turn = np.array([code in (3, 6, 9, 12) for code in range(16)])
    cells = height * width
    codes = np.zeros((height, width), np.int8)
    choices = np.full(cells, -1)  # of each cell: 2 for a link to the right, plus 1 for a link down
    networks = np.empty((1024, height, width), np.int8)
    count = cell = 0
    while cell >= 0:
        choices[cell] += 1
        row, column = cell // width, cell % width
        if choices[cell] == 4:
            choices[cell] = -1
            codes[row, column] = 0
            cell -= 1
            continue
        right, down = choices[cell] >> 1, choices[cell] & 1
        if (right and column == width - 1) or (down and row == height - 1):
            continue
        up_code = codes[row - 1, column] if row else np.int8(0)
        left_code = codes[row, column - 1] if column else np.int8(0)
        up, left = up_code >> 1 & 1, left_code >> 2 & 1
        code = 8 * up + 4 * right + 2 * down + left
        if connections[code] == 1 or (fill and code == 0):
            continue
        if is_turn[code] and (is_turn[up_code] or is_turn[left_code]):
            continue
        is_crossing = connections[code] >= 3
        if is_crossing and ((up and connections[up_code] >= 3) or (left and connections[left_code] >= 3)):
            continue
        codes[row, column] = code
        if cell < cells - 1:
            cell += 1
        elif _is_connected(codes):
            if count == len(networks):
                networks = np.concatenate((networks, np.empty_like(networks)))
            networks[count] = codes
            count += 1
    return networks[:count]


def with_symmetry(grids: Int8[np.ndarray, "G H W"]) -> Int8[np.ndarray, "M H W"]:
    """Returns all different rotations and mirror images of square grids, class by class."""
    images: dict[bytes, NDArray[np.int8]] = {}
    for grid in grids:
        for image in (grid, mirror(grid)):
            for turns in range(4):
                turned = np.asarray(rotate(image, turns))
                images.setdefault(turned.tobytes(), turned)
    return np.stack(list(images.values()))


def read_networks(name: str) -> Int8[np.ndarray, "G H W"]:
    """Reads the networks of a space, one of each class of rotations and mirror images.

    Raises:
      InputError: for an unknown name, or a file whose checksum differs.
    """
    if name not in SPACES:
        raise InputError("space", f"one of {', '.join(SPACES)}", repr(name))
    file = _FOLDER / f"{name}.txt"
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    if head.split()[-1] != _checksum(rows):
        raise InputError(file, "networks with the checksum of the first line", "others")
    height, width, _ = SPACES[name]
    return np.array([[int(code, 16) for code in row] for row in rows], np.int8).reshape(-1, height, width)


def _checksum(rows: list[str]) -> str:
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()


def _write_networks(name: str) -> str:
    """Lists the networks of a space and writes their file; returns its first line."""
    networks = list_networks(*SPACES[name])
    classes = {canonical_form(grid): grid for grid in networks[::-1]}
    rows = sorted("".join(f"{code:x}" for code in grid.ravel()) for grid in classes.values())
    head = f"{len(classes)} classes of {len(networks)} networks {_checksum(rows)}"
    write(_FOLDER / f"{name}.txt", "\n".join([head, *rows]) + "\n")
    return head


def make_space(grids: Int8[np.ndarray, "G H W"]) -> Space:
    """Makes the space of all levels on networks. The environment's own steps say where actions lead."""
    codes = jnp.asarray(grids, jnp.int8)
    places = [np.flatnonzero(np.asarray(lane_nodes(grid))) for grid in codes]
    count = max(map(len, places))
    flat = np.stack([np.pad(place, (0, count - len(place)), constant_values=place[0]) for place in places])
    is_node = np.arange(count) < np.array([[len(place)] for place in places])
    width = codes.shape[2]
    nodes = LaneNode(*(jnp.asarray(part, jnp.int32) for part in (flat // (4 * width), flat // 4 % width, flat % 4)))
    index = np.zeros((len(flat), codes[0].size * 4), np.int32)
    for row, place in zip(index, places, strict=True):
        row[place] = np.arange(len(place))
    onward, choice, distance = _explore(codes, nodes, jnp.asarray(index))
    is_level = np.asarray((distance > 0) & (distance < UNREACHABLE)) & is_node[:, :, None] & is_node[:, None]
    distance = np.where(is_level, distance, 0).astype(np.int16)
    cyclomatic = jax.vmap(measure)(codes).cyclomatic
    pairs = jnp.asarray(np.flatnonzero(is_level), jnp.int32)
    return Space(codes, cyclomatic, nodes, onward, choice & is_node, jnp.asarray(distance), pairs)


@cache
def open_space(name: str) -> Space:
    """Makes a space, once."""
    return make_space(read_networks(name))


@jax.jit
def _explore(grids: Array, nodes: LaneNode, index: Array) -> tuple[Array, Array, Array]:
    """Returns where actions lead and whether turns are open ``[G, N, ...]``, and distances ``[G, start, goal]``."""
    # A limit and costs have no influence on where a step leads. The levels are not drawn from.
    params = RoadNavParams(some_levels(jax.random.key(0), [[[6, 3], [12, 9]]]), window=0, goal="none")

    def explore(of: tuple[Array, LaneNode, Array]) -> tuple[Array, Array, Array]:
        grid, nodes, index = of

        def turn(node: LaneNode, action: Array) -> tuple[Array, Array]:
            level = Level(grid, node, node, jnp.int32(0), jnp.zeros(grid.shape, jnp.uint8))
            seen, state = RoadNav.reset_to_level(jax.random.key(0), level, params)
            node = RoadNav.step(jax.random.key(0), state, action, params).state.node
            return index[(node.row * grid.shape[1] + node.column) * 4 + node.heading], seen.ways.sum() > 1

        onward, choice = jax.vmap(jax.vmap(turn, (None, 0)), (0, None))(nodes, jnp.arange(3))
        away = jax.vmap(lambda goal: distances(grid, goal))(nodes)
        return onward, choice[:, 0], away[:, nodes.row, nodes.column, nodes.heading].T

    return jax.lax.map(explore, (grids, nodes, index))


def levels_of(space: Space, index: Int[Array, " B"]) -> Level:
    """Makes the levels with these numbers, 0 to L - 1. Their shortest ways are not computed; `RoadNav` needs none."""
    count = space.choice.shape[1]
    pair = space.pairs[index]
    grid, start, goal = pair // (count * count), pair // count % count, pair % count
    grids = space.grids[grid]
    starts, goals = (jax.tree.map(lambda part, at=at: part[grid, at], space.nodes) for at in (start, goal))
    shortest = space.distance[grid, start, goal].astype(jnp.int32)
    return Level(grids, starts, goals, shortest, jnp.zeros(grids.shape, jnp.uint8))


def draw(key: Key[Array, ""], space: Space, count: int) -> Int32[Array, " B"]:
    """Draws numbers of levels uniformly; the key is consumed."""
    return jax.random.randint(key, (count,), 0, len(space.pairs))


if __name__ == "__main__":
    for name in SPACES:
        print(f"{name}: {_write_networks(name)}", flush=True)
