"""Searches that begin with given maps."""

import json

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import SearchSpec, evolve, repair, road_problem
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.problem.descriptor import paper_axes

# Two loops side by side, by Duckietown's rules; fill would put roads into the middle of both.
TOWN = np.array([[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]], np.int8)
KEYS = jax.random.split(jax.random.key(5), 2)
EA = {"method": "ea", "preset": "paper", "rules": "duckietown"}


def holds(elites, grid):
    """For each seed, whether the grid is among the elites."""
    alike = (np.asarray(elites.grids) == np.asarray(grid)).all(axis=(-2, -1))
    return (alike & np.asarray(elites.valid)).any(axis=-1)


def test_arrays_of_grids_are_taken_as_they_are():
    one = np.asarray(TOWN)
    assert SearchSpec(initial=one) == SearchSpec(initial=one[None]) == SearchSpec(initial=[one])


def test_given_grids_stand_first_and_are_repaired():
    broken = np.where(TOWN == 13, 9, TOWN).astype(np.int8)  # the crossing at the bottom no longer leads to the east
    plain = road_problem(TOWN.shape, paper_axes(TOWN.shape)).random(KEYS[0], 5)
    for fill in (False, True):
        problem = road_problem(TOWN.shape, paper_axes(TOWN.shape), fill=fill, initial=np.array([TOWN, broken]))
        made = problem.random(KEYS[0], 5)
        assert made.dtype == np.int8
        np.testing.assert_array_equal(made[0], repair(TOWN, fill=fill))
        np.testing.assert_array_equal(made[1], repair(broken, fill=fill))
        if not fill:
            np.testing.assert_array_equal(made[0], TOWN)
            np.testing.assert_array_equal(made[2:], plain[2:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "preset"),
    [(method, "tuned") for method in ("map-elites", "ea", "pso", "gwo")]
    + [("map-elites", "paper"), ("ea", "paper"), ("gwo", "paper")],
)
def test_every_method_begins_with_them(method, preset):
    settings = {"method": method, "preset": preset, "generations": 0, "rules": "duckietown"}
    result = evolve(KEYS, TOWN.shape, initial=[TOWN, TOWN[::-1, ::-1]], **settings)
    assert holds(result.elites, TOWN).all()
    assert not holds(evolve(KEYS, TOWN.shape, **settings).elites, TOWN).any()


def test_such_a_run_continues_as_any_other():
    whole = evolve(KEYS, TOWN.shape, generations=20, initial=[TOWN], **EA)
    half = evolve(KEYS, TOWN.shape, generations=10, initial=[TOWN], **EA)
    rest = evolve(KEYS, TOWN.shape, generations=10, initial=[TOWN], state=half.state, **EA)
    jax.tree.map(np.testing.assert_array_equal, rest.elites, whole.elites)
    assert holds(half.elites, TOWN).all()
    with refused("state", "one of a run with another key, other options or functions", expected="this run"):
        evolve(KEYS, TOWN.shape, generations=10, state=half.state, **EA)


@pytest.mark.parametrize(
    ("settings", "subject", "got", "expected"),
    [
        ({"initial": [TOWN[:3]]}, "initial", "one of 3 x 5", "4 x 5"),
        ({"initial": [TOWN] * 21}, "initial", "21", "at most 20"),
        ({"initial": [TOWN + 9]}, "initial: map 0: grid", "16 at C1 ([0, 2])", ""),
        ({"initial": 6}, "initial", "6", "files of maps"),
        ({"initial": [TOWN], "method": "pso"}, "initial", "1 grid", "PSO"),
    ],
)
def test_a_run_refuses_grids_that_it_cannot_begin_with(settings, subject, got, expected):
    with refused(subject, got, expected):
        evolve(KEYS, TOWN.shape, generations=1, **EA | settings)


def test_a_town_of_others_is_where_generate_begins(tmp_path):
    (tmp_path / "town.yaml").write_text(to_duckietown(TOWN))
    command = ["generate", "--size", "4", "5", "--maps", "1", "--seeds", "2", "--generations", "2", "--tile-px", "16"]
    command += ["--method", "ea", "--preset", "paper"]
    command += ["--rules", "duckietown", "--from", str(tmp_path / "town.yaml"), "--out", str(tmp_path / "out")]
    assert main(command) == 0
    archive = np.load(tmp_path / "out" / "archive.npz")
    assert (archive["grids"] == TOWN).all(axis=(-2, -1)).any()
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["settings"]["search"]["initial"] == [TOWN.tolist()]
