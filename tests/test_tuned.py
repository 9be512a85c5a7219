"""The presets `tuned`: how far they reach, and what they can be asked for."""

from functools import cache
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracle import fitness as oracle_fitness
from oracle import measure as oracle

from elitelanes_jax import InputError, Weights, evolve, fitness, measure, random_grids, repair
from elitelanes_jax.annealing import AnnealingConfig, Cooling, accepts, fresh_grid
from elitelanes_jax.archive import Axis, describe, tuned_axes
from elitelanes_jax.draws import UNIT, exponential, random_words
from elitelanes_jax.moves import Mix
from elitelanes_jax.optimizers import AimedMapElitesConfig, DiscretePsoConfig, Scouts, aimed_map_elites
from elitelanes_jax.problem import road_problem
from elitelanes_jax.requests import ranges_of, read_ranges
from elitelanes_jax.run import advance, start
from elitelanes_jax.search import seed_keys
from elitelanes_jax.symmetry import rotate

METHODS = ("ea", "map-elites", "pso", "gwo")


@cache
def optimum(side, fill):
    """The lowest fitness of all networks on a square, found by trying every set of links."""
    links = [((r, c), (r, c + 1), 4, 1) for r in range(side) for c in range(side - 1)]
    links += [((r, c), (r + 1, c), 2, 8) for r in range(side - 1) for c in range(side)]
    made = np.zeros((len(links), side, side), np.int8)
    for number, (one, other, ahead, back) in enumerate(links):
        made[number][one], made[number][other] = ahead, back
    worth = jax.jit(lambda codes: jax.vmap(lambda grid: fitness(measure(grid)))(codes))
    best = 2**31
    numbers = np.arange(2 ** len(links))
    for part in np.array_split(numbers, max(1, len(numbers) >> 16)):
        codes = np.zeros((len(part), side, side), np.int8)
        for number, layer in enumerate(made):
            codes |= np.where((part >> number & 1)[:, None, None] == 1, layer, 0).astype(np.int8)
        if fill:
            codes = codes[(np.vectorize(int.bit_count, otypes=[int])(np.arange(16))[codes] >= 2).all(axis=(1, 2))]
        if len(codes):
            best = min(best, int(worth(codes).min()))
    return best


@pytest.mark.parametrize("fill", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_the_optimum_of_small_grids_is_found_by_all(method, fill):
    result = evolve(seed_keys(0, 4), (3, 3), method=method, preset="tuned", evaluations=4000, fill=fill)
    assert result.history.best_fitness[:, -1].tolist() == [optimum(3, fill)] * 4


@pytest.mark.slow
@pytest.mark.parametrize("fill", [True, False])
def test_the_optimum_of_four_by_four_is_found(fill):
    result = evolve(seed_keys(0, 8), (4, 4), method="ea", preset="tuned", evaluations=30_000, fill=fill)
    assert result.history.best_fitness[:, -1].tolist() == [optimum(4, fill)] * 8


def test_the_tuned_ea_reaches_the_proven_optimum_of_six_by_six():
    result = evolve(seed_keys(3, 4), (6, 6), method="ea", preset="tuned", evaluations=30_000, fill=True)
    assert result.history.best_fitness[:, -1].tolist() == [-158] * 4
    best = np.asarray(result.best()[0])
    assert oracle_fitness(oracle(best)) == -158


@pytest.mark.parametrize("method", ["ea", "pso", "gwo"])
def test_tuned_is_better_than_paper(method):
    keys = seed_keys(1, 4)
    best = {
        preset: evolve(keys, (8, 8), method=method, preset=preset, evaluations=8000, fill=True).history.best_fitness
        for preset in ("paper", "tuned")
    }
    assert best["tuned"][:, -1].max() < best["paper"][:, -1].min()


def test_evaluations_are_generations_rounded_up():
    for evaluations, generations in ((0, 0), (1, 1), (32, 1), (33, 2)):
        result = evolve(jax.random.key(0), (4, 4), method="ea", preset="tuned", evaluations=evaluations)
        assert result.state.generation == generations
    with pytest.raises(InputError, match="evaluations: expected them or generations, got both, 5 and 6"):
        evolve(jax.random.key(0), (4, 4), evaluations=5, generations=6)
    with pytest.raises(InputError, match="evaluations: expected a whole number, 0 or more, got 1.5"):
        evolve(jax.random.key(0), (4, 4), evaluations=1.5)


def test_a_run_in_parts_is_the_whole_run():
    for method in ("ea", "map-elites"):
        keys = seed_keys(2, 2)
        config = {"method": method, "preset": "tuned", "where": ["crossings=2..9"]}
        whole = evolve(keys, (5, 6), evaluations=6400, **config)
        half = evolve(keys, (5, 6), evaluations=3200, **config)
        rest = evolve(keys, (5, 6), evaluations=3200, state=half.state, **config)
        jax.tree.map(np.testing.assert_array_equal, rest.elites, whole.elites)
        alone = evolve(keys[1], (5, 6), evaluations=6400, **config)
        jax.tree.map(lambda one, all_: np.testing.assert_array_equal(one, all_[1]), alone.elites, whole.elites)


def test_what_is_asked_for_is_found():
    where = ["crossings=4..6", "cyclomatic=3..5", "straight_share=0.2..0.6"]
    for method in METHODS:
        result = evolve(
            seed_keys(0, 2), (6, 6), method=method, preset="tuned", evaluations=9600, fill=True, where=where
        )
        good = result.meets()
        assert good.any(axis=1).all(), method
        for seed, place in np.argwhere(good)[:10]:
            found = oracle(result.elites.grids[seed, place])
            assert 4 <= found["crossings"] <= 6
            assert 3 <= found["cyclomatic"] <= 5
            assert 0.2 * found["tiles"] <= found["straights"] <= 0.6 * found["tiles"]
            assert result.elites.fitness[seed, place] == oracle_fitness(found)


def test_another_range_needs_no_second_compilation():
    from conftest import compilations

    setting = {"method": "ea", "preset": "tuned", "evaluations": 320}
    evolve(jax.random.key(0), (5, 5), where=["crossings=2..3"], **setting)
    with compilations() as compiled:
        evolve(jax.random.key(0), (5, 5), where=["bridges=0", "tiles=9..20"], **setting)
    assert not compiled


def test_given_cells_are_in_every_map():
    fix = [[None] * 6 for _ in range(6)]
    fix[2][2] = fix[2][3] = fix[3][2] = fix[3][3] = 0
    fix[5][1:4] = [5, 5, 5]
    for method, preset in (("ea", "paper"), ("pso", "paper"), ("ea", "tuned"), ("map-elites", "tuned")):
        result = evolve(jax.random.key(1), (6, 6), method=method, preset=preset, evaluations=960, fill=True, fix=fix)
        grids = np.asarray(result.elites.grids)[np.asarray(result.elites.valid)]
        assert (grids[:, 2:4, 2:4] == 0).all()
        assert (grids[:, 5, 1:4] == 5).all()


def test_duckietowns_rules_are_kept():
    result = evolve(seed_keys(0, 2), (7, 7), preset="tuned", evaluations=32_000, rules="duckietown")
    metrics = result.elites.metrics
    lawful = np.asarray(result.elites.valid & (metrics.crowded_crossings == 0) & (metrics.unlinked_neighbours == 0))
    assert lawful.sum() > 20
    for seed, place in np.argwhere(lawful)[::5]:
        check_duckietown(np.asarray(result.elites.grids[seed, place]))
    with pytest.raises(InputError, match="fill: expected none with the rules of duckietown"):
        evolve(jax.random.key(0), (4, 4), rules="duckietown", fill=True)
    with pytest.raises(InputError, match="rules: expected one of duckietown, got 'luck'"):
        evolve(jax.random.key(0), (4, 4), rules="luck")


def check_duckietown(grid):
    """The rules as they read, tile by tile."""
    height, width = grid.shape
    kind = {0: "empty", **dict.fromkeys((3, 6, 9, 12), "turn"), **dict.fromkeys((7, 11, 13, 14, 15), "crossing")}
    for row, column in np.ndindex(height, width):
        for other, side, answer in (((row, column + 1), 4, 1), ((row + 1, column), 2, 8)):
            if other[0] < height and other[1] < width and grid[row, column] and grid[other]:
                assert grid[row, column] & side
                assert grid[other] & answer
                kinds = {kind.get(int(grid[row, column])), kind.get(int(grid[other]))}
                assert kinds not in ({"crossing"}, {"crossing", "turn"})


def test_niches_are_aimed_at():
    """Islands that aim at flawless niches fill more of them than a search without aims."""
    axes = tuned_axes((8, 8))
    shares = []
    for preset in ("standard", "tuned"):
        result = evolve(seed_keys(0, 3), (8, 8), preset=preset, axes=axes, evaluations=64_000, fill=True)
        flawless = np.asarray(result.elites.valid).reshape(3, 25, 16)[..., 0]
        shares.append(flawless.sum(axis=1))
    assert (shares[1] > shares[0]).all()


@pytest.mark.parametrize(("chains", "regions"), [(1, 8), (1, 2), (4, 8)])
def test_what_all_regions_find_meets_in_the_last_archive(chains, regions):
    problem = road_problem((5, 5), tuned_axes((5, 5)), fill=True)
    annealing = AnnealingConfig(population=8, chains=chains, cycle=20)
    optimizer = aimed_map_elites(problem, AimedMapElitesConfig(annealing, regions=regions))
    state, _ = advance(optimizer, seed_keys(0, 1), start(optimizer, seed_keys(0, 1)), 1, 100, most=100)
    fitness = np.asarray(state.archive.fitness).reshape(-1, 400)
    assert len(fitness) == 1 + min(regions, 8 // chains // 2)
    np.testing.assert_array_equal(fitness[-1], fitness.min(axis=0))
    apart = (fitness[:-1] < 2**31 - 1).sum(axis=1)
    assert (apart > 0).all()
    assert (fitness[:-1] != fitness[-1]).any(axis=1).all()
    elites = jax.vmap(optimizer.elites)(state)
    np.testing.assert_array_equal(elites.fitness[0], fitness[-1])
    worth = problem.evaluate(elites.grids[0]).fitness
    np.testing.assert_array_equal(worth[elites.valid[0]], elites.fitness[0][elites.valid[0]])


def test_a_region_that_fills_no_more_niches_begins_again():
    """What a region had is gone when it stalls, and only then; what all know stays."""
    problem = road_problem((5, 5), tuned_axes((5, 5)), fill=True)
    annealing = AnnealingConfig(population=8, chains=1, cycle=4)
    optimizer = aimed_map_elites(problem, AimedMapElitesConfig(annealing, regions=2, patience=5))
    step, key = jax.jit(optimizer.step), jax.random.key(0)
    state = optimizer.init(key)
    vacant, ages, gained, begun = 2**31 - 1, np.zeros(2, int), np.zeros(2, int), 0
    for number in range(150):
        before = np.asarray(state.archive.fitness).reshape(3, 400)
        state, _ = step(jax.random.fold_in(key, number), state)
        after = np.asarray(state.archive.fitness).reshape(3, 400)
        assert (after[-1] <= before[-1]).all()
        for region in range(2):
            stalls = ages[region] >= max(20, 2 * gained[region])
            own = np.full(400, vacant) if stalls else before[region]
            assert (after[region] <= own).all()
            assert not stalls or (after[region] < vacant).sum() <= 3 < (before[region] < vacant).sum()
            ages[region] = 1 if stalls else ages[region] + 1
            flawless = np.stack([own, after[region]]).reshape(2, 25, 16)[..., 0] < vacant
            more = flawless[1].sum() > flawless[0].sum()
            gained[region] = ages[region] if more else 0 if stalls else gained[region]
            begun += stalls
        np.testing.assert_array_equal(state.growth.age, ages)
        np.testing.assert_array_equal(state.growth.gained, gained)
    assert begun > 3


@pytest.mark.parametrize("symmetric", [0, 1])
def test_cycles_from_random_grids_are_symmetric_or_not(symmetric):
    annealing = AnnealingConfig(population=8, chains=1, cycle=4, moves=Mix(completed=0))
    config = AimedMapElitesConfig(annealing, anew=1, symmetric=symmetric, scouts=Scouts(share=0))
    optimizer = aimed_map_elites(road_problem((6, 7), tuned_axes((6, 7))), config)
    step, key, seen = jax.jit(optimizer.step), jax.random.key(0), []
    state = optimizer.init(key)
    for number in range(250):
        state, _ = step(jax.random.fold_in(key, number), state)
        seen.append(state.chains.grids[:4])  # of the islands in regions
        np.testing.assert_array_equal(state.twins, [symmetric] * 4 + [0.5] * 4)
    seen = np.concatenate(seen)
    same = (seen == np.stack([rotate(grid, 2) for grid in seen])).all(axis=(1, 2))
    assert len(np.unique(seen, axis=0)) > 100
    assert same.all() if symmetric else same.mean() < 0.1


def stepped(axes, scouts, steps=150, **config):
    """The states of a search on 6 x 6 whose islands begin with random grids all the time."""
    annealing = AnnealingConfig(population=8, chains=1, cycle=4)
    problem = road_problem((6, 6), axes, fill=True, where=ranges_of(read_ranges(["tiles=36"])))
    optimizer = aimed_map_elites(problem, AimedMapElitesConfig(annealing, anew=1, scouts=scouts, **config))
    step, state, states = jax.jit(optimizer.step), optimizer.init(jax.random.key(0)), []
    for number in range(steps):
        state, _ = step(jax.random.fold_in(jax.random.key(0), number), state)
        states.append(state)
    return problem, states


@pytest.mark.parametrize("symmetric", [0, 1])
def test_scouts_go_past_what_is_vacant_for_a_long_cycle(symmetric):
    axes = tuned_axes((6, 6))
    _, states = stepped(axes, Scouts(share=1, longer=20, symmetric=symmetric), longer=2)
    for before, after in pairwise(states):
        scouts = np.asarray(after.scouts)
        assert scouts[:4].all()  # in regions
        assert not scouts[4:].any()
        begun = np.asarray(before.cooling.step) == 0
        assert (np.asarray(after.cooling.length) == np.where(scouts, 80, 4)).all()
        assert (np.asarray(after.twins)[scouts] == symmetric).all()
        aims = np.asarray(after.aims)
        assert np.isin(aims[scouts, 0], (0, axes[0].bins - 1)).all()
        assert (aims[scouts, 1:] == 0).all()
        np.testing.assert_array_equal(aims[~begun], np.asarray(before.aims)[~begun])


@pytest.mark.parametrize(("start", "bins", "ends"), [(35, 2, {0}), (36, 2, {1}), (35, 3, {0, 2})])
def test_scouts_go_where_the_filled_niches_are_not(start, bins, ends):
    """With every cell filled all grids have 36 tiles, so that no other bin is ever filled."""
    _, states = stepped((Axis("tiles", bins, start=start),), Scouts(share=1, longer=2), longer=2)
    assert all(np.asarray(state.scouts)[:4].all() for state in states)
    assert set(np.concatenate([np.asarray(state.aims)[:4, 0] for state in states]).tolist()) == ends


def test_where_nothing_is_vacant_nobody_scouts():
    for axes, scouts in (((Axis("tiles", 1),), Scouts(share=1)), (tuned_axes((6, 6)), Scouts(share=0))):
        _, states = stepped(axes, scouts, steps=40)
        assert not np.any([state.scouts for state in states])


def test_scouts_see_flaws_alone():
    """Of two grids alike in flaws they take the worse one too: what rewards, and a cold temperature, change nothing."""
    scouts = Scouts(share=1, symmetric=0, hottest=1, coldest=1, longer=50)
    problem, states = stepped(tuned_axes((6, 6)), scouts, longer=2)
    worse = 0
    for before, after in pairwise(states):
        goes_on = np.asarray(after.scouts) & (np.asarray(before.cooling.step) > 0)
        far = []
        for counts in (before.chains.counts, after.chains.counts):
            cyclomatic = np.asarray(describe(counts, problem.axes))[:, 0]
            steps = 200 * np.abs(cyclomatic.clip(0, 24) - np.asarray(after.aims)[:, 0])
            far.append(np.asarray(problem.flaws(counts)) + steps)
        assert (far[1] <= far[0] + 8.4)[goes_on].all()
        worse += (np.asarray(after.chains.fitness) > np.asarray(before.chains.fitness))[goes_on].sum()
    assert worse > 10


def test_flaws_are_the_fitness_without_what_rewards():
    grids = np.random.default_rng(5).integers(0, 16, (40, 5, 6)).astype(np.int8)
    weights = Weights(turns=-7, tiles=3, constant=11)
    where = ranges_of(read_ranges(["crossings=2..4"]))
    problem = road_problem((5, 6), tuned_axes((5, 6)), weights=weights, where=where)
    rewards = Weights(*(0 for _ in Weights._fields))
    rewards = rewards._replace(turns=-7, cyclomatic=-2, straight_score=-2, constant=11)
    fitness_, counts = problem.evaluate(grids)
    expected = fitness_ - fitness(jax.vmap(measure)(grids), rewards)
    np.testing.assert_array_equal(problem.flaws(counts), expected)


def test_aims_are_bins():
    with pytest.raises(InputError, match="axes: expected aim to be a bin, 0 to 2"):
        evolve(jax.random.key(0), (4, 4), axes=[Axis("crossings", 3, aim=3)])


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (AnnealingConfig(population=0), "config: expected population to be a whole number, 1 or more, got 0"),
        (AnnealingConfig(population=10), "config: expected a population that is a multiple of the 4 chains"),
        (AnnealingConfig(coldest=90), "config: expected coldest <= hottest <= 4000, got 90 and 60"),
        (AnnealingConfig(cycle=0), "config: expected cycle to be a whole number, 1 or more, got 0"),
    ],
)
def test_annealing_settings_are_checked(config, message):
    with pytest.raises(InputError, match=message):
        evolve(jax.random.key(0), (4, 4), method="ea", config=config)


def test_swarm_and_island_settings_are_checked():
    with pytest.raises(InputError, match=r"config: expected cognitive \+ social to be at most 1"):
        evolve(jax.random.key(0), (4, 4), method="pso", config=DiscretePsoConfig(cognitive=0.7, social=0.7))
    for scouts, message in (
        (Scouts(longer=0), "config: expected longer to be a whole number, 1 or more, got 0"),
        (Scouts(hottest=20), "config: expected coldest <= hottest <= 4000, got 25 and 20"),
        (Scouts(share=2), "config: expected share to be"),
        (Scouts(symmetric=-1), "config: expected symmetric to be"),
    ):
        with pytest.raises(InputError, match=message):
            evolve(jax.random.key(0), (4, 4), preset="tuned", config=AimedMapElitesConfig(scouts=scouts))
    with pytest.raises(InputError, match="config: expected contest to be at most 8, got 9"):
        evolve(jax.random.key(0), (4, 4), config=AimedMapElitesConfig(contest=9))


def test_worse_grids_are_accepted_as_metropolis_says():
    words = random_words(jax.random.key(0), (200_000,))
    for temperature, worse in ((16 * 60, 30), (16 * 60, 100), (16 * 18, 18), (16 * 4000, 4000)):
        share = np.asarray(accepts(words, jnp.int32(temperature), jnp.int32(0), jnp.int32(worse))).mean()
        assert share == pytest.approx(np.exp(-worse / (temperature / 16)), abs=0.01)
    assert accepts(words, jnp.int32(1), jnp.int32(7), jnp.int32(7)).all()


def test_exponential_draws():
    drawn = np.asarray(exponential(random_words(jax.random.key(1), (200_000,)))) / UNIT
    assert drawn.min() >= 0
    for quantile in (0.1, 0.5, 0.9, 0.99):
        assert np.quantile(drawn, quantile) == pytest.approx(-np.log(1 - quantile), rel=0.03, abs=0.002)


def test_cycles_cool_and_grow():
    config = AnnealingConfig(cycle=10).checked()
    place = Cooling.first(config, (12, 12))
    temperatures, starts = [], []
    for step in range(1, 60):
        temperatures.append(int(place.temperature(config, (12, 12))))
        place = place.after(grows=True)
        if place.begins:
            starts.append(step + 1)
    assert starts == [10, 25, 47]  # cycles of 10, 15, 22 and 33
    assert temperatures[0] > temperatures[8] == min(temperatures[:9])
    assert 16 * 18 <= temperatures[8] <= 16 * 25
    assert temperatures[9] == 16 * 60


def test_fresh_grids_are_random_grids_of_the_alphabet():
    problem = road_problem((9, 7), tuned_axes((9, 7)), alphabet=(3, 5, 10, 15))
    words = random_words(jax.random.key(2), (4000,))
    codes = np.asarray(jax.vmap(lambda word: fresh_grid(problem, word)[0])(words))
    assert set(np.unique(codes)) == {3, 5, 10, 15}
    share = (codes == 5).mean(axis=0)
    assert abs(share - 0.25).max() < 0.05
    pairs = (codes[:, 0, 0] == codes[:, 0, 1]).mean(), (codes[:-1, 0, 0] == codes[1:, 0, 0]).mean()
    assert pairs == pytest.approx((0.25, 0.25), abs=0.05)


@pytest.mark.parametrize("shape", [(6, 7), (5, 5)])
def test_fresh_grids_are_symmetric_if_asked_for(shape):
    problem = road_problem(shape, tuned_axes(shape))
    words = random_words(jax.random.key(3), (50,))
    plain = np.asarray(jax.vmap(lambda word: fresh_grid(problem, word)[0])(words))
    grids, ranks = jax.vmap(lambda word: fresh_grid(problem, word, symmetric=True))(words)
    second = np.arange(plain[0].size).reshape(shape) > (plain[0].size - 1) / 2
    np.testing.assert_array_equal(grids, [np.where(second, rotate(grid, 2), grid) for grid in plain])
    np.testing.assert_array_equal(ranks, ranks[:, ::-1, ::-1])
    if plain[0].size % 2 == 0:
        settled = jax.vmap(repair)(grids, ranks)
        np.testing.assert_array_equal(settled, [rotate(grid, 2) for grid in settled])


def test_random_grids_start_the_search():
    """Nothing but random grids of the alphabet goes in."""
    problem = road_problem((5, 5), tuned_axes((5, 5)))
    keys = jax.random.key(4)
    expected = jax.vmap(problem.settle)(random_grids(keys, 6, (5, 5)))
    np.testing.assert_array_equal(problem.random(keys, 6), expected)
    assert (np.asarray(jax.vmap(repair)(expected)) == np.asarray(expected)).all()


def test_weights_steer():
    weights = Weights(straight_score=0, crossings=50)
    result = evolve(jax.random.key(0), (6, 6), method="ea", preset="tuned", evaluations=9600, weights=weights)
    assert oracle(np.asarray(result.best()))["crossings"] <= 2
