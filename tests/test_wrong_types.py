"""Every public function, and every record of options, names an argument of a wrong type in one line, or takes it."""

import pickle
from dataclasses import MISSING, fields
from functools import cache
from inspect import Parameter, isclass, isfunction, isgenerator, signature, unwrap
from types import ModuleType, SimpleNamespace

import jax
import numpy as np
import pytest

import elitelanes_jax
from elitelanes_jax import (
    InputError,
    RoadMap,
    benchmark,
    drive,
    ea,
    load_tiles,
    measure,
    optimizers,
    photographs,
    render,
    tiles,
)
from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.records import Record
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.maps import GenerateSpec, PackSpec, pack
from elitelanes_jax.maps.furnishing.spec import FurnishSpec
from elitelanes_jax.network import measure_town
from elitelanes_jax.optimizers import interop
from elitelanes_jax.problem import Population, road_problem
from elitelanes_jax.problem.descriptor import paper_axes

ROOMS = [one for name in elitelanes_jax.__all__ if isinstance(one := getattr(elitelanes_jax, name), ModuleType)]


def public_of(face):
    own = [name for name, one in vars(face).items() if getattr(one, "__module__", "") == face.__name__]
    found = [getattr(face, name) for name in getattr(face, "__all__", own) if name[0] != "_"]
    return [one for one in found if getattr(one, "__module__", "").startswith("elitelanes_jax")]


def is_record(one):
    return isclass(one) and issubclass(one, Record)


EVERY = list(dict.fromkeys(one for face in [elitelanes_jax, *ROOMS, interop] for one in public_of(face)))
FUNCTIONS = [one for one in EVERY if isfunction(unwrap(one))]
RECORDS = [one for one in EVERY if is_record(one)]
CLASSES = [elitelanes_jax.Problem, optimizers.Move, RoadMap, tiles.TileSet, tiles.ObjectSet]

KEY = jax.random.key(0)
VALUES = [None, "x", -1, 2.5, object(), [], {}, np.zeros((2, 3, 4, 5)), KEY]

# These search, compile or write with whatever fits, so they are given only what cannot fit.
SLOW = {"draw_sample", "evolve", "explore", "generate", "look", "make", "make_dataset"}
SLOW |= {
    "make_rides",
    "stream_views",
    "views",
    "write_result",
    "measure_town",
    "propose_tiles",
    "random_level",
    "random_pose",
    "repair",
    "run",
}
ELSEWHERE = {"show"}  # they need other packages


@cache
def arguments():
    """A good argument for each name of a required parameter."""
    grid = np.array([[6, 3], [12, 9]], np.int8)
    task, made, tile_set = benchmark.find_task("5x5A-10000"), road_problem((4, 4)), load_tiles()
    levels = drive.make_levels(KEY, [grid], 2)
    found = Population(np.zeros((2, 4, 4), np.int8), np.zeros(2, np.int32), np.zeros((2, len(made.feature_names)), int))
    run = SimpleNamespace(evaluations=np.arange(3), best_fitness=np.arange(3), elite_count=np.arange(3))
    spaces = SimpleNamespace(Discrete=print, Box=print)
    vectors = SimpleNamespace(AutoresetMode=str, VectorEnv=object, utils=SimpleNamespace(batch_space=print))
    gymnasium = SimpleNamespace(Env=object, spaces=spaces, vector=vectors)
    taker = type("Taker", (), {"__init__": lambda self, *anything: None})
    vec_env = SimpleNamespace(VecEnv=taker, base_vec_env=SimpleNamespace(VecEnv=taker, spaces=spaces))
    stable_baselines3 = SimpleNamespace(common=SimpleNamespace(vec_env=vec_env))
    pufferlib = SimpleNamespace(PufferEnv=taker, emulation=SimpleNamespace(gymnasium=gymnasium))
    road_map, tile = RoadMap(grid), tile_set.tiles[0]
    photo, corners = (
        photographs.Photograph("a.jpg", np.zeros((240, 320, 3), np.uint8)),
        [[50, 50], [150, 50], [150, 150], [50, 150]],
    )
    proposal = photographs.Proposal("a.jpg", 320, 240, corners, np.eye(3).tolist(), 0.0, [[6]], [[1.0]], 1.0, {}, "")
    return {
        "apply": print, "archive": made.empty_archive(), "archives": "a.npz",
        "asked": np.array([0, 1]),
        "axes": paper_axes((4, 4)), "best": np.full((1, len(task.optimum)), np.inf), "best_known": np.zeros(3),
        "batch": 2,
        "bits": np.zeros(3, np.uint32), "camera": drive.Camera(), "codes": grid, "config": optimizers.EvolutionConfig(),
        "count": 2, "cuts": [photographs.Cut("turn_1", 6, tile.image, "a.jpg", 0, 0)], "depth": 3.0,
        "dataset": "views", "descriptor": np.zeros((2, 5), int), "dtype": np.dtype(np.int32),
        "environment": drive.RoadNav,
        "evaluate": made.evaluate, "features": {}, "file": "map.json", "files": [], "fill": True,
        "fitness": np.zeros(3), "folder": "folder", "found": found, "function": measure, "generations": 1,
        "goal": drive.LaneNode(0, 1, 1), "grid": grid, "grids": np.zeros((2, 4, 4), np.int8),
        "groups": {"a": {"turns": [1, 2]}}, "gymnasium": gymnasium, "image": "map.pgm",
        "index": 0, "indices": 2, "ink": (0, 0, 0), "jaxmarl": None, "kernel": measure, "key": KEY,
        "keys": optimizers.seed_keys(0, 2), "level": levels, "levels": levels,
        "licence": "", "maps": [road_map], "matrix": np.eye(3), "metric": "turns", "metrics": measure(grid),
        "move": optimizers.make_move("link"), "name": "turns", "names": ["turns"], "niche": np.zeros(2, np.int32),
        "number": 3, "objects": [], "observation": {"speed": np.zeros(3, np.float32)}, "optimizer": ea(made),
        "other": grid, "out": "out", "params": drive.RoadNavParams(levels),
        "parts": "a", "pettingzoo": None,
        "payload": collect([road_map], tile_px=16), "picture": render(grid, tile_set, tile_px=16),
        "photograph": photo, "plan": grid, "proposal": proposal, "tile": tile, "turns": 1,
        "pictures": (), "pixels": grid.astype(np.uint8), "points": [[1, 2]], "pose": drive.Pose(0.5, 0.5, 0.0),
        "position": (1, 9), "predictions": "labels", "prefix": "city", "probability": 0.5, "problem": made,
        "pufferlib": pufferlib,
        "record": run, "result": None, "results": {}, "robots": 20,
        "rides": None, "road_map": road_map, "rotations": tile_set.rotations, "rows": [{"file": "a"}], "scale": 0.5,
        "scenes": None,
        "search": print, "seed": 0, "shape": (4, 4), "sheet": np.zeros((20, 20, 3), np.uint8),
        "sight": drive.make_sight(tile_set, tile_px=16), "size": 16,
        "source": road_map, "sources": [road_map],
        "spaces": spaces, "spec": elitelanes_jax.SearchSpec(), "stable_baselines3": stable_baselines3,
        "start": drive.LaneNode(0, 0, 3),
        "state": drive.LaneDrive.reset(KEY, drive.LaneDriveParams(levels))[1], "submission": None, "task": task,
        "tasks": [task], "text": "tiles: []", "tiles": tile_set, "to": "sumo",
        "valid": np.ones(3, bool), "values": [1.0, 2.0],
        "trips": [], "views": {}, "weights": optimizers.MoveWeights(), "what": [road_map], "width": 4.0, "worst": 3.0,
        "x": [1, 2],
    }  # fmt: skip


def calls_with(one):
    """Yields for each parameter its name, and the function of a value that calls `one` with the value for it."""
    if is_record(one):
        needed = [field.name for field in fields(one) if field.default is field.default_factory is MISSING]
        known = {name: arguments()[name] for name in needed if name in one.options()}
        for name in one.options():
            yield name, lambda value, name=name: one(**known | {name: value})
        return
    parameters = [each for each in signature(one).parameters.values() if each.kind != Parameter.VAR_KEYWORD]
    known = {each.name: arguments()[each.name] for each in parameters if each.default is each.empty and each.kind != 2}
    for each in parameters:
        if each.kind == Parameter.VAR_POSITIONAL:
            keywords = {name: value for name, value in known.items() if signature(one).parameters[name].kind == 3}
            first = [value for name, value in known.items() if name not in keywords]
            yield each.name, lambda value, first=first, keywords=keywords: one(*first, value, **keywords)
        else:
            yield each.name, lambda value, name=each.name: one(**known | {name: value})


def refusal(call, value):
    """Returns the message of an `InputError`, or of the system about a file; None if the value is taken."""
    try:
        result = call(value)
        if isgenerator(result):
            next(result)
    except (InputError, OSError) as error:
        return str(error)
    return None


@pytest.mark.usefixtures("any_types")
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("one", [*FUNCTIONS, *RECORDS, *CLASSES], ids=lambda one: f"{one.__module__}.{one.__name__}")
def test_a_wrong_type_is_named(one, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if one.__name__ in ELSEWHERE:
        pytest.skip("needs another package")
    for name, call in calls_with(one):
        for value in [object()] if one.__name__ in SLOW else VALUES[:-1] if is_record(one) else VALUES:
            message = refusal(call, value) or name
            assert any(word in message for word in (name, "expected", str(value)))
            assert "\n" not in message


FLAGS = [
    (one, parameter.name)
    for one in FUNCTIONS
    for parameter in signature(one).parameters.values()
    if parameter.annotation is bool
]


@pytest.mark.parametrize(("one", "flag"), FLAGS, ids=lambda value: getattr(value, "__name__", value))
@pytest.mark.parametrize("value", ["no", "False", None, 0, []])
def test_a_flag_is_true_or_false(one, flag, value, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    required = {
        name: arguments()[name]
        for name, parameter in signature(one).parameters.items()
        if parameter.default is Parameter.empty and parameter.kind is not Parameter.VAR_KEYWORD and name != flag
    }
    with pytest.raises(InputError, match=f"^{flag}: expected True or False, got "):
        one(**required, **{flag: value})
    assert not list(tmp_path.iterdir())


def test_a_text_for_force_replaces_no_folder(tmp_path):
    out = tmp_path / "pack"
    spec = PackSpec(split=(1, 0, 0), trips=1)
    pack(spec, [[6, 3], [12, 9]], out)
    with pytest.raises(InputError, match="^force: expected True or False, got 'no'$"):
        pack(spec, [[6, 7, 3], [12, 13, 9]], out, force="no")
    assert "6, 7, 3" not in next((out / "maps").rglob("*.json")).read_text()


def test_flags_of_numpy_are_taken():
    assert measure_town([[6, 3], [12, 9]], detour=np.bool_(False)).mean_detour == 0
    specs = [GenerateSpec(at_most=np.bool_(True)), FurnishSpec(unique_tags=np.bool_(True))]
    assert specs == [GenerateSpec(at_most=True), FurnishSpec(unique_tags=True)]
    assert specs[0].at_most is specs[1].unique_tags is True  # JSON has no flag of NumPy
    walker = {"kind": "duckie", "x": 0.5, "y": 0.5, "static": np.bool_(False)}
    assert RoadMap([[5]], objects=[walker]).objects[0].static is False


def test_what_is_taken_is_not_blamed():
    def fails(grid, *, names=("a",), count=2, **more):
        raise KeyError("of the user's own")

    taken = [
        ((RoadMap(np.array([[6, 3], [12, 9]])),), {}),
        (([[6, 3], [12, 9]],), {"names": ["b"], "count": np.int64(3)}),
        ((KEY,), {"count": None, "more": object()}),
    ]
    fails.__annotations__ = {"grid": "unknown", "names": tuple[str, ...], "count": int | None}
    for positional, named in taken:
        with pytest.raises(KeyError):
            name_wrong_arguments(fails)(*positional, **named)
    with pytest.raises(InputError, match="^names: expected a list, each item a text, got 3$"):
        name_wrong_arguments(fails)(KEY, names=3)
    with pytest.raises(TypeError, match="unexpected keyword"):
        name_wrong_arguments(measure)(KEY, colour=3)


@pytest.mark.parametrize("key", [KEY, jax.random.split(KEY, 2), 0])
def test_an_error_in_ones_own_function_is_not_blamed_on_an_argument(key):
    with pytest.raises(AttributeError, match="no_such_metric"):
        elitelanes_jax.evolve(key, (3, 4), generations=0, fitness=lambda metrics: metrics.no_such_metric)


def test_public_functions_can_be_sent_to_other_processes():
    assert all(pickle.loads(pickle.dumps(one)) is one for one in FUNCTIONS if one.__module__ != interop.__name__)
