"""The specification of a dataset: its fields on the command line and in Python, and the numbers that follow from it."""

import json
from dataclasses import replace
from functools import partial

import pytest
from refusals import refused

from elitelanes_jax import DatasetSpec, SearchSpec
from elitelanes_jax.dataset._transforms import STANDARD, Transforms
from elitelanes_jax.dataset.planning import plan_dataset
from elitelanes_jax.dataset.spec import describe_sides, maps_by_shape, maps_by_split
from elitelanes_jax.search.resolve import plain_spec, spec_from_plain
from elitelanes_jax.search.settings import OPTIONS

SQUARES = [(3, 3), (4, 4)]
RECTANGLES = [(3, 5), (4, 5)]


@pytest.mark.parametrize(
    ("size", "shapes"),
    [
        (9, [(9, 9)]),
        ("3..4", SQUARES),
        (["3..4"], SQUARES),
        (((3, 4),), SQUARES),
        ("3..4 5", RECTANGLES),
        (["3..4", 5], RECTANGLES),
        (((3, 4), (5, 5)), RECTANGLES),
        ((9, 12), [(9, 12)]),
        ("2..3 5..6", [(2, 5), (2, 6), (3, 5), (3, 6)]),
    ],
)
def test_sizes_of_squares_and_of_rectangles(size, shapes):
    spec = DatasetSpec(size=size)
    assert spec.shapes == shapes
    assert replace(spec) == spec  # a checked field passes its check


def test_plain_values_are_json(tmp_path):
    search = SearchSpec(
        axes=["straight_share:10"],
        where=["crossings=2..3", "bridges=0"],
        weights={"dead_ends": 480},
        fix=[[6, None], [None, 9]],
        initial=[[[6, 3], [12, 9]]],
        alphabet=range(1, 16),
    )
    spec = DatasetSpec(size=2, transforms=STANDARD.replace(crop=16), tiles=tmp_path, search=search)
    for one in (DatasetSpec(), spec):
        plain = json.loads(json.dumps(one.to_plain()))
        assert {*plain, "part"} == set(DatasetSpec.options())
        assert set(plain["search"]) == {*OPTIONS, "large"}
        searched = plain.pop("search")
        transforms = plain.pop("transforms")
        assert json.loads(json.dumps(plain_spec(spec_from_plain(searched)))) == searched
        back = DatasetSpec(**plain, search=one.search)
        assert back.replace(transforms=one.transforms) == one
        assert Transforms(**transforms | {"scale": tuple(transforms["scale"])}) == one.transforms


def test_a_camera_that_is_removed_gives_back_the_positions_of_views():
    for transforms in ("standard", "varied"):
        spec = DatasetSpec(camera={"rows": 120}, transforms=transforms)
        assert spec.to_plain()["transforms"]["rotation"] == spec.ranges.rotation == 0
        assert spec.replace(camera=None) == DatasetSpec(transforms=transforms)


def test_sizes_in_words_are_those_of_maps():
    assert describe_sides(DatasetSpec(size="8..14").size) == "8 x 8 to 14 x 14"
    assert describe_sides(DatasetSpec(size="3..4 5").size) == "3 x 5 to 4 x 5"
    wide, high = [[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]], [[6, 5, 3], *[[10, 0, 10]] * 3, [12, 5, 9]]
    assert describe_sides(DatasetSpec(maps_from=[wide, high], split=(1, 0, 0)).size) == "3 to 5 x 3 to 4"


@pytest.mark.parametrize("count", [7, 10, 33, 1000])
@pytest.mark.parametrize("split", [(0.8, 0.1, 0.1), (1.0, 0.0, 0.0), (0.34, 0.33, 0.33), (0.0, 0.5, 0.5)])
def test_splits_have_their_shares(count, split):
    counts = maps_by_split(DatasetSpec(maps=count, split=split, size=5))
    assert sum(counts) == count
    assert all(abs(got - count * share) <= 1 for got, share in zip(counts, split, strict=True))


@pytest.mark.parametrize(
    ("options", "subject", "got", "expected"),
    [
        ({"search": {"evaluations": 9}}, "maps_from", "evaluations", ""),
        ({"search": {"style": "town"}}, "maps_from", "style", ""),
        (
            {"search": {"style": "town", "fill": True, "rules": None}},
            "maps_from",
            "style, fill",
            "",
        ),
        ({"size": 5}, "size", "5 x 5", "2 x 2 to 2 x 3"),
        ({"size": "3..4 9"}, "size", "3 x 9 to 4 x 9", "2 x 2 to 2 x 3"),
        ({"maps": 3}, "maps", "3", "given"),
    ],
)
def test_given_maps_leave_nothing_to_search(options, subject, got, expected):
    """Only the options that the user gave are named, not those of a style."""
    options |= {"search": DatasetSpec().search.replace(**options.pop("search", {}))}
    with refused(subject, got, expected):
        DatasetSpec(maps_from=[[[6, 3], [12, 9]], [[6, 5, 3], [12, 5, 9]]], split=(1, 0, 0), **options)


def test_sizes_share_the_maps():
    assert maps_by_shape(DatasetSpec(maps=10, size="3..6")) == {(3, 3): 3, (4, 4): 3, (5, 5): 2, (6, 6): 2}
    assert maps_by_shape(DatasetSpec(maps=10, size="3..4 6..7")) == {(3, 6): 3, (3, 7): 3, (4, 6): 2, (4, 7): 2}


def test_given_maps_may_be_thin_and_be_replaced():
    spec = DatasetSpec(maps_from=[[[4, 5, 1]]] * 3, split=(1, 0, 0))
    assert spec.replace(seed=3) == DatasetSpec(maps_from=[[[4, 5, 1]]] * 3, split=(1, 0, 0), seed=3)
    assert spec.replace(maps_from=[[[6, 3], [12, 9]]]).maps == 1
    assert spec.replace(maps_from=None).size == DatasetSpec().size


SHELF = {"straight": 200, "turn": 200}


def test_objects_without_room_are_refused_unless_cells_may_be_empty():
    with refused("furnish", "a search whose maps have no cells without road", expected="trees=3"):
        plan_dataset(DatasetSpec(furnish="trees=3"))
    free = [{"rules": "duckietown"}, {"style": "town"}, {"fill": False}, {"inventory": SHELF}]
    for search in (*free, {"fill": True, "inventory": SHELF}):
        make = partial(DatasetSpec, size=14, furnish="trees=3 lane_duckies=2", search=SearchSpec(**search))
        if search in free:
            plan_dataset(make())
        else:
            with refused("furnish", "a search whose maps have no cells without road", expected="trees=3"):
                plan_dataset(make())
    plan_dataset(DatasetSpec(size=2, furnish="trees=3", search=SearchSpec(fix=[[None, None], [None, None]])))
    plan_dataset(DatasetSpec(furnish="trees=0.5 lane_duckies=2 lane_robots=1 signs=possible"))


def test_an_object_set_that_nothing_is_drawn_with_is_said(monkeypatch):
    said = []
    monkeypatch.setattr("elitelanes_jax.dataset.planning.announce_at_end", lambda *words: said.append(words))
    plan_dataset(DatasetSpec(objects="objects", furnish="signs=possible"))
    assert not said
    plan_dataset(DatasetSpec(objects="objects"))
    assert said == [("objects", "not drawn, because the maps have no objects")]


def test_maps_without_crossings_need_no_signs():
    free = [{"where": "crossings=..0"}, {"where": "cyclomatic=1"}, {"alphabet": [3, 5, 6, 9, 10, 12]}]
    for search in free:
        plan_dataset(DatasetSpec(furnish="signs", search=SearchSpec(**search)))
    for size in (2, (2, 3)):
        plan_dataset(DatasetSpec(furnish="signs", size=size))
    with refused("furnish", "neither", expected="rules=duckietown"):
        plan_dataset(DatasetSpec(furnish="signs", size=3))


def test_signs_at_every_crossing_need_maps_that_can_have_them():
    with refused("furnish", "neither", expected="signable=1"):
        plan_dataset(DatasetSpec(furnish="signs"))
    plan_dataset(DatasetSpec(furnish="signs", search=SearchSpec(style="town")))
    plan_dataset(DatasetSpec(furnish="signs", search=SearchSpec(where=["signable=1"])))
    plan_dataset(DatasetSpec(furnish="signs", maps_from=[[[6, 3], [12, 9]]], split=(1, 0, 0)))


def test_too_few_maps_are_told_with_those_that_are_left_out():
    """Three files gave "got 1", without a word about the other two."""
    rings = [[[6, 3], [12, 9]], [[0, 0, 0], [6, 3, 0], [12, 9, 0]], [[6, 3], [12, 9]]]
    with refused("maps_from", "1 and 2 left out, the same as another ...", expected="0.3"):
        DatasetSpec(maps_from=rings, split=(0.4, 0.3, 0.3))
