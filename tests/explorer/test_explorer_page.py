"""The page: all elites are in it, whatever names hold stays text, and a faulty source leaves no page."""

import base64
import json
import os
import re
import shutil
import sys
import zlib
from dataclasses import replace
from hashlib import sha256
from html.parser import HTMLParser
from stat import S_IMODE

import numpy as np
import pytest
from explored import big_result, own_result, write_run
from refusals import refused

from elitelanes_jax import Result, RoadMap, SearchSpec, evolve, load_tiles, read_map
from elitelanes_jax.benchmark import find_task
from elitelanes_jax.cli.main import main
from elitelanes_jax.explorer import _collect, explore, page
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.explorer._shown import _floors
from elitelanes_jax.explorer.page import page_of
from elitelanes_jax.formats.road_map import map_to_json
from elitelanes_jax.network import Metrics
from elitelanes_jax.network import fitness as weighted_sum
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.search.resolve import resolve
from elitelanes_jax.tiles import choose_tiles
from elitelanes_jax.tiles.rendering import recall_choice
from elitelanes_jax.tiles.tileset import default_tiles

LOOP = np.array([[6, 3], [12, 9]], np.int8)
HOSTILE = "</script><script>alert(1)</script><!-- &lt; \u2028 '\""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("explored") / "run")


class Elements(HTMLParser):
    """The elements of a page with their texts."""

    def __init__(self, page):
        super().__init__()
        self.found = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs), []))

    def handle_data(self, data):
        if self.found:
            self.found[-1][2].append(data)

    def text(self, **wanted):
        (found,) = ["".join(text) for _, given, text in self.found if wanted.items() <= given.items()]
        return found


def read_array(values, blob):
    """The array that a table among the values stands for."""
    dtype, start, count = values["array"]
    array = np.frombuffer(blob, np.dtype(dtype).newbyteorder("<"), count, start)
    if "codes" in values:
        array = np.stack([array & 15, array >> 4], axis=-1).ravel()[: values["codes"]]
    return array


def test_the_page_holds_all_elites_of_a_run(run, tmp_path):
    assert main(["explore", str(run), "--out", str(tmp_path / "page.html")]) == 0
    elements = Elements((tmp_path / "page.html").read_text())
    values = json.loads(elements.text(id="elitelanes-values"))
    blob = zlib.decompress(base64.b64decode(elements.text(id="elitelanes-blob")))
    (shown,) = values["runs"]
    elites = Result.load(run / "archive.npz").elites
    valid = np.asarray(elites.valid)
    np.testing.assert_array_equal(read_array(shown["grids"], blob), np.asarray(elites.grids)[valid].ravel())
    np.testing.assert_array_equal(read_array(shown["fitness"], blob), np.asarray(elites.fitness)[valid])
    np.testing.assert_array_equal(read_array(shown["seed"], blob), np.nonzero(valid)[0])
    assert (shown["seeds"], shown["shape"], len(shown["maps"])) == (3, [5, 6], 3)
    assert read_array(shown["history"]["best_fitness"], blob).size == 3 * shown["history"]["steps"]
    assert shown["record"]["versions"]["elitelanes_jax"] == values["version"]


def test_tiles_are_those_that_render_draws(run):
    """The lots choose as `choose_tiles` does, and written maps keep the pictures that they were drawn with."""
    tiles = load_tiles()
    payload = collect([run])
    blob = zlib.decompress(payload.blob)
    lots = read_array(payload.values["lots"], blob)
    rotations = payload.values["tiles"]["rotations"]
    grid = np.random.default_rng(0).choice(tiles.alphabet, (7, 9))
    listed = zip((rotations[str(code)] for code in grid.flat), lots, strict=False)
    chosen = [pictures[int(lot * len(pictures))] for pictures, lot in listed]
    expected = choose_tiles(grid, tiles)
    assert chosen == (expected[..., 0] * 4 + expected[..., 1]).ravel().tolist()
    for shown in payload.values["runs"][0]["maps"]:
        road_map = read_map(run / "maps" / shown["name"] / "map.json")
        drawn = recall_choice(road_map, tiles)
        assert shown["pictures"] == (drawn[..., 0] * 4 + drawn[..., 1]).ravel().tolist()


def test_hostile_names_stay_text(tmp_path):
    folder = tmp_path / "a<b>'\"&"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"versions": {}, "settings": {HOSTILE: [HOSTILE]}}))
    map_folder = folder / "maps" / "0000<script>"
    map_folder.mkdir(parents=True)
    (map_folder / "map.json").write_text(map_to_json(RoadMap(LOOP)))
    page = page_of(collect([folder]))
    elements = Elements(page)
    assert [tag for tag, _, _ in elements.found].count("script") == 3
    assert len(re.findall("<script", page)) == 3 == len(re.findall("</script>", page))
    assert "<!--" not in page[page.index("<head>") :]
    values = json.loads(elements.text(id="elitelanes-values"))
    assert values["title"] == folder.name
    assert values["runs"][0]["record"]["settings"] == {HOSTILE: [HOSTILE]}
    assert values["runs"][0]["labels"] == ["0000<script>"]


@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode")
def test_a_folder_whose_name_is_not_utf8_has_a_page(run, tmp_path):
    folder = tmp_path / os.fsdecode(b"run\xff")
    shutil.copytree(run, folder)
    assert main(["explore", str(folder)]) == 0
    assert "<title>run? " in (folder / "explore.html").read_text(encoding="utf-8")


def test_the_page_lets_the_browser_ask_for_nothing(run):
    page = page_of(collect([run]))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert policy.startswith("default-src 'none'; script-src 'sha256-") and "http" not in policy
    script = re.search(r'<script type="module">(.*?)</script>', page, re.DOTALL)[1]
    assert base64.b64encode(sha256(script.encode()).digest()).decode() in policy
    assert not re.findall(r"<(?:link|img|iframe)\b", page[: page.index("<body>")])


def test_many_elites_fit_into_eight_megabytes():
    assert len(page_of(collect(big_result()))) < 8_000_000


def change_json(file, **values):
    file.write_text(json.dumps(json.loads(file.read_text()) | values))


def half_written(folder):
    (folder / "archive.npz").write_bytes((folder / "archive.npz").read_bytes()[:-500])


def other_size(folder):
    (folder / "maps" / "0000" / "map.json").write_text(map_to_json(RoadMap(LOOP)))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (half_written, "archive.npz: expected"),
        (other_size, "expected a map of 5 x 6, as the archive's, got 2 x 2"),
        (lambda folder: change_json(folder / "run.json", settings={"size": [9, 9]}), "as run.json says, got 5 x 6"),
        (lambda folder: (folder / "run.json").write_text("{"), "run.json: expected the JSON of a run"),
        (lambda folder: (folder / "run.json").write_text("[]"), "run.json: expected the record of a run"),
        (lambda folder: (folder / "run.json").write_text('{"versions": -1e999}'), "expected numbers, got -1e999"),
        (lambda folder: (folder / "run.json").write_text("[" * 100_000), "run.json: expected the JSON of a run"),
        (lambda folder: (folder / "run.json").unlink(), "expected a folder with run.json, got one without"),
        (lambda folder: (folder / "maps" / "0001" / "map.json").write_text("{}"), 'got no "codes"'),
        (lambda folder: np.savez(folder / "archive.npz", grids=np.zeros(3)), "archive.npz: expected a result"),
    ],
)
def test_a_faulty_run_is_refused_and_no_page_is_written(run, tmp_path, capsys, spoil, words):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    spoil(folder)
    assert main(["explore", str(folder), "--out", str(tmp_path / "page.html")]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["run"]


def test_a_page_is_replaced_only_by_force_and_other_files_never(tmp_path, capsys):
    (tmp_path / "map.json").write_text(map_to_json(RoadMap(LOOP)))
    line = ["explore", str(tmp_path / "map.json"), "--out", str(tmp_path / "page.html")]
    assert main(line) == 0
    assert main(line) == 2
    assert "; --force replaces it" in capsys.readouterr().err
    assert main([*line, "--force"]) == 0
    (tmp_path / "page.html").write_text("<!doctype html>\nmine")
    assert main([*line, "--force"]) == 2
    assert "got an existing one; --force replaces only pages of explore\n" in capsys.readouterr().err
    assert (tmp_path / "page.html").read_text() == "<!doctype html>\nmine"


@pytest.mark.skipif(sys.platform == "win32", reason="no such links and permissions")
def test_a_replaced_page_keeps_its_permissions_and_links_stay(tmp_path, capsys):
    (tmp_path / "map.json").write_text(map_to_json(RoadMap(LOOP)))
    line = ["explore", str(tmp_path / "map.json"), "--out"]
    assert main([*line, str(tmp_path / "page.html")]) == 0
    (tmp_path / "page.html").chmod(0o600)
    for name, target in (("link.html", "page.html"), ("lost.html", "nowhere.html")):
        (tmp_path / name).symlink_to(target)
    assert main([*line, str(tmp_path / "link.html"), "--force"]) == 0
    assert main([*line, str(tmp_path / "lost.html")]) == main([*line, str(tmp_path / "lost.html"), "--force"]) == 2
    assert "lost.html: expected a new file, got a link that leads nowhere" in capsys.readouterr().err
    assert S_IMODE((tmp_path / "page.html").stat().st_mode) == 0o600
    assert (tmp_path / "link.html").is_symlink() and (tmp_path / "lost.html").is_symlink()


def test_a_page_of_another_process_is_not_replaced(tmp_path, monkeypatch):
    def write_at_the_same_moment(payload):
        (tmp_path / "page.html").write_text("of the other")
        return "mine"

    monkeypatch.setattr(page, "page_of", write_at_the_same_moment)
    with refused(tmp_path / "page.html", "an existing one"):
        explore(RoadMap(LOOP), tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text() == "of the other"


def fractional(metrics, usual):
    return usual / 7 + metrics.tiles


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "dtype", "is_usual", "floors"),
    [
        ({}, "int32", True, True),
        ({"where": ["crossings=6", "bridges=2"]}, "int32", False, True),
        ({"weights": {"symmetry": -1}}, "int32", True, False),
        ({"fitness": fractional}, "float32", False, False),
    ],
)
def test_floors_are_those_of_the_usual_fitness_and_a_float_fitness_keeps_its_fractions(
    tmp_path, options, dtype, is_usual, floors
):
    result = evolve(0, (6, 6), seeds=2, style="paper", method="map-elites", preset="paper", generations=3, **options)
    result.save(tmp_path / "result.npz")
    payload = collect([tmp_path / "result.npz"])
    (shown,) = payload.values["runs"]
    blob = zlib.decompress(payload.blob)
    fitness = np.asarray(result.elites.fitness)[np.asarray(result.elites.valid)]
    values = read_array(shown["fitness"], blob)
    assert values.dtype == dtype == shown["fitness"]["array"][0]
    np.testing.assert_array_equal(values, fitness)
    assert (fitness % 1 != 0).any() == (dtype == "float32")
    assert shown["usual_fitness"] is is_usual
    assert (shown["floors"] is not None) is floors
    best = read_array(shown["history"]["best_fitness"], blob).reshape(2, -1)
    np.testing.assert_array_equal(best[:, -1], result.history.best_fitness[:, -1])


def test_floors_of_a_search_with_fixed_cells_are_those_of_maps_with_empty_cells():
    for fix, track in ((None, "A"), ([[0, *[None] * 5], *[[None] * 6] * 5], "B")):
        spec = SearchSpec(style="paper", method="map-elites", preset="paper", fix=fix)
        task = find_task(f"6x6{track}-10000")
        proven = dict(zip(task.cyclomatic.tolist(), task.optimum.tolist(), strict=True))
        assert _floors(resolve(spec, (6, 6))) == proven


def test_a_generation_without_elites_has_an_infinite_best_fitness():
    result = big_result()
    best = result.history.best_fitness.copy()
    best[0, 0] = vacant_fitness(best.dtype)
    payload = collect(replace(result, history=result.history._replace(best_fitness=best)))
    shown = payload.values["runs"][0]["history"]["best_fitness"]
    best = read_array(shown, zlib.decompress(payload.blob))
    assert best[0] == np.inf and np.isfinite(best[1:]).all()


def test_a_long_history_keeps_its_first_and_its_last_generation():
    """400 of 2000 generations."""
    result, generation, zeros = big_result(), np.arange(1, 2001), np.zeros((32, 2000), np.int32)
    history = result.history._replace(
        generation=generation, evaluations=generation, best_fitness=zeros, elite_count=zeros
    )
    payload = collect(replace(result, history=history))
    shown = payload.values["runs"][0]["history"]["evaluations"]
    evaluations = read_array(shown, zlib.decompress(payload.blob))
    assert (len(evaluations), evaluations[0], evaluations[-1]) == (400, 1, 2000)


def test_the_fractions_of_a_map_file_are_kept():
    payload = collect([RoadMap(LOOP, fitness=-0.25), RoadMap(LOOP, fitness=3)])
    (shown,) = payload.values["runs"]
    assert read_array(shown["fitness"], zlib.decompress(payload.blob)).tolist() == [-0.25, 3]
    assert not shown["usual_fitness"]


def test_a_map_file_with_other_weights_has_another_fitness_than_the_usual_one(run):
    town = next(iter(sorted(run.glob("maps/*/map.json"))))
    road_map = read_map(town)
    usual = int(weighted_sum(Metrics(**{name: road_map.metrics[name] for name in Metrics._fields})))
    for fitness, is_usual in ((usual, True), (usual - 7, False), (None, True)):
        payload = collect([replace(road_map, fitness=fitness)])
        assert payload.values["runs"][0]["usual_fitness"] is is_usual


def test_the_page_computes_no_fitness_that_has_a_penalty_of_ranges():
    for where, is_usual in (([], True), (["crossings=6"], False)):
        result = evolve(0, (4, 4), method="ea", preset="paper", generations=2, where=where)
        assert collect(result).values["runs"][0]["usual_fitness"] is is_usual


def test_picked_maps_are_in_the_niches_that_they_were_picked_from(run, tmp_path):
    """The page cannot measure the shares of towns, so their values are in it."""
    line = f"pick {run / 'archive.npz'} --maps 3 --at-most --axes crossings:4 symmetry:5 --tile-px 16 --quiet --out"
    assert main([*line.split(), str(tmp_path / "picked")]) == 0
    payload = collect(tmp_path / "picked")
    (shown,) = payload.values["runs"]
    blob = zlib.decompress(payload.blob)
    assert shown["axes"] == json.loads((tmp_path / "picked" / "run.json").read_text())["axes"]
    maps = [read_map(tmp_path / "picked" / "maps" / one["name"] / "map.json") for one in shown["maps"]]
    assert read_array(shown["niche"], blob).tolist() == [5 * one.niche[0] + one.niche[1] for one in maps]
    symmetry = read_array(shown["features"]["symmetry"], blob).tolist()
    assert symmetry == [one.descriptor["symmetry"] for one in maps]
    change_json(tmp_path / "picked" / "run.json", axes=[{"metric": "crossings", "bins": 0}])
    with refused(tmp_path / "picked" / "run.json", '[{"metric": "crossings", "bins": 0}]'):
        collect(tmp_path / "picked")


def test_results_stand_side_by_side():
    (own, big) = collect({"own": own_result(), "big": big_result()}).values["runs"]
    shown = [(one["name"], one["seeds"], one["seed"]["array"][2]) for one in (own, big)]
    assert shown == [("own", 2, 40), ("big", 32, 12800)]
    assert own["features"]["corners"]["array"][2] == 40 and own["weights"]["symmetry"] == -3
    assert big["history"]["best_fitness"]["array"][2] == 32 * big["history"]["steps"]


def test_maps_of_several_sizes_are_grouped_and_none_is_refused():
    maps = [RoadMap(LOOP), RoadMap(np.array([[6, 5, 3], [12, 5, 9]], np.int8)), RoadMap(LOOP)]
    runs = collect(maps).values["runs"]
    shown = [(one["name"], one["shape"], len(one["maps"])) for one in runs]
    assert shown == [("maps of 2 x 2", [2, 2], 2), ("maps of 2 x 3", [2, 3], 1)]
    assert [one["maps"] for one in collect([one.codes for one in maps]).values["runs"]] == [one["maps"] for one in runs]
    groups = collect({"one": maps[:1], "both": maps}).values["runs"]
    assert [one["name"] for one in groups] == ["one", "both, maps of 2 x 2", "both, maps of 2 x 3"]
    for nothing in ([], {}):
        with refused("what", "nothing"):
            collect(nothing)
    with refused("what", "ndarray"):
        collect(np.array(3))
    with refused("what: none", "nothing"):
        collect({"some": maps, "none": []})
    with refused("what", "(1, 2)"):
        collect({(1, 2): maps})


def test_a_text_that_is_too_long_for_a_path_is_no_file_and_no_tile_set(run, tmp_path):
    with refused("xxxxxxxxxxxxxxxxxxxx...", "File name too long"):
        collect("x" * 5000)
    shutil.copytree(run, tmp_path / "run")
    file = tmp_path / "run" / "run.json"
    record = json.loads(file.read_text())
    record["settings"]["tiles"] = "x" * 5000
    file.write_text(json.dumps(record))
    assert collect(tmp_path / "run").values["tiles"]["name"] == load_tiles().name


@pytest.mark.slow
def test_the_tile_set_of_a_run_is_found_from_everywhere(tmp_path, monkeypatch, capsys):
    """Its relative path is looked up in each folder above the run; another set of the same path is not its own."""
    home, away = tmp_path / "home", tmp_path / "away"
    shutil.copytree(default_tiles(), home / "mine")
    (home / "mine" / "tileset.toml").write_text('name = "my tiles"\n')
    shutil.copytree(default_tiles(), away / "mine")
    monkeypatch.chdir(home)
    line = "generate --size 5 6 --seeds 2 --maps 2 --generations 3 --method ea --preset paper --tile-px 16 --tiles mine"
    assert main([*line.split(), "--quiet", "--out", "runs/one"]) == 0
    for folder in (home, home / "runs", away):
        monkeypatch.chdir(folder)
        capsys.readouterr()
        assert main(["explore", str(home / "runs" / "one"), "--out", str(folder / "page.html")]) == 0
        assert "not in" not in capsys.readouterr().err
        assert collect([home / "runs" / "one"]).values["tiles"]["name"] == "my tiles"
    shutil.rmtree(home / "mine")
    capsys.readouterr()
    assert main(["explore", str(home / "runs" / "one"), "--out", str(tmp_path / "page.html")]) == 0
    said = "mine: expected the tile pictures of the run, got none; the package's own are shown; see --tiles\n"
    assert capsys.readouterr().err == said


def test_a_cell_of_a_chosen_map_that_the_tiles_cannot_draw_is_named(run, tmp_path, monkeypatch):
    """Elites that are not chosen may have other tiles."""
    lines = []
    monkeypatch.setattr(_collect, "announce", lines.append)
    crossing = [[0, 4, 0], [2, 15, 8], [0, 1, 0]]
    (tmp_path / "crossing.json").write_text(map_to_json(RoadMap(crossing)))
    few = load_tiles()
    few = replace(few, tiles=tuple(tile for tile in few.tiles if tile.code != 15))
    words = f"the tile set {few.name!r} has no picture of 15 (crossing4) at B2 ([1, 1]); such cells stay empty"
    for what, name in (
        (tmp_path / "crossing.json", f"{tmp_path}/crossing.json"),
        ([RoadMap(crossing)], "map 0"),
        ({"mine": RoadMap(crossing)}, "map 0"),
    ):
        collect(what, tiles=few, tile_px=16)
        assert lines.pop() == f"{name}: {words}" and not lines
    assert (Result.load(run / "archive.npz").elites.grids == 15).any()
    assert collect(run / "archive.npz", tiles=few, tile_px=16) and not lines


def test_runs_and_maps_of_the_same_name_are_told_apart(run, tmp_path, monkeypatch):
    for name in ("maps", "runs/maps", "runs/maps (2)"):
        shutil.copytree(run, tmp_path / name)
    RoadMap(np.full((5, 6), 5, np.int8)).save(tmp_path / "town.json")
    monkeypatch.chdir(tmp_path)
    runs = collect(["maps", "runs", "town.json"]).values["runs"]
    assert [run["name"] for run in runs] == ["maps", "maps (3)", "maps (2)", "maps (4)"]
    named = {"town": [LOOP, np.zeros((3, 3), np.int8)], "town, maps of 2 x 2": LOOP}
    names = [run["name"] for run in collect(named).values["runs"]]
    assert names == ["town, maps of 2 x 2", "town, maps of 3 x 3", "town, maps of 2 x 2 (2)"]
