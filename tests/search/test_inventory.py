"""Maps that a shelf of tiles suffices for: the tiles are ranges of features, and every map says what it leaves."""

import json

import jax
import numpy as np
import pytest
from certified import evolve

from elitelanes_jax import GenerateSpec, SearchSpec, generate
from elitelanes_jax.network.codes import KIND_OF
from elitelanes_jax.problem.inventory import COUNTED, parse_inventory
from elitelanes_jax.search.resolve import plain_spec, resolve, search_from_plain, spec_from_plain

SHELF = {"straight": 20, "turn": 10, "crossing3": 4, "crossing4": 0}


def tiles_of(grid):
    kinds = [KIND_OF[code] for code in np.ravel(grid).tolist()]
    return {kind: kinds.count(kind) for kind in COUNTED}


@pytest.mark.parametrize(
    "given",
    [
        "straight=20 turn=10 crossing3=4",
        ["crossing3 = 4", "straight=20", "turn=10"],
        {"straight": 20, "turn": np.int64(10), "crossing3": 4},
        SHELF.items(),
        "straight=20 turn=10\ncrossing3=4 crossing4=0",
    ],
)
def test_an_inventory_can_be_written_in_many_ways(given, tmp_path):
    assert parse_inventory(given) == tuple(SHELF.items())
    (tmp_path / "shelf.toml").write_text("straight = 20\nturn = 10\ncrossing3 = 4\n")
    assert parse_inventory(tmp_path / "shelf.toml") == parse_inventory([str(tmp_path / "shelf.toml")])
    assert parse_inventory((str(tmp_path / "shelf.toml"),)) == tuple(SHELF.items())
    assert parse_inventory(tmp_path / "shelf.toml") == tuple(SHELF.items())


def ranges_of(spec, shape=(6, 6)):
    return {item.name: (item.low, item.high) for item in resolve(spec, shape, room_for="anything").ranges}


def test_an_inventory_narrows_the_ranges_and_leaves_cells_empty():
    spec = SearchSpec(style="town", inventory=SHELF, where=["turns=6..20", "straights=3..8"])
    limits = ranges_of(spec)
    assert limits["turns"] == (6, 10) and limits["straights"] == (3, 8) and limits["crossings4"] == (None, 0)
    assert not resolve(SearchSpec(inventory=SHELF), (6, 6)).fills
    without = SearchSpec(style="town", where=["turns=6..20", "straights=3..8"])
    assert ranges_of(spec.replace(inventory=None)) == ranges_of(without)
    search = resolve(spec, (6, 6), room_for="anything")
    read = search_from_plain(json.loads(json.dumps(search.to_plain())), (6, 6))
    assert read == search == resolve(search.to_spec(), (6, 6), room_for="anything")
    for other in (spec_from_plain(json.loads(json.dumps(plain_spec(spec)))), read.to_spec()):
        assert ranges_of(other) == limits
        assert ranges_of(other.replace(inventory={"turn": 15}))["turns"] == (6, 15)
        assert "crossings4" not in ranges_of(other.replace(inventory=None))
    equal = SearchSpec(inventory=SHELF, where=["crossings=..5", f"turns=..{SHELF['turn']}"])
    for other in (spec_from_plain(plain_spec(equal)), resolve(equal, (8, 8)).to_spec()):
        assert ranges_of(other, (8, 8)) == ranges_of(equal, (8, 8))
        assert [*ranges_of(other.replace(inventory=None), (8, 8))] == ["crossings", "turns"]
    like = SearchSpec(like=[[6, 5, 3], [10, 0, 10], [12, 5, 9]], inventory=SHELF)
    assert {"turn_share", "turns"} <= set(ranges_of(like))


def test_searches_without_these_counts_measure_nothing_more():
    """The program of a search depends on its static fields: a crossing is counted only in searches that name it."""
    assert resolve(SearchSpec(), (5, 5)).measured == ()
    assert set(resolve(SearchSpec(inventory=SHELF), (5, 5)).measured) == {"crossings3", "crossings4"}
    named = resolve(SearchSpec(weights="crossings4=-9", axes="crossings3:4"), (5, 5))
    assert named.measured == ("crossings3", "crossings4")


def test_maps_need_what_the_shelf_has(tmp_path):
    shelf = {"straight": 8, "turn": 8, "crossing3": 2}
    spec = GenerateSpec(
        size=(5, 5), maps=3, seeds=2, tile_px=16, search=SearchSpec(inventory=shelf, method="ea", generations=60)
    )
    for place, road_map in enumerate(generate(spec, tmp_path / "out")):
        used = tiles_of(road_map.codes)
        metrics = json.loads((tmp_path / "out" / "maps" / f"{place:04d}" / "map.json").read_text())["metrics"]
        for kind, name in COUNTED.items():
            assert metrics[name] == used[kind] and metrics[f"{name}_left"] == shelf.get(kind, 0) - used[kind] >= 0


@pytest.mark.slow
@pytest.mark.parametrize("size", [5, 6, 8, 10])
@pytest.mark.parametrize("style", ["town", None])
def test_a_map_for_every_shelf(size, style):
    """The shelf has the tiles of a drawn town, no more: 200 shelves together, other ones for each search."""
    key = size if style else 100 + size
    # Most small towns are rings.
    drawn = evolve(key, (size, size), seeds=8, style="town", where="crossings=0..").maps(25)
    assert len(drawn) == 25
    for index, town in enumerate(drawn):
        shelf, budget, maps = tiles_of(town.codes), 12_500, []
        while not maps and budget < 200_000:
            budget *= 2
            result = evolve(
                jax.random.split(jax.random.key(index), 1),
                (size, size),
                style=style,
                inventory=shelf,
                evaluations=budget,
            )
            maps = result.choose(1000).maps
        assert maps, shelf
        for road_map in maps:
            assert all(count <= shelf[kind] for kind, count in tiles_of(road_map.codes).items())
