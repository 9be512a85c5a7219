"""Of a traced code, which nobody checks, all kernels read the same bits: the four lowest."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax import load_tiles, measure, mirror, repair, road_problem, rotate
from elitelanes_jax.drive import (
    Camera,
    LaneNode,
    Pose,
    distances,
    lane_nodes,
    lane_pose,
    look,
    make_sight,
    movements,
    random_level,
    random_pose,
)
from elitelanes_jax.network import difference, measure_town
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.optimizers import MoveWeights, random_move, refit_strip, with_symmetric_copy
from elitelanes_jax.optimizers._moves import KNOWN_MOVES, make_move
from elitelanes_jax.problem import Problem

KEY, POSE = jax.random.key(4), Pose(1.5, 1.7, 0.3)
ROUTES = Problem((4, 5), lambda grids: None, alphabet=(3, 5, 6, 9, 10, 12))


def moved(move, grid):
    return move.apply(random_bits(KEY, (move.bits,)), grid.astype(jnp.int8), grid[::-1].astype(jnp.int8))


KERNELS = {
    "measure": partial(measure, alphabet=(3, 5, 15)),
    "measure_town": measure_town,
    "repair": repair,
    "repair, fill": partial(repair, fill=True, fixed=np.eye(4, 5, dtype=bool)),
    "rotate": partial(rotate, quarter_turns=2),
    "mirror": mirror,
    "evaluate": lambda grid: road_problem((4, 5)).evaluate(grid[None].astype(jnp.int8)),
    "Problem.repair": ROUTES.repair,
    "difference": lambda grid: difference(grid, np.full((2, 3), 7)),
    "distances": lambda grid: distances(grid, LaneNode(1, 1, 1)),
    "lanes": lambda grid: (lane_nodes(grid), movements(grid), lane_pose(grid, POSE), random_pose(KEY, grid)),
    "random_level": partial(random_level, KEY),
}
SLOW = {f"move {name}": partial(moved, make_move(name)) for name in KNOWN_MOVES} | {
    "refit_strip": partial(moved, refit_strip()),
    "mixed moves": partial(moved, with_symmetric_copy(0.5, random_move(MoveWeights(), fill=False))),
    "look": lambda grid: look(POSE, grid, make_sight(load_tiles(), Camera(rows=9, columns=12), tile_px=16)),
}


@pytest.mark.parametrize("name", [*KERNELS, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_the_four_lowest_bits_are_read(name):
    kernels, rng = jax.jit(jax.vmap((KERNELS | SLOW)[name])), np.random.default_rng(2)
    grids = rng.integers(0, 16, (8, 4, 5))
    codes = grids + 16 * rng.integers(-50, 50, grids.shape)
    jax.tree.map(np.testing.assert_array_equal, kernels(codes), kernels(grids))
