"""Wrong arguments from Python: each is named in one line, before any search. `test_wrong_types` has the wrong types."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

from elitelanes_jax import (
    Axis,
    DatasetSpec,
    GenerateSpec,
    InputError,
    Problem,
    Result,
    RoadMap,
    SearchSpec,
    Weights,
    annealed_ea,
    annealed_map_elites,
    ea,
    evolve,
    explore,
    export,
    load_tiles,
    measure,
    plots,
    pso,
    random_grids,
    read_map,
    render,
    road_problem,
    rotate,
)
from elitelanes_jax.benchmark import (
    Operators,
    Submission,
    compute_scores,
    find_task,
    run_task,
)
from elitelanes_jax.dataset import draw_sample
from elitelanes_jax.drive import (
    Camera,
    LaneDrive,
    LaneDriveParams,
    LaneNode,
    Pose,
    RoadNav,
    RoadNavParams,
    Robot,
    auto_replay,
    auto_reset,
    distances,
    film,
    lane_pose,
    look,
    make,
    make_levels,
    make_objects,
    make_rides,
    make_scenes,
    make_sight,
    random_pose,
)
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive._camera import pack_sight
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.formats import MapObject, without_dead_ends
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.maps import FormatOptions, PackSpec, PickSpec, furnish, merge, pick
from elitelanes_jax.network import canonical_form, gridlock_potential, repair, vmap_in_blocks
from elitelanes_jax.optimizers import (
    PRESETS,
    AnnealingConfig,
    EvolutionConfig,
    Move,
    MoveWeights,
    evaluate,
    make_move,
    refit_strip,
    run,
    seed_keys,
    truncate,
    with_fill,
    with_symmetric_copy,
)
from elitelanes_jax.optimizers._population import random_population
from elitelanes_jax.optimizers.interop import qdax_moves, qdax_scoring_fn
from elitelanes_jax.photographs import Photograph, propose_tiles
from elitelanes_jax.problem import Population, coverage, extreme_maps, insert, qd_score
from elitelanes_jax.problem.descriptor import niche_index
from elitelanes_jax.problem.kernels import with_town_features
from elitelanes_jax.tiles import inspect_tiles, load_objects, propose_masks, write_png
from elitelanes_jax.tiles.contact_sheet import write_text
from elitelanes_jax.tiles.rendering import png_of, scale_tiles

GRID = np.array([[6, 3], [12, 9]])
FRAME = Photograph("frame", np.zeros((240, 320, 3), np.uint8))
TASK = find_task("5x5A-10000")
RING = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]])
LONG = "a" * 300


@cache
def levels():
    return make_levels(jax.random.key(0), RING)


@cache
def searched():
    return evolve(0, (2, 2), seeds=1, method="ea", preset="paper", generations=1)


POPULATION = Population(np.zeros((2, 4, 4), np.int8), np.zeros(2, np.int32), np.zeros((2, 3), np.int32))


def begin(environment, params):
    return jax.random.key(0), environment.reset(jax.random.key(0), params(levels()))[1]


def moved(grid):
    move = make_move("transplant")
    return move.apply(np.zeros(move.bits, np.uint32), grid)


def drive_by(action):
    return LaneDrive.step(*begin(LaneDrive, LaneDriveParams), np.array(action), LaneDriveParams(levels()))


def look_at(grid, pose=None, **options):
    pose = pose or Pose(0.5, 0.5, 0.0)
    pictures, labels = np.zeros((8, 8, 8, 3), np.uint8), np.zeros((8, 8, 8), np.uint8)
    return look(pose, grid, pack_sight(pictures, labels, {0: [(0, 0)]}, Camera(rows=6, columns=8)), **options)


def step_with(environment, key, action=(0, 0)):
    return environment.step(key, begin(LaneDrive, LaneDriveParams)[1], action, LaneDriveParams(levels()))


def found():
    return Result.load(Path(__file__).parents[1] / "docs" / "examples" / "run" / "archive.npz")


WRONG = {
    "seed: expected a whole number, 0 to": lambda: GenerateSpec(seed=-1),
    "transforms: expected some of none, standard": lambda: DatasetSpec(transforms="luck"),
    "fill: expected True or False, got 'no'": lambda: SearchSpec(fill="no"),
    "weights: expected NAME=N with one of components": lambda: SearchSpec(weights=[3]),
    "where cyclomatic: expected a range with some": lambda: evolve(0, where="cyclomatic=200.."),
    "quarter_turns: expected a whole number": lambda: rotate(GRID, "x"),
    "optimizer: expected a function from a problem to an Optimizer": lambda: evolve(0, (4, 4), optimizer="ea"),
    "optimizer: expected a function that returns an Optimizer, got int": lambda: evolve(
        0, (4, 4), optimizer=lambda problem: 3
    ),
    "weights bridges: expected a whole number, -2147483648 to 2147483647": lambda: SearchSpec(
        weights={"bridges": 2**40}
    ),
    "size: expected a whole number, 0 or more, got '1_2'": lambda: GenerateSpec(size="1_2 4"),
    "camera: rows: expected a whole number": lambda: DatasetSpec(camera={"rows": "x"}),
    "camera: row: expected one of offset, heading": lambda: DatasetSpec(camera={"row": 48}),
    "transforms: luck: expected one of": lambda: DatasetSpec(transforms={"luck": 1}),
    "transforms: scale: expected a factor, or the smallest and the largest": lambda: DatasetSpec(
        transforms="scale=1..2..3"
    ),
    "action: expected two numbers, shape (2,), got shape (3,)": lambda: drive_by([0, 0, 0]),
    "action: expected real numbers, got complex64": lambda: drive_by(np.array([1j, 0], np.complex64)),
    "action: expected one whole number, got shape (2,)": lambda: RoadNav.step(
        *begin(RoadNav, RoadNavParams), np.array([0, 0]), RoadNavParams(levels())
    ),
    "policy: expected two numbers": lambda: make_rides(RING, policy=lambda seen: [0, 0, 0], seconds=0.1),
    "path: expected a name, got 3": lambda: Result.load(3),
    "grid: expected rows of tile codes, got 'town.json'; read_map reads": lambda: without_dead_ends("town.json"),
    "map: expected a map, a grid or a file of one, got 3": lambda: render(3),
    "size: expected rows and columns, got {5: 1, 6: 2}": lambda: GenerateSpec(size={5: 1, 6: 2}),
    "size: expected rows and columns, got b'68'": lambda: GenerateSpec(size=b"68"),
    "size: expected (height, width), two whole numbers, got [": lambda: GenerateSpec(
        size=np.ma.masked_array([6, 8], [False, True])
    ),
    "shape: expected (height, width), two whole numbers, got {5: 1, 6: 2}": lambda: evolve(0, {5: 1, 6: 2}),
    f"{LONG}: expected a folder of tile pictures, got none": lambda: load_tiles(LONG),
    "at_most: expected True or False, got 3": lambda: GenerateSpec(tiles=Path(LONG), at_most=3),
    f"{LONG}: expected a folder of objects, got none": lambda: load_objects(LONG),
    "grid: expected rows of tile codes, got a RoadMap; give its codes": lambda: measure(RoadMap([[6, 3], [12, 9]])),
    "optimizer: expected an Optimizer, got PRNGKeyArray": lambda: run(jax.random.key(0), None, 3),
    "image: expected uint8 [H, W, 3], at least 2 pixels a side, got float64 [4, 4]": lambda: propose_masks(
        np.zeros((4, 4))
    ),
    "image: expected a square picture, got 6 x 4 pixels": lambda: propose_masks(np.zeros((4, 6, 3), np.uint8)),
    "image: expected uint8 [H, W, 3], at least 2 pixels a side, got uint8 [1, 1, 3]": lambda: propose_masks(
        np.zeros((1, 1, 3), np.uint8)
    ),
    "sheet: expected uint8 [H, W, 3], at least 2 pixels a side, got uint8 [9, 9, 1]": lambda: write_text(
        np.zeros((9, 9, 1), np.uint8), "a", (0, 0), 1, (0, 0, 0)
    ),
    "sheet: expected uint8 [H, W, 3], at least 2 pixels a side, got uint8 [0, 9, 3]": lambda: write_text(
        np.zeros((0, 9, 3), np.uint8), "a", (0, 0), 1, (0, 0, 0)
    ),
    "photograph: image: expected uint8 [H, W, 3], at least 2 pixels a side, got uint16": lambda: propose_tiles(
        Photograph("frame", np.zeros((240, 320, 3), np.uint16))
    ),
    "photograph: image: expected uint8 [H, W, 3], at least 2 pixels a side, got [[1, 2]]": lambda: propose_tiles(
        Photograph("frame", [[1, 2]])
    ),
    "shape: expected 1 to 40 rows and columns, got 0 and 1": lambda: propose_tiles(FRAME, shape=(0, 1)),
    "shape: expected 1 to 40 rows and columns, got 1000 and 1000": lambda: propose_tiles(FRAME, shape=(1000, 1000)),
    "shape: expected 1 to 40 rows and columns, got 'ab'": lambda: propose_tiles(FRAME, shape="ab"),
    "shape: expected 2 x 2 like codes, got 7 x 2": lambda: propose_tiles(FRAME, shape=(7, 2), codes=GRID),
    "shape: expected 3 x 4 or 2 x 2 like codes, got 4 x 3": lambda: propose_tiles(
        FRAME, shape=(4, 3), codes=np.pad(GRID, ((0, 1), (1, 1)))
    ),
    "fit: expected True, or corners to take as they are, got False": lambda: propose_tiles(FRAME, fit=False),
    "lens: expected a name, got ''": lambda: Photograph.read("a.png", lens=""),
    "codes: expected 1 to 40 rows and columns, got 41 and 2": lambda: propose_tiles(FRAME, codes=np.ones((41, 2), int)),
    "codes: grid: expected tile codes 0 to 15, got 99": lambda: propose_tiles(FRAME, codes=[[99]]),
    "marked: expected a mask of the grid's shape (2, 2), got [[1], [1, 2]]": lambda: plots.road_map(
        GRID, marked=[[1], [1, 2]]
    ),
    "pixels: expected uint8 or uint16 [H, W], [H, W, 3] or [H, W, 4], got uint8 [4]": lambda: png_of(
        np.zeros(4, np.uint8)
    ),
    "file: expected a name that ends in .png, got map.json": lambda: write_png("map.json", np.zeros((4, 4), np.uint8)),
    "moves: expected names of letters, digits and _ that no other": lambda: evolve(0, moves={3: (1, 2)}),
    "user_moves: expected moves by name, got (1,)": lambda: MoveWeights(user_moves=(1,)),
    "user_moves: mine: expected a weight and a Move, got 3": lambda: MoveWeights(user_moves={"mine": 3}),
    "cells: expected at most 33,554,432 in all, got": lambda: export(
        np.full((99, 99), 15), "movingai", FormatOptions(cells=64)
    ),
    "map: expected one map, got 2": lambda: export([GRID, GRID], "dt-maps"),
    "to: expected one of duckietown, dt-maps, duckiematrix, sumo, opendrive": lambda: export(GRID, "csv"),
    "options: expected FormatOptions, got {'cells': 8}": lambda: export(GRID, "movingai", {"cells": 8}),
    "cells: expected none with usd, got 8; this": lambda: export(GRID, "usd", FormatOptions(cells=8)),
    "tile_size: expected more than two lanes, 6.4 m, got 6 m": lambda: export(GRID, "sumo", FormatOptions(tile_size=6)),
    "name: expected a name, got 3": lambda: export(GRID, "sumo", name=3),
    "to: expected one of duckietown, dt-maps, duckiematrix, sumo": lambda: PackSpec(to=3),
    "furnish: 3: expected one of objects, signs, lights": lambda: furnish(GRID, {3: 3}),
    "town.json: no such file or directory": lambda: furnish("town.json"),
    "grid: expected rows of one length": lambda: canonical_form([[6, 3], [12]]),
    "size: expected a whole number, 1 or more, got 0": lambda: scale_tiles(load_tiles(), 0),
    "pixels: expected uint8 or uint16 [H, W], [H, W, 3] or [H, W, 4], got float64 [4, 4, 3]": lambda: write_png(
        "map.png", np.zeros((4, 4, 3))
    ),
    "pixels: expected uint8 or uint16 [H, W], [H, W, 3] or [H, W, 4], got uint8 [0, 4]": lambda: png_of(
        np.zeros((0, 4), np.uint8)
    ),
    "params: expected RoadNavParams, got LaneDriveParams(": lambda: begin(RoadNav, LaneDriveParams),
    "params: expected LaneDriveParams, got RoadNavParams(": lambda: begin(LaneDrive, RoadNavParams),
    "robot: expected a latency, as the state of the wheels has, got none": lambda: LaneDrive.step(
        jax.random.key(0),
        LaneDrive.reset(jax.random.key(0), LaneDriveParams(levels(), robot=Robot(latency=1.0)))[1],
        np.zeros(2),
        LaneDriveParams(levels()),
    ),
    "state: expected LaneDriveState, got RoadNavState(": lambda: LaneDrive.step(
        *begin(RoadNav, RoadNavParams), np.zeros(2), LaneDriveParams(levels())
    ),
    "action: expected one whole number, got float": lambda: RoadNav.step(
        *begin(RoadNav, RoadNavParams), 1.7, RoadNavParams(levels())
    ),
    "best: expected shape [..., 2] for 5x5A-10000, got [2, 9]": lambda: compute_scores(TASK, np.zeros((2, 9))),
    "best: expected numbers, infinite in vacant niches, got nan": lambda: compute_scores(TASK, np.full((1, 2), np.nan)),
    "best: expected no fitness below the optimum": lambda: compute_scores(TASK, TASK.optimum[None] - [[0, 1]]),
    "name: expected a feature such as turns or straight_share, got 'bridge'; is it bridges?": lambda: extreme_maps(
        "bridge"
    ),
    "names: expected features that the search has measured, got boxfill": lambda: with_town_features(
        {}, ["boxfill"], GRID
    ),
    "config: expected EvolutionConfig, got AnnealingConfig(": lambda: ea(road_problem((4, 4)), AnnealingConfig()),
    "config: expected AnnealingConfig, got EvolutionConfig(": lambda: annealed_ea(
        road_problem((4, 4)), EvolutionConfig()
    ),
    "config: expected one number as tile_rate, got shape (2,), which only jax.vmap maps over": lambda: ea(
        road_problem((4, 4)), EvolutionConfig(tile_rate=np.array([0.1, 0.2]))
    ),
    "keys: expected keys [S], such as those of seed_keys, got 0": lambda: run(ea(road_problem((4, 4))), 0, 3),
    "seed: expected a whole number, 0 to 4294967295, got -1": lambda: seed_keys(-1, 2),
    "what: map 0: grid: expected rows of tile codes, got 3": lambda: explore([3], "page.html"),
    "fill: expected True or False, got 1": lambda: road_problem((4, 4), fill=1),
    # JAX has made int32 of it by then.
    "grids: expected int8 [P, 4, 4], got int64 [3, 4, 4]": lambda: evaluate(
        road_problem((4, 4)), np.zeros((3, 4, 4), np.int64)
    ),
    "tile_px: expected a whole number, 16 to 512, got 16.0": lambda: render(GRID, tile_px=16.0),
    "grids: expected int8 [P, 4, 4], got int32 [2, 2]": lambda: evaluate(road_problem((4, 4)), [[6, 3], [12, 9]]),
    "name: expected one of link, corner, outline, street, straight, clear, mirror, slide, transplant, displaced, "
    "refit, got 'streets'": lambda: make_move("streets"),
    "count: expected a whole number, 1 or more, got 0": lambda: random_population(
        road_problem((4, 4)), jax.random.key(0), 0
    ),
    "out: expected a name that ends in .html or .htm, got page.png": lambda: explore(GRID, "page.png"),
    "tile_px: expected a whole number, 16 to 512, got 9": lambda: explore(GRID, "page.html", tile_px=9),
    "rides: expected rides on the map, got rides on another one": lambda: next(
        film(GRID[:, ::-1], load_tiles(), make_rides(GRID, 1, seconds=0.1))
    ),
    "maps_from: expected enough for one in the split train, 0.5 of them, got 1": lambda: DatasetSpec(
        maps_from=[GRID, rotate(GRID)], split=(0.5, 0, 0.5)
    ),
    "seed: expected a whole number, 0 to 4294967295, got 1.5": lambda: searched().save("out.npz", seed=1.5),
    "axes 'turns': expected at least one bin, of a width of at least 1, got 4 of width 0": lambda: niche_index(
        np.zeros((3, 1), np.int32), (Axis("turns", 4),)
    ),
    "axes: expected at least one, got none": lambda: niche_index(np.zeros((3, 0), int), ()),
    "descriptor: expected whole numbers, got float64": lambda: niche_index(np.zeros((3, 1)), (Axis("turns", 4, 1),)),
    "checkpoint: expected a name, got ''": lambda: evolve(0, (3, 3), evaluations=100, checkpoint=""),
    "what: expected a name, got ''": lambda: explore([""], "page.html"),
    "folder: expected a name, got ''": lambda: inspect_tiles(""),
    "fixed: expected bool [2, 3], got array(": lambda: Problem((2, 3), print, fixed=np.eye(2, 3, dtype=int)),
    "penalties: expected int32 [2000], got int32 [2000, 1]": lambda: run(
        annealed_map_elites(
            replace(road_problem((4, 4)), penalties=lambda features: features[..., :1]),
            PRESETS["map-elites", "irregular"],
        ),
        seed_keys(0, 1),
        1,
    ),
    "params: expected numbers for all environments, got arrays, which only jax.vmap maps over": lambda: Batch(
        RoadNav, RoadNavParams(levels(), limit=np.array([3, 4])), 2, "Disabled"
    ),
    "tile_px: expected a whole number, 16 to 512, got 8": lambda: make_sight(tile_px=8),
    "tiles: expected TileSet, got 'tiles'": lambda: make_sight("tiles"),
    "objects: expected ObjectSet, got {}": lambda: make_sight(objects={}),
    "objects: expected ObjectSet, got 'none'": lambda: make_scenes(GRID, objects="none", tile_px=16),
    "bits: expected a whole number, 0 or more, got -1": lambda: Move(-1, print),
    "grid: expected integer tile codes, got float32": lambda: moved(np.ones((3, 3), np.float32)),
    "grid: expected two dimensions (rows, columns), got shape (1, 2, 2)": lambda: moved([GRID]),
    "grid: expected tile codes 0 to 15, got 99": lambda: moved([[99]]),
    "niche: expected whole numbers, got bool": lambda: insert(POPULATION, np.zeros(2, bool), POPULATION),
    "mates: expected 2 grids, got 1": lambda: qdax_moves(road_problem((2, 2)))[1](
        np.zeros((2, 2, 2), np.int8), np.zeros((1, 2, 2), np.int8), jax.random.key(0)
    ),
    "fitness: expected features that are measured, got 'signable'; weights={'signable': 0} measures": lambda: evolve(
        0, (4, 4), evaluations=50, fitness=lambda features: features["signable"]
    ),
    "fitness: expected features that are measured, got 'crosings'; is it crossings?": lambda: evolve(
        0, (4, 4), evaluations=50, fitness=lambda features: features["crosings"]
    ),
    "moves: stairs: expected a weight and a Move, got Move(": lambda: evolve(
        0, (4, 4), evaluations=50, moves={"stairs": make_move("link")}
    ),
    "niche: expected 2 indices, one for each grid, got [3]": lambda: insert(POPULATION, np.zeros(3, int), POPULATION),
    "populations: expected at least one, got none": lambda: truncate(count=3),
    "pose: expected Pose of numbers, got Pose(x='a', y=0, theta=0)": lambda: lane_pose(GRID, Pose("a", 0, 0)),
    "scale: expected a number over 0, up to 100, got -1": lambda: write_text(
        np.zeros((9, 9, 3), np.uint8), "text", (0, 0), -1, (0, 0, 0)
    ),
    "seeds: expected each seed once, got 7 2 times": lambda: run_task(TASK, print, [7, 7]),
    "submission: task: expected Task, got '5x5A-10000'": lambda: Submission(TASK.name, np.zeros(5)).score(),
    "file: expected a name that ends in .npz, got a.json": lambda: Submission(
        TASK, np.zeros((10, 1, 1, 5, 5), np.int8)
    ).save("a.json"),
    "seeds: expected a number or several, 0 or more, got []": lambda: run_task(TASK, print, []),
    "progress: expected True or False, got 'no'": lambda: evolve(0, progress="no"),
    "key: expected a jax.random.key, got Array((2,), dtype=key": lambda: random_grids(seed_keys(0, 2), 3),
    "key: expected a jax.random.key, got Array((3,), dtype=key": lambda: make_levels(seed_keys(0, 3), RING),
    "key: expected a jax.random.key, got 4": lambda: RoadNav.reset(4, RoadNavParams(levels())),
    "key: expected a jax.random.key, got None": lambda: LaneDrive.reset(None, LaneDriveParams(levels())),
    "key: expected a jax.random.key, got 5": lambda: step_with(LaneDrive, 5),
    "key: expected a jax.random.key, got 6": lambda: step_with(auto_reset(LaneDrive), 6),
    "key: expected a jax.random.key, got Array((7,), dtype=key": lambda: step_with(LaneDrive, seed_keys(0, 7)),
    "action: expected float [2], got 'left'": lambda: step_with(LaneDrive, jax.random.key(0), "left"),
    "action: expected int [] or": lambda: RoadNav.step(*begin(RoadNav, RoadNavParams), "left", RoadNavParams(levels())),
    "keys: expected keys [S], such as those of seed_keys, got Array([0, 0]": lambda: run(
        ea(road_problem((4, 4))), jax.random.PRNGKey(0), 2
    ),
    "generations: expected a whole number, 0 or more, got -1": lambda: run(
        ea(road_problem((4, 4))), seed_keys(0, 2), -1
    ),
    "levels: expected one or more levels, got none": lambda: RoadNavParams(
        jax.tree.map(lambda part: part[:0], levels())
    ),
    "params: expected options with levels, got 'easy'": lambda: auto_replay(RoadNav).reset(jax.random.key(0), "easy"),
    "state: expected ReplayState, got RoadNavState(": lambda: auto_replay(RoadNav).observe(
        begin(RoadNav, RoadNavParams)[1], RoadNavParams(levels())
    ),
    "level: expected one level (see random_level), got one of shape (1, 3, 3)": lambda: RoadNav.reset_to_level(
        jax.random.key(0), levels(), RoadNavParams(levels())
    ),
    "level: expected one level (see random_level), got an array": lambda: LaneDrive.reset_to_level(
        jax.random.key(0), RING, LaneDriveParams(levels())
    ),
    "movement: expected Movement of whole numbers, got Movement(row=0.5": lambda: lane_pose(
        GRID, Pose(0.5, 0.5, 0), Movement(0.5, 0, 0, 0)
    ),
    "movement: expected one Movement, got Movement(": lambda: lane_pose(
        GRID, Pose(0.5, 0.5, 0), Movement(*np.zeros((4, 2), int))
    ),
    "goal: expected LaneNode of whole numbers, got LaneNode(row=0.5": lambda: distances(GRID, LaneNode(0.5, 0, 0)),
    "grid: expected tile codes 0 to 15, got 16": lambda: look_at(np.full((2, 2), 16)),
    "grid: expected integer tile codes, got float64": lambda: look_at(np.zeros((2, 2))),
    "pose: expected one Pose, got Pose(x=array([0.5, 0.5])": lambda: look_at(GRID, Pose(*np.full((3, 2), 0.5))),
    "objects: expected those of one map, got shape [1, 1]; jax.vmap takes several": lambda: look_at(
        GRID, objects=make_objects([RoadMap(GRID, objects=(MapObject("duckie", 0.5, 0.5, 0.0, 0.1),))])
    ),
    "chosen: expected integers of shape (2, 2, 2), got int32 of shape (3, 3, 2)": lambda: look_at(
        np.zeros((2, 2), int), chosen=np.zeros((3, 3, 2), np.int32)
    ),
    "chosen: expected integers of shape (2, 2, 2), got float32": lambda: look_at(
        np.zeros((2, 2), int), chosen=np.zeros((2, 2, 2), np.float32)
    ),
    "chosen: expected tiles of the 8 pictures, each an index and 0 to 3 quarter turns, got 9 and 0": lambda: look_at(
        np.zeros((1, 1), int), chosen=[[[9, 0]]]
    ),
    "offset: expected a number, 0 or more, got [0.1, 0.2]": lambda: random_pose(
        jax.random.key(0), RING, offset=[0.1, 0.2]
    ),
    **{
        f"{name}: {words}": lambda name=name, value=value: random_pose(jax.random.key(0), RING, **{name: value})
        for name in ("offset", "heading")
        for value, words in (
            (float("nan"), "expected a number, 0 or more, got nan"),
            (3 + 0j, "expected a number, 0 or more, got (3+0j)"),
            (True, "expected a number, 0 or more, got True"),
            (np.full(2, 0.5), "expected one number, got shape [2]"),
            (np.array(-0.5), "expected a number, 0 or more, got -0.5"),
        )
    },
    **{
        f"raster: expected True or False, got {value!r}": lambda value=value: repair(RING, raster=value)
        for value in (float("nan"), 2**40, [1], (1, 2), 1, "yes")
    },
    "raster: expected one bool, got shape [2]": lambda: repair(RING, raster=np.ones(2, bool)),
    **{
        f"robots: expected a number, got {value!r}": lambda value=value: gridlock_potential(RING, value)
        for value in (float("nan"), "x", True, None, np.array([3.0]))
    },
    **{
        f"probability: expected a number, 0 to 1, got {value!r}": lambda make=make, value=value: make(
            value, make_move("link")
        )
        for make, value in ((with_fill, float("nan")), (with_fill, -1), (with_symmetric_copy, None))
    },
    **{
        f"{name}: expected a number, 0 to 1, got 1.5": lambda name=name: refit_strip(**{name: 1.5})
        for name in ("whole", "straight")
    },
    "valid: expected an array of bool, got [1.0, 0.0]": lambda: qd_score([1, 2], [1.0, 0.0], 3),
    "valid: expected an array of bool, got [nan]": lambda: coverage([float("nan")]),
    "feasible: expected an array of bool, got [1, 0]": lambda: coverage([True, False], [1, 0]),
    "worst: expected a number, got nan": lambda: qd_score([1, 2], [True, False], float("nan")),
    "fitness: expected numbers in valid niches, got NaN or minus infinity": lambda: qd_score(
        [float("nan"), 2], [True, True], 3
    ),
    "operators: expected one of tiles, links, moves, got ['tiles']": lambda: Operators(["tiles"], TASK, 0),
    "task: expected Task, got '5x5A-10000'": lambda: Operators("tiles", "5x5A-10000", 0),
    "seed: expected a whole number, 0 to 9223372036854775807, got -1": lambda: Operators("tiles", TASK, -1),
    "seed: expected a whole number, 0 to 9223372036854775807, got 1.5": lambda: Operators("tiles", TASK, 1.5),
    "lane_offset: expected tiles, a number over 0 and under 0.5, got nan": lambda: replace(
        load_tiles(), lane_offset=float("nan")
    ),
    "lane_offset_spread: expected a number, 0 or more, got -1": lambda: replace(load_tiles(), lane_offset_spread=-1),
    "blend: expected True or False, got 'no'": lambda: replace(load_tiles(), blend="no"),
    "name: expected str, got 3": lambda: replace(load_tiles(), name=3),
    **{
        f"seed: expected a whole number, 0 to 4294967295, got {value!r}": lambda value=value: draw_sample(
            RoadMap(GRID), load_tiles(), 0, seed=value
        )
        for value in (True, {}, [], b"1", 2**40)
    },
    **{
        f"grid: expected rows of tile codes, got {value!r}": lambda value=value: measure(value)
        for value in (None, 3, {"codes": []})
    },
    "pose: expected one Pose, got Pose(x=[0.5, 1.5]": lambda: lane_pose(GRID, Pose([0.5, 1.5], [0.5, 1.5], [0, 0])),
    "goal: expected one LaneNode, got LaneNode(": lambda: distances(GRID, LaneNode(*np.zeros((3, 2), int))),
    "windows: expected one of count, seed, limit": lambda: make("RoadNav", "no-map.json", windows=5),
    "moves: expected mine to return int8 and bool (4, 4), got [((4, 4)": lambda: evolve(
        0, (4, 4), moves={"mine": (1, Move(1, lambda bits, grid, mate: grid))}
    ),
    "moves: mine: apply: expected a function of bits, grid, mate, got one of (bits, grid)": lambda: evolve(
        0, moves={"mine": (1, Move(1, lambda bits, grid: None))}
    ),
    "features: mine: expected a function of grid, got one of (grid, other)": lambda: evolve(
        0, features={"mine": lambda grid, other: 0}
    ),
    "search: expected a function of task, generator, got one of ()": lambda: run_task(TASK, lambda: None, 1),
    "what: mine: expected maps, grids or files of maps, got None": lambda: collect({"mine": None}),
    "what: mine: no-run: no such file or directory": lambda: collect({"mine": "no-run"}),
    **{
        "colours: expected three ranges, of hue, saturation and value, for road, red, yellow, got "
        f"{colours!r}": lambda colours=colours: propose_masks(np.zeros((4, 4, 3), np.uint8), colours)
        for colours in ({"road": 1}, {"road": (), "red": (), "yellow": ()})
    },
    "what: expected one Result, or several by name, got a list of them": lambda: explore(
        [found(), found()], "page.html"
    ),
    "index: expected a whole number, 0 or more, got -1": lambda: draw_sample(RoadMap(GRID), load_tiles(), -1),
    "path: expected a file, got a folder, .": lambda: found().save("."),
    "file: expected a file, got a folder, .": lambda: write_png(".", np.zeros((4, 4), np.uint8)),
    r"file: expected a path, got 'a\x00b'": lambda: read_map("a\0b"),
    r"file: expected a path, got '\ud800'": lambda: read_map("\ud800"),
    r"out: expected a path, got '\ud800'": lambda: merge("part", "\ud800"),
    f"{LONG}: expected a part of a run, made by elitelanes generate --part, got none": lambda: merge(LONG, "out"),
    f"{LONG}: file name too long": lambda: pick(PickSpec(), LONG, "out"),
    f"furnish: {LONG}.toml: file name too long": lambda: furnish(GRID, f"{LONG}.toml"),
    "count: expected a whole number, 0 or more, got -2": lambda: truncate(POPULATION, count=-2),
    "niche: expected indices 0 to 1, got -1 to 0": lambda: insert(POPULATION, np.array([0, -1]), POPULATION),
    "found: expected grids of shape [4, 4] each, as in the archive, got [5, 4]": lambda: insert(
        POPULATION, [0, 1], POPULATION._replace(grids=np.zeros((2, 5, 4), np.int8))
    ),
    "found: expected features of shape [3] each, as in the archive, got [2]": lambda: insert(
        POPULATION, [0, 1], POPULATION._replace(features=np.zeros((2, 2), np.int32))
    ),
    "found: expected grids of 2 slots, as of fitness, got 1": lambda: insert(
        POPULATION, [0, 1], POPULATION._replace(grids=np.zeros((1, 4, 4), np.int8))
    ),
    "archive: expected features of 2 slots, as of fitness, got 1": lambda: insert(
        POPULATION._replace(features=np.zeros((1, 3), np.int32)), [0, 1], POPULATION
    ),
    "feasible: expected bool [3], got shape [1]": lambda: coverage([True, False, True], [True]),
    "feature_weights: expected 2 numbers, one for each of measured, got shape [3]": lambda: road_problem(
        (4, 4), measured=["symmetry", "signable"], feature_weights=np.arange(3)
    ),
    "feature_weights: expected whole numbers, got float64": lambda: road_problem(
        (4, 4), measured=["signable"], feature_weights=[0.9]
    ),
    "every: expected a checkpoint, the folder that is written to, got none": lambda: evolve(0, (4, 4), every=2),
    "weights: expected a fitness within int32 for every grid of 4 x 4": lambda: road_problem(
        (4, 4), weights=Weights(edges=np.int32(2**26)), measured=["edges"], feature_weights=np.array([2**31 - 1])
    ),
    "measured: expected each name once, got edges 2 times": lambda: road_problem(
        (4, 4), measured=["edges", "edges"], feature_weights=np.array([2**28, 1])
    ),
    "features: expected names that no built-in feature and no column of a table has, got 'turns'": lambda: road_problem(
        (4, 4), measured=["turns"], features={"turns": lambda grid: grid[0, 0]}
    ),
    "features: expected names that no built-in feature and no column of a table has, got 'turns_left'": lambda: evolve(
        0, (4, 4), features={"turns_left": lambda grid: grid[0, 0]}
    ),
    "features: expected names that no built-in feature and no column of a table has, got 'niche'": lambda: evolve(
        0, (4, 4), features={"niche": lambda grid: grid[0, 0]}
    ),
    "features: expected a to return an integer scalar, got int8 of shape (4,)": lambda: road_problem(
        (4, 4), "a:3:1", features={"a": lambda grid: grid[0]}
    ),
    "measured: expected a list of str, got 'signable'": lambda: road_problem((4, 4), measured="signable"),
    "measured: expected a feature such as turns": lambda: road_problem((4, 4), measured=["signabel"]),
    "fitness: expected it to return an integer or float scalar, got": lambda: road_problem(
        (4, 4), fitness=lambda grid: grid[0]
    ),
    "fix: expected cells of a map of 4 x 4, got 2 x 2": lambda: road_problem((4, 4), fix=[[6, 3], [12, 9]]),
    "axes: expected features of the problem, ones, got one; is it ones?": lambda: Problem(
        (4, 4), road_problem((4, 4)).evaluate, ("ones",), axes="one:3"
    ),
    "feature_names: expected each name once, got a 2 times": lambda: Problem(
        (4, 4), road_problem((4, 4)).evaluate, ("a", "a")
    ),
    "fill: expected True or False, got 3": lambda: Problem((4, 4), lambda grids: grids, fill=3),
    "features: expected a name, got ''": lambda: road_problem((4, 4), features={"": lambda grid: grid[0, 0]}),
    "fixed: expected bool [2, 2], got [[True], [True, False]]": lambda: Problem(
        (2, 2), print, fixed=[[True], [True, False]]
    ),
    "initial: expected whole numbers of shape [N, 2, 2], got [[[1099511627776, 0], [0, 0]]]": lambda: Problem(
        (2, 2), print, initial=[[[2**40, 0], [0, 0]]]
    ),
    "initial: expected none with the paper's PSO, whose particles are no grids, got 1 grid": lambda: pso(
        road_problem((2, 2), initial=np.zeros((1, 2, 2), np.int8))
    ),
    "limits: expected an array of whole numbers, got [[0, 1]]": lambda: road_problem((4, 4), limits=[[0, 1]]),
    "limits: expected an array of whole numbers, got float64": lambda: road_problem(
        (4, 4), limits=np.full((2, 23), np.nan)
    ),
    "arguments: expected arrays with a first axis of one length, got shapes [2, 3], []": lambda: vmap_in_blocks(
        lambda row, number: row + number
    )(np.zeros((2, 3)), 1),
    "arguments: expected arrays with a first axis of one length, got shapes [2], [3]": lambda: vmap_in_blocks(
        lambda one, other: one + other
    )(np.zeros(2), np.zeros(3)),
    "fixed: expected bool [4, 4], got": lambda: Problem(
        (4, 4), road_problem((4, 4)).evaluate, fixed=np.zeros((3, 4), bool)
    ),
    "config: expected none with an optimizer, got AnnealingConfig": lambda: evolve(
        0, (4, 4), optimizer=annealed_ea, config=AnnealingConfig()
    ),
    "method: expected none with an optimizer, got 'pso'": lambda: evolve(
        0, (4, 4), optimizer=annealed_ea, method="pso"
    ),
    "problem: axes: expected a problem with at least one axis": lambda: qdax_scoring_fn(
        Problem((4, 4), road_problem((4, 4)).evaluate)
    ),
    "measured: expected features that may be weighed, got the share turn_share": lambda: road_problem(
        (4, 4), measured=["turn_share"], feature_weights=np.arange(1)
    ),
    "dtype: expected that of a fitness, int32 or float32, got bool": lambda: road_problem((4, 4)).empty_archive(bool),
    "dtype: expected that of a fitness, int32 or float32, got int8": lambda: road_problem((4, 4)).empty_archive("int8"),
    "initial: expected whole numbers of shape [N, 4, 4], got int8 [4, 4]": lambda: road_problem(
        (4, 4), initial=np.zeros((4, 4), np.int8)
    ),
    "initial: expected whole numbers of shape [N, 4, 4], got int8 [2, 5, 5]": lambda: road_problem(
        (4, 4), initial=np.zeros((2, 5, 5), np.int8)
    ),
    "initial: expected tile codes 0 to 15, got 99 to 99": lambda: road_problem(
        (4, 4), initial=np.full((1, 4, 4), 99, np.int8)
    ),
    "repair: expected a function of grid, dirty, raster=False, got one of (grid)": lambda: Problem(
        (4, 4), print, repair=lambda grid: grid
    ),
    "repair: expected a function of grid, dirty, raster=False, got one of (grid, mask, rows)": lambda: Problem(
        (4, 4), print, repair=lambda grid, mask, rows: grid
    ),
    "keys: expected at least one, got none": lambda: run(ea(road_problem((4, 4))), seed_keys(0, 0), 1),
    "features: expected shape [..., 19], got [2, 1]": lambda: road_problem((4, 4)).niche(np.zeros((2, 1), int)),
}


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_argument_is_named(message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as error:
        WRONG[message]()
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())
