"""The page in Chromium: everything is clicked through by ``browser.mjs``, and what it saw is right.

It needs the packages of `make explorer` and Debian's chromium.
"""

import json
import re
import subprocess
from collections import Counter
from dataclasses import replace
from math import pi
from pathlib import Path

import cv2
import numpy as np
import pytest
from explored import IN_BROWSER, big_result, float_result, own_result, write_run
from sign_cases import placed_again

from elitelanes_jax import DatasetSpec, Result, RoadMap, Weights, load_tiles, read_map, render, repair
from elitelanes_jax._util.cells import cell_name
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.explorer.page import page_of
from elitelanes_jax.formats import MapObject, make_plan
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.road_map import map_to_json, read_maps
from elitelanes_jax.maps import furnish
from elitelanes_jax.network import measure_town, plain_measure
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.problem.fixed_cells import parse_fixed_cells
from elitelanes_jax.problem.inventory import COUNTED, parse_inventory
from elitelanes_jax.tiles import LABEL_COLOURS

HERE = Path(__file__).parent

pytestmark = IN_BROWSER

HOSTILE = '<i><b>bold</b></i><img src=x onerror="alert(1)"><script>alert(2)</script>'
LOOP = np.array([[6, 3], [12, 9]], np.int8)
TOWN = HERE.parents[1] / "docs" / "examples" / "town.json"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("browser")


@pytest.fixture(scope="module")
def run(folder):
    return write_run(folder / "run")


@pytest.fixture(scope="module")
def drawn(run):
    """The first map that the run wrote, and its index among the elites."""
    (shown, *_) = collect([run]).values["runs"][0]["maps"]
    return read_map(run / "maps" / shown["name"] / "map.json"), shown["elite"]


def photographs():
    """The package's tiles, each in a light of its own."""
    random, tiles = np.random.default_rng(0), load_tiles()
    lit = [
        tile._replace(image=np.clip(tile.image * random.uniform(0.6, 1.1, 3), 0, 255).astype(np.uint8))
        for tile in tiles.tiles
    ]
    return replace(tiles, tiles=tuple(lit), blend=True)


def write_large_maps(folder):
    """Writes a drawn map of 1024 x 1024 tiles, of more than 20 MB, and a map of Duckietown of that size."""
    side, indent = 1024, "\n    "

    def table(cell):
        row = f"[{', '.join([cell] * side)}]"
        return f"[{indent}{f',{indent}'.join([row] * side)}\n  ]"

    drawn = f'{{"tile_set": "a", "tiles": {table(json.dumps("straight-road"))}, "quarter_turns": {table("0")}}}'
    (folder / "large.json").write_text(f'{{\n  "codes": {table("10")},\n  "drawn": {drawn}\n}}\n')
    assert (folder / "large.json").stat().st_size > 20e6
    row = f"- [{', '.join(['straight/N'] * side)}]\n"
    (folder / "large.yaml").write_text(f"tiles:\n{row * side}")


@pytest.fixture(scope="module")
def furnished():
    return furnish(read_map(TOWN), "all lights=0.2 duckies=6", seed=3)


@pytest.fixture(scope="module")
def seen(folder, run, drawn, furnished):
    (folder / "run.html").write_text(page_of(collect([run])))
    (folder / "own.html").write_text(page_of(collect(own_result())))
    (folder / "float.html").write_text(page_of(collect(float_result())))
    (folder / "big.html").write_text(page_of(collect(big_result())))
    for px in (64, 32):
        (folder / f"photo{px}.html").write_text(page_of(collect([read_map(TOWN)], tiles=photographs(), tile_px=px)))
    hostile = collect([RoadMap(LOOP)])
    hostile.values["runs"][0]["labels"] = [HOSTILE]
    hostile.values["title"] = HOSTILE
    (folder / "hostile.html").write_text(page_of(hostile))
    (folder / "furnished.html").write_text(page_of(collect([furnished])))
    duckie, sign = MapObject("duckie", 1.5, 1.5, 0.0, 0.08, static=False), MapObject("sign_stop", 0.5, 0.5, pi, 0.18, 1)
    (folder / "objects.json").write_text(map_to_json(RoadMap(np.zeros((4, 4), np.int8), objects=(duckie, sign))))
    (folder / "town.yaml").write_text(to_duckietown(furnished.codes, objects=furnished.objects))
    (folder / "sizes.html").write_text(page_of(collect({"small": [RoadMap(LOOP)], "town": [read_map(TOWN)]})))
    write_large_maps(folder)
    command = ["node", HERE / "browser.mjs", folder, str(drawn[1])]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def test_no_message_no_request_no_dialog(seen):
    assert seen["console"] == []
    pages = ("run", "big", "own", "float", "photo64", "photo32", "hostile", "furnished", "sizes")
    assert set(seen["requests"]) == {f"{page}.html" for page in pages}
    assert seen["dialogs"] == []
    assert seen["strict"] == 0
    assert seen["refused"] == "refused"


def test_a_frame_without_an_origin_shows_all_views(seen):
    """Nothing is said on the console, see the test above."""
    assert seen["frames"] == [["Maps", "Draw", "Run", "Archive", 1]] * 4


def test_the_archive_opens_by_click_and_keys_and_the_address_keeps_it(seen):
    archive = seen["archive"]
    clicked, walked = (re.search(r"niche=([\d-]+)", archive[key])[1] for key in ("clicked", "walked"))
    column = int(clicked.removesuffix("-0-0-0-0"))
    assert walked == f"{column + 1}-0-0-0-1"
    assert archive["changes"] == 4
    assert archive["count"] == "Seeds that fill the niche"
    for word in ("seed=count", "across=dead_ends", "colour=bridges", f"niche={walked}"):
        assert word in archive["kept"]


def test_every_layer_and_overlay_changes_the_picture(seen, drawn):
    counts = drawn[0].metrics
    empty = sum(
        counts[name] == 0 for name in ("bridges", "adjacent_crossings", "adjacent_turns", "dead_ends", "cyclomatic")
    )
    assert seen["niche"]["different"] == seen["niche"]["looks"] - empty
    assert "look=tiles" in seen["niche"]["hash"] and "overlays=bridges,adjacent_crossings" in seen["niche"]["hash"]


def test_saved_files_are_those_of_python(seen, drawn, folder):
    road_map = drawn[0]
    saved = read_map(folder / "saved.json")
    np.testing.assert_array_equal(saved.codes, road_map.codes)
    assert dict(saved.metrics) == dict(road_map.metrics)
    assert (saved.fitness, saved.descriptor, saved.niche, saved.drawn) == (
        *(road_map.fitness, road_map.descriptor, road_map.niche),
        road_map.drawn,
    )
    assert (folder / "saved.yaml").read_text() == to_duckietown(road_map.codes)
    assert seen["niche"]["svg"].endswith(".svg")
    assert (folder / "saved.svg").read_text().startswith('<svg xmlns="http://www.w3.org/2000/svg"')
    picture = render(road_map, tile_px=64)
    np.testing.assert_array_equal(cv2.imread(str(folder / "saved.png"))[..., ::-1], picture.image)
    colours = np.array(LABEL_COLOURS, np.uint8)[picture.labels]
    np.testing.assert_array_equal(cv2.imread(str(folder / "labels.png"))[..., ::-1], colours)


@pytest.mark.parametrize("px", [64, 32])
def test_photographed_tiles_are_brought_together_as_render_does_it(seen, folder, px):
    tiles = photographs()
    plain, expected = (
        render(read_map(TOWN), replace(tiles, blend=blend), tile_px=px).image.astype(int) for blend in (False, True)
    )
    picture = cv2.imread(str(folder / f"photo{px}.png"))[..., ::-1].astype(int)
    assert np.abs(plain - expected).max() > 30
    assert np.abs(picture - expected).max() <= 1
    assert (picture == expected).mean() > 0.9999


def test_maps_are_filtered_sorted_and_compared(seen, run, folder):
    elites = Result.load(run / "archive.npz").elites
    crossings = np.asarray(elites.metrics.crossings)[np.asarray(elites.valid)]
    maps = seen["maps"]
    least = int(crossings.min()) + 3
    assert maps["where"] == f"--where crossings={least}.."
    assert int(maps["kept"]) == (crossings >= least).sum()
    assert maps["sorted"] == sorted(crossings, reverse=True)[:12]
    listed = read_maps(folder / "selection.json")
    assert sorted(one.metrics["crossings"] for one in listed) == sorted(crossings[crossings >= least])
    grids, fitness = (np.asarray(array)[np.asarray(elites.valid)] for array in (elites.grids, elites.fitness))
    for one in listed:
        assert one.fitness == fitness[(grids == one.codes).all(axis=(1, 2)).argmax()]
        assert one.metrics == {
            name: float(value) if name == "coverage" else value for name, value in plain_measure(one.codes).items()
        }
    assert DatasetSpec(maps_from=folder / "selection.json", split=(1, 0, 0)).shapes == [(5, 6)]
    assert (maps["compared"], maps["left"]) == (2, 1)
    assert maps["rows"] > 20
    assert re.search(r"pins=0\.\d+,0\.\d+", maps["compareHash"])
    assert seen["run"]["charts"] == 2
    assert "evaluations per second" in seen["run"]["settings"]


def test_features_beside_the_metrics_are_shown_filtered_and_saved(seen, folder):
    result = own_result()
    elites, own = result.elites, seen["own"]
    symmetry, corners = (elites.features[name] for name in ("symmetry", "corners"))
    kept = (symmetry >= 600) & (symmetry <= 900) & (corners >= 2)
    assert (own["kept"], own["where"], own["legend"]) == (str(kept.sum()), "--where symmetry=0.6..0.9", "Corners")
    assert own["note"] == "Corners: not in the text, as --where does not take it."
    listed = read_maps(folder / "own.json")
    assert sorted(one.metrics["symmetry"] for one in listed) == sorted(symmetry[kept] / 1000)
    assert sorted(one.metrics["corners"] for one in listed) == sorted(corners[kept])
    best = np.unravel_index(elites.fitness.argmin(), elites.fitness.shape)
    town = measure_town(elites.grids[best])
    assert own["values"]["Corners"] == str(corners[best])
    assert own["values"]["Longest street"] == str(town.longest_street)
    assert own["values"]["Mean detour"] == f"{town.mean_detour / 1000:.2f}"
    assert own["values"]["Repetition"] == f"{round(town.repetition / 10)} %"
    assert own["drawn"].replace("−", "-").replace(",", "") == str(elites.fitness[best] - 50 * corners[best])
    assert own["total"] == "Weighted sum"
    assert own["left"] == "Corners: only a search can measure it; the sum here leaves it out."


def test_a_float_fitness_is_shown_filtered_and_saved_with_its_fractions(seen, folder):
    fitness, shown = float_result().elites.fitness.ravel(), seen["float"]
    among = sorted(fitness[(fitness >= -2.5) & (fitness <= 0.25)].tolist())
    assert 0 < len(among) < fitness.size
    assert shown["kept"] == str(len(among))
    assert sorted(one.fitness for one in read_maps(folder / "float.json")) == among
    assert shown["range"].endswith("..") and float(shown["range"][:-2]) % 1 != 0
    assert shown["narrowed"] == shown["again"] == str((fitness >= float(shown["range"][:-2])).sum())
    marks = [float(mark.replace("−", "-")) for mark in shown["marks"]]
    assert len(marks) == 5 and abs(marks[0] - fitness.min()) < 1e-4
    np.testing.assert_allclose(np.diff(marks), (marks[-1] - marks[0]) / 4, rtol=1e-3)
    assert re.search(r"fitness −?\d\.\d+$", shown["head"])
    assert "Above the proven floor" not in shown["quantities"]
    assert (shown["total"], shown["row"]) == ("Weighted sum", "–")
    assert shown["note"].startswith("The recorded fitness adds a penalty of ranges, has other weights, or is a user's")
    assert read_map(folder / "float-drawn.json").fitness is None


def test_drawing(seen, folder):
    draw = seen["draw"]
    assert draw["open"] == {"deadEnds": 2, "bridges": 6}
    ring = np.zeros((6, 6), np.int8)
    ring[1, 2:4] = ring[4, 2:4] = 5
    ring[2:4, 1] = ring[2:4, 4] = 10
    ring[1, 1], ring[1, 4], ring[4, 1], ring[4, 4] = 6, 3, 12, 9
    written = read_map(folder / "drawn.json")
    np.testing.assert_array_equal(written.codes, ring)
    metrics = plain_measure(ring)
    assert {name: written.metrics[name] for name in METRIC_NAMES} == {name: metrics[name] for name in METRIC_NAMES}
    weights = Weights()._asdict()
    total = sum(weights[name] * metrics[name] for name in METRIC_NAMES) - weights["components"]
    assert draw["ring"] == {"deadEnds": 0, "cyclomatic": 1, "fitness": str(total).replace("-", "−")}
    assert draw["undone"] == 2
    template = parse_fixed_cells(folder / "fix.json")
    assert template.fixed.sum() == 2 and template.grid[1, 1] == 6 and template.grid[2, 2] == 0
    assert draw["mended"] == 1
    assert draw["mismatches"] == 2
    numbers = [int(draw[name].replace("−", "-").replace(",", "")) for name in ("total", "weighted")]
    assert numbers[1] - numbers[0] == 2 * 500
    assert "--weights crossings=500" in draw["weights"]
    dropped, expected = read_map(folder / "dropped.json"), read_map(folder / "town.yaml")
    np.testing.assert_array_equal(dropped.codes, expected.codes)
    for one, other in zip(dropped.objects, expected.objects, strict=True):
        assert one._replace(x=0, y=0, angle=0) == other._replace(x=0, y=0, angle=0)
        assert one[1:4] == pytest.approx(other[1:4])
    assert draw["refused"] == [
        "x.json: expected tile codes 0 to 15, got 99 at B1 ([0, 1])",
        'x.yaml: expected a Duckietown map, got no "tiles"',
        "x.yaml: expected readable YAML, got unexpected end of the stream within a flow collection",
        "x.png: expected a map as JSON or Duckietown's YAML, got a fault at character 0",
    ]
    assert draw["elsewhere"] == "ring.json: 2 × 2 tiles" and "view=draw" in draw["opened"]


def test_furnished_maps_are_shown_and_saved_with_their_objects(seen, folder, furnished):
    assert sum(int(words.split()[-1]) for words in seen["objects"]["listed"]) == len(furnished.objects)
    stops = sum(thing.kind == "sign_stop" for thing in furnished.objects)
    assert f"stop sign {stops}" in seen["objects"]["listed"]
    assert read_map(folder / "furnished.json").objects == furnished.objects
    assert [one.objects for one in read_maps(folder / "list.json")] == [furnished.objects]
    assert (folder / "furnished.yaml").read_text() == to_duckietown(furnished.codes, objects=furnished.objects)
    picture = render(furnished, tile_px=64)
    shown, labels = (
        cv2.imread(str(folder / f"furnished{name}.png"))[..., ::-1].astype(int) for name in ("", "-labels")
    )
    assert (np.abs(shown - picture.image).max(axis=-1) > 30).mean() < 1e-3 < (picture.instances > 0).mean() / 10
    assert (labels == np.array(LABEL_COLOURS)[picture.labels]).all(axis=-1).mean() > 0.99


def test_a_plan_is_saved(folder, furnished):
    plan, svg = make_plan(furnished), (folder / "plan.svg").read_text()
    texts = Counter(re.findall(r"<text[^>]*>([^<]*)</text>", svg))
    names = {"crossing3": "3-way", "crossing4": "4-way"}
    expected = [cell_name(row, column) for row, column, *_ in plan.placed]
    expected += [f"{count} × {names.get(kind, kind)}" for kind, count in plan.tiles.items() if kind != "empty"]
    expected += [f"{plan.floor[0]:g} m", f"{plan.floor[1]:g} m", *map(str, range(7, len(plan.objects) + 1))]
    assert [words for words in expected if texts[words] != 1] == []
    for colour, metres in plan.tape.items():
        assert any(words.startswith(f"{metres:.2f} m {colour}, ") for words in texts)
    listed = [words for words in texts if words.startswith("\N{BALLOT BOX} ")]
    assert len(listed) == len(plan.placed) + len(plan.objects)
    for number, thing in enumerate(plan.objects, 1):
        if thing.kind == "sign_stop":
            assert f"\N{BALLOT BOX} {number} stop sign, tag {thing.tag}" in listed
    assert svg.count("<use ") == len(plan.placed) + 4


def test_objects_are_added_moved_turned_and_deleted(seen, folder):
    duckie, fixed, sign = read_map(folder / "moved.json").objects
    assert duckie == MapObject(
        "duckie", pytest.approx(2.25, abs=0.02), pytest.approx(1.75, abs=0.02), 0, 0.08, static=False
    )
    assert fixed == MapObject("sign_stop", 0.5, 0.5, pi, 0.18, 1)
    assert sign == MapObject(
        "sign_stop", pytest.approx(3.3, abs=0.02), pytest.approx(3, abs=0.02), pytest.approx(-pi / 2), 0.18, 586
    )
    objects = seen["objects"]
    assert objects["opened"] == "objects.json: 4 × 4 tiles"
    for words, expected in zip(
        objects["said"],
        [
            r"stop sign, tag 20, x 3\.0\d, y \S+, angle 15°",
            r"stop sign, tag 21, x 3\.\d+, y \S+, angle 0°",
            r"stop sign, tag 20, .*",
            r"Deleted: stop sign, tag 20, .*",
            r"stop sign, tag 21, .*",
        ],
        strict=True,
    ):
        assert re.fullmatch(expected, words), words
    assert objects["refused"][0] == "x: expected a number from -1 to 5, got 99"
    assert objects["refused"][1] == "tag: expected a whole number from 0 to 586, got 587"
    assert float(objects["refused"][2]) == sign.x
    assert (folder / "moved.yaml").read_text() == to_duckietown(
        np.zeros((4, 4), np.int8), objects=[duckie, fixed, sign]
    )
    assert objects["missed"] == []


def test_signs_that_do_not_fit_are_placed_again(seen, folder, furnished):
    signs = seen["signs"]
    assert signs["fits"] == [[], [], []]
    ((words,),) = [signs["stale"]]
    assert re.fullmatch(r"Signs do not fit the roads: \d+ signs are out of place\.Place them again", words)
    assert signs["undone"] == signs["stale"]
    (before,), (after,), (message,) = signs["crowded"]
    room = r"(\d crossings have) no room for signs, because a road is at a corner"
    assert before.endswith("Place them again")
    # The crossings without signs are still counted, and no button promises them signs.
    (crossings,) = re.fullmatch(rf"Signs do not fit the roads: {room}\.", after).groups()
    assert re.fullmatch(rf"Signs placed again; {room}", message).groups() == (crossings,)
    saved = read_map(folder / "signs.json")
    codes = furnished.codes.copy()
    codes[2, 2] = 0
    np.testing.assert_array_equal(saved.codes, repair(codes, codes != furnished.codes))
    assert list(saved.objects) == placed_again(saved.codes, furnished.objects)
    assert signs["said"].startswith("Signs placed again")
    assert re.fullmatch(r"drawn\.json: roads end at \d tiles, the first at A1 .*", signs["ends"])
    assert signs["plan"] == "Duckietown has no tile for the dead end at A1 ([0, 0]); mend the map first"


def test_the_shelf_says_what_is_left_while_roads_are_drawn(seen, furnished):
    shelf = seen["signs"]["shelf"]
    tiles = make_plan(furnished).tiles
    assert shelf["before"] == [tiles[kind] for kind in COUNTED] == [17, 4, 6, 1]
    assert shelf["unset"] == ["–"] * 4
    text = "straight=17 turn=4 crossing3=6 crossing4=1"
    left, words, code, address = shelf["full"]
    assert (left, words, code) == (["0"] * 4, ": enough tiles", f"--inventory {text}")
    assert "shelf=17,4,6,1" in address
    assert parse_inventory(text) == tuple(zip(COUNTED, shelf["before"], strict=True))
    used, left, words = shelf["drawn"]
    assert [count + int(rest.replace("−", "-")) for count, rest in zip(used, left, strict=True)] == [17, 4, 6, 1]
    assert used != shelf["before"] and words == ": enough tiles"
    assert shelf["lacking"] == [f"−{used[1] - 1}", f": it lacks {used[1] - 1} turns"]


def test_a_tap_on_a_phone_shows_the_map(seen):
    assert seen["phone"] == {"taps": [True] * 4, "niche": True}
    assert seen["scrolled"] == 0


def test_compared_maps_have_one_scale(seen):
    """The loop has 2 columns, the town 7."""
    for loop, town in seen["scales"]:
        assert town == pytest.approx(loop * 7 / 2, rel=0.03)


def test_the_largest_files_are_opened(seen):
    assert seen["large"] == ["large.json: 1024 × 1024 tiles", "large.yaml: 1024 × 1024 tiles", "100 %"]


def test_keys_alone_reach_and_work_everything(seen):
    keys = seen["keys"]
    assert keys["missed"] == []
    assert re.fullmatch(r"--where crossings=\d+\.\.\d+", keys["where"])
    assert (keys["opened"], keys["compared"]) == (5, "2")
    assert (keys["drawn"], keys["undone"]) == ("13 %", "10 %")
    assert keys["fixed"] and keys["read"]
    assert re.search(r"--weights \w+=-?\d+", keys["weights"])
    assert keys["chart"].startswith("Best fitness against evaluations")


def test_it_is_fast(seen):
    """Milliseconds; the limits are those of a machine that does nothing else, three times."""
    times = seen["times"]
    assert min(times["colours"], times["smalls"], times["larges"]) >= 20
    assert times["shown"] < 3 * 1000
    assert times["colour"] < 3 * 100
    assert times["small"] < 3 * 16
    assert times["large"] < 3 * 100


def test_names_are_text(seen):
    assert HOSTILE.rpartition("/")[2] in seen["hostile"]["words"]
    assert (seen["hostile"]["scripts"], seen["hostile"]["bold"]) == (3, 0)
