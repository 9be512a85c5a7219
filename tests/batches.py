"""All kernels, methods and environments, each as a function of a batch: its first axis is that of the batch."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax import (
    RoadMap,
    drive,
    fitness,
    load_tiles,
    measure,
    mirror,
    random_grids,
    repair,
    road_problem,
    rotate,
    run,
)
from elitelanes_jax.drive._camera import pack_sight
from elitelanes_jax.drive.robot import Robot
from elitelanes_jax.maps import furnish
from elitelanes_jax.network import (
    bernoulli,
    difference,
    gridlock_gamma,
    gridlock_number,
    gridlock_potential,
    measure_town,
    randint,
)
from elitelanes_jax.network.bits import random_bits, split
from elitelanes_jax.optimizers import (
    PRESETS,
    AnnealedMapElitesConfig,
    AnnealingConfig,
    EvolutionConfig,
    GwoConfig,
    MoveWeights,
    interop,
    make_optimizer,
    random_move,
    refit_strip,
    with_symmetric_copy,
)
from elitelanes_jax.problem import Population, insert
from elitelanes_jax.tiles import load_objects
from elitelanes_jax.tiles.rendering import scale_tiles

COUNT, SHAPE = 4, (4, 5)
RING = np.array([[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [14, 5, 15, 5, 11], [12, 5, 13, 5, 9]], np.int8)

# Few chains and short cycles, so that a cycle begins within the steps of a test.
FEW = AnnealingConfig(population=8, chains=4, cycle=1)
CONFIGS = {
    **{f"{method}, {preset}": config for (method, preset), config in PRESETS.items() if preset != "tuned"},
    **{f"{method}, tuned": PRESETS[method, "tuned"].replace(annealing=FEW) for method in ("map-elites", "pso", "gwo")},
    "ea, tuned": FEW,
    "ea, comma": EvolutionConfig(survivors="comma"),
    "gwo, worst": GwoConfig(omega="worst"),
    "map-elites, towns": AnnealedMapElitesConfig(FEW, initial_towns_from=4, require_feasible=True),
}


class Batch(NamedTuple):
    """A function and its arguments, each with the axis of the batch in front."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]

    @classmethod
    def each(cls, function: Callable[..., Any], *arguments: Any) -> "Batch":
        """Maps a function of one element."""
        return cls(jax.vmap(function), arguments)


def keys():
    return jax.random.split(jax.random.key(0), COUNT)


def grids():
    return random_grids(jax.random.key(1), COUNT, SHAPE)


def words(count):
    return random_bits(jax.random.key(2), (COUNT, count))


def problems():
    zeros = {"fours": lambda grid: (grid == 15).sum(dtype=jnp.int32)}
    return {
        "plain": road_problem(SHAPE, fill=True),
        "ranges": road_problem(SHAPE, where={"crossings": (2, 4), "straight_share": (0.2, 0.5)}),
        "towns": road_problem(SHAPE, "symmetry:3", measured=("mean_detour", "turns"), feature_weights=np.array([3, 4])),
        "own": road_problem(SHAPE, "fours:3", features=zeros, measured=("fours",), feature_weights=np.array([3])),
        "float": road_problem(SHAPE, fitness=lambda usual, metrics: usual.astype(jnp.float32) + metrics.coverage),
        "fixed": road_problem(SHAPE, fix=[[0, *[None] * 4], *[[None] * 5] * 3], initial=RING[None]),
    }


def evaluated(problem, grids):
    """All that a problem does with grids."""
    fitness, features = problem.evaluate(grids)
    niche, archive = problem.niche(features), problem.empty_archive(fitness.dtype)
    return fitness, problem.penalties(features), niche, insert(archive, niche, Population(grids, fitness, features))


def filled(grid, mask, raster):
    return repair(grid, mask, raster=raster, fill=True, fixed=mask)


def gridlocks(grid):
    # The potential's last digits depend on the batch.
    return gridlock_number(grid), gridlock_gamma(grid), jnp.round(gridlock_potential(grid, 20), 3)


def kernels():
    masks = jax.device_put(np.asarray(grids()) > 7)
    yield "measure", Batch.each(measure, grids())
    yield "measure large grids", Batch.each(measure, random_grids(jax.random.key(1), COUNT, (17, 18)))
    yield "measure_town", Batch.each(measure_town, grids())
    yield "gridlock", Batch.each(gridlocks, grids())
    yield "fitness", Batch(lambda grids: fitness(jax.vmap(measure)(grids)), (grids(),))
    yield "repair", Batch.each(repair, grids(), masks)
    yield "repair, fill", Batch.each(partial(filled, raster=True), grids(), masks)
    yield "rotate, mirror", Batch.each(lambda grid: (rotate(grid), mirror(grid)), grids())
    yield "difference", Batch.each(difference, grids(), grids()[::-1])
    yield "random_grids", Batch.each(lambda key: random_grids(key, 2, SHAPE), keys())
    yield "random_bits", Batch.each(lambda key: random_bits(key, (3,)), keys())
    yield "randint, bernoulli", Batch.each(lambda bits: (randint(bits, 9), bernoulli(bits, 0.5)), words(5))
    for name, problem in problems().items():
        yield f"problem, {name}", Batch(partial(evaluated, problem), (grids(),))
        yield f"random, {name}", Batch.each(lambda key, problem=problem: problem.random(key, 2), keys())


def moves():
    mix = with_symmetric_copy(0.5, random_move(MoveWeights(refit=9), fill=False))
    for name, move in (("moves", mix), ("strips", refit_strip())):
        yield name, Batch.each(move.apply, words(move.bits), grids(), grids()[::-1])


def stepped(optimizer, key):
    """Two steps in a loop of one's own."""
    return jax.lax.scan(lambda state, key: optimizer.step(key, state), optimizer.init(key), split(key))


def methods():
    for name, config in CONFIGS.items():
        yield name, Batch(partial(run, make_optimizer(road_problem(SHAPE), config), generations=2), (keys(),))
    optimizer = make_optimizer(road_problem(SHAPE), PRESETS["map-elites", "paper"])
    yield "steps in a loop", Batch.each(partial(stepped, optimizer), keys())


def loops():
    problem = road_problem(SHAPE, fill=True)
    score, (_, vary) = interop.qdax_scoring_fn(problem), interop.qdax_moves(problem)
    task = interop.evosax_task(problem)
    yield "qdax", Batch(lambda grids: score(grids, None), (grids(),))
    yield "qdax, moves", Batch.each(lambda grid, key: vary(grid[None], grid[None], key), grids(), keys())
    yield "evosax", Batch.each(lambda key: task.decode(task.sample(key)), keys())


def levels():
    objects = drive.Objects(jnp.zeros((2, 1), jnp.int32), *(jnp.ones((2, 1), jnp.float32) for _ in range(5)))
    return drive.make_levels(jax.random.key(3), RING[None], 2)._replace(objects=objects)


def sight():
    tiles, camera = load_tiles(), drive.Camera(rows=6, columns=8, noise=3.0, distortion=(-0.1, 0.01))
    scaled = scale_tiles(tiles, 8)
    return pack_sight(scaled["image"], scaled["labels"], tiles.rotations, camera, load_objects().views_by_kind)


def driven(environment, params, key, action):
    """Steps in a loop, also with resets. In the last bit, products may differ in one step of ten."""
    observation, start = environment.reset(key, params)

    def ride(environment):
        def step(state, key):
            done = environment.step(key, state, action, params)
            return done.state, done

        return jax.lax.scan(step, start, split(key, 16))

    return observation, ride(environment), ride(drive.auto_reset(environment))


def environments():
    rough = Robot(noise=0.1, latency=0.5, trim=0.02)
    turns, wheels = np.arange(COUNT, dtype=np.int32) % 3, np.full((COUNT, 2), [0.4, 0.5], np.float32)
    settings = {
        "LaneDrive": {},
        "LaneDrive, rough": {"robot": rough, "task": "lane", "action": "twist", "collision": "cost"},
        "LaneDrive, camera": {"observe": "camera", "sight": sight()},
    }
    nav = drive.RoadNavParams(levels(), goal="both", whole_map=True, window=3)
    yield "RoadNav", Batch.each(partial(driven, drive.RoadNav, jax.device_put(nav)), keys(), jax.device_put(turns))
    traffic = drive.RoadTrafficParams(drive.make_traffic_levels([RING]), robots=5, slots=2, strict=True)
    choices = np.arange(5 * COUNT, dtype=np.int32).reshape(COUNT, 5) % 4
    driven_traffic = partial(driven, drive.RoadTraffic, jax.device_put(traffic))
    yield "RoadTraffic", Batch.each(driven_traffic, keys(), jax.device_put(choices))
    for name, more in settings.items():
        params = jax.device_put(drive.LaneDriveParams(levels(), **more))
        yield name, Batch.each(partial(driven, drive.LaneDrive, params), keys(), jax.device_put(wheels))
    yield "lanes", Batch.each(lambda key: drive.lane_pose(RING, drive.random_pose(key, RING)), keys())
    yield "levels", Batch.each(lambda key: drive.random_level(key, RING), keys())
    look = {"camera": drive.Camera(rows=4, columns=6), "variation": drive.Variation.varied(), "samples": 1}
    scenes = drive.make_scenes([furnish(RoadMap(RING), "all")], tile_px=16)
    yield "views", Batch.each(lambda key: jax.tree.leaves(drive.views(key, scenes, 1, **look)), keys())
    yield "pure_pursuit", Batch.each(partial(expert, jax.device_put(drive.LaneDriveParams(levels()))), keys())


def expert(params, key):
    return drive.pure_pursuit(drive.LaneDrive.reset(key, params)[1], params)


GROUPS = {"kernels": kernels, "moves": moves, "methods": methods, "loops": loops, "environments": environments}


def batches(*groups: str) -> Iterator[tuple[str, Batch]]:
    """Yields the name and the batch of each kernel, method and environment of some groups."""
    for group in groups:
        yield from GROUPS[group]()


def plain(tree: Any) -> list[np.ndarray]:
    """The arrays of a tree in NumPy."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
