"""A result writes what `generate` writes, and a map draws itself."""

from xml.etree import ElementTree

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import NotEnoughMapsError, Result, RoadMap, evolve, read_map, write_result
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats.sketch import draw_svg

OPTIONS = {"method": "ea", "preset": "paper", "generations": 30}


@pytest.mark.parametrize("key", [0, pytest.param(jax.random.key(0), marks=pytest.mark.slow)])
def test_a_result_writes_what_generate_writes(key, tmp_path):
    result = evolve(key, (5, 6), **OPTIONS)
    maps = write_result(result, str(tmp_path / "out"), 1, tile_px=16)
    names = {str(file.relative_to(tmp_path / "out")) for file in (tmp_path / "out").rglob("*") if file.is_file()}
    line = "generate --size 5 6 --maps 1 --method ea --preset paper --generations 30 --tile-px 16 --quiet --out"
    assert main([*line.split(), str(tmp_path / "same")]) == 0
    assert names == {str(one.relative_to(tmp_path / "same")) for one in (tmp_path / "same").rglob("*") if one.is_file()}
    assert read_map(tmp_path / "out/maps/0000/map.json").codes.tolist() == maps[0].codes.tolist()
    np.testing.assert_array_equal(Result.load(tmp_path / "out/archive.npz").elites.fitness, result.elites.fitness)
    for command in (
        ["explore", "out", "--out", "page.html"],
        ["pick", "out/archive.npz", "--maps", "1", "--out", "more"],
    ):
        given = [str(tmp_path / word) if word[:3] in ("out", "pag", "mor") else word for word in command]
        assert main([*given, *(["--quiet"] if command[0] == "pick" else [])]) == 0
    with refused(tmp_path / "out", "one with files in it"):
        write_result(result, tmp_path / "out", 1)
    write_result(result, tmp_path / "out", 1, force=True, tile_px=16)
    with pytest.raises(NotEnoughMapsError, match=r"; at_most=True writes those found; more seeds find more$"):
        write_result(result, tmp_path / "none", 10_000)
    with pytest.raises(
        NotEnoughMapsError, match=r"; a wider range than crossings=20\.\., more seeds or evaluations find more$"
    ):
        write_result(result, tmp_path / "none", 10_000, where="crossings=20..")
    with refused("tile", "'tile'", hint="tiles"):
        write_result(result, tmp_path / "none", maps=1, tile=1)
    with refused("path", "town.json", expected=".npz"):
        result.save("town.json")
    with refused("tile_px", "1"):
        write_result(result, tmp_path / "none", 1, tile_px=1)
    assert not (tmp_path / "none").exists()


def test_the_results_of_an_optimizer_of_ones_own_are_written(tmp_path):
    from elitelanes_jax import ea

    result = evolve(0, (5, 6), seeds=2, optimizer=ea, evaluations=3_000)
    assert len(write_result(result, tmp_path / "out", 1, tile_px=16)) == 1


def test_a_map_draws_itself():
    codes = np.array([[6, 7, 3], [12, 13, 9]])
    drawn = ElementTree.fromstring(RoadMap(codes).to_svg())
    assert RoadMap(codes)._repr_svg_() == RoadMap(codes).to_svg()
    assert drawn.get("viewBox") == "0 0 3 2"
    ground, road, line = (path.get("d") for path in drawn)
    assert ground == "M0 0h3v2H0z" and road == line
    assert road.count("M") == sum(int(code).bit_count() for code in codes.ravel())
    assert "M0.5 0.5l0.5 0" in road and "M0.5 0.5l0 0.5" in road and "M0.5 0.5l0 -0.5" not in road
    assert draw_svg(np.zeros((1, 4), int)).count("M0.5") == 0
    with refused("grid", "16 at A1 ([0, 0])"):
        draw_svg([[16]])
