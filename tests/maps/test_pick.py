"""Choosing maps from archives of earlier searches."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax import PickSpec, Result, SearchSpec, evolve, measure, read_map, write_result
from elitelanes_jax import pick as pick_maps
from elitelanes_jax.cli.main import main
from elitelanes_jax.maps.picking import _resolve_choice, _Source
from elitelanes_jax.network import canonical_form
from elitelanes_jax.search.resolve import resolve
from elitelanes_jax.tiles.tileset import default_tiles

SMALL = ["--size", "5", "6", "--maps", "6", "--generations", "5", "--tile-px", "16", "--quiet"]
SMALL += ["--method", "ea", "--preset", "paper"]


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """Folders of two searches with other seeds; of the second also an archive with fewer runs and elites."""
    folder = tmp_path_factory.mktemp("searched")
    assert main(["generate", *SMALL, "--seeds", "3", "--out", str(folder / "one")]) == 0
    assert main(["generate", *SMALL, "--seeds", "3", "--seed", "7", "--out", str(folder / "two")]) == 0
    with np.load(folder / "two" / "archive.npz") as stored:
        fewer = {name: array[:2, :15] if array.ndim > 1 else array for name, array in stored.items()}
    np.savez(folder / "two" / "fewer.npz", **fewer)
    return folder


def pick(*arguments, out):
    return main(["pick", *map(str, arguments), "--tile-px", "16", "--out", str(out)])


def maps(folder):
    return [read_map(file) for file in sorted(folder.glob("maps/*/map.json"))]


def test_the_same_number_of_maps_is_the_same_choice(searched, tmp_path):
    assert pick(searched / "one" / "archive.npz", "--maps", 6, out=tmp_path / "out") == 0
    chosen, written = (
        {file.relative_to(folder): file.read_bytes() for file in folder.glob("maps/*/*")}
        for folder in (tmp_path / "out", searched / "one")
    )
    assert chosen == written
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["elites"] == json.loads((searched / "one" / "run.json").read_text())["elites"]
    assert [archive["file"] for archive in run["archives"]] == [str(searched / "one" / "archive.npz")]


def test_more_maps_of_several_searches_in_ranges_unlike_others(searched, tmp_path):
    files = [searched / "one" / "archive.npz", searched / "two" / "fewer.npz"]
    known = sorted(searched.glob("one/maps/*/map.json"))
    out = tmp_path / "out"
    assert pick(*files, "--maps", 9, "--where", "bridges=0", "cyclomatic=5..", "--unlike", *known, out=out) == 0
    chosen = maps(out)
    assert len(chosen) == 9
    forms = [canonical_form(road_map.codes) for road_map in (*chosen, *map(read_map, known))]
    assert len(set(forms)) == 15
    archives = [Result.load(file) for file in files]
    assert [archive.elites.valid.shape for archive in archives] == [(3, 20), (2, 15)]
    assert {road_map.seed[0] for road_map in chosen} == {0, 7}
    for road_map in chosen:
        metrics = measure(road_map.codes)
        assert (metrics.components, metrics.dead_ends, metrics.bridges) == (1, 0, 0)
        assert metrics.cyclomatic >= 5
        assert road_map.metrics == {name: value.item() for name, value in metrics._asdict().items()}
        archive = archives[[0, 7].index(road_map.seed[0])]
        assert (archive.elites.grids[road_map.seed[1]] == road_map.codes).all(axis=(1, 2)).any()


def test_other_axes_spread_the_maps_otherwise(searched, tmp_path):
    assert pick(searched / "one" / "archive.npz", "--maps", 4, "--axes", "turns:30:1", out=tmp_path / "out") == 0
    chosen = maps(tmp_path / "out")
    assert [road_map.descriptor for road_map in chosen] == [{"turns": road_map.metrics["turns"]} for road_map in chosen]
    assert len({tuple(road_map.niche) for road_map in chosen}) == 4


def test_an_archive_may_have_tiles_that_the_first_one_lacks(tmp_path):
    files = [tmp_path / f"{name}.npz" for name in ("rings", "crossings")]
    for file, alphabet in zip(files, ([3, 5, 6, 9, 10, 12], None), strict=True):
        result = evolve(0, (4, 4), seeds=1, generations=40, method="map-elites", preset="paper", alphabet=alphabet)
        result.save(file, seed=0)
    assert pick(*files, "--where", "crossings=1..", "--maps", 1, "--at-most", out=tmp_path / "out") == 0
    assert all(road_map.metrics["crossings"] for road_map in maps(tmp_path / "out"))


def test_maps_of_all_archives_keep_the_fixed_cells_of_the_first(searched, tmp_path):
    first, other = tmp_path / "fixed.npz", searched / "one" / "archive.npz"
    elsewhere = Result.load(other).with_seed_axis()
    fix: list[list[int | None]] = [[None] * 6 for _ in range(5)]
    fix[2][2] = code = int(elsewhere.choose(1).maps[0].codes[2, 2])
    result = evolve(0, (5, 6), seeds=1, generations=40, method="ea", preset="paper", fix=fix)
    result.save(first, seed=5)
    joined = pick_maps(PickSpec(maps=90, at_most=True, tile_px=16), [first, other], tmp_path / "out")
    assert {road_map.seed[0] for road_map in joined} == {0, 5}
    assert all(road_map.codes[2, 2] == code for road_map in joined)
    broken = elsewhere.elites.grids[:, :, 2, 2] != code
    flawless, reasons = replace(elsewhere, search=result.search).without_flaws()
    assert broken.any() and not (flawless & broken).any()
    assert reasons["with other codes in fixed cells"] == (broken & elsewhere.without_flaws()[0]).sum()
    # The search of the first archive counts, and the other one has no fixed cells.
    assert len(pick_maps(PickSpec(maps=6, tile_px=16), [other, first], tmp_path / "free")) == 6


def test_maps_have_the_tiles_of_the_search(tmp_path):
    """The tile set has four-way crossings, but the search has none."""
    result = evolve(2, (5, 5), seeds=4, evaluations=4000, preset="paper", alphabet=[3, 5, 6, 7, 9, 10, 11, 12, 13, 14])
    assert (result.elites.grids[result.satisfies()] == 15).any()
    expected = [road_map.codes.tolist() for road_map in result.maps(20)]
    assert len(expected) == 20 and not any(15 in np.ravel(codes) for codes in expected)
    written = write_result(result, tmp_path / "written", 20, tile_px=16)
    picked = pick_maps(PickSpec(maps=20, tile_px=16), tmp_path / "written" / "archive.npz", tmp_path / "picked")
    for chosen in (written, picked):
        assert [road_map.codes.tolist() for road_map in chosen] == expected
        assert not any(road_map.metrics["off_alphabet"] for road_map in chosen)


def test_no_map_is_an_example_of_any_archive(searched, tmp_path):
    plain, like = searched / "one" / "archive.npz", tmp_path / "like.npz"
    example = Result.load(plain).choose(1).maps[0].codes
    evolve(0, (5, 6), seeds=1, generations=5, method="ea", preset="paper", like=[example]).save(like, seed=5)
    for archives, found in (([plain], True), ([plain, like], False)):
        picked = pick_maps(PickSpec(maps=90, at_most=True, tile_px=16), archives, tmp_path / str(found))
        forms = {canonical_form(road_map.codes) for road_map in picked}
        assert (canonical_form(example) in forms) == found


def test_only_maps_that_the_tiles_can_draw_are_picked(searched, tmp_path):
    """From a search whose tiles had crossings, with a set that has no four-way one."""
    tiles = tmp_path / "tiles"
    shutil.copytree(default_tiles(), tiles, ignore=shutil.ignore_patterns("crossing4*"))
    archive = searched / "one" / "archive.npz"
    assert (Result.load(archive).elites.grids == 15).any()
    assert pick(archive, "--maps", 3, "--at-most", "--tiles", tiles, out=tmp_path / "out") == 0
    assert maps(tmp_path / "out") and not any((road_map.codes == 15).any() for road_map in maps(tmp_path / "out"))


def test_ranges_of_ones_own_replace_those_of_the_search(searched):
    result = Result.load(searched / "one" / "archive.npz")
    spec = result.search.to_spec().replace(where="turns=4.. crossings=2..")
    sources = [_Source("result", replace(result, search=resolve(spec, (5, 6))), None)]
    ranges = _resolve_choice(PickSpec(where="crossings=1.. tiles=9.."), sources).ranges
    assert list(map(str, ranges)) == ["turns=4..", "crossings=1..", "tiles=9.."]


def test_axes_of_ones_own_replace_the_targets_of_the_search():
    search = resolve(SearchSpec(style="town"), (6, 6))
    sources = [_Source("result", SimpleNamespace(search=search), None)]
    town = search.settings
    assert _resolve_choice(PickSpec(), sources).settings.targets == town.targets != ()
    assert _resolve_choice(PickSpec(axes="turns:5"), sources).settings.targets == ()


def test_archives_of_maps_of_other_sizes_are_refused(searched, tmp_path, capsys):
    with np.load(searched / "one" / "archive.npz") as stored:
        arrays = dict(stored)
    arrays["grids"] = np.pad(arrays["grids"], [(0, 0), (0, 0), (0, 1), (0, 0)])
    arrays["metrics.empty_cells"] += arrays["grids"].shape[-1]
    arrays["metrics.coverage"] = (arrays["metrics.tiles"] / arrays["grids"][0, 0].size).astype(np.float32)
    np.savez(tmp_path / "taller.npz", **arrays)
    assert pick(searched / "one" / "archive.npz", tmp_path / "taller.npz", out=tmp_path / "out") == 2
    assert "taller.npz: expected maps of 5 x 6, as in the first archive, got 6 x 6" in capsys.readouterr().err


@pytest.mark.slow
def test_features_of_ones_own_come_along_and_choose(tmp_path, capsys):
    def corner(grid):
        return (grid[0] > 0).sum(dtype=jnp.int32)

    keys, kind = jax.random.split(jax.random.key(0), 2), {"method": "ea", "preset": "paper", "generations": 3}
    evolve(keys, (5, 6), features={"corner": corner}, weights={"corner": 3}, **kind).save(tmp_path / "own.npz", seed=0)
    evolve(keys, (5, 6), **kind).save(tmp_path / "plain.npz", seed=0)
    own, plain = tmp_path / "own.npz", tmp_path / "plain.npz"
    assert pick(own, "--maps", 2, "--axes", "corner:7:1", "--where", "corner=3..", out=tmp_path / "a") == 0
    for road_map in maps(tmp_path / "a"):
        assert road_map.metrics["corner"] == (road_map.codes[0] > 0).sum() >= 3
        assert road_map.descriptor == {"corner": road_map.metrics["corner"]}
    assert pick(own, plain, "--maps", 2, out=tmp_path / "b") == 0
    assert all("corner" not in road_map.metrics for road_map in maps(tmp_path / "b"))
    capsys.readouterr()
    assert pick(own, plain, "--maps", 2, "--where", "corner=3..", out=tmp_path / "c") == 2
    assert "plain.npz: expected features that the search has measured, got corner" in capsys.readouterr().err
    assert pick(own, "--maps", 2, "--where", "corners=3..", out=tmp_path / "c") == 2
    assert "is it corner?" in capsys.readouterr().err and not (tmp_path / "c").exists()


@pytest.mark.parametrize("seeds", [None, 2])
def test_results_that_were_saved_are_picked_from(seeds, tmp_path):
    key = jax.random.key(0) if seeds is None else 0
    result = evolve(key, (5, 6), seeds=seeds, method="ea", preset="paper", generations=60)
    file = tmp_path / "own.npz"
    result.save(file)
    for number, archives in enumerate((str(file), [file], (str(file),))):
        found = pick_maps(PickSpec(maps=1, tile_px=16), archives, str(tmp_path / str(number)))
        assert [one.seed for one in found] == [None]
        assert [one.codes.tolist() for one in found] == [one.codes.tolist() for one in result.maps(1)]
