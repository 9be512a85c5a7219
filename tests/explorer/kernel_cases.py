"""Cases for the explorer's kernel in TypeScript: grids, and what Python makes of them.

`python tests/explorer/kernel_cases.py` writes explorer/tests/cases.json, which Vitest reads.
"""

import json
from math import pi, radians
from pathlib import Path

import numpy as np

from elitelanes_jax import InputError, RoadMap, Weights, fitness, repair
from elitelanes_jax.explorer._payload import plan_values
from elitelanes_jax.formats import OBJECT_KINDS, MapObject, make_plan
from elitelanes_jax.formats.duckietown import read_duckietown, to_duckietown
from elitelanes_jax.formats.objects import base_kind, object_values
from elitelanes_jax.formats.plan_pages import _bill, _object_to_place
from elitelanes_jax.network import Metrics, measure_town, plain_measure
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.problem.descriptor import niche_bins, paper_axes
from elitelanes_jax.problem.features import SHARE_UNIT, SHARES

__all__ = ["ALPHABET", "CASES", "WEIGHTS", "kernel_cases"]

CASES = Path(__file__).parents[2] / "explorer" / "tests" / "cases.json"

ALPHABET = (0, 3, 5, 6, 7, 9, 10, 11, 12)
WEIGHTS = Weights(turns=7, off_alphabet=-13, components=31, constant=5)
CODES = [range(16), [0, 3, 6, 9, 12, 5, 10], [0, 0, *range(16)], [5, 7, 10, 11, 13, 14, 15]]
SHAPES = [(1, 1), (1, 6), (6, 1), (2, 2), (3, 7), (9, 8)]


BY_HAND = """\
# As people write maps.
tile_size: 0.61
"tiles": [
    ['curve_left / W', straight/E, curve_left/N], # a row
    [ straight/S,  floor/N ,
      straight/N],
  ]
tiles2:
- - grass
  - curve_left
objects:
  first:
    height: 0.06
    kind: 'duckie'
    static: off
    place: {tile: [1,0], relative: {~SE2Transform: {p: [-0.1, 0.2,], theta: 1.5}}}
  light: {kind: trafficlight, pos: [1.5, 1], rotate: 400, optional: true}
  street:
    kind: sign_blank
    pose:
      ~SE2Transform:
        p:
        - 0.3
        - 0.4
    tag:
      ~TagInstance: {tag_id: 551, family: 36h11}
  slot:
    kind: sign_1_way_left
    attach:
      tile:
        - 2
        - 1
      slot: 6
    pose:
      ~SE2Transform: {theta_deg: -270}
  own: {kind: "my.crane", place: {tile: [0, 0], relative: {~SE2Transform: {}}}}
"""


# Names that YAML takes for something else, and heights halfway between two numbers of six decimals.
ODD = tuple(
    MapObject(f"other:{name}", 1.5, 0.25, 0.5, height)
    for name, height in zip(
        ("no", "True", "n", "4wd", "crane"), (0.0078125, 0.0234375, 1.0546875, 2.0, 0.1), strict=True
    )
)

# A town whose metres of white tape are rounded twice, and objects that are nearly on its border, halfway between two
# angles, and at one position.
PLANNED_TOWN = [
    [6, 7, 7, 5, 7, 3],
    [14, 9, 10, 6, 15, 11],
    [14, 5, 11, 14, 11, 10],
    [14, 7, 13, 15, 15, 11],
    [12, 13, 5, 13, 13, 9],
]
PLANNED_OBJECTS = (
    MapObject("house", -1e-5, -0.008, pi / 4, 0.2),
    MapObject("duckiebot", -0.009, -0.009, radians(0.499), 0.12),
    MapObject("bus", 2.0, 1.0, radians(0.4996), 0.12),
    MapObject("truck", 2.5, 1.0, radians(-89.5), 0.2),
    MapObject("tree", 3.0, 2.0, 0.0, 0.25),
    MapObject("cone", 3.0, 2.0, 0.0, 0.08),
    MapObject("other:" + "abcdefgh" * 8, 4.0, 3.0, -7.0, 0.1),
)


def kernel_cases():
    """The text of the file: a case a line."""
    random = np.random.default_rng(0)
    cases = [_case(random.choice(codes, shape), random) for shape in SHAPES for codes in CODES]
    lines = ",\n".join(json.dumps(case) for case in cases)
    shared = {"alphabet": ALPHABET, "weights": WEIGHTS._asdict(), "kinds": OBJECT_KINDS, "plan": plan_values()}
    shared["by_hand"] = {"duckietown": BY_HAND} | _read(BY_HAND)
    shared["odd"] = {
        "objects": [object_values(thing) for thing in ODD],
        "duckietown": to_duckietown([[6, 3], [12, 9]], objects=ODD),
    }
    shared["planned"] = _planned(RoadMap(PLANNED_TOWN, objects=PLANNED_OBJECTS))
    heads = [f'"{name}": {json.dumps(values)}' for name, values in shared.items()]
    return "{\n" + ",\n".join([*heads, f'"cases": [\n{lines}\n]']) + "\n}\n"


def _case(grid, random):
    grid = grid.astype(np.int8)
    dirty, fixed = random.random((2, *grid.shape)) < np.array([0.3, 0.1])[:, None, None]
    measured = plain_measure(grid, ALPHABET)
    shares = {
        name: SHARE_UNIT * measured[part] // max(1, sum(measured[other] for other in of))
        for name, (part, of) in SHARES.items()
    }
    axes = paper_axes(grid.shape)
    objects = _objects(random, *grid.shape)
    text = _or_none(lambda: to_duckietown(grid, objects=objects))
    fills = (False, True) if min(grid.shape) > 1 else (False,)
    repaired = [np.asarray(repair(grid, dirty, fixed=fixed, fill=fill)) for fill in fills]
    return {
        "rows": grid.tolist(),
        "dirty": dirty.ravel().astype(int).tolist(),
        "fixed": fixed.ravel().astype(int).tolist(),
        "repaired": [one.ravel().tolist() for one in repaired],
        "metrics": [measured[name] for name in METRIC_NAMES],
        "fitness": int(fitness(Metrics(**measured), WEIGHTS)),
        "shares": shares,
        "axes": [axis._asdict() for axis in axes],
        "bins": niche_bins(np.array([measured[axis.metric] for axis in axes]), axes).tolist(),
        "town": {name: int(value) for name, value in measure_town(grid)._asdict().items()},
        "objects": [object_values(thing) for thing in objects],
        "duckietown": text,
        "read": text and _read(text),
        "plan": _or_none(lambda: _plan(repaired[-1])),
    }


def _read(text):
    codes, objects = read_duckietown(text)
    return {"rows": codes.tolist(), "objects": [object_values(thing) for thing in objects]}


def _objects(random, height, width):
    """Some objects anywhere, at right angles and others."""
    kinds = random.choice([*OBJECT_KINDS, "other:helicopter"], 3)
    positions = random.uniform(-1, 1 + np.array([width, height]), (3, 2)).round(6).tolist()
    angles = [float(random.choice([0, pi / 2, pi, -pi / 2, -pi])), *random.uniform(-7, 7, 2).round(6).tolist()]
    tags, stays = random.integers(0, 587, 3).tolist(), [True, True, False]
    found = zip(kinds.tolist(), positions, angles, tags, stays, strict=True)
    return [
        MapObject(kind, *position, angle, OBJECT_KINDS[base_kind(kind)].height, *more)
        for kind, position, angle, *more in found
    ]


def _plan(grid):
    plan = make_plan(grid)
    return {"quarterTurns": [tile.quarter_turns for tile in plan.placed], "tiles": plan.tiles, "tape": plan.tape}


def _planned(road_map):
    """Returns a map with the lines of its plan: the metres of tape, and for each object its position and direction."""
    plan = make_plan(road_map)
    things = enumerate(plan.objects, 1)
    return {
        "rows": road_map.codes.tolist(),
        "objects": [object_values(thing) for thing in road_map.objects],
        "tape": _bill(plan)[1][1:4],
        "kinds": [thing.kind for thing in plan.objects],
        "positions": [_object_to_place(thing, number, plan.tile_size)[1].strip() for number, thing in things],
    }


def _or_none(make):
    try:
        return make()
    except InputError:
        return None


if __name__ == "__main__":
    CASES.write_text(kernel_cases(), encoding="utf-8")
