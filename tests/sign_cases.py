"""Maps whose roads or signs were changed after they were furnished, what is said of their signs, and signs that fit.

`python tests/sign_cases.py` writes sign_cases.json. The explorer's tests read it, because its editor places signs
again. Objects are lists of the fields of `MapObject`.
"""

import json
from math import hypot
from pathlib import Path

import numpy as np

from elitelanes_jax import RoadMap
from elitelanes_jax.formats.tags import SIGN_TAGS, STREETS
from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.faults import count_sign_faults
from elitelanes_jax.maps.furnishing.signs import crossings, has_free_corners, place_signs
from elitelanes_jax.maps.furnishing.space import Space
from elitelanes_jax.maps.furnishing.street_names import Tags, place_street_names

__all__ = ["CASES", "placed_again", "sign_cases"]

CASES = Path(__file__).with_name("sign_cases.json")

LIGHT, STREET_NAME = "trafficlight", "sign_street_name"
SIGNS = {"sign_stop", "sign_t_light_ahead", "sign_4_way_intersect"}
SIGNS |= {"sign_T_intersect", "sign_left_T_intersect", "sign_right_T_intersect"}
WORDS = (
    "signs=possible",
    "signs=possible lights=0.4",
    "lights=0.5",
    "street_names=possible",
    "signs=possible street_names=possible lights=0.3 trees=0.3",
    "all",
)


def sign_cases():
    """Returns the text of the file: a case a line."""
    random = np.random.default_rng(6)
    cases = [_case(random, (5, 6), words, lambda codes: codes) for words in WORDS]
    cases += [_case(random, (9, 7), words, lambda codes: _with_a_square(random, codes)) for words in WORDS]
    cases += [_case(random, (7, 7), words, lambda codes: _town(random, codes.shape, 1)) for words in WORDS[:2]]
    # A large town has more signs than there are tag numbers.
    cases.append(_case(random, (24, 24), "signs=possible", lambda codes: _with_a_square(random, codes)))
    # Signs were deleted by hand, and roads were drawn at the corners of crossings.
    cases += [_case(random, (7, 7), words, lambda codes: codes, keep=0.7) for words in WORDS]
    cases += [_case(random, (7, 10), words, lambda codes: _with_a_road(random, codes)) for words in WORDS]
    lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in cases)
    heads = [f'"tags": {json.dumps(SIGN_TAGS)}', f'"streets": {json.dumps(STREETS)}']
    return "{\n" + ",\n".join([*heads, f'"cases": [\n{lines}\n]']) + "\n}\n"


def _case(random, shape, words, change, keep=1.0):
    """Returns a town whose roads changed after it was furnished, with a share of its objects."""
    town = _town(random, shape, 0.85)
    objects = furnish(RoadMap(town), words, seed=int(random.integers(100))).objects
    kept = [thing for thing in objects if keep == 1 or random.random() < keep]
    codes = change(town)
    rows = "/".join("".join(f"{code:x}" for code in line) for line in codes.tolist())
    faults = count_sign_faults(RoadMap(codes, objects=kept))
    return {
        "rows": rows,
        "changed": bool((codes != town).any()) or len(kept) < len(objects),
        "objects": kept,
        "faults": {
            "crossings": faults.lacking,
            "withoutRoom": faults.without_room,
            "streets": faults.nameless,
            "wrong": faults.wrong,
        },
        "placed": placed_again(codes, kept),
    }


def _town(random, shape, share):
    """Streets on every third row and column, with a share of their links."""
    codes = np.zeros(shape, np.int8)
    for row in range(0, shape[0], 3):
        for column in range(shape[1] - 1):
            if random.random() < share:
                codes[row, column] |= 4
                codes[row, column + 1] |= 1
    for column in range(0, shape[1], 3):
        for row in range(shape[0] - 1):
            if random.random() < share:
                codes[row, column] |= 2
                codes[row + 1, column] |= 8
    return codes


def _with_a_square(random, codes):
    """Returns a town with any roads in 3 x 3 cells, among them the crossing of two streets at row 3, column 3."""
    row, column = random.integers(1, 4, 2)
    codes = codes.copy()
    codes[row : row + 3, column : column + 3] = random.choice([0, 5, 10, 15], (3, 3))
    return codes


def _with_a_road(random, codes):
    """Returns a town with a road from west to east, as the editor draws it."""
    codes, row = codes.copy(), random.choice([1, 2, 4, 5])
    codes[row, :-1] |= 4
    codes[row, 1:] |= 1
    return codes


def placed_again(codes, objects):
    """Returns the objects with new signs, made by the functions of `furnish`. Lights stay at free crossings."""
    kinds = {thing.kind for thing in objects}
    others = [thing for thing in objects if thing.kind not in SIGNS | {LIGHT, STREET_NAME}]
    tags, space = Tags(unique=False), Space(codes)
    for thing in others:
        tags.use(thing)
    arms = crossings(codes)
    free = [crossing for crossing in arms if has_free_corners(codes, crossing)]
    lights = {crossing: [] for crossing in arms}
    for thing in objects:
        if thing.kind == LIGHT and _nearest(thing, arms):
            lights[_nearest(thing, arms)].append(thing)
    lit = {crossing for crossing in free if lights[crossing]}
    signs = place_signs(arms, set(free), "possible", lit) if kinds & SIGNS else []
    placed = [tags.give(sign) for sign in signs]
    placed += [light for crossing in free for light in lights[crossing]]
    for thing in [*placed, *others]:
        space.add(thing)
    before = len(space.objects)
    if STREET_NAME in kinds:
        place_street_names(space, "possible", tags)
    return [*placed, *space.objects[before:], *others]


def _nearest(light, arms):
    """Returns the nearest crossing, None if it is 1.5 tiles away or more."""

    def distance(crossing):
        return hypot(crossing[1] + 0.5 - light.x, crossing[0] + 0.5 - light.y)

    nearest = min(arms, key=distance, default=None)
    return nearest if nearest and distance(nearest) < 1.5 else None


if __name__ == "__main__":
    CASES.write_text(sign_cases(), encoding="utf-8")
