"""No writer of maps writes the same roads twice, and no two splits have maps that are alike."""

import csv
import json
from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import oracle
import pytest

from elitelanes_jax import DatasetSpec, Result, RoadMap, SearchSpec, make_dataset, mirror, rotate, write_result
from elitelanes_jax.dataset import _plan
from elitelanes_jax.maps import GenerateSpec, PackSpec, PickSpec, generate, generation, merge, pack, pick
from elitelanes_jax.maps.given import parse_given
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network import measure, wfc
from elitelanes_jax.network.likeness import ALIKE
from elitelanes_jax.network.metrics import stack_metrics
from elitelanes_jax.network.plain_metrics import cut_to_roads
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.network.symmetry import canonical_form
from elitelanes_jax.optimizers.presets import PRESETS
from elitelanes_jax.problem.descriptor import compute_descriptor
from elitelanes_jax.search import History, MeasuredElites
from elitelanes_jax.search.records import RunState
from elitelanes_jax.search.resolve import resolve

SEARCH = SearchSpec(fill=False, evaluations=2000)


def networks(count, side, seed):
    """Returns connected networks, filled."""
    grids = wfc.generate_batch(np.random.default_rng(seed), 4 * count, (side, side), border="closed").grid
    grids = [np.asarray(grid, np.int8) for grid in grids]
    return [grid for grid in grids if measure(grid).components == 1][:count]


def copies(grid, shape, rng):
    """Yields a network at random positions in `shape`, rotated and mirrored, the last two with a link less or more."""
    for number in range(5):
        image = np.asarray(rotate(mirror(grid) if rng.integers(2) else grid, int(rng.integers(4))))
        if number > 2:
            image = with_other_link(image, rng)
        rooms = (height - side for height, side in zip(shape, image.shape, strict=True))
        starts = [int(rng.integers(room + 1)) for room in rooms]
        yield np.pad(image, [(start, side - start - len(image)) for start, side in zip(starts, shape, strict=True)])


def with_other_link(grid, rng):
    """Returns a network that differs in one link."""
    cells = list(np.ndindex(grid.shape[0], grid.shape[1] - 1))
    for index in rng.permutation(len(cells)):
        row, column = cells[index]
        other = grid.copy()
        other[row, column] ^= 4
        other[row, column + 1] ^= 1
        metrics = measure(other)
        if metrics.components == 1 and not metrics.dead_ends:
            return other
    return grid


def make_result(shape, seed=0, seeds=2, count=4):
    """Returns a result in which each of `count` networks has moved copies, and copies that hardly differ."""
    rng = np.random.default_rng(seed)
    grids = [copy for grid in networks(count, 5, seed) for copy in copies(grid, shape, rng)]
    slots = len(grids) // seeds
    grids = jnp.asarray(rng.permutation(np.array(grids, np.int8))[: seeds * slots].reshape(seeds, slots, *shape))
    metrics = jax.jit(jax.vmap(jax.vmap(measure)))(grids)
    search = resolve(SEARCH, shape)
    elites = MeasuredElites(
        grids,
        jnp.zeros((seeds, slots), jnp.int32),
        compute_descriptor(stack_metrics(metrics), METRIC_NAMES, search.axes),
        jnp.ones((seeds, slots), bool),
        metrics,
        {},
    )
    state = RunState(np.int32(0), (), np.uint32(0))
    return Result(elites, History.empty(seeds), state, search, PRESETS[search.settings.method, search.settings.preset])


def check_apart(parts, *, given=False):
    """Checks maps by their split, `parts` has lists of grids: each pair by the oracle.

    The empty borders of given maps do not count.
    """
    grids = [(name, np.array(grid, np.int8)) for name, part in parts.items() for grid in part]
    if given:
        grids = [(name, cut_to_roads(grid)) for name, grid in grids]
    assert len(grids) > 1
    for (name, grid), (other_name, other) in combinations(grids, 2):
        difference = oracle.difference(grid, other)
        assert difference > 0
        assert name == other_name or difference >= ALIKE


def parts_of_dataset(folder):
    rows = {name: (folder / name / "metadata.jsonl").read_text().splitlines() for name in SPLITS}
    return {name: [json.loads(line)["codes"] for line in lines] for name, lines in rows.items()}


def parts_of_pack(folder):
    parts = {name: [] for name in SPLITS}
    with (folder / "maps.csv").open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            file = folder / "maps" / row["niche"] / f"{row['id']}.json"
            parts[row["split"]].append(json.loads(file.read_text())["codes"])
    return parts


@pytest.fixture
def evolving(monkeypatch):
    """Searches find what `make_result` returns, because a real search seldom finds so many copies."""

    def evolve_search(search, keys, *_, **__):
        seed = int(keys.data.sum()) % 1000
        return replace(make_result(search.shape, seed, len(keys.data)), search=search)

    for room in (_plan, generation):
        monkeypatch.setattr(room, "evolve_search", evolve_search)
        monkeypatch.setattr(room, "compile_search", lambda *_, **__: None, raising=False)


def test_maps_of_a_result(tmp_path):
    result = make_result((6, 7))
    with pytest.warns(UserWarning, match=r"^found \d+ of 1,000 maps among \d+ elites \(\d+ like another when moved, "):
        maps = result.maps(1000)
    check_apart({"all": [road_map.codes for road_map in maps]})
    picked = write_result(result, tmp_path / "picked", 10, tile_px=16)
    check_apart({"all": [road_map.codes for road_map in picked]})
    unlike = [np.pad(mirror(road_map.codes), 2) for road_map in picked]
    others = result.choose(1000, exclude=unlike).maps
    assert {canonical_form(road_map.codes, crop=True) for road_map in others}.isdisjoint(
        canonical_form(codes, crop=True) for codes in unlike
    )
    assert len(others) == len(maps) - 10


def test_generated_merged_and_picked_maps(evolving, tmp_path):
    spec = GenerateSpec(size=(6, 6), maps=8, seeds=2, tile_px=16, search=SEARCH)
    maps = generate(spec, tmp_path / "out")
    check_apart({"all": [road_map.codes for road_map in maps]})

    parts = []
    for index in (1, 2):
        parts.append(tmp_path / f"part-{index}")
        generate(spec.replace(part=(index, 2)), parts[-1])
    merged = merge(parts, tmp_path / "merged")
    check_apart({"all": [road_map.codes for road_map in merged]})

    archives = [part / "archive.npz" for part in parts]
    unlike = [mirror(np.pad(road_map.codes, 1)) for road_map in merged]
    picked = pick(PickSpec(maps=8, tile_px=16, unlike=unlike), archives, tmp_path / "picked")
    check_apart({"all": [*unlike, *(road_map.codes for road_map in picked)]})


def test_splits_of_a_dataset_of_several_sizes(evolving, tmp_path):
    """The networks of 6 x 6 are found again in 7 x 7 cells."""
    spec = DatasetSpec(size=(6, 7), maps=30, tile_px=16, transforms="none", search=SEARCH, split=(0.5, 0.25, 0.25))
    about = make_dataset(spec, tmp_path / "out")
    parts = parts_of_dataset(tmp_path / "out")
    check_apart(parts)
    assert sum(map(len, parts.values())) == 30
    assert about["pictures"] == {name: len(part) for name, part in parts.items()}


def given_maps():
    rng = np.random.default_rng(3)
    grids = [copy for grid in networks(9, 5, 1) for copy in copies(grid, (6, 8), rng)]
    grids += [np.pad(grid, 1) for grid in grids[::2]] + [np.pad(grid, 2) for grid in networks(9, 4, 2)]
    return [RoadMap(grid, niche=[number % 7]) for number, grid in enumerate(grids)]


def test_splits_of_given_maps(tmp_path):
    maps = given_maps()
    assert parse_given(maps).left_out >= 9 * 2
    spec = DatasetSpec(maps_from=maps, tile_px=16, transforms="none", split=(0.5, 0.25, 0.25))
    make_dataset(spec, tmp_path / "out")
    check_apart(parts_of_dataset(tmp_path / "out"), given=True)


def test_splits_of_a_pack(tmp_path):
    about = pack(PackSpec(split=(0.5, 0.25, 0.25), trips=1), given_maps(), tmp_path / "out")
    parts = parts_of_pack(tmp_path / "out")
    check_apart(parts, given=True)
    assert {name: counts["maps"] for name, counts in about["splits"].items()} == {
        name: len(part) for name, part in parts.items()
    }
    moved = [RoadMap(np.pad(mirror(one.codes), 1), niche=one.niche) for one in given_maps()]
    pack(PackSpec(split=(1, 0, 0), trips=1), moved, tmp_path / "moved")
    names = [{file.stem for file in (tmp_path / out / "maps").rglob("*.json")} for out in ("out", "moved")]
    assert names[0] == names[1], "an id is that of the roads"


@pytest.mark.slow
@pytest.mark.parametrize(("size", "maps"), [((6, 6), 100), ((6, 8), 200)])
def test_splits_of_small_towns(size, maps, tmp_path):
    """Small towns move in their grids, and towns of one size are found again in larger grids."""
    search = SearchSpec(style="town", evaluations=20_000)
    make_dataset(DatasetSpec(size=size, maps=maps, tile_px=16, search=search), tmp_path / "out")
    check_apart(parts_of_dataset(tmp_path / "out"))
