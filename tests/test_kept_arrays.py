"""What is kept of a caller's arrays is a copy: the caller may write to them later.

JAX on a processor shares the memory of NumPy's arrays at addresses that 64 divides.
"""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

from elitelanes_jax import RoadMap, Weights, load_tiles, random_grids, repair, road_problem
from elitelanes_jax.drive import (
    Camera,
    LaneDrive,
    LaneDriveParams,
    RoadNav,
    RoadNavParams,
    Variation,
    auto_replay,
    film,
    make_levels,
    make_rides,
    make_scenes,
    make_sight,
    stream_views,
)
from elitelanes_jax.drive._batch import DISABLED, Batch
from elitelanes_jax.drive.interop import GymnaxEnv
from elitelanes_jax.drive.robot import Robot
from elitelanes_jax.optimizers import MoveWeights, random_move
from elitelanes_jax.problem import Problem
from elitelanes_jax.tiles import ObjectSet, TileSet, load_objects

KEY, SHAPE = jax.random.key(1), (4, 5)
MAPS = np.asarray(jax.vmap(partial(repair, fill=True))(random_grids(KEY, 4, SHAPE)))
FIXED = np.eye(*SHAPE, dtype=bool)
TINY = Camera(rows=4, columns=6)
SPACES = SimpleNamespace(Discrete=int, Box=int)


class Case(NamedTuple):
    """Draws arrays, makes something that keeps them, and looks at what it kept."""

    draw: Callable[[], Any]
    make: Callable[[Any], Any]
    look: Callable[[Any], Any]


def aligned(tree):
    """Copies arrays to addresses that 64 divides."""

    def place(array):
        array = np.asarray(array)
        memory = np.zeros(array.nbytes + 64, np.uint8)
        start = -memory.ctypes.data % 64
        placed = memory[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
        placed[...] = array
        return placed

    return jax.tree.map(place, tree)


def zero(tree):
    for array in jax.tree.leaves(tree):
        array[...] = 0


def levels():
    return make_levels(KEY, MAPS)


def batch(environment, params, levels):
    return Batch(environment, params(levels), 4, DISABLED)


def ride(batch):
    """A step of all wrappers; the actions are kept until it is made."""
    batch.reset(range(4))
    actions = aligned(np.ones(4, np.int32) if batch.environment.actions else np.ones((4, 2), np.float32))
    batch.send(actions)
    zero(actions)
    return batch.receive()


def replayed(level):
    return auto_replay(RoadNav).reset_to_level(KEY, level, RoadNavParams(levels()))[1]


def draw_tiles():
    return [(tile.image, tile.road, tile.red, tile.yellow) for tile in load_tiles().tiles]


def make_tiles(pictures):
    drawn = load_tiles()
    names = ("image", "road", "red", "yellow")
    tiles = [
        tile._replace(**dict(zip(names, parts, strict=True))) for tile, parts in zip(drawn.tiles, pictures, strict=True)
    ]
    return TileSet("copy", "", tuple(tiles))


def draw_objects():
    first = load_objects().pictures[0]
    return dict(first.views), first.top


def make_object_set(pictures):
    first = load_objects().pictures[0]
    return ObjectSet("copy", (type(first)(first.name, first.kind, 1, (1, 1), None, *pictures),))


def draw_road():
    columns = road_problem(SHAPE, limits=None, measured=("crossings4",)).feature_names
    return MAPS[:2], np.tile(np.int32([[1], [3]]), len(columns) + 4), np.int32([7]), np.array(5, np.int32)


def make_road(arrays):
    initial, limits, feature_weights, bridges = arrays
    options = {"measured": ("crossings4",), "feature_weights": feature_weights, "weights": Weights(bridges=bridges)}
    return road_problem(SHAPE, initial=initial, limits=limits, **options)


def record(kind, **numbers):
    return Case(lambda: numbers, lambda arrays: kind(**arrays), lambda made: [getattr(made, name) for name in numbers])


CASES = {
    "LaneDrive": Case(levels, partial(batch, LaneDrive, LaneDriveParams), ride),
    "RoadNav": Case(levels, partial(batch, RoadNav, RoadNavParams), ride),
    "GymnaxEnv": Case(
        levels, lambda levels: GymnaxEnv(RoadNav, RoadNavParams(levels), SPACES), lambda env: env.default_params
    ),
    "auto_replay": Case(lambda: jax.tree.map(lambda part: part[0], levels()), replayed, lambda state: state),
    "sight": Case(
        lambda: make_sight(load_tiles(), TINY, tile_px=16),
        lambda sight: LaneDriveParams(levels(), sight=sight),
        lambda params: params.sight,
    ),
    "RoadMap": Case(lambda: MAPS[0], RoadMap, lambda road_map: road_map.codes),
    "TileSet": Case(draw_tiles, make_tiles, lambda tiles: [tile[2:6] for tile in tiles.tiles]),
    "ObjectSet": Case(
        draw_objects, make_object_set, lambda objects: (objects.pictures[0].views, objects.pictures[0].top)
    ),
    "Problem": Case(
        lambda: {"initial": MAPS, "fixed": FIXED},
        lambda arrays: Problem(SHAPE, lambda grids: grids, **arrays),
        lambda problem: (problem.initial, problem.fixed),
    ),
    "LaneDriveParams": record(lambda **more: LaneDriveParams(levels(), **more), limit=np.int32([40, 50])),
    "Robot": record(Robot, noise=np.float32([0.1, 0.2])),
    "Camera": record(Camera, height=np.float32([0.1, 0.2]), ground=np.float32([[1, 2, 3]])),
    "Variation": record(Variation, offset=np.float32([0.1, 0.2])),
    "MoveWeights": record(MoveWeights, link=np.int32([3, 4])),
}
SLOW = {
    "road_problem": Case(draw_road, make_road, lambda problem: (problem.initial, problem.evaluate(MAPS))),
    "random_move": Case(
        lambda: FIXED,
        lambda fixed: random_move(MoveWeights(fill_probability=1.0), fill=False, fixed=fixed),
        lambda move: move.apply(np.arange(move.bits, dtype=np.uint32), MAPS[0] & 9),
    ),
    "stream_views": Case(
        lambda: make_scenes(MAPS[:1], tile_px=16),
        lambda scenes: stream_views(0, scenes, 2, camera=TINY, samples=1),
        next,
    ),
    "film": Case(
        lambda: make_rides(MAPS[0], 1, seconds=1), lambda rides: film(MAPS[0], load_tiles(), rides, tile_px=16), next
    ),
}


@pytest.mark.parametrize("name", [*CASES, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_writing_to_an_array_later_changes_nothing(name):
    case = (CASES | SLOW)[name]
    arrays = case.draw()
    expected = jax.tree.map(np.array, case.look(case.make(aligned(arrays))))
    given = aligned(arrays)
    made = case.make(given)
    zero(given)
    jax.tree.map(np.testing.assert_array_equal, jax.tree.map(np.array, case.look(made)), expected)
