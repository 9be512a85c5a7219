"""What users add: a fitness, moves and problems of their own, in every method."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import evolve
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax import Problem, Result, annealed_ea, ea, road_problem, run
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.optimizers import (
    PRESETS,
    EvolutionConfig,
    Move,
    MoveWeights,
    make_optimizer,
    random_move,
    seed_keys,
)
from elitelanes_jax.optimizers import evaluate as score
from elitelanes_jax.optimizers._moves import KNOWN_MOVES
from elitelanes_jax.problem import Axis, Evaluation

SHAPE = (4, 4)
PAPER = {"method": "map-elites", "preset": "paper"}
# Those that differ from another in little: slow proofs.
SLOW = {("map-elites", "standard"), ("map-elites", "irregular"), ("pso", "tuned"), ("gwo", "tuned")}
# JAX 0.7 rounds floats in a compiled search in another way than alone.
ROUNDING = 1e-6 if jax.__version_info__ < (0, 8) else 0


def methods(names=PRESETS, slow=SLOW):
    """Parametrizes a test by the methods and their presets."""
    marked = [pytest.param(one, marks=[pytest.mark.slow] if one in slow else [], id=", ".join(one)) for one in names]
    return pytest.mark.parametrize("which", marked)


def search(which, **options):
    return evolve(jax.random.key(0), SHAPE, method=which[0], preset=which[1], **options)


def roughness(metrics, grid):
    """Neither whole numbers nor of one sign, and NaN for some grids."""
    value = metrics.turns / 3 - metrics.straights + 300.5 * metrics.dead_ends
    return jnp.where(grid[1, 1] == 14, jnp.nan, value)


def slow_roughness(grid):
    metrics = oracle(grid)
    return np.nan if grid[1, 1] == 14 else metrics["turns"] / 3 - metrics["straights"] + 300.5 * metrics["dead_ends"]


def mark(code):
    """A move that writes a code into a corner that its bits name."""

    def apply(bits, grid, mate=None):
        dirty = jnp.zeros(grid.shape, bool).at[bits[0] % 2 * 3, bits[1] % 2 * 3].set(True)
        return jnp.where(dirty, jnp.int8(code), grid), dirty

    return Move(2, apply)


def elites(result):
    return [np.asarray(array)[np.asarray(result.elites.valid)] for array in result.elites[:2]]


@cache
def rough(which):
    """A search in which NaN occurs."""
    return search(which, fitness=roughness, generations=30)


@methods(slow={*PRESETS} - {("ea", "paper")})
def test_a_float_fitness_is_that_of_the_kernel_in_every_method(which):
    result = rough(which)
    grids, fitness = elites(result)
    assert fitness.dtype == np.float32 and len(grids)
    np.testing.assert_allclose(fitness, [slow_roughness(grid) for grid in grids], rtol=1e-6, atol=1e-6)
    assert (grids[:, 1, 1] != 14).all(), "NaN wins nothing"
    assert np.isposinf(np.asarray(result.elites.fitness)[~np.asarray(result.elites.valid)]).all()
    assert result.history.best_fitness[-1] == fitness.min()
    assert result.history.best_fitness.dtype == np.float32 and result.history.refused.dtype == np.int32
    if which == ("map-elites", "tuned"):
        assert result.history.refused.sum() > 10


@pytest.mark.slow
@methods(
    [which for which in PRESETS if which[1] in ("paper", "standard")],
    slow=SLOW | {("ea", "paper"), ("gwo", "paper"), ("pso", "paper")},
)
def test_whole_numbers_give_the_same_search_as_floats(which):
    plain, whole, real = (
        search(which, fitness=fitness, generations=10)
        for fitness in (None, lambda usual: usual, lambda usual: usual / 1)
    )
    for one in (whole, real):
        np.testing.assert_array_equal(plain.elites.grids, one.elites.grids)
        np.testing.assert_array_equal(plain.elites.valid, one.elites.valid)
        np.testing.assert_array_equal(
            *(np.asarray(result.elites.fitness)[result.elites.valid] for result in (plain, one))
        )


@pytest.mark.slow
def test_it_may_add_to_the_usual_fitness_and_take_all_that_is_measured():
    def fitness(usual, features, metrics, grid):
        both = features["corner"] == grid[1, 1], features["turns"] == metrics.turns
        share = features["turn_share"] == 1000 * metrics.turns // metrics.tiles
        return usual + 1000 * features["symmetry"] + jnp.where(both[0] & both[1] & share, 0, 10**6)

    keys = jax.random.split(jax.random.key(2), 4)
    options = {"features": {"corner": lambda grid: grid[1, 1]}, "axes": "symmetry:4", "where": "turns=4..", **PAPER}
    result = evolve(keys, SHAPE, fitness=fitness, generations=5, weights={"tiles": 3}, **options)
    usual = evolve(keys, SHAPE, generations=0, weights={"tiles": 3}, **options | {"method": "ea"})
    known = dict(zip(map(bytes, elites(usual)[0]), elites(usual)[1].tolist(), strict=True))
    first = evolve(keys, SHAPE, fitness=fitness, generations=0, weights={"tiles": 3}, **options)
    compared = 0
    for one in (first, result):
        symmetry = np.asarray(one.elites.features["symmetry"])[np.asarray(one.elites.valid)]
        for grid, value, parts in zip(*elites(one), symmetry.tolist(), strict=True):
            if bytes(grid) in known:
                assert value == known[bytes(grid)] + 1000 * parts
                compared += 1
    assert compared > 3


@pytest.mark.slow
def test_values_out_of_range_are_refused():
    features = {
        "large": lambda grid: jnp.where(grid[1, 1] == 6, 2**30, 7),
        "unsigned": lambda grid: jnp.where(grid[1, 1] == 12, jnp.uint32(2**32 - 1), jnp.uint32(1)),
        "weighed": lambda grid: jnp.where(grid[1, 1] == 3, -(10**6), 3),
    }
    odd = {"odd": lambda grid: jnp.where(grid[1, 1] == 6, 2**28 + 1, 0)}
    grids = jax.random.randint(jax.random.key(4), (256, *SHAPE), 0, 16, jnp.int8)
    for corners, options in (
        ((3, 6, 12), {"features": features, "measured": [*features], "feature_weights": [0, 0, -1000]}),
        ((6,), {"fitness": lambda metrics, grid: jnp.where(grid[1, 1] == 6, -(2**29) - 1, metrics.turns)}),
        ((6,), {"features": odd, "measured": ["odd"], "feature_weights": [2]}),
        ((6,), {"fitness": lambda metrics, grid: jnp.where(grid[1, 1] == 6, -jnp.inf, 1.0 * metrics.turns)}),
    ):
        valid = jax.jit(partial(score, road_problem(SHAPE, **options)))(grids).valid
        np.testing.assert_array_equal(valid, ~np.isin(grids[:, 1, 1], corners))
    result = search(("ea", "paper"), generations=5, features=features, weights={"weighed": -1000})
    found, _ = elites(result)
    assert len(found) and not np.isin(found[:, 1, 1], (3, 6, 12)).any()
    assert result.history.refused.sum() > 0


@pytest.mark.parametrize("large", [np.int64(2**40), np.uint64(2**63), np.array(-(2**40))])
def test_large_numbers_of_numpy_are_refused(large):
    for options in ({"fitness": lambda grid: large}, {"features": {"mine": lambda grid: large}, "axes": "mine:2"}):
        problem = road_problem(SHAPE, **options)
        assert not jax.jit(partial(score, problem))(jnp.zeros((2, *SHAPE), jnp.int8)).valid.any()


def test_an_error_of_the_user_is_not_blamed_on_jax():
    def fails(grid):
        raise OverflowError("mine")

    for options in ({"fitness": fails}, {"features": {"mine": fails}}):
        with pytest.raises(OverflowError, match="^mine"):
            evolve(0, SHAPE, seeds=1, generations=1, **options)


@methods(slow={*PRESETS} - {("ea", "paper")})
def test_a_search_may_refuse_all_grids(which):
    with pytest.warns(UserWarning, match="the result has no elites"):
        result = search(which, fitness=lambda grid: jnp.nan, generations=3)
    with pytest.warns(UserWarning, match="found 0 of 16 maps among 0 elites"):
        assert not result.elites.valid.any() and result.maps() == []
    assert (result.history.refused > 0).all()
    assert (result.history.elite_count == 0).all()


@pytest.mark.slow
@methods([("map-elites", "tuned"), ("ea", "tuned")], slow=set())
def test_a_run_in_parts_is_one_run_and_is_saved(which, tmp_path):
    run = partial(search, which, fitness=roughness)
    half = run(generations=12)
    half.save(tmp_path / "half.npz")
    read = Result.load(tmp_path / "half.npz")
    jax.tree.map(np.testing.assert_array_equal, half.elites, read.elites)
    np.testing.assert_array_equal(half.history.refused, read.history.refused)
    whole = run(generations=18, state=read.state)
    jax.tree.map(np.testing.assert_array_equal, whole.elites, rough(which).elites)
    begun, ended = (run(generations=count, checkpoint=tmp_path / "kept", every=0) for count in (12, 30))
    np.testing.assert_array_equal(begun.elites.fitness, half.elites.fitness)
    np.testing.assert_array_equal(ended.elites.fitness, rough(which).elites.fitness)
    assert ended.history.best_fitness.dtype == np.float32


def of_factor(name, factor):
    """Makes a function of the user, as an argument of `evolve`, which differs by a constant."""
    if name == "optimizer":
        config = EvolutionConfig(population=4, offspring=4, tile_rate=factor / 10)
        return {"optimizer": lambda problem: ea(problem, config)}
    made = {
        "fitness": lambda metrics: factor * metrics.turns,
        "features": {"mine": lambda grid: factor * grid[1, 1].astype(jnp.int32)},
        "moves": {"mine": (1, Move(1, lambda bits, grid, mate=None: (grid * factor // factor, grid > factor)))},
    }
    return {name: made[name], "method": "ea"} | ({} if name == "moves" else {"preset": "paper"})


@pytest.mark.parametrize(
    "name", ["fitness", *(pytest.param(name, marks=pytest.mark.slow) for name in ("optimizer", "features", "moves"))]
)
def test_a_function_is_known_by_what_it_computes(name, tmp_path):
    """An equal function continues a run, whatever its name; an edited function of the same name does not."""
    run = partial(evolve, jax.random.key(0), SHAPE, generations=1)
    state = run(checkpoint=tmp_path / name, **of_factor(name, 2)).state
    assert run(state=state, **of_factor(name, 2)).state.generation == 2
    kept = run(checkpoint=tmp_path / name, **of_factor(name, 2) | {"generations": 2})
    assert kept.state.generation == 2
    for options, subject, got, expected in (
        ({"state": state}, "state", "one of a run with another key, other options or functions", ""),
        ({"checkpoint": tmp_path / name}, tmp_path / name, "results with '...'", "functions"),
    ):
        with refused(subject, got, expected):
            run(**of_factor(name, 3), **options)


def test_a_feature_is_known_by_what_it_computes_beside_another_function_of_its_name():
    run = partial(evolve, jax.random.key(0), SHAPE, generations=1, method="ea", moves={"mine": (1, mark(3))})
    before = run(features={"mine": lambda grid: (grid == 5).sum()})
    assert [name for name, _ in before.functions] == ["mine", "move mine"]
    with refused("state", "one of a run with another key, other options or functions"):
        run(features={"mine": lambda grid: (grid == 10).sum()}, state=before.state)


@pytest.mark.slow
def test_a_function_whose_values_change_is_another_one(tmp_path):
    """What a function reads may change between two calls, as in a sweep in a notebook."""
    added = np.zeros((), np.int32)
    run = partial(evolve, 0, SHAPE, seeds=1, method="ea", preset="paper", generations=2)
    options = {
        "fitness": lambda usual: usual + added.item(),
        "features": {"mine": lambda grid: (grid[0, 0] * 0 + added.item()).astype(jnp.int32)},
    }
    for name, value in options.items():
        added[...] = 0
        before = run(**{name: value})
        added[...] = 1
        after = run(**{name: value})
        with refused("state", "one of a run with another key, other options or functions"):
            run(**{name: value}, state=before.state)
        one, other = (r.elites.fitness if name == "fitness" else r.elites.features["mine"] for r in (before, after))
        np.testing.assert_array_equal(np.asarray(one) + 1, other)


def test_functions_are_traced_a_few_times():
    """Tracing a large one takes longer than a search: four times at the first call, twice later."""
    calls = {"mine": 0, "fitness": 0}

    def counted(name, value):
        calls[name] += 1
        return value

    options = {
        "fitness": lambda usual: counted("fitness", usual),
        "features": {"mine": lambda grid: counted("mine", grid[0, 0])},
        "axes": "mine:4:4",
    }
    for most in (4, 2):
        evolve(0, SHAPE, seeds=1, method="ea", preset="paper", generations=2, **options)
        assert max(calls.values()) <= most
        calls |= dict.fromkeys(calls, 0)


@pytest.mark.parametrize(
    "worst", [np.nan, *(pytest.param(worst, marks=pytest.mark.slow) for worst in (np.inf, -np.inf))]
)
def test_a_fitness_that_is_nowhere_finite_is_a_warning(worst):
    options = {"seeds": 2, "method": "ea", "preset": "paper", "generations": 2}
    words = (
        r"^the result has no elites: \d+ grids were refused, because their fitness or a feature is not a finite number"
    )
    with pytest.warns(UserWarning, match=words):
        evolve(0, SHAPE, fitness=lambda usual: usual + worst, **options)


def test_chosen_maps_have_a_float_fitness():
    maps = rough(("map-elites", "tuned")).maps(5)
    assert maps and all(isinstance(road_map.fitness, float) for road_map in maps)


@pytest.mark.parametrize(
    ("options", "subject", "got", "expected"),
    [
        ({"fitness": 3}, "fitness", "3", "a function"),
        ({"fitness": lambda turns: turns}, "fitness", "'turns'", "arguments"),
        ({"fitness": lambda grid: grid}, "fitness", "int32 of shape (4, 4)", "scalar"),
        ({"fitness": lambda usual: None}, "fitness", "None", "scalar"),
        ({"features": {"mine": lambda grid: 2**40}}, "features", "1099511627776", "mine"),
        ({"fitness": lambda usual: 2**40}, "fitness", "1099511627776", "scalar"),
        ({"fitness": lambda usual, /: usual}, "fitness", "<function <lambda> ...", "named arguments"),
        ({"fitness": lambda grid: "x"}, "fitness", "'x'", "scalar"),
        ({"fitness": lambda grid: grid[1, 1] > 1}, "fitness", "bool of shape ()", "scalar"),
        ({"fitness": lambda metrics: float(metrics.turns)}, "fitness", None, "trace"),
        ({"moves": 3}, "moves", "3", "by name"),
        ({"moves": {"mirror": -1}}, "moves: mirror", "-1", "number"),
        (
            {"moves": {"mine": (1, lambda bits: bits)}},
            "moves: mine",
            "(1, <function <lambda> ...",
            "a weight and a Move",
        ),
        ({"moves": {"mirror": np.array(3)}}, "moves", "an array, .annealing.moves.mirror", "plain numbers"),
        (
            {"moves": {"mine": (jnp.int32(3), mark(3))}},
            "moves",
            "an array, .annealing.moves.user_moves...",
            "plain numbers",
        ),
        (
            {"moves": {None: (1, mark(3))}},
            "moves",
            "None",
            "names",
        ),
        ({"moves": {"mine": (-1, Move(1, print))}}, "moves: mine", "-1", "number"),
        (
            {"moves": {"mine": (1, Move(1, lambda bits, grid, mate: (grid, grid)))}},
            "moves",
            None,
            "mine to return int8",
        ),
        ({"moves": {"mirror": 0}, "preset": "paper"}, "moves", "MapElitesConfig", "a method"),
    ],
)
def test_wrong_functions_are_named(options, subject, got, expected, any_types):
    with refused(subject, got, expected):
        evolve(jax.random.key(0), SHAPE, generations=1, **options)


def test_the_name_of_a_move_is_suggested(any_types):
    with refused("moves", "'miror'", hint="is it mirror?"):
        evolve(jax.random.key(0), SHAPE, generations=1, moves={"miror": 0})


def test_moves_of_the_user_are_made_in_proportion_to_their_weights():
    grid, bits = jnp.full(SHAPE, 15, jnp.int8), random_bits(jax.random.key(0), (20_000, 10))
    weights = MoveWeights(**dict.fromkeys(KNOWN_MOVES, 0) | {"clear": 1})
    weights = weights.with_moves({"clear": 0, "a": (1, mark(1)), "b": (3, mark(2))})
    varied = jax.jit(jax.vmap(lambda bits: random_move(weights, fill=True).apply(bits, grid).grid))(bits)
    assert float((varied == 1).any(axis=(1, 2)).mean()) == pytest.approx(0.25, abs=0.02)
    assert float((varied == 2).any(axis=(1, 2)).mean()) == pytest.approx(0.75, abs=0.02)
    corners = varied[:, (0, 0, 3, 3), (0, 3, 0, 3)] != 15
    np.testing.assert_allclose(corners.mean(axis=0), 0.25, atol=0.02)


def test_a_move_of_weight_0_and_the_order_of_names_change_nothing():
    grid, bits = jnp.full(SHAPE, 15, jnp.int8), random_bits(jax.random.key(1), (300, 10))
    both = {"a": (2, mark(1)), "b": (3, mark(2))}

    def made(moves):
        move = random_move(MoveWeights().with_moves(moves), fill=True)
        return jax.jit(jax.vmap(lambda bits: move.apply(bits, grid).grid))(bits)

    np.testing.assert_array_equal(made(both | {"c": (0, mark(1))}), made(dict(reversed(both.items()))))


@methods([(method, "tuned") for method in ("map-elites", "ea", "pso", "gwo")], slow=SLOW | {("ea", "tuned")})
def test_a_search_makes_the_moves_of_the_user(which):
    """Only a move that writes crossings into corners: these are the only crossings that a search without others has."""
    moves = dict.fromkeys(KNOWN_MOVES, 0) | {"mine": (1, mark(3))}
    more = {"moves": moves, "alphabet": [15], "fill": False, "generations": 20}
    result = search(which, fitness=lambda grid: -(grid[1, 1] == 3).astype(jnp.int32), **more)
    assert result.history.best_fitness[-1] in (0, -1)
    assert result.search.settings.method == which[0]


def evaluate(grids):
    """Colours: neighbours that are alike, and how many cells have colour 1; nothing of roads."""
    alike = (grids[:, 1:] == grids[:, :-1]).sum(axis=(1, 2)) + (grids[:, :, 1:] == grids[:, :, :-1]).sum(axis=(1, 2))
    ones = (grids == 1).sum(axis=(1, 2))
    return Evaluation(alike, jnp.stack([alike, ones], axis=1))


def real(grids):
    alike, features = evaluate(grids)
    return Evaluation(jnp.where(features[:, 1] == 3, jnp.nan, alike / 7), features)


def constant(fitness, features, grids):
    return Evaluation(jnp.full(len(grids), fitness), jnp.full((len(grids), 1), features))


COLOURS = (0, 1, 2, 3)


# Those that run on floats alone in the fast tests: whole numbers are a slow proof there, and the reverse.
OF_FLOATS = {("map-elites", "tuned"), ("pso", "paper")}


@methods(slow=SLOW | OF_FLOATS | {("ea", "paper"), ("ea", "tuned")})
def test_a_problem_of_ones_own_runs_with_every_optimizer(which):
    check_search(which, evaluate)


@pytest.mark.slow
@methods(slow=set(PRESETS) - OF_FLOATS)
def test_one_of_floats_does_so_too(which):
    check_search(which, real)


def check_search(which, score):
    problem = Problem((5, 4), score, ("alike", "ones"), (Axis("ones", 6, 3),), COLOURS)
    optimizer = make_optimizer(problem, PRESETS[which])
    states, info = jax.jit(partial(run, optimizer), static_argnums=1)(seed_keys(0, 2), 40)
    found = jax.jit(jax.vmap(optimizer.elites))(states)
    valid = np.asarray(found.valid)
    assert valid.any(axis=1).all()
    grids = jnp.asarray(np.asarray(found.grids)[valid])
    assert np.isin(grids, COLOURS).all()
    again = score(grids)
    np.testing.assert_allclose(np.asarray(found.fitness)[valid], again.fitness, rtol=ROUNDING if score is real else 0)
    np.testing.assert_array_equal(np.asarray(found.features)[valid], again.features)
    assert not np.isnan(again.fitness).any()
    assert (info.best_fitness[-1] <= info.best_fitness[0]).all()
    chance = score(jax.jit(problem.random, static_argnums=1)(jax.random.key(1), 200)).fitness
    assert (info.best_fitness[-1] < jnp.nanmedian(chance)).all(), "better than by chance"
    if which[0] == "map-elites":
        np.testing.assert_array_equal(np.asarray(found.features)[..., 1].clip(max=17)[valid] // 3, np.nonzero(valid)[1])


def test_what_is_wrong_with_a_problem_is_said(any_types):
    for arguments, subject, got, expected in (
        (((1, 4), evaluate), "shape", "1 x 4", "from 2"),
        (((5, 4), evaluate, ("alike",), (Axis("turns", 3, 1),)), "axes", "turns", "alike"),
        (((5, 4), evaluate, (), (), (0, 16)), "alphabet", "16", "codes"),
    ):
        with refused(subject, got, expected):
            Problem(*arguments)
    for method in ("paper", "tuned"):
        with refused("axes", "none", expected="problem"):
            make_optimizer(Problem((5, 4), evaluate, ("alike", "ones")), PRESETS["map-elites", method]).init(
                jax.random.key(0)
            )
    with refused("evaluate", "((32,), (32, 2))", expected="shapes"):
        annealed_ea(Problem((5, 4), evaluate, ("alike",))).init(jax.random.key(0))
    for fitness, features in ((True, 1), (1, 0.5), (1j, 1)):
        odd = Problem((5, 4), partial(constant, fitness, features), ("alike",))
        with refused("evaluate", expected="real numbers"):
            annealed_ea(odd).init(jax.random.key(0))
    for returned in (None, np.zeros(2), ([0, 0], [[0], [0]]), (np.zeros(2), np.zeros((2, 1), int), 0)):
        other = Problem((5, 4), lambda grids, returned=returned: returned, ("alike",))
        with refused("evaluate", expected="tuple"):
            score(other, np.zeros((2, 5, 4), np.int8))
    many = Problem((5, 4), evaluate, ("alike", "ones"), initial=np.zeros((40, 5, 4), np.int8))
    with refused("initial", "40", expected="at most 32"):
        annealed_ea(many).init(jax.random.key(0))
    with refused("initial", "int8 [3, 0]", expected="[N, 5, 4]"):
        Problem((5, 4), evaluate, ("alike", "ones"), initial=np.zeros((3, 0), np.int8))
    none = Problem((5, 4), evaluate, ("alike", "ones"), initial=np.zeros((0, 5, 4), np.int8))
    assert none.random(jax.random.key(0), 2).shape == (2, 5, 4)


@pytest.mark.parametrize("kind", [jnp.int8, jnp.int16])
def test_whole_numbers_of_few_bits_are_a_fitness(kind):
    narrow = Problem((5, 4), partial(constant, kind(1), 1), ("alike",))
    state = annealed_ea(narrow).init(jax.random.key(0))
    assert annealed_ea(narrow).elites(state).valid.all()


def test_a_state_that_cannot_be_saved_is_refused_before_the_search(tmp_path):
    def keyed(problem):
        plain = ea(problem)
        return plain._replace(
            init=lambda key: (key, plain.init(key)),
            step=lambda key, state: ((key, plain.step(key, state[1])[0]), plain.step(key, state[1])[1]),
            elites=lambda state: plain.elites(state[1]),
            init_unevaluated=None,
        )

    options = {"seeds": 2, "generations": 2, "optimizer": keyed, "progress": False}
    assert len(evolve(0, (4, 4), **options).history.generation) == 2
    with refused("state", "key<fry>"):
        evolve(0, (4, 4), checkpoint=tmp_path / "kept", **options)
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize(("wrong", "got"), [(0, "0"), (8.5, "8.5")])
def test_a_step_evaluates_a_whole_number_of_grids(wrong, got):
    with refused("optimizer: evaluations_per_step", got):
        evolve(0, (4, 4), seeds=1, optimizer=lambda problem: ea(problem)._replace(evaluations_per_step=wrong))


@pytest.mark.slow
def test_what_a_fitness_reads_may_change_beside_an_optimizer():
    """An optimiser is traced once, but the fitness that it minimises is another one after the change."""
    added = 0
    options = {"optimizer": ea, "fitness": lambda usual: usual + added, "generations": 1}
    before = evolve(jax.random.key(0), SHAPE, **options)
    added = 1
    after = evolve(jax.random.key(0), SHAPE, **options)
    np.testing.assert_array_equal(before.elites.fitness + 1, after.elites.fitness)
    with refused("state", "one of a run with another key, other options or functions"):
        evolve(jax.random.key(0), SHAPE, **options, state=before.state)
