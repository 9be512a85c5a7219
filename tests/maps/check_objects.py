"""Checks the signs and objects of Duckietown map files by Duckietown's rules, from the files alone.

    python tests/maps/check_objects.py FILE.yaml ...    # a line for each broken rule; exit code 1 if there is one

It shares no code with the package, and needs PyYAML alone. The rules, with the sections of the operation manual:

- Traffic signs, Placement: from each stop line, the control and the topology are on the far corners of the crossing,
  face the driver, and are on cells without road or outside the map. A crossing has no other such signs.
- Street Name Signs, Placement: if there are such signs, each turn has one, in the outer corner beyond the white tape,
  facing the middle; each other road between crossings has one or more, beside a straight tile, facing it.
- Traffic lights, Placement: the stand is outside the driving region; the lights are over the crossing.
- Tags: a number of the kind's, as in the database of tags.
- No other object is on a tile with a road; no two overlap. Sizes are measured from the meshes of duckietown-world.
"""

import math
import sys
from collections import Counter
from pathlib import Path

import yaml

# Sides that a tile opens, as (east, north) steps, by its kind when it faces east.
N, E, S, W = (0, 1), (1, 0), (0, -1), (-1, 0)
ROADS = {
    "straight": {E, W},
    "curve_left": {W, N},
    "curve_right": {W, S},
    "3way_left": {W, E, N},
    "3way_right": {W, E, S},
}
TURNS = {"E": 0, "N": 1, "W": 2, "S": 3}

# Metres high, long and wide.
SIZES = {
    "duckie": (0.08, 0.088, 0.06),
    "cone": (0.08, 0.05, 0.05),
    "barrier": (0.08, 0.284, 0.056),
    "duckiebot": (0.12, 0.179, 0.131),
    "bus": (0.18, 0.659, 0.205),
    "truck": (0.2, 0.362, 0.156),
    "tree": (0.25, 0.14, 0.14),
    "house": (0.5, 0.676, 0.879),
    "building": (0.6, 0.64, 0.424),
    "sign": (0.18, 0.055, 0.072),
    "sign_blank": (0.18, 0.055, 0.183),  # street names: the manual's 7.2 inches
}
TAPE = 0.2925 + 0.012 + 0.21 + 0.048  # from a turn's inner corner to the far side of its outer white tape
STAND, ARM = (0.097, 0.086), 0.528  # of a traffic light: its foot, and from there to its lights
SLACK = 1e-4  # metres, for numbers that are written with six decimals

CONTROLS = {"sign_stop", "sign_t_light_ahead"}
TAGS = {
    "sign_stop": {1, *range(20, 39), *range(162, 197)},
    "sign_t_light_ahead": {*range(74, 95), *range(200, 230)},
    "sign_4_way_intersect": {8, *range(13, 20), *range(44, 57), *range(197, 200), *range(231, 235), *range(262, 265)},
    "sign_right_T_intersect": {9, *range(57, 61), *range(132, 142), 235, 238, 241, 244, 260, 261},
    "sign_left_T_intersect": {10, *range(61, 65), *range(152, 162), 237, 240, 242, 245, 248, 249},
    "sign_blank": {*range(440, 552)},
    "sign_T_intersect": {11, *range(65, 69), *range(142, 152), 236, 239, 243, 246, 247},
}


def turned(step, quarters):
    """Returns a step turned counter-clockwise."""
    for _ in range(quarters % 4):
        step = (-step[1], step[0])
    return step


def sides_of(tile):
    """Returns the sides that a tile opens; none without a road."""
    kind, _, facing = tile.partition("/")
    if kind == "4way":
        return {N, E, S, W}
    return {turned(side, TURNS[facing or "E"]) for side in ROADS.get(kind, ())}


def outline(x, y, length, width, angle):
    """Returns the corners of a rectangle."""
    c, s = math.cos(angle), math.sin(angle)
    return [
        (x + u * length / 2 * c - v * width / 2 * s, y + u * length / 2 * s + v * width / 2 * c)
        for u, v in ((1, 1), (1, -1), (-1, -1), (-1, 1))
    ]


def apart(one, other):
    """Returns whether a line parallel to a side of one of two rectangles separates them."""
    for corners in (one, other):
        for (ax, ay), (bx, by) in ((corners[0], corners[1]), (corners[1], corners[2])):
            size = math.hypot(bx - ax, by - ay)
            nx, ny = (bx - ax) / size, (by - ay) / size
            a, b = ([x * nx + y * ny for x, y in points] for points in (one, other))
            if max(a) <= min(b) + SLACK or max(b) <= min(a) + SLACK:
                return True
    return False


def check(text):
    """Returns the broken rules of a map file, in words."""
    values = yaml.safe_load(text)
    side, rows = float(values["tile_size"]), values["tiles"][::-1]  # the first row south
    roads = {(x, y): sides_of(tile) for y, row in enumerate(rows) for x, tile in enumerate(row)}
    faults, things = [], []
    for name, thing in (values.get("objects") or {}).items():
        kind, pose = thing["kind"], thing["pose"]["~SE2Transform"]
        (x, y), angle = pose["p"], math.radians(pose["theta_deg"])
        if kind == "trafficlight":
            scale, arm = thing["height"] / 0.4, angle - math.pi / 2
            x, y, length, width = x - 0.27 * scale * math.cos(arm), y - 0.27 * scale * math.sin(arm), *STAND
            head = (x + ARM * scale * math.cos(arm), y + ARM * scale * math.sin(arm))
            column, row = (math.floor(value / side) for value in head)
            middle = (column + 0.5) * side, (row + 0.5) * side
            if len(roads.get((column, row), ())) < 3 or math.dist(head, middle) > 0.2 * side:
                faults.append(f"{name}: its lights are not over the middle of a crossing")
        else:
            tall, length, width = SIZES.get(kind, SIZES["sign"])
            length, width = (value * thing["height"] / tall for value in (length, width))
        corners = outline(x, y, length, width, angle)
        xs, ys = zip(*corners, strict=True)
        for column in range(math.floor((min(xs) + SLACK) / side), math.floor((max(xs) - SLACK) / side) + 1):
            for row in range(math.floor((min(ys) + SLACK) / side), math.floor((max(ys) - SLACK) / side) + 1):
                square = outline((column + 0.5) * side, (row + 0.5) * side, side, side, 0)
                sides = roads.get((column, row), ())
                inner = [(value + 0.5 + sum(step) / 2) * side for value, step in zip((column, row), zip(*sides))]  # noqa: B905
                beyond = is_turn(sides) and min(math.dist(inner, corner) for corner in corners) > TAPE
                if sides and not (beyond and kind == "sign_blank") and not apart(corners, square):
                    faults.append(f"{name}: it is on the road of column {column}, row {row} from the south")
        tag = thing.get("tag", {}).get("~TagInstance", {}).get("tag_id")
        if kind in TAGS and tag not in TAGS[kind]:
            faults.append(f"{name}: its tag is not one of its kind")
        things.append((name, kind, x, y, angle, corners))
    for index, (name, *_, one) in enumerate(things):
        for other, *_, two in things[index + 1 :]:
            if not apart(one, two):
                faults.append(f"{name}: it is in {other}")
    return faults + check_signs(roads, side, things) + check_names(roads, side, things)


def is_turn(sides):
    """Returns whether a tile opens two sides that meet at a corner."""
    return len(sides) == 2 and turned(min(sides), 2) not in sides


def check_names(roads, side, things):
    """Returns the broken rules of street names."""
    # Half a tile ahead of a sign is its road.
    steps = [(x / side + math.cos(angle) / 2, y / side + math.sin(angle) / 2) for _, _, x, y, angle, *_ in things]
    named = Counter(tuple(map(math.floor, step)) for step, (_, kind, *_) in zip(steps, things) if kind == "sign_blank")  # noqa: B905
    left = {tile for tile, sides in roads.items() if len(sides) == 2} if named else set()
    faults = [f"street name: it faces {tile}, which is no turn or straight road" for tile in named if tile not in left]
    while left:
        road, new = set(), {left.pop()}
        while new:
            road |= new
            new = {(x + dx, y + dy) for x, y in new for dx, dy in roads[x, y]} & left
            left -= new
        if any(named[tile] != 1 for tile in road if is_turn(roads[tile])) or not any(named[tile] for tile in road):
            faults.append(f"road with {min(road)}: {[named[tile] for tile in sorted(road)]} street names")
    return faults


def check_signs(roads, side, things):
    """Returns the broken rules of signs."""
    faults = []
    signs = {name: thing for name, *thing in things if thing[0] in TAGS and thing[0] != "sign_blank"}
    used = Counter()
    for (column, row), sides in roads.items():
        if len(sides) < 3:
            continue
        place, controls = f"crossing at column {column}, row {row} from the south", set()
        for back in sides:
            ahead = turned(back, 2)
            left, right = turned(ahead, 1), turned(ahead, 3)
            closed = [way for way, step in (("right", left), ("", ahead), ("left", right)) if step not in sides]
            topology = f"sign_{'_'.join((*closed, 'T')).lstrip('_') if closed else '4_way'}_intersect"
            seen = []
            for name, (kind, x, y, angle, *_) in signs.items():
                dx, dy = x / side - column - 0.5, y / side - row - 0.5
                forward, leftward = dx * ahead[0] + dy * ahead[1], dx * left[0] + dy * left[1]
                faces = math.cos(angle) * back[0] + math.sin(angle) * back[1] > 0.999
                if faces and 0.5 < forward < 0.8 and 0.5 < abs(leftward) < 0.8:
                    seen.append(kind)
                    used[name] += 1
            if len(seen) != 2 or topology not in seen or not CONTROLS & {*seen}:
                faults.append(f"{place}: from {back} one sees {seen}")
            controls |= CONTROLS & {*seen}
        near = [max(abs(x / side - column - 0.5), abs(y / side - row - 0.5)) < 0.9 for _, _, x, y, *_ in things]
        lights = sum(is_near and kind == "trafficlight" for is_near, (_, kind, *_) in zip(near, things, strict=True))
        if controls != ({"sign_t_light_ahead"} if lights else {"sign_stop"}) or lights > 1:
            faults.append(f"{place}: {controls} with {lights} lights")
    return faults + [f"{name}: seen from {used[name]} stop lines" for name in signs if used[name] != 1]


if __name__ == "__main__":
    found = [f"{file}: {fault}" for file in sys.argv[1:] for fault in check(Path(file).read_text(encoding="utf-8"))]
    print("\n".join(found) or f"{len(sys.argv) - 1} files, no rule broken")
    sys.exit(bool(found))
