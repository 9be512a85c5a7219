"""Styles: settings as data, of the package and of one's own; and maps like given ones."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.generate import describe_maps
from elitelanes_jax.maps.generation import generate
from elitelanes_jax.maps.run import DIFFERENCE
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.network.plain_town import plain_town
from elitelanes_jax.network.symmetry import mirror, rotate
from elitelanes_jax.network.town import measure_town
from elitelanes_jax.problem.features import feature_unit
from elitelanes_jax.search.evolution import evolve
from elitelanes_jax.search.like import difference_from, ranges_like, settings_like
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.search.style import STYLES

RING = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [10, 0, 6, 9], [12, 5, 9, 0]], np.int8)
EIGHT = np.array([[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]], np.int8)


@pytest.mark.parametrize("style", STYLES)
def test_a_style_is_a_specification(style):
    spec = SearchSpec(style=style)
    assert spec == SearchSpec().replace(style=style) == SearchSpec(**json.loads(json.dumps(spec.to_plain())))


def test_the_papers_style_changes_nothing():
    assert SearchSpec(style="paper") == SearchSpec()


def test_given_settings_stand_before_those_of_a_style():
    spec = SearchSpec().replace(style="town", rules=None, axes="turns:5", preset="tuned")
    town = SearchSpec(style="town")
    assert (spec.rules, spec.preset, [axis.metric for axis in spec.axes]) == (None, "tuned", ["turns"])
    assert town.rules == "duckietown" and spec.weights == town.weights != ()


def test_ranges_and_weights_are_joined(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('where = ["crossings=4..", "turns=9"]\n[weights]\nturns = 3\nedges = 1\n')
    given = {"style": file, "where": "turns=..5 bridges=0", "weights": {"edges": -1}}
    expected = SearchSpec(where="crossings=4.. turns=..5 bridges=0", weights={"turns": 3, "edges": -1})
    assert SearchSpec().replace(**given) == SearchSpec(**given) == expected
    like = SearchSpec(like=[RING], where="symmetry=0.1..")
    assert [str(item) for item in like.where if item.name == "symmetry"] == ["symmetry=0.1.."] and len(like.where) > 4


def test_a_style_of_ones_own(tmp_path):
    file = tmp_path / "grid.toml"
    file.write_text('method = "ea"\nwhere = ["crossings=4.."]\nevaluations = 500\n[weights]\nturns = 3\n')
    expected = SearchSpec(method="ea", where="crossings=4..", evaluations=500, weights={"turns": 3})
    assert SearchSpec(style=str(file)) == SearchSpec(style=file) == expected


def test_large_maps_have_settings_of_their_own(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        'axes = ["turns:4"]\nwhere = ["turns=2..", "edges=9.."]\n[targets]\nturns = [4, 5]\n'
        '[large]\naxes = ["tiles:5"]\nwhere = ["turns=8.."]\nevaluations = 500\n'
    )
    small = SearchSpec(axes="turns:4", where="turns=2.. edges=9..", targets={"turns": [4, 5]})
    large = SearchSpec(axes="tiles:5", where="turns=8.. edges=9..", evaluations=500)
    spec = SearchSpec(style=file)
    assert spec.on((11, 30)) == small and spec.on((12, 12)) == large
    assert small.on((12, 12)) == small
    assert SearchSpec(**json.loads(json.dumps(spec.to_plain()))) == spec == SearchSpec().replace(style=file)
    # Given ones hold for all sizes.
    given = {"axes": "bridges:2", "where": "turns=3..", "weights": {"edges": 1}}
    joined = SearchSpec(evaluations=500, **given | {"where": "turns=3.. edges=9.."})
    for one in (SearchSpec(style=file, **given), SearchSpec().replace(style=file, **given)):
        assert one.on((12, 12)) == joined
    assert spec.replace(**given).on((12, 12)) == SearchSpec(evaluations=500, **given)
    assert spec.replace(large=None).on((12, 12)) == small


def test_large_towns_are_those_of_their_style():
    town, large = (SearchSpec(style="town").on(shape) for shape in ((11, 11), (12, 24)))
    assert town.targets and not large.targets and town.large is large.large is None
    assert "mean_block" in {axis.metric for axis in large.axes} & {item.name for item in large.where}
    with pytest.raises(InputError, match="large: expected settings of a search.*got 'large'"):
        SearchSpec(large={"large": {}})
    searched = evolve(jax.random.split(jax.random.key(0), 1), (12, 12), style="town", evaluations=0).spec
    assert searched == large.replace(evaluations=0)


@pytest.mark.parametrize(
    ("style", "message"),
    [
        ("towns", "style: expected one of paper, town, or a file that ends in .toml, got 'towns'; is it town?"),
        (3, "style: expected one of paper, town, or"),
        ("no.toml", "style 'no.toml': no such file"),
        ("broken.toml", "style 'broken.toml': expected TOML"),
        ("unknown.toml", "got 'rule'; is it rules?"),
        ("wrong.toml", "rules: expected one of duckietown, got 'chess'"),
    ],
)
def test_wrong_styles_are_named(style, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.toml").write_text("rules =")
    (tmp_path / "unknown.toml").write_text('rule = "duckietown"')
    (tmp_path / "wrong.toml").write_text('rules = "chess"')
    with pytest.raises(InputError) as caught:
        SearchSpec(style=style)
    assert message in str(caught.value)


def test_towns_keep_the_rules_and_lie_in_the_styles_niches(any_types):
    found = evolve(jax.random.split(jax.random.key(0), 2), (6, 6), style="town", evaluations=8_000)
    maps = found.maps(30)
    assert len(maps) > 10
    for road_map in maps:
        metrics, town = plain_measure(road_map.codes), plain_town(road_map.codes)
        assert not any(
            metrics[name] for name in ("crowded_crossings", "unlinked_neighbours", "dead_ends", "mismatches")
        )
        assert metrics["components"] == 1
        assert road_map.descriptor["symmetry"] == town["symmetry"]
        assert road_map.descriptor["box_fill"] == town["box_fill"]


def test_plain_features_are_those_of_the_kernel():
    rng = np.random.default_rng(0)
    grids = [*rng.integers(0, 16, (20, 4, 5), np.int8), np.zeros((4, 5), np.int8)]
    grids += [np.where(rng.random((4, 5)) < 0.3, grid, 0) for grid in grids]
    for grid in grids:
        measured = measure_town(np.asarray(grid, np.int8))
        assert plain_town(grid) == {name: int(getattr(measured, name)) for name in plain_town(grid)}


def test_what_is_like_given_maps():
    spec = SearchSpec(like=[RING, EIGHT])
    assert spec.rules == "duckietown" and spec.preset == "irregular"
    for grid in (RING, EIGHT):
        values = plain_town(grid) | plain_measure(grid)
        for item in spec.where:
            part = {"turn_share": "turns", "crossing_share": "crossings"}.get(item.name)
            value = values[part] / values["tiles"] if part else values[item.name] / feature_unit(item.name)
            assert item.low <= value <= item.high, item
    again = SearchSpec(**json.loads(json.dumps(spec.to_plain())))
    assert again == spec
    assert SearchSpec(like=[np.full((3, 3), 15)]).rules is None
    assert settings_like([RING])["where"] == settings_like([np.pad(RING, 2)])["where"]
    with pytest.raises(InputError, match="like: expected maps with roads"):
        SearchSpec(like=[np.zeros((3, 3), int)])


def test_the_difference_is_that_from_the_nearest():
    assert difference_from(rotate(mirror(RING)), [EIGHT, RING]) == 0
    assert difference_from(np.pad(RING, 1), [RING]) == 0
    changed = RING.copy()
    changed[1, 1] = 5
    assert difference_from(changed, [EIGHT, RING]) == 1 / 16
    assert difference_from(RING, [EIGHT]) > 0.3


def test_maps_like_given_ones_are_written_with_their_difference(tmp_path, any_types):
    block = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [10, 0, 0, 10], [12, 5, 5, 9]])
    where = "turn_share=0.2.. symmetry=0.5.. adjacent_turns_per_tile=0..1"
    search = SearchSpec(like=[RING], preset="paper", generations=5, where=where, initial=[block, RING])
    maps = generate(
        GenerateSpec(size=(4, 4), maps=4, at_most=True, seeds=2, tile_px=16, search=search), tmp_path / "out"
    )
    assert maps
    for number, road_map in enumerate(maps):
        difference = json.loads((tmp_path / f"out/maps/{number:04}/map.json").read_text())["metrics"][DIFFERENCE]
        assert difference == pytest.approx(difference_from(road_map.codes, [RING]), abs=1e-3)
        assert difference > 0
        low = next(item.low for item in search.where if item.name == "box_fill")
        assert int(measure_town(road_map.codes).box_fill) >= 1000 * low
    assert describe_maps(maps, 4, tmp_path).endswith("of their cells")


def test_a_given_map_is_none_of_the_chosen_wherever_it_lies():
    moved = np.pad(rotate(RING), [(1, 1), (0, 2)])
    found = evolve(jax.random.split(jax.random.key(0), 1), (6, 6), rules="duckietown", initial=[moved], generations=0)
    assert moved.tolist() in [road_map.codes.tolist() for road_map in found.maps(99)]
    for given in (RING, moved):
        like = replace(found, spec=replace(found.spec, like=[given], where=_anything()))
        assert all(difference_from(road_map.codes, [given]) for road_map in like.maps(99))


def _anything():
    """Ranges of the features that `like` has ranges of, so that it sets nothing else."""
    return [f"{name}=0.." for name in ranges_like()]


def test_given_settings_stay_beside_maps_to_be_like():
    spec = SearchSpec().replace(like=[RING], preset="tuned", rules=None)
    assert (spec.preset, spec.rules) == ("tuned", None) and len(spec.where) == 6 and spec.targets
    assert SearchSpec().replace(like=[RING], method="ea").preset == "tuned"
    assert SearchSpec().replace(style="town", method="ea").preset == "tuned"
    assert not SearchSpec().replace(like=[RING], axes="turns:5").targets
