"""A command merges a search once, and resolves and checks it once for each size; all else follows from the result."""

from dataclasses import replace

import pytest
from refusals import refused

from elitelanes_jax import SearchSpec
from elitelanes_jax.cli.main import main
from elitelanes_jax.maps import planning
from elitelanes_jax.problem.ranges import parse_ranges
from elitelanes_jax.search import evolution, spec
from elitelanes_jax.search import resolve as module
from elitelanes_jax.search.resolve import has_other_alphabet, resolve, with_ranges

SEARCH = "--method ea --preset paper --generations 2 --seeds 2 --at-most --quiet"


@pytest.fixture
def counted(monkeypatch):
    """The calls that merge the options of a search, that resolve it, and that check it."""
    calls = {"merge_layers": 0, "resolve": 0, "_check_choices": 0, "_check_shape": 0, "_check_constraints": 0}

    def counting(name, function):
        def call(*arguments, **named):
            calls[name] += 1
            return function(*arguments, **named)

        return call

    for name in ("_check_choices", "_check_shape", "_check_constraints"):
        monkeypatch.setattr(module, name, counting(name, getattr(module, name)))
    monkeypatch.setattr(spec, "merge_layers", counting("merge_layers", spec.merge_layers))
    counted_resolve = counting("resolve", module.resolve)
    for user in (module, planning, evolution):
        monkeypatch.setattr(user, "resolve", counted_resolve)
    return calls


@pytest.mark.parametrize(
    ("line", "sizes"),
    [
        (f"generate --size 5 6 --maps 1 {SEARCH} --style paper --out OUT", 1),
        (
            "dataset --size 4..5 --maps 4 --split 1 0 0 --preset paper --evaluations 2000 --tile-px 16"
            " --quiet --out OUT",
            2,
        ),
    ],
)
def test_a_command_merges_once_and_resolves_and_checks_each_size_once(line, sizes, counted, tmp_path):
    assert main(line.replace("OUT", str(tmp_path / "out")).split()) == 0
    assert counted.pop("merge_layers") == 1
    assert set(counted.values()) == {sizes}


def test_parts_are_resolved_once_and_joined_once(counted, tmp_path):
    for part in (1, 2):
        out = str(tmp_path / str(part))
        assert main(f"generate --size 5 6 --maps 1 {SEARCH} --part {part}/2 --out {out}".split()) == 0
    assert set(counted.values()) == {2}
    line = f"merge {tmp_path / '1'} {tmp_path / '2'} --quiet --out {tmp_path / 'both'}"
    assert main(line.split()) == 0
    assert set(counted.values()) == {3}


def test_evolve_resolves_once(counted):
    evolution.evolve(0, (4, 5), seeds=1, method="ea", preset="paper", generations=1, where="turns=1..")
    assert set(counted.values()) == {1}


def test_a_search_draws_from_the_alphabet_of_the_tiles_unless_the_user_names_one():
    turns = (3, 5, 6, 9, 10, 12)
    assert resolve(SearchSpec(), (5, 5), turns).alphabet == turns
    assert resolve(SearchSpec(alphabet=[3, 6, 9, 12]), (5, 5), turns).alphabet == (3, 6, 9, 12)


def test_more_ranges_leave_the_niches_of_the_elites():
    """A file may have other axes than its preset has in this version."""
    search = resolve(SearchSpec(where="turns=1.. tiles=2.."), (6, 6))
    search = replace(search, axes=search.axes[:1])
    ranged = with_ranges(search, parse_ranges("turns=3.. bridges=0"))
    assert ranged.axes == search.axes
    assert list(map(str, ranged.ranges)) == ["turns=3..", "tiles=2..", "bridges=0"]


def test_room_for_maps_is_less_than_room_for_grids():
    spec = SearchSpec(where="cyclomatic=0", rules="duckietown")
    resolve(spec, (5, 5))
    with refused("where cyclomatic", "cyclomatic=0"):
        resolve(spec, (5, 5), room_for="maps")


def test_searches_on_other_shapes_differ_in_more_than_the_alphabet():
    """`merge` blames the tile set for an archive of a search with another alphabet alone."""
    search = resolve(SearchSpec(), (6, 6))
    turns = resolve(SearchSpec(), (6, 6), alphabet=(0, 3, 5, 6, 9, 10, 12))
    assert has_other_alphabet(search, turns)
    assert not has_other_alphabet(search, search)
    assert not has_other_alphabet(search, resolve(SearchSpec(), (7, 7)))
    assert not has_other_alphabet(turns, resolve(SearchSpec(method="ea"), (6, 6)))
