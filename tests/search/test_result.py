"""Results in files: what was saved is loaded, bit for bit, or refused in one line."""

import json
from dataclasses import replace
from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import evolve
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refused

from elitelanes_jax import InputError, Optimizer, Result, SearchSpec, ea
from elitelanes_jax._util.npz import npz_bytes, read_npz
from elitelanes_jax.optimizers import PRESETS, AnnealedGwoConfig, AnnealingConfig, EvolutionConfig, MapElitesConfig
from elitelanes_jax.optimizers.presets import config_from_plain, config_to_plain, find_preset
from elitelanes_jax.search.records import History, check_metrics
from elitelanes_jax.search.resolve import plain_spec, search_from_plain

SHAPE = (5, 6)
KEYS = jax.random.split(jax.random.key(3), 3)

search = partial(evolve, method="ea", preset="paper", fill=False)


@pytest.fixture(scope="module")
def result():
    return search(
        KEYS, SHAPE, generations=7, where=["bridges=0..", "straight_share=0.333333333.."], weights=["bridges=9"]
    )


def same(one, other):
    assert (one.search, one.config) == (other.search, other.config)
    for kept, first in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(kept, first)
        assert kept.dtype == first.dtype


def test_what_is_saved_is_loaded(result, tmp_path):
    result.save(tmp_path / "result.npz")
    kept = Result.load(tmp_path / "result.npz")
    same(kept, result)
    chex.assert_trees_all_equal_dtypes(kept.elites, result.elites)
    assert isinstance(kept.elites.grids, jax.Array)
    np.testing.assert_array_equal(kept.best(), result.best())
    with np.load(tmp_path / "result.npz") as stored:
        plain = json.loads(str(stored["settings"]))["search"]
        assert search_from_plain(plain, SHAPE) == result.search
    kept.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "result.npz").read_bytes()
    alone = search(KEYS[1], SHAPE, generations=0)
    alone.save(tmp_path / "alone.npz")
    same(Result.load(str(tmp_path / "alone.npz")), alone)


def test_without_the_state_equal_searches_give_equal_bytes(result, tmp_path):
    again = evolve(KEYS, SHAPE, spec=result.search.to_spec())
    for number, one in enumerate((result, again)):
        one.save(tmp_path / f"{number}.npz", state=False)
    assert (tmp_path / "0.npz").read_bytes() == (tmp_path / "1.npz").read_bytes()
    kept = Result.load(tmp_path / "0.npz")
    chex.assert_trees_all_equal(kept.elites, result.elites)
    assert np.isnan(kept.history.evaluations_per_second).all()
    with refused("state", "that of a result that was joined or saved without its state"):
        evolve(KEYS, SHAPE, spec=result.search.to_spec(), state=kept.state)


def counting(problem):
    """An optimiser whose states are dictionaries of arrays."""
    inner = ea(problem, EvolutionConfig(population=4, offspring=4))

    def init(key):
        return {"population": inner.init(key), "steps": jnp.zeros((), jnp.int8)}

    return Optimizer(init, lambda *_: None, lambda state: inner.elites(state["population"]), 4)


def test_a_state_of_ones_own_is_saved_and_one_with_keys_refused(tmp_path):
    arrays = evolve(KEYS, (3, 4), optimizer=counting, generations=0)
    arrays.save(tmp_path / "arrays.npz")
    same(Result.load(tmp_path / "arrays.npz"), arrays)
    with refused("state", "key<fry>"):
        replace(arrays, state=arrays.state._replace(inner=(KEYS,))).save(tmp_path / "keys.npz")
    assert [file.name for file in tmp_path.iterdir()] == ["arrays.npz"]


class Factory:
    """A factory that is an object."""

    def __call__(self, problem):
        return counting(problem)


CONFIGS = [*PRESETS.values(), MapElitesConfig(EvolutionConfig(tile_rate=0.3)), AnnealedGwoConfig(leaders=2)]


@pytest.mark.parametrize(
    ("made_by", "method", "preset"),
    [
        ({"method": "ea", "preset": "paper"}, "ea", "paper"),
        ({"config": MapElitesConfig()}, "map-elites", "paper"),
        ({"config": MapElitesConfig(parents="archive")}, "map-elites", "standard"),
        ({"config": EvolutionConfig(tile_rate=0.3)}, "ea", "custom"),
        ({"optimizer": counting}, "custom", "test_result.counting"),
        ({"optimizer": partial(partial(counting))}, "custom", "test_result.counting"),
        ({"optimizer": Factory(), "spec": SearchSpec(method="pso")}, "custom", "test_result.Factory"),
        ({"optimizer": lambda problem: counting(problem)}, "custom", "test_result.<lambda>"),
    ],
)
def test_a_result_says_what_made_it(made_by, method, preset, tmp_path, capsys):
    options = {"shape": (3, 4), "generations": 0, "progress": True}
    result = evolve(KEYS, **options, **made_by)
    assert (result.search.settings.method, result.search.settings.preset) == (method, preset)
    name = preset if method == "custom" else method
    assert repr(result).startswith(f"Result of {name}{'' if method == 'custom' else f', preset {preset}'}: 3 x 4 tiles")
    assert name in capsys.readouterr().err
    config = made_by.get("config", PRESETS.get((method, preset)))
    assert result.config == config and (str(config) in repr(result)) is (preset == "custom")
    result.save(tmp_path / "result.npz")
    kept = Result.load(tmp_path / "result.npz")
    same(kept, result)
    # It can be made again with what it says.
    again = evolve(KEYS, spec=kept.search.to_spec(), config=kept.config, optimizer=made_by.get("optimizer"), **options)
    same(again, result)
    if method == "custom":
        with refused("method", "'custom'"):
            evolve(KEYS, spec=kept.search.to_spec(), **options)
    elif preset == "custom":
        with refused("preset", "'custom'"):
            evolve(KEYS, spec=kept.search.to_spec(), **options)
        assert evolve(KEYS, spec=kept.search.to_spec(), preset="paper", **options).search.settings.preset == "paper"


@pytest.mark.parametrize("config", CONFIGS)
def test_configurations_are_plain_values(config):
    back = config_from_plain(json.loads(json.dumps(config_to_plain(config))))
    assert back == config and type(back) is type(config)
    preset = PRESETS[find_preset(back)]
    assert type(preset) is type(config) and (preset == config or config not in PRESETS.values())


WORDS = st.sampled_from(["", "\ud800", "custom", "paper", "town", "turns=3", "kind", "name"])
anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | WORDS,
    lambda items: st.lists(items, max_size=2) | st.dictionaries(WORDS, items, max_size=2),
)


@st.composite
def spoilt(draw, value):
    """A value of JSON with something else somewhere in it, missing or more."""
    if isinstance(value, dict | list) and value and draw(st.booleans()) | draw(st.booleans()):
        names = sorted(value) if isinstance(value, dict) else range(len(value))
        name = draw(st.sampled_from(names))
        copy = value.copy()
        if draw(st.integers(0, 9)):
            copy[name] = draw(spoilt(value[name]))
        else:
            del copy[name]
        return copy
    return {**value, "more": 1} if isinstance(value, dict) and draw(st.booleans()) else draw(anything)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    file = tmp_path_factory.mktemp("saved") / "result.npz"
    options = {"where": "turns=0..", "weights": "turns=2", "generations": 0, "rules": "duckietown"}
    evolve(KEYS, (3, 4), config=MapElitesConfig(EvolutionConfig(tile_rate=0.3)), **options).save(file)
    return file


@pytest.mark.usefixtures("any_types")
@given(st.data())
@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_a_file_says_it_is_read_or_refused(saved, data):
    about, arrays = read_npz(saved)
    wrong = data.draw(spoilt(about))
    file = saved.with_name("wrong.npz")
    file.write_bytes(npz_bytes(arrays, wrong))
    try:
        result = Result.load(file)
    except InputError as error:
        said = str(error)
        assert "\n" not in said and said.startswith(str(file))
    else:  # and then it says so again
        result.save(file)
        same(Result.load(file), result)


def changed(file, **changes):
    about, arrays = read_npz(file)
    for name, value in changes.items():
        target = about if name in about else arrays
        name = name if name in about else name.replace("__", ".")
        target.pop(name, None)
        if value is not None:
            target[name] = value
    return npz_bytes(arrays, about)


@pytest.mark.parametrize(
    ("changes", "got"),
    [
        (
            {"format": "elitelanes result, version 2"},
            "one of the format 'elitelanes result...version 1'",
        ),
        ({"format": None}, "a file without options"),
        ({"search": {"method": "luck"}}, "a file with wrong options: search...got {'method': 'luck'}"),
        ({"search": plain_spec(SearchSpec()) | {"method": "luck"}}, "a file with wrong options: method...got 'luck'"),
        ({"config": config_to_plain(MapElitesConfig())}, "a file with wrong options: config...got MapElitesConfig"),
        (
            {"config": {"kind": "EvolutionConfig", "population": 3}},
            "a file with wrong options: config...got {'population': 3}",
        ),
        (
            {"search": plain_spec(SearchSpec()) | {"like": ["\ud800"]}},
            "a file with wrong options: like: file...got '\\ud800'",
        ),
        ({"axes": "luck"}, "a file with wrong options: axes 'luck':...1 or more"),
        ({"grids": None}, "a file without grids"),
        ({"fitness": np.zeros(3, np.int32)}, "fitness of int32 (3,), which does not fit the other arrays"),
        ({"history__best_fitness": np.zeros((3, 6), np.int32)}, "history.best_fitness of int32 (3, 6)...other arrays"),
        ({"state__inner.0": None}, "a file with an incomplete state"),
        ({"state__generation": None}, "a file with an incomplete state"),
        ({"state__generation": np.array("a")}, "a file with an incomplete state"),
        (
            {"config": config_to_plain(AnnealingConfig()) | {"moves": [1]}},
            "a file with wrong options: config...got [1]",
        ),
        ({"luck": np.zeros(2)}, "a file with luck, which no result has"),
    ],
)
def test_a_file_that_is_no_result_is_refused_in_one_line(result, tmp_path, changes, got):
    file = tmp_path / "result.npz"
    result.save(file)
    file.write_bytes(changed(file, **changes))
    with refused(tmp_path / "result.npz", got) as caught:
        Result.load(file)
    assert "\n" not in str(caught.value)


def test_the_seconds_of_a_continued_run_are_those_of_its_own_generations():
    counts = np.zeros((2, 2), np.int32)
    history = History(np.array([3, 4]), np.array([30, 40]), counts, counts, np.array([5.0, 10.0]), counts)
    assert history.seconds == pytest.approx(2 * 10 / 5 + 2 * 10 / 10)


def test_each_grid_is_checked(result, monkeypatch):
    monkeypatch.setattr("elitelanes_jax.search.records._CHECKED_AT_ONCE", 2)
    check_metrics(result.elites)
    for place in np.argwhere(result.elites.valid)[:5].tolist():
        grids = np.array(result.elites.grids)
        grids[*place] ^= 15
        with refused("", "... instead of ...", expected="metrics of its grids"):
            check_metrics(result.elites._replace(grids=grids))


def test_grids_that_were_changed_are_refused(result, tmp_path):
    """Another program changed a tile of an elite, and its metrics are those of the former grid."""
    whole, file = tmp_path / "whole.npz", tmp_path / "changed.npz"
    result.save(whole)
    _, arrays = read_npz(whole)
    first, last = np.argwhere(arrays["valid"])[[0, -1]].tolist()
    grids = arrays["grids"].copy()
    grids[*last][0, 0] ^= 15
    share = arrays["metrics.coverage"].copy()
    share[*first] = np.nan
    for changes in ({"grids": grids}, {"metrics__coverage": share}):
        file.write_bytes(changed(whole, **changes))
        with refused(tmp_path / "changed.npz", expected="metrics of its grids"):
            Result.load(file)
    elites = result.elites._replace(grids=jnp.asarray(result.elites.grids) ^ 15)
    with refused("elites", "... instead of ...", expected="metrics of its grids"):
        replace(result, elites=elites).maps(1)
    # What a vacant slot has does not matter.
    grids = arrays["grids"].copy()
    grids[~arrays["valid"]] = 15
    file.write_bytes(changed(whole, grids=grids))
    assert (np.array(Result.load(file).elites.valid) == arrays["valid"]).all()


def test_files_of_other_kinds_are_refused(tmp_path):
    file = tmp_path / "result.npz"
    with refused(tmp_path / "result.npz", "no such file or directory"):
        Result.load(file)
    file.write_text('{"codes": [[6, 3], [12, 9]]}')
    with refused(tmp_path / "result.npz", "a file that cannot be read as such: no archive of arrays"):
        Result.load(file)
    with file.open("wb") as stream:
        np.save(stream, np.zeros(3))
    with refused(tmp_path / "result.npz", "a file that cannot be read as such: no archive of arrays"):
        Result.load(file)


def test_nothing_pickled_is_run(tmp_path):
    class Harm:
        def __reduce__(self):
            return (tmp_path.joinpath("harm").write_text, ("done",))

    with (tmp_path / "result.npz").open("wb") as stream:
        np.savez(stream, grids=np.array([Harm()], object))
    with refused(tmp_path / "result.npz", "a file that cannot be read as such: Object arrays cannot be loaded..."):
        Result.load(tmp_path / "result.npz")
    assert not (tmp_path / "harm").exists()


def test_a_flipped_bit_is_noticed_where_it_counts(result, tmp_path):
    file, rng = tmp_path / "result.npz", np.random.default_rng(0)
    result.save(file)
    whole, refused = np.frombuffer(file.read_bytes(), np.uint8), 0
    for place in rng.integers(len(whole), size=60).tolist():
        file.write_bytes((whole ^ (np.arange(len(whole)) == place)).astype(np.uint8).tobytes())
        try:
            same(Result.load(file), result)
        except InputError:
            refused += 1
    assert refused > 30


def test_a_file_that_cannot_be_written_leaves_the_one_before(result, tmp_path, small_files_only):
    result.save(tmp_path / "result.npz")
    before = (tmp_path / "result.npz").read_bytes()
    small_files_only(100)
    with pytest.raises(OSError, match="result.npz"):
        result.save(tmp_path / "result.npz")
    assert (tmp_path / "result.npz").read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["result.npz"]
