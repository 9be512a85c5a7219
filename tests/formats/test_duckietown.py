"""Duckietown's map files: there and back, by files that others wrote, and by duckietown-world itself."""

import re
import time
from itertools import pairwise

import jax
import numpy as np
import pytest
import yaml
from conftest import ALL_SHAPES, grids
from duckietown_lanes import OWN_ENVIRONMENT, check_lanes, read_by_duckietown_world, say_by_duckietown_world
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from refusals import refused

from elitelanes_jax import InputError, evolve, measure, random_grids, read_map, repair
from elitelanes_jax.drive.lanes import lane_length, lane_point
from elitelanes_jax.formats import without_dead_ends
from elitelanes_jax.formats.duckietown import read_duckietown, to_duckietown
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.network.wfc import generate_batch

# A loop with a bar across it: what each tile joins is plain.
LOOP = """
tile_size: 0.585
tiles:
- [floor, floor, floor, floor, floor]
- [floor, curve_left/W, 3way_left/W, curve_left/N, floor]
- [floor, straight/S, straight/N, straight/N, asphalt]
- [floor, curve_left/S, 3way_left/E, curve_right/S, grass]
objects:
- {kind: duckie, pos: [1, 1], rotate: 0}
"""

tables = hnp.arrays(
    np.int8, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.sampled_from((0, *ROAD_ALPHABET))
)


@given(tables)
def test_there_and_back_is_the_same(grid):
    text = to_duckietown(grid)
    back, _ = read_duckietown(text)
    np.testing.assert_array_equal(back, grid)
    assert back.dtype == np.int8
    assert to_duckietown(back) == text
    assert "3way_right" not in text and "curve_right" not in text
    assert yaml.safe_load(text)["tile_size"] == 0.585
    assert np.shape(yaml.safe_load(text)["tiles"]) == grid.shape


def test_a_map_by_hand():
    assert read_duckietown(LOOP)[0].tolist() == [[0] * 5, [0, 6, 7, 3, 0], [0, 10, 10, 10, 0], [0, 12, 13, 9, 0]]
    assert to_duckietown([[6, 3], [12, 9]], tile_size=0.61) == (
        "tile_size: 0.61\ntiles:\n- [curve_left/W, curve_left/N]\n- [curve_left/S, curve_left/E]\n"
    )
    for size in (1, 0.6, 0.01, 12.5, 100, np.int64(1), np.float32(0.585), np.float64(0.61)):
        text = to_duckietown([[6, 3], [12, 9]], tile_size=size)
        assert text.startswith(f"tile_size: {size!s}") and type(size)(yaml.safe_load(text)["tile_size"]) == size


def test_all_kinds_and_sides():
    """Each kind is the one before it turned by a quarter; without a side it is turned to the east."""
    sides = {"N": (-1, 0), "E": (0, 1), "S": (1, 0), "W": (0, -1)}
    opens = {  # when turned to the east, as duckietown-world's templates have it
        "straight": "EW",
        "curve_left": "NW",
        "curve_right": "SW",
        "3way_left": "NEW",
        "3way_right": "ESW",
        "4way": "NESW",
    }
    for kind, letters in opens.items():
        steps = [sides[letter] for letter in letters]
        for side in "ENWS":
            grid = np.zeros((3, 3), int)
            for row, column in steps:
                grid[1 + row, 1 + column] = 1
            expected = 8 * grid[0, 1] + 4 * grid[1, 2] + 2 * grid[2, 1] + grid[1, 0]
            text = (
                f"tiles:\n- [{kind}/{side}, ' {kind} / {side} ']\n- [{kind if side == 'E' else 'grass'}, floor/{side}]"
            )
            got, _ = read_duckietown(text)
            assert got.tolist() == [[expected, expected], [expected if side == "E" else 0, 0]]
            steps = [(-column, row) for row, column in steps]  # a quarter turn counter-clockwise


@given(grids(ALL_SHAPES))
def test_without_dead_ends_nothing_is_left_that_leads_nowhere(grid):
    left = without_dead_ends(grid)
    metrics = plain_measure(left)
    assert metrics["dead_ends"] == metrics["mismatches"] == metrics["boundary_violations"] == 0
    assert not (left & ~grid).any()
    np.testing.assert_array_equal(without_dead_ends(left), left)
    assert metrics["cyclomatic"] == plain_measure(grid)["cyclomatic"]  # no loop is lost
    np.testing.assert_array_equal(read_duckietown(to_duckietown(left))[0], left)


def test_dead_ends_are_named():
    grid = [[6, 3, 0], [14, 13, 1], [8, 0, 0]]
    with refused("grid", "dead ends at C2 ([1, 2]), A3 ([2, 0])", hint="dead_ends='grass'"):
        to_duckietown(grid)
    assert without_dead_ends(grid).tolist() == [[6, 3, 0], [12, 9, 0], [0, 0, 0]]
    with refused("grid", "dead ends at A1 ([0, 0]), B1 ([0, 1])...and 92 more"):
        to_duckietown(np.ones((10, 10), int))


def test_messages_are_short_whatever_a_file_unfolds_to():
    names = "abcdefghi"
    lines = [f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]" for before, name in pairwise(names)]
    bomb = "\n".join(["a: &a [0, 1, 2]", *lines, "tiles: "])
    for text in (bomb + "[*i, *i]", bomb + "{i: *i}", "tiles: [[" + "a" * 999, f"tiles: [[*{'a' * 999}]]"):
        with pytest.raises(InputError) as caught:
            read_duckietown(text)
        assert len(str(caught.value)) < 300


BOMB = "b0: &b0 [x, x]\n" + "".join(f"b{i}: &b{i} [*b{i - 1}, *b{i - 1}]\n" for i in range(1, 25))


@pytest.mark.parametrize(
    "objects",
    [
        "*b24",
        "[*b24]",
        "[{kind: *b24}]",
        *(f"[{{kind: duckie, {place}}}]" for place in ("pos: *b24", "pos: [*b24, 1]", "pose: *b24", "place: *b24")),
        *(f"[{{kind: sign_stop, pos: [1, 1], {key}: *b24}}]" for key in ("height", "rotate", "tag")),
        "[{kind: sign_stop, pos: [1, 1], tag: {~TagInstance: *b24}}]",
        "[{kind: sign_stop, pos: [1, 1], tag: {~TagInstance: {tag_id: *b24}}}]",
        "[{kind: duckie, attach: {tile: *b24, slot: *b24}}]",
        "[{kind: duckie, pos: [1, 1]}]\ntile_size: *b24",
    ],
)
def test_aliases_in_objects_are_not_unfolded(objects, tmp_path):
    """Unfolded, the texts have 200 MB."""
    file = tmp_path / "map.yaml"
    file.write_text(f"tiles: [[floor, floor], [floor, floor]]\n{BOMB}objects: {objects}\n")
    start = time.perf_counter()
    with pytest.raises(InputError) as caught:
        read_map(file)
    assert time.perf_counter() - start < 0.7 and len(str(caught.value)) < 900


@pytest.mark.parametrize("first", ["", "#\n", "\n", "a: 1\n...\n", "# \u2028", "\ufeff"])
def test_many_directives_are_refused_whatever_comes_first(first):
    """With 20,000 of them, libyaml needs a second; the time grows with the square."""
    text = first + "".join(f"%TAG !a{number}! t:x\n" for number in range(20_000)) + "---\ntiles: [[floor]]\n"
    with refused("", "16 directives and more"):
        read_duckietown(text)


@pytest.mark.parametrize(
    ("text", "subject", "got", "expected"),
    [
        ("tiles: \x07", "...map.yaml", "...at position 7", "readable"),
        ("tiles: [", "...map.yaml", "a fault at line ..., column ...: ...", "readable"),
        ("- a", "...map.yaml", 'no "tiles"', ""),
        ("tiles: road", "...map.yaml: tiles", "'road'", ""),
        ("tiles: [[floor, floor], road]", "...map.yaml: tiles", "[['floor', 'floor'], 'road']", ""),
        ("tiles: [[floor, floor], [floor]]", "...map.yaml: grid", "rows of several", ""),
        ("tiles: [[]]", "...map.yaml: shape", "1 x 0", "sides"),
        ("tiles: [[floor, floor], [floor, river/N]]", "...map.yaml: tiles", "'river/N' at B2 ([1, 1])", ""),
        ("tiles: [[floor, floor], [floor, 4]]", "...map.yaml: tiles", "'4' at B2 ([1, 1])", ""),
        ("tiles: [[straight/Q, floor], [floor, floor]]", "...map.yaml: tiles", "'straight/Q' at A1 ([0, 0])", ""),
        ("tiles: &a [*a, *a]", "...map.yaml: tiles", "... at A1 ([0, 0])", "one of"),
        ("a: *b\ntiles: [[floor, floor], [floor, floor]]", "...map.yaml", "an alias of nothing, *b", ""),
        ("{[a]: b}", "...map.yaml", "a list for a key", ""),
        ("tiles: [[floor]]\ntiles: [[4way]]", "...map.yaml: YAML", "tiles twice", ""),
        ("a: b\n---\na: b", "...map.yaml", "several", ""),
        ("%TAG ! a\n" * 16, "...map.yaml", "16 directives and more", ""),
        ("", "...map.yaml", 'no "tiles"', ""),
        ("[" * 100_000, "...map.yaml", "more", "nested"),
        ("- " * 100_000, "...map.yaml", "more", "nested"),
        ("[" + "a," * 1_400_000 + "]", "...map.yaml", "more", "values"),
        (
            "r: &r [" + "floor, " * 20_000 + "]\ntiles: [" + "*r, " * 20_000 + "]",
            "...map.yaml: shape",
            "20000 x 20000",
            "1024",
        ),
    ],
)
def test_bad_maps_are_named(text, subject, got, expected, tmp_path):
    file = tmp_path / "map.yaml"
    file.write_text(text)
    with refused(subject, got, expected):
        read_map(file)


def test_one_merge_key_of_many_tables_is_refused_before_they_are_merged():
    """Merged one by one, the keys of these tables take 20 s."""
    keys = "".join(f"  k{index}: x\n" for index in range(20_000))
    text = f"a: &a\n{keys}b:\n  <<: [{'*a, ' * 20_000}]\ntiles: [[floor]]\n"
    start = time.process_time()
    with refused("", "more", expected="values"):
        read_duckietown(text)
    assert time.process_time() - start < 5


@pytest.mark.parametrize("escape", [r"\U00110000", r"\UFFFFFFFF"])
def test_escapes_beyond_unicode_are_refused_without_libyaml_too(escape, monkeypatch):
    monkeypatch.delattr(yaml, "CSafeLoader")
    with refused("", expected="readable"):
        read_duckietown(f'tiles: [["{escape}"]]')


def test_aliases_are_what_they_name_and_other_values_do_not_matter():
    text = "when: !!int soon\nrow: &row [floor, &road 4way]\ntiles: [*row, [*road, floor], *row]"
    assert read_duckietown(text)[0].tolist() == [[0, 15], [15, 0], [0, 15]]


def test_bad_settings_are_named():
    grid = [[6, 3], [12, 9]]
    for size in (0, 0.009, 101, True, "0.6", np.array([0.5, 0.6]), float("nan"), 1j, None):
        with refused("tile_size", repr(size)):
            to_duckietown(grid, tile_size=size)


def maps_of_all_kinds():
    """200 grids: collapsed, filled, with dead ends turned to grass, evolved, by Duckietown's rules."""
    collapsed = generate_batch(np.random.default_rng(0), 50, (12, 12), border="closed", attempts=100)
    assert collapsed.success.all()
    mixed = random_grids(jax.random.key(1), 80, (9, 14), alphabet=range(16))
    filled = jax.vmap(lambda grid: repair(grid, fill=True))(mixed)
    budget = {"preset": "tuned", "evaluations": 50_000}
    evolved = evolve(jax.random.key(2), fill=True, **budget).elites
    ruled = evolve(jax.random.split(jax.random.key(3), 4), rules="duckietown", **budget).elites
    parts = [
        collapsed.grid,
        filled[:40],
        [without_dead_ends(grid) for grid in mixed[40:]],
        with_none_of(evolved, "dead_ends")[:40],
        with_none_of(ruled, "dead_ends", "crowded_crossings", "unlinked_neighbours")[:30],
    ]
    assert [len(part) for part in parts] == [50, 40, 40, 40, 30]
    return [np.asarray(grid) for part in parts for grid in part]


def with_none_of(elites, *names):
    flaws = sum(np.asarray(getattr(elites.metrics, name)) for name in names)
    return np.asarray(elites.grids)[np.asarray(elites.valid) & (flaws == 0)]


@pytest.mark.slow
def test_duckietown_world_drives_along_the_roads_that_there_are(tmp_path):
    """200 of 200 maps load, and the graph of lanes is the one that the grid says, border by border."""
    made = maps_of_all_kinds()
    files = [tmp_path / f"{number:03d}.yaml" for number in range(len(made))]
    for file, grid in zip(files, made, strict=True):
        file.write_text(to_duckietown(grid))
    for grid, graph in zip(made, read_by_duckietown_world(files), strict=True):
        check_lanes(grid, graph)


@pytest.mark.slow
def test_maps_that_come_with_duckietown_world_are_read_as_it_reads_them(tmp_path):
    """Those of 2 x 2 tiles and more; it makes no graph of those that have roads which lead nowhere, and only those."""
    texts = {}
    for file in OWN_ENVIRONMENT.parents[1].glob("lib/*/site-packages/duckietown_world/data/gd1/maps/*.yaml"):
        # It takes points for one that are the same in whole centimetres: with the 0.595 m of some of these maps, not
        # even all of its own lanes meet.
        text = re.sub(r"^tile_size: .*$", "tile_size: 0.6", file.read_text(), flags=re.MULTILINE)
        if min(np.shape(yaml.safe_load(text)["tiles"])) > 1:
            texts[tmp_path / file.name] = text
            (tmp_path / file.name).write_text(text)
    kinds = set()
    for file, graph in zip(texts, read_by_duckietown_world(texts), strict=True):
        grid = read_map(file).codes
        metrics = measure(grid)
        assert ("incomplete" in graph) == bool(metrics.mismatches or metrics.boundary_violations), file
        if "incomplete" not in graph:
            check_lanes(grid, graph)
            kinds |= set(re.findall(r"[34]way\w*|curve_\w+|straight", texts[file]))
    assert kinds == {"straight", "curve_left", "curve_right", "3way_left", "3way_right", "4way"}


@pytest.mark.slow
def test_our_lanes_are_beside_those_of_duckietown_world():
    (lines,) = say_by_duckietown_world("centre_lines.py")
    for turn, theirs in enumerate((lines["go_right"], lines["go_straight"], lines["go_left"])):
        east = Movement(*(np.int32(number) for number in (0, 0, 1, turn)))
        pose = lane_point(east, np.linspace(0, lane_length(east.turn), 2001, dtype=np.float32))
        ours = np.stack([pose.x - 0.5, 0.5 - pose.y], axis=1)
        away = np.hypot(*(np.array(theirs)[:, None] - ours).transpose(2, 0, 1))
        assert 0.019 < max(away.min(axis=0).max(), away.min(axis=1).max()) < 0.021
