"""Styles: options as data, of the package and of users; and maps like example maps."""

import argparse
import json
import pickle
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from certified import evolve
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from elitelanes_jax import Axis, DatasetSpec, InputError, SearchSpec, rotate
from elitelanes_jax.cli.arguments import add_options, read_options
from elitelanes_jax.network import canonical_form, measure_town, plain_measure
from elitelanes_jax.network.plain_metrics import cut_to_roads, plain_town
from elitelanes_jax.problem.features import feature_unit
from elitelanes_jax.search.like import settings_like
from elitelanes_jax.search.resolve import plain_spec, resolve, search_from_plain, spec_from_plain
from elitelanes_jax.search.settings import OPTIONS, Settings
from elitelanes_jax.search.style import STYLES, Style

RING = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [10, 0, 6, 9], [12, 5, 9, 0]], np.int8)
EIGHT = np.array([[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]], np.int8)


def plain(spec):
    """What a file gives back of a specification."""
    return spec_from_plain(json.loads(json.dumps(plain_spec(spec))))


def stored(search):
    """What a file gives back of a resolved search."""
    return search_from_plain(json.loads(json.dumps(search.to_plain())), search.shape)


def settings_of(spec, shape=(6, 6)):
    return resolve(spec, shape, room_for="anything").settings


@pytest.mark.parametrize("style", STYLES)
def test_a_style_is_a_specification(style):
    spec = SearchSpec(style=style)
    assert spec == SearchSpec().replace(style=style) and plain_spec(plain(spec)) == plain_spec(spec)
    for shape in ((6, 6), (12, 15)):
        search = resolve(spec, shape)
        assert search.settings.style == style
        assert search == resolve(search.to_spec(), shape) == resolve(plain(spec), shape) == stored(search)


def test_the_papers_style_changes_nothing_but_the_name():
    assert SearchSpec(style="paper") == SearchSpec().replace(style="paper") != SearchSpec()
    assert settings_of(SearchSpec(style="paper")) == replace(settings_of(SearchSpec()), style="paper")
    assert settings_of(SearchSpec(style="paper").replace(style=None)) == settings_of(SearchSpec())


STYLE = """
preset = "irregular"
rules = "duckietown"
axes = [{ metric = "turns", bins = 4 }]
where = ["turns=2..", "edges=9.."]
fill = false
[weights]
turns = 3
edges = 1
[targets]
turns = [4, 5]
[large]
axes = ["tiles:5"]
where = ["turns=8.."]
"""

# Values of each option: the default, the style's, others; of the command line too, where they are texts.
VALUES = {
    "style": [None, "paper", "town", "mine.toml"],
    "like": [(), ["ring.json"], [RING, EIGHT]],
    "method": ["map-elites"],
    "preset": ["tuned", "irregular", "paper"],
    "evaluations": [200_000, "500", 8],
    "generations": [None, 7, "3"],
    "axes": [None, ["turns:5"], "edges:2:3", (Axis("tiles", 5),), [{"metric": "tiles", "bins": 4, "target": 2}]],
    "where": [(), ["turns=3.."], ["edges=9..", "bridges=0"], {"turns": (2, None), "turn_share": (0.1, 1 / 3)}],
    "weights": [(), ["turns=3"], {"edges": -1, "bridges": 2}, [("turns", 0)]],
    "targets": [(), {"turns": [4, 5]}, {"edges": [1]}],
    "fix": [None, [[0, None, None], [None, 3, None]]],
    "rules": [None, "duckietown"],
    "fill": [None, False],
    "initial": [(), ["ring.json"], [RING]],
    "alphabet": [None, range(1, 16)],
    "large": [None, {"where": "edges=30.."}, {"preset": "paper", "fill": False}],
}


@st.composite
def options(draw):
    """Some options, and the names of those that are given first."""
    names = draw(st.lists(st.sampled_from([*VALUES]), unique=True))
    given = {name: draw(st.sampled_from(VALUES[name])) for name in names}
    if given.get("generations") is not None:
        given.pop("evaluations", None)
    return given, draw(st.sets(st.sampled_from([*given]))) if given else set()


@pytest.fixture(scope="module", autouse=True)
def _files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("styles")
    (folder / "mine.toml").write_text(STYLE)
    (folder / "ring.json").write_text(json.dumps({"codes": RING.tolist()}))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield


def outcome(make):
    """What is made, or the message."""
    try:
        return make()
    except InputError as error:
        return str(error)


def on_the_command_line(given, defaults):
    """What the command line makes of options; None where it has no such options."""
    parser, words = argparse.ArgumentParser(), []
    add_options(parser, defaults)
    for name, value in given.items():
        option = OPTIONS.get(name)
        texts = value if isinstance(value, list) else [value]
        if option is None or option.metavar is None or not all(isinstance(text, str | int) for text in texts):
            return None
        words += [f"--{option.flag or name}", *map(str, texts)]
    return read_options(parser.parse_args(words), defaults)


def in_a_file(given):
    """What a style file with these options makes; None where TOML has no such values, or a style no such options."""

    def toml(value):
        if isinstance(value, dict):
            return "{" + ", ".join(f"{name} = {toml(item)}" for name, item in value.items()) + "}"
        return f"[{', '.join(map(toml, value))}]" if isinstance(value, list | tuple) else json.dumps(value)

    try:
        text = "".join(f"{name} = {toml(value)}\n" for name, value in given.items())
    except TypeError:
        return None
    if "null" in text or given.get("initial") == () or {"style", "like", "evaluations", "generations"} & set(given):
        return None
    Path("other.toml").write_text(text)
    return SearchSpec(style="other.toml")


def resolved(spec, **changed):
    """All options but the style's name."""
    return plain_spec(spec) | {"style": None} | changed


SHAPES = ((5, 5), (12, 13))


@pytest.mark.slow
@given(options())
@settings(max_examples=150)
def test_all_ways_in_agree(drawn):
    given, names = drawn
    expected, replaced = (outcome(lambda make=make: make(**given)) for make in (SearchSpec, SearchSpec().replace))
    assert replaced == expected
    if isinstance(expected, str):
        return
    assert expected == pickle.loads(pickle.dumps(expected)) == expected.replace()
    assert plain_spec(plain(expected)) == plain_spec(expected)
    first, then = ({name: given[name] for name in given if (name in names) is part} for part in (True, False))
    assert plain_spec(SearchSpec(**first).replace(**then)) == plain_spec(expected)
    if (said := outcome(lambda: on_the_command_line(given, SearchSpec()))) is not None:
        assert said == expected
    if (read := outcome(lambda: in_a_file(given))) is not None:
        assert resolved(read) == resolved(expected)
    dataset = DatasetSpec().search.replace(**given)
    if given.get("generations") is None:
        usual = dataset.options["evaluations"]
        assert usual == (expected.options["evaluations"] if "evaluations" in given else 100_000)
    assert resolved(dataset, evaluations=0) == resolved(expected, evaluations=0)
    for shape in SHAPES:
        search, other = (
            outcome(lambda spec=spec, shape=shape: resolve(spec, shape)) for spec in (expected, plain(expected))
        )
        if isinstance(search, str):
            assert isinstance(other, str)  # what it read has no style to be named
        else:
            assert search == other == resolve(search.to_spec(), shape) == stored(search)


@given(options())
def test_what_is_given_stands(drawn):
    given, _ = drawn
    if isinstance(spec := outcome(lambda: SearchSpec(**given)), str):
        return
    for shape in SHAPES:
        if isinstance(search := outcome(lambda shape=shape: resolve(spec, shape)), str):
            continue
        large = (spec.options.get("large") or {}) if shape == SHAPES[1] else {}
        for name, value in given.items():
            if name == "large" or name in large:
                continue
            alone = SearchSpec(**{name: value}).options[name]
            if name in ("where", "weights"):
                changed = {item[0] for item in large.get(name, ())}
                assert {item for item in alone if item[0] not in changed} <= set(getattr(search.settings, name))
            elif name not in ("style", "like"):
                assert getattr(search.settings, name) == alone


def test_large_towns_are_those_of_their_style():
    town, large = (settings_of(SearchSpec(style="town"), shape) for shape in ((11, 11), (12, 24)))
    assert town.targets and not large.targets
    assert "mean_block" in {axis.metric for axis in large.axes} & {item.name for item in large.where}
    with refused("large", "'large'"):
        SearchSpec(large={"large": {}})
    for options in ({"evaluations": 10}, SearchSpec(evaluations=10)):
        with refused("large: evaluations", "'evaluations'"):
            SearchSpec(large=options)
    assert large.style == "town"
    own = settings_of(SearchSpec(style="town", large={"where": "turns=4.."}), (12, 12))
    assert own.axes == large.axes and {str(item) for item in own.where} == {*map(str, large.where), "turns=4.."}
    assert settings_of(SearchSpec(style="town", large=None), (12, 12)).axes == town.axes


def ranges_of_crossings(shape, **options):
    search = resolve(SearchSpec(**{"style": "town"} | options), shape, room_for="maps")
    assert search == stored(search) == resolve(plain(SearchSpec(**{"style": "town"} | options)), shape)
    return [str(item) for item in search.ranges if item.name == "crossings"]


def test_small_towns_have_a_crossing_where_there_is_room_for_one():
    """In all 24 maps of 4 x 4 cells and all 9 of 3 x 4 cells that keep the rules there is none."""
    for shape in ((3, 4), (2, 9), (4, 4), (12, 12), (12, 40)):
        assert ranges_of_crossings(shape) == []
    for shape in ((3, 5), (5, 3), (6, 6), (11, 11), (11, 40)):
        assert ranges_of_crossings(shape) == ["crossings=1.."]
    # What a user asks for holds, and what allows no crossing too.
    for where in ("crossings=0", "crossings=0..", "crossings=2..", "crossings=..3"):
        assert ranges_of_crossings((8, 8), where=where) == [where]
    for options in (
        {"where": "cyclomatic=1"},
        {"where": "crossing_share=0"},
        {"inventory": {"straight": 20, "turn": 10}},
        {"alphabet": [3, 5, 6, 9, 10, 12]},
    ):
        assert ranges_of_crossings((8, 8), **options) == []
    assert ranges_of_crossings((8, 8), inventory={"straight": 20, "turn": 10, "crossing3": 4}) == ["crossings=1.."]
    for style in (None, "paper", Style("mine", {"rules": "duckietown"})):
        assert ranges_of_crossings((8, 8), style=style) == []
    with refused("where crossings", "crossings=1..", expected="with 0"):
        ranges_of_crossings((4, 4), where="crossings=1..")
    with refused("where tiles", "tiles=..3", expected="of 24..64"):
        ranges_of_crossings((8, 8), where="tiles=..3")


def test_errors_name_the_origin_of_an_option_that_nobody_gave():
    for options, origin in (
        ({"where": "tiles=..3"}, "where"),
        ({"style": Style("few", {"where": "tiles=..3"})}, "style 'few': where"),
        ({"style": Style("few", {"large": {"where": "tiles=..3"}})}, "style 'few': where"),
    ):
        for search in (lambda spec: resolve(spec, (12, 12), room_for="maps"), lambda spec: evolve(0, spec=spec)):
            with refused(f"{origin} tiles", "tiles=..3", expected="144"):
                search(SearchSpec(**options))
    for options in (
        {"method": "pso", "preset": "irregular"},
        {"rules": "duckietown", "fill": True},
        {"alphabet": [5, 10, 15]},
        {"weights": {"turns": 2**28}},
        {"fix": [[6, None, None], [10, None, 0], [8, None, None]]},
        {"initial": [RING]},
    ):
        for style in (Style("own", options), Style("own", {"large": options})):
            with refused(f"style 'own': {[*options][-1]}") as caught:
                resolve(SearchSpec(style=style), (12, 12), room_for="maps")
            assert pickle.loads(pickle.dumps(caught.value)).args == caught.value.args
    with refused("alphabet", "no 3") as caught:
        resolve(SearchSpec(alphabet=[5, 10, 15]), (12, 12), room_for="maps")
    assert pickle.loads(pickle.dumps(caught.value)).subject == "alphabet"
    with refused("like: where box_fill", "box_fill=0.65..0.85"):
        evolve(0, like=[RING], rules=None)
    with refused("like: where box_fill", "box_fill=0.65..0.85"):
        evolve(0, like=[RING], rules=None, style=Style("full", {"where": "box_fill=1"}))
    with refused("where box_fill", "box_fill=..0.9"):
        evolve(0, like=[RING], rules=None, where="box_fill=..0.9")


def test_plain_features_are_those_of_the_kernel():
    rng = np.random.default_rng(0)
    grids = [*rng.integers(0, 16, (20, 4, 5), np.int8), np.zeros((4, 5), np.int8)]
    grids += [np.where(rng.random((4, 5)) < 0.3, grid, 0) for grid in grids]
    for grid in grids:
        measured = measure_town(np.asarray(grid, np.int8))
        assert plain_town(grid) == {name: int(getattr(measured, name)) for name in plain_town(grid)}


def test_what_is_like_given_maps():
    spec = settings_of(SearchSpec(like=[RING, EIGHT]))
    assert spec.rules == "duckietown" and spec.preset == "irregular"
    for grid in (RING, EIGHT):
        values = plain_town(grid) | plain_measure(grid)
        for item in spec.where:
            part = {"turn_share": "turns", "crossing_share": "crossings"}.get(item.name)
            value = values[part] / values["tiles"] if part else values[item.name] / feature_unit(item.name)
            assert item.low <= value <= item.high, item
    square = np.pad(np.array([[6, 3], [12, 9]], np.int8), 1)
    long = np.array([[6, *[5] * 10, 3], [12, *[5] * 10, 9]], np.int8)
    rings = [plain_town(grid)["loops_per_tile"] / 1000 for grid in (square, long)]
    assert rings == [0.25, 0.041]
    found = settings_like([square, long])["where"]["loops_per_tile"]
    assert found == (0.0, 0.303), "a quarter of the range on either side, and none below 0"
    full = resolve(SearchSpec(like=[np.full((3, 3), 15)]), (6, 6), room_for="anything")
    assert full.settings.rules is None and full.fills
    crowded = [[6, 7, 3, 0], [14, 15, 11, 0], [12, 15, 15, 3], [0, 12, 13, 9]]
    assert not resolve(SearchSpec(like=[crowded]), (6, 6), room_for="anything").fills
    assert settings_like([RING])["where"] == settings_like([np.pad(RING, 2)])["where"]
    with refused("like", "one without"):
        resolve(SearchSpec(like=[np.zeros((3, 3), int)]), (6, 6))


@pytest.mark.parametrize("name", ["like", "initial"])
def test_an_empty_list_of_maps_is_refused(name):
    for empty in ([], iter([])):
        with refused(name, "none", expected="one map"):
            evolve(0, **{name: empty})
    with refused(f"large: {name}", "none" if name == "initial" else "'like'"):
        SearchSpec(large={name: []})
    assert settings_of(SearchSpec(**{name: ()})) == settings_of(SearchSpec()) == Settings()


@pytest.mark.slow
def test_a_given_map_is_none_of_the_chosen_wherever_it_lies():
    moved = np.pad(rotate(RING), [(1, 1), (0, 2)])
    found = evolve(jax.random.split(jax.random.key(0), 1), (6, 6), rules="duckietown", initial=[moved], generations=0)
    assert moved.tolist() in [road_map.codes.tolist() for road_map in found.choose(99).maps]
    for example in (RING, moved):
        rows = tuple(map(tuple, example.tolist()))
        settings = replace(found.search.settings, like=(rows,))
        like = replace(found, search=replace(found.search, settings=settings))
        with pytest.warns(UserWarning, match="^found "):
            maps = like.maps(99)
        forms = {canonical_form(cut_to_roads(road_map.codes)) for road_map in maps}
        assert canonical_form(RING) not in forms


def test_given_settings_stay_beside_maps_to_be_like():
    spec = settings_of(SearchSpec().replace(like=[RING], preset="tuned", rules=None))
    assert (spec.preset, spec.rules) == ("tuned", None) and len(spec.where) == 6 and spec.targets
    assert settings_of(SearchSpec().replace(like=[RING], method="ea")).preset == "tuned"
    assert settings_of(SearchSpec().replace(style="town", method="ea")).preset == "tuned"
    assert not settings_of(SearchSpec().replace(like=[RING], axes="turns:5")).targets
