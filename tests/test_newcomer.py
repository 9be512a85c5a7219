"""The first lines that one would try in each room: results, maps and paths are taken wherever they make sense."""

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import Result, drive, evolve, explorer, plots, read_map, render, tiles

TOWN = [[6, 7, 3], [12, 13, 9]]


@pytest.fixture(scope="module")
def result() -> Result:
    return evolve(0, (6, 6), seeds=2, style="town", evaluations=2000)  # a program that other tests have compiled


@pytest.mark.parametrize("name", ["RoadNav", "LaneDrive"])
def test_environments_are_made_by_name(result, name):
    environment, params = drive.make(name, result.maps(2), count=4, limit=7)
    assert params.levels.grid.shape == (4, 6, 6) and params.limit == 7
    observation, state = environment.reset(jax.random.key(0), params)
    assert observation is not None and state is not None
    _, same = drive.make(name, np.stack([one.codes for one in result.maps(2)]), count=4, limit=7)
    jax.tree.map(np.testing.assert_array_equal, same, params)


def test_robots_that_share_towns_are_made_by_name(result):
    environment, params = drive.make("RoadTraffic", result.maps(2), robots=3)
    assert params.levels.grid.shape == (2, 6, 6)
    observation, state = environment.reset(jax.random.key(0), params)
    assert observation.allowed.shape == (3, 4) and state.lane.shape == (3,)


@pytest.mark.parametrize(
    ("name", "options", "subject", "got", "expected"),
    [
        ("Maze", {}, "name", "'Maze'", ""),
        ("RoadNav", {"seed": -1}, "seed", "-1", ""),
        ("RoadNav", {"limit": 0}, "limit", "0", ""),
        ("RoadTraffic", {"seed": 3}, "seed", "3", "None"),
        ("RoadTraffic", {"robots": 99}, "robots", "99", "at most 14"),
    ],
)
def test_bad_environments_are_refused(name, options, subject, got, expected):
    with refused(subject, got, expected):
        drive.make(name, [TOWN], **options)


def test_a_map_is_driven_on_as_it_is(result):
    (road_map,) = result.maps(1)
    rides = drive.make_rides(road_map, 1, seconds=1)
    np.testing.assert_array_equal(rides.levels.grid[0], drive.make_rides(road_map.codes, 1, seconds=1).levels.grid[0])


def test_a_map_saves_itself(result, tmp_path):
    (road_map,) = result.maps(1)
    road_map.save(str(tmp_path / "map.json"))
    assert (tmp_path / "map.json").read_text() == road_map.to_json()
    assert read_map(tmp_path / "map.json").fitness == road_map.fitness


def test_pictures_are_written_by_paths_as_texts(tmp_path):
    picture = render(TOWN)
    tiles.write_png(str(tmp_path / "town.png"), picture.image)
    picture.save(str(tmp_path / "town"))
    assert (tmp_path / "town.png").read_bytes() == (tmp_path / "town/image.png").read_bytes()


def test_results_and_maps_are_explored(result, tmp_path):
    for number, what in enumerate((result, result.maps(2), result.maps(1)[0])):
        page = tmp_path / f"{number}.html"
        assert explorer.explore(what, str(page)) == page.stat().st_size


def test_results_are_plotted(result):
    (road_map,) = result.maps(1)
    drawn = plots.road_map(road_map), plots.road_map(road_map.codes)
    assert drawn[0].get_xlim() == drawn[1].get_xlim()
    shown, usual = plots.archive_map(result), plots.archive_map(result.elites.fitness, result.search.axes)
    np.testing.assert_array_equal(shown.images[0].get_array(), usual.images[0].get_array())
    shown, usual = plots.history(result), plots.history(result.history)
    np.testing.assert_array_equal(shown.lines[0].get_ydata(), usual.lines[0].get_ydata())
    with refused("axes", "none", expected="axes"):
        plots.archive_map(result.elites.fitness)
