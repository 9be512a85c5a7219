"""What is kept of a caller's arrays is a copy: the caller may write to them later.

JAX on a processor shares the memory of NumPy's arrays at addresses that 64 divides.
"""

import copy
import pickle
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from inspect import isclass, ismodule
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

import elitelanes_jax
from elitelanes_jax import (
    DatasetSpec,
    GenerateSpec,
    InputError,
    PickSpec,
    RoadMap,
    SearchSpec,
    Weights,
    evolve,
    load_tiles,
    random_grids,
    repair,
    road_problem,
)
from elitelanes_jax.benchmark import Submission, Task, find_task
from elitelanes_jax.drive import (
    Camera,
    LaneDrive,
    LaneDriveParams,
    RoadNav,
    RoadNavParams,
    RoadTrafficParams,
    Variation,
    auto_replay,
    film,
    make_levels,
    make_rides,
    make_scenes,
    make_sight,
    make_traffic_levels,
    stream_views,
    traffic_rule,
)
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive._batch_programs import DISABLED
from elitelanes_jax.drive.interop import GymnaxEnv
from elitelanes_jax.drive.robot import Robot
from elitelanes_jax.formats import Plan, make_plan
from elitelanes_jax.maps import FormatOptions, PackSpec
from elitelanes_jax.optimizers import (
    AnnealedGwoConfig,
    AnnealedMapElitesConfig,
    AnnealedPsoConfig,
    AnnealingConfig,
    EvolutionConfig,
    GwoConfig,
    Move,
    MoveWeights,
    PsoConfig,
    random_move,
)
from elitelanes_jax.photographs import Cut, Photograph, Proposal
from elitelanes_jax.photographs.lenses import Lens
from elitelanes_jax.problem import Problem
from elitelanes_jax.search import Result
from elitelanes_jax.tiles import ObjectSet, Tile, TileSet, load_objects

KEY, SHAPE = jax.random.key(1), (4, 5)
MAPS = np.asarray(jax.vmap(partial(repair, fill=True))(random_grids(KEY, 4, SHAPE)))
FIXED = np.eye(*SHAPE, dtype=bool)
TINY = Camera(rows=4, columns=6)
STAY = Move(0, lambda bits, grid, mate: grid)
ROOMS = [f"elitelanes_jax.{file.parent.name}" for file in Path(elitelanes_jax.__file__).parent.glob("*/__init__.pyi")]
SPACES = SimpleNamespace(Discrete=int, Box=int)


class Case(NamedTuple):
    """Draws arrays, makes something that keeps them, and looks at what it kept."""

    draw: Callable[[], Any]
    make: Callable[[Any], Any]
    look: Callable[[Any], Any]


def aligned(tree):
    """Copies arrays to addresses that 64 divides."""

    def place(array):
        if not hasattr(array, "dtype"):
            return array
        array = np.asarray(array)
        memory = np.zeros(array.nbytes + 64, np.uint8)
        start = -memory.ctypes.data % 64
        placed = memory[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
        placed[...] = array
        return placed

    return jax.tree.map(place, tree)


def spoil(tree):
    """Writes zeros to arrays, and empties lists and dictionaries."""
    if isinstance(tree, np.ndarray):
        if tree.flags.writeable:
            tree[...] = 0
    elif isinstance(tree, list | tuple | dict):
        for part in list(tree.values() if isinstance(tree, dict) else tree):
            spoil(part)
        if not isinstance(tree, tuple):
            tree.clear()
    elif jax.tree.leaves(tree) != [tree]:
        spoil(jax.tree.leaves(tree))


def levels():
    return make_levels(KEY, MAPS)


def batch(environment, params, levels):
    return Batch(environment, params(levels), 4, DISABLED)


def ride(batch):
    """A step of all wrappers; the actions are kept until it is made."""
    batch.reset(range(4))
    actions = aligned(np.ones(4, np.int32) if batch.environment.actions else np.ones((4, 2), np.float32))
    batch.send(actions)
    spoil(actions)
    return batch.receive()


def replayed(level):
    return auto_replay(RoadNav).reset_to_level(KEY, level, RoadNavParams(levels()))[1]


tile_set, object_set = cache(load_tiles), cache(load_objects)  # Nothing can write to their arrays.


def draw_tile():
    tile = tile_set().tiles[0]
    layers = {name: np.array(getattr(tile, name)) for name in ("image", "road", "red", "yellow")}
    return layers | {"opaque": np.ones_like(tile.road), "transparent": {"image": 0.5}}


def draw_object():
    first = object_set().pictures[0]
    return dict(first.views), first.top


def make_object(pictures):
    first = object_set().pictures[0]
    return type(first)(first.name, first.kind, 1, (1, 1), None, *pictures)


def draw_task():
    return {name: value for name, value in find_task("5x5A-10000")._asdict().items() if hasattr(value, "dtype")}


def draw_proposal():
    numbers = {"corners": [[0.5, 1.5]], "homography": [[1.0]], "codes": [[6, 3]], "sure": [[0.5, 1.0]]}
    return numbers | {"evidence": {"alike": 1.0}}


def draw_result():
    result = evolve(KEY, SHAPE, method="ea", evaluations=80)
    return {"elites": result.elites, "history": result.history, "state": result.state}


def make_result(arrays):
    return Result(**arrays, search=evolve(KEY, SHAPE, method="ea", evaluations=80).search)


def draw_options():
    return {
        "like": [MAPS[0].tolist(), np.array(MAPS[1])],
        "axes": ["cyclomatic:4", {"metric": "crossings", "bins": 3}],
        "where": ["crossings=1..3"],
        "weights": {"crossings": 3},
        "fix": [[None] * 5] * 3 + [[0] * 5],
        "inventory": {"turn": 8},
        "alphabet": [0, 6, 3, 12, 9],
        "features": ["mine"],
        "initial": [np.array(MAPS[2])],
    }


def draw_map():
    names = [["turn_1"] * SHAPE[1] for _ in range(SHAPE[0])]
    drawn = {"tile_set": "own", "tiles": names, "quarter_turns": np.zeros(SHAPE, int).tolist()}
    return {"codes": MAPS[0], "metrics": {"crossings": 1}, "descriptor": {"turns": 2}, "drawn": drawn} | {
        "niche": [1, 2],
        "seed": [3, 4],
        "unsure": [[0, 1]],
    }


def draw_road():
    columns = road_problem(SHAPE, limits=None, measured=("crossings4",)).feature_names
    return MAPS[:2], np.tile(np.int32([[1], [3]]), len(columns) + 4), np.int32([7]), np.array(5, np.int32)


def make_road(arrays):
    initial, limits, feature_weights, bridges = arrays
    options = {"measured": ("crossings4",), "feature_weights": feature_weights, "weights": Weights(bridges=bridges)}
    return road_problem(SHAPE, initial=initial, limits=limits, **options)


def numbers_of(kind):
    """Arrays of two numbers for each field that takes an array."""
    return {
        name: np.array([default, default])
        for name, default in kind().values().items()
        if isinstance(default, int | float) and is_traced(kind, name, default)
    }


def is_traced(kind, name, default):
    try:
        kind(**{name: np.array([default, default])})
    except InputError:
        return False
    return True


def record(kind, draw):
    """The fields that are drawn by name, as the made thing has them."""
    return Case(draw, lambda fields: kind(**fields), lambda made: [getattr(made, name) for name in draw()])


def options(kind, draw):
    """Options, which the made thing has as plain values of another form."""
    return Case(draw, lambda fields: kind(**fields), lambda made: repr([getattr(made, name) for name in draw()]))


CASES = {
    "LaneDrive": Case(levels, partial(batch, LaneDrive, LaneDriveParams), ride),
    "RoadNav": Case(levels, partial(batch, RoadNav, RoadNavParams), ride),
    "GymnaxEnv": Case(
        levels, lambda levels: GymnaxEnv(RoadNav, RoadNavParams(levels), SPACES), lambda env: env.default_params
    ),
    "auto_replay": Case(lambda: jax.tree.map(lambda part: part[0], levels()), replayed, lambda state: state),
    "sight": Case(
        lambda: make_sight(tile_set(), TINY, tile_px=16),
        lambda sight: LaneDriveParams(levels(), observe="camera", sight=sight),
        lambda params: params.sight,
    ),
    "RoadMap": record(RoadMap, draw_map),
    "Plan": record(Plan, lambda: make_plan(MAPS[0])._asdict()),
    "Tile": record(partial(Tile, "turn_1", 6), draw_tile),
    "TileSet": record(partial(TileSet, "own", ""), lambda: {"tiles": list(tile_set().tiles)}),
    "ObjectSet": record(partial(ObjectSet, "own"), lambda: {"pictures": list(object_set().pictures)}),
    "ObjectPictures": Case(draw_object, make_object, lambda made: (made.views, made.top)),
    "Photograph": record(partial(Photograph, "floor.jpg"), lambda: {"image": np.array(tile_set().tiles[0].image)}),
    "Lens": record(
        partial(Lens, fisheye=False, width=4, height=3), lambda: {"matrix": np.eye(3), "distortion": np.ones(4)}
    ),
    "Cut": record(
        partial(Cut, "turn_1", 6, photo="floor.jpg", row=0, column=0),
        lambda: {"image": np.array(tile_set().tiles[0].image)},
    ),
    "Proposal": record(partial(Proposal, photo="", width=4, height=3, radial=0.0, score=1.0, advice=""), draw_proposal),
    "Task": record(partial(Task, name="own", shape=(5, 5), fill=True, evaluations=10_000, tiles=None), draw_task),
    "Submission": record(partial(Submission, find_task("5x5A-10000")), lambda: {"grids": MAPS[None, None]}),
    "Problem": record(partial(Problem, SHAPE, lambda grids: grids), lambda: {"initial": MAPS, "fixed": FIXED}),
    "LaneDriveParams": record(lambda **more: LaneDriveParams(levels(), **more), lambda: {"limit": np.int32([40, 50])}),
    "RoadNavParams": record(lambda **more: RoadNavParams(levels(), **more), lambda: {"limit": np.int32([40, 50])}),
    "RoadTrafficParams": Case(
        lambda: {"levels": make_traffic_levels(MAPS), "rule": traffic_rule("traffic_light")},
        lambda fields: RoadTrafficParams(**fields, robots=4),
        lambda params: (params.levels, params.rule),
    ),
    "Robot": record(Robot, lambda: {"noise": np.float32([0.1, 0.2])}),
    "Camera": record(Camera, lambda: {"height": np.float32([0.1, 0.2]), "ground": np.float32([[1, 2, 3]])}),
    "Variation": record(Variation, lambda: {"offset": np.float32([0.1, 0.2])}),
    "MoveWeights": record(MoveWeights, lambda: {"link": np.int32([3, 4]), "user_moves": {"none": (1, STAY)}}),
    "SearchSpec": Case(draw_options, lambda options: SearchSpec(**options), lambda spec: repr(spec)),
    "GenerateSpec": options(GenerateSpec, lambda: {"size": [4, 5], "part": [1, 2], "furnish": {"trees": 0.5}}),
    "PickSpec": options(
        PickSpec, lambda: {"where": ["crossings=1..3"], "axes": ["turns:3"], "unlike": [MAPS[0].tolist()]}
    ),
    "DatasetSpec": options(DatasetSpec, lambda: {"size": [[4, 5]], "split": [0.5, 0.5, 0.0], "part": [1, 2]}),
    "PackSpec": options(PackSpec, lambda: {"to": ["sumo"], "split": [0.5, 0.5, 0.0]}),
    "FormatOptions": options(FormatOptions, lambda: {"origin": [50.0, 8.0]}),
    **{
        kind.__name__: record(kind, partial(numbers_of, kind))
        for kind in (AnnealedGwoConfig, AnnealedMapElitesConfig, AnnealedPsoConfig, AnnealingConfig, EvolutionConfig)
    },
    **{kind.__name__: record(kind, partial(numbers_of, kind)) for kind in (GwoConfig, PsoConfig)},
}
SLOW = {
    "Result": Case(draw_result, make_result, lambda result: (result.elites, result.history, result.state)),
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
        lambda: make_rides(MAPS[0], 1, seconds=1), lambda rides: film(MAPS[0], tile_set(), rides, tile_px=16), next
    ),
}

KEPT_BY = {
    "Level": ("LaneDrive", "RoadNav", "GymnaxEnv", "auto_replay"),
    "Objects": ("LaneDrive",),
    "Sight": ("sight",),
    "TrafficLevels": ("RoadTrafficParams",),
    "TrafficRule": ("RoadTrafficParams",),
    "Weights": ("road_problem",),
    "MeasuredElites": ("Result",),
    "History": ("Result",),
    "Metrics": ("Result",),
}
"""Pytrees of compiled programs, and the cases of what keeps them. A pytree itself is no more than a tuple."""

RESULTS = {
    *("Picture", "Measured", "Scores", "Views", "Transition", "Info"),
    *("LaneDriveObservation", "RoadNavObservation", "RoadTrafficObservation"),
    *("LaneDriveInfo", "RoadNavInfo", "RoadTrafficInfo"),
    *("Pose", "LaneNode", "Evaluation", "Population"),
}
"""What functions return with new arrays. Functions that take one have used it when they return."""

VALUES = {
    *("Axis", "MapObject", "Move", "Environment", "Optimizer", "Search", "MapElitesConfig"),
    *("Operators", "OperatorSet"),
    *("InputError", "NotEnoughMapsError", "SearchInterrupted"),
}
"""What has numbers, texts, functions, tuples of these, and other public records."""


def public_classes():
    """Returns the public classes of all rooms, also those of modules that a room lists."""
    classes, seen = set(), set()

    def walk(module):
        seen.add(module)
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if isclass(thing):
                classes.add(thing)
            elif ismodule(thing) and thing not in seen:
                walk(thing)

    walk(elitelanes_jax)
    for room in ROOMS:
        walk(import_module(room))
    return classes


def test_every_public_class_has_a_case():
    """A new public class copies what it keeps, or a line above says who does."""
    tables = [set(CASES) | set(SLOW), set(KEPT_BY), RESULTS, VALUES]
    names = {kind.__name__ for kind in public_classes()}
    assert names - set().union(*tables) == set()
    assert sum(len(table & names) for table in tables) == len(names)
    assert set().union(*KEPT_BY.values()) <= set(CASES) | set(SLOW)
    # Every room was walked.
    assert {"Tile", "Photograph", "Submission", "Level", "GymnaxEnv", "RoadMap", "Result"} <= names


@pytest.mark.parametrize("name", [*CASES, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_writing_to_an_array_later_changes_nothing(name):
    case = (CASES | SLOW)[name]
    arrays = case.draw()
    expected = jax.tree.map(np.array, case.look(case.make(aligned(arrays))))
    given = aligned(arrays)
    made = case.make(given)
    spoil(given)
    jax.tree.map(np.testing.assert_array_equal, jax.tree.map(np.array, case.look(made)), expected)


NAMED_TUPLES = ("Plan", "Tile", "Photograph", "Lens", "Cut", "Proposal", "Task", "Submission")


@pytest.mark.parametrize("name", NAMED_TUPLES)
def test_a_named_tuple_with_copies_is_a_named_tuple(name):
    case = CASES[name]
    made = case.make(aligned(case.draw()))
    first, *others = made
    assert (first, *others) == tuple(made) and made._asdict() == dict(zip(made._fields, made, strict=True))
    assert repr(made).startswith(f"{name}({made._fields[0]}=")
    for other in (
        made._replace(**case.draw()),
        type(made)._make(made),
        pickle.loads(pickle.dumps(made)),
        copy.deepcopy(made),
        jax.tree.map(lambda part: part, made),
    ):
        assert type(other) is type(made)
        jax.tree.map(np.testing.assert_array_equal, case.look(other), case.look(made))
        for part in case.look(other):
            assert not isinstance(part, np.ndarray) or not part.flags.writeable
    with pytest.raises(TypeError, match="missing"):
        type(made)()


def test_a_copy_is_not_copied_again():
    photograph = Photograph("floor.jpg", np.zeros((300, 400, 3), np.uint8))
    for other in (photograph._replace(name="other.jpg"), copy.copy(photograph), Photograph(*photograph)):
        assert other.image is photograph.image
    tiles = tile_set().tiles
    assert all(tile.image is given.image for tile, given in zip(TileSet("own", "", tiles).tiles, tiles, strict=True))
