"""The specification of a dataset: its fields on the command line and in Python, and the numbers that follow from it."""

import json
from dataclasses import replace

import pytest

from elitelanes_jax import DatasetSpec, InputError, SearchSpec
from elitelanes_jax.cli.arguments import read_options
from elitelanes_jax.cli.main import make_parser
from elitelanes_jax.dataset import STANDARD, Transforms
from elitelanes_jax.dataset.spec import maps_by_shape, maps_by_split

SQUARES = [(3, 3), (4, 4)]
RECTANGLES = [(3, 5), (4, 5)]


@pytest.mark.parametrize(
    ("size", "shapes"),
    [
        (9, [(9, 9)]),
        ("9", [(9, 9)]),
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


@pytest.mark.parametrize(
    ("arguments", "size"),
    [
        ([], "8..14"),
        (["--size", "9"], 9),
        (["--size", "3..4"], "3..4"),
        (["--size", "3..4", "5"], "3..4 5"),
        (["--size", "3..4", "--size", "5..6"], "3..4 5..6"),
    ],
)
def test_sizes_on_the_command_line(arguments, size):
    options = make_parser().parse_args(["dataset", "--out", "somewhere", *arguments])
    assert read_options(options, DatasetSpec()) == DatasetSpec(size=size)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"size": "3..4..5"}, "size: expected the smallest and the largest side"),
        ({"size": ((),)}, "size: expected the smallest and the largest side"),
        ({"size": ()}, "size: expected a range of sides such as 8..14, or two, of rows and columns"),
        ({"size": None}, "size: expected a range of sides"),
        ({"size": 3.5}, "size: expected a range of sides"),
        ({"maps": 5, "size": "3..4 5..7"}, "maps: expected one of each size at least, 6, got 5"),
        ({"split": (1, 0)}, "split: expected three shares that sum to 1"),
        ({"split": 1}, "split: expected three shares that sum to 1, got 1"),
        ({"split": (float("nan"), 0.5, 0.5)}, "split: expected a number, 0 to 1, got nan"),
        ({"transforms": Transforms(crop=600)}, "transforms: expected a crop .*, 8 tiles of 64 .*, 512 pixels, got 600"),
        ({"search": SearchSpec(fix=[[6, 3], [12, 9]])}, "fix: expected maps of the given cells' size, 2 x 2, got 7"),
        ({"search": None}, "search: expected SearchSpec, got None"),
        ({"tiles": 3}, "tiles: expected a name, got 3"),
    ],
)
def test_bad_fields_are_named(fields, message):
    with pytest.raises(InputError, match=f"^{message}"):
        DatasetSpec(**fields)


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
        assert set(plain) == set(DatasetSpec.options())
        assert set(plain["search"]) == set(SearchSpec.options())
        searched = SearchSpec.from_plain(plain.pop("search"))
        transforms = plain.pop("transforms")
        back = DatasetSpec(**plain, search=searched)
        assert back.replace(transforms=one.transforms) == one
        assert Transforms(**transforms | {"scale": tuple(transforms["scale"])}) == one.transforms


@pytest.mark.parametrize("count", [7, 10, 33, 1000])
@pytest.mark.parametrize("split", [(0.8, 0.1, 0.1), (1.0, 0.0, 0.0), (0.34, 0.33, 0.33), (0.0, 0.5, 0.5)])
def test_splits_have_their_shares(count, split):
    counts = maps_by_split(DatasetSpec(maps=count, split=split, size=5))
    assert sum(counts) == count
    assert all(abs(got - count * share) <= 1 for got, share in zip(counts, split, strict=True))


def test_a_single_map_is_one_split():
    assert maps_by_split(DatasetSpec(maps=1, split=(0, 0, 1), size=5)) == (0, 0, 1)


def test_sizes_share_the_maps():
    assert maps_by_shape(DatasetSpec(maps=10, size="3..6")) == {(3, 3): 3, (4, 4): 3, (5, 5): 2, (6, 6): 2}
    assert maps_by_shape(DatasetSpec(maps=10, size="3..4 6..7")) == {(3, 6): 3, (3, 7): 3, (4, 6): 2, (4, 7): 2}
