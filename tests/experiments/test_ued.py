"""RoadUED: its spaces are complete, its regret is exact, and its methods choose the levels that they should."""

import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from pages import blocks, run_program
from refusals import refused
from scipy import stats

from elitelanes_jax.drive import RoadNav
from elitelanes_jax.network import measure

pytest.importorskip("experiments.navigation.ppo", reason="flax and optax are not here", exc_type=ImportError)
from experiments.navigation.ued import agent, jaxued_scripts, regret, spaces, worst
from experiments.navigation.ued.methods import (
    accel,
    archive,
    domain_randomisation,
    neighbours,
    oracle,
    plr,
    sfl,
    traced,
)

CERTIFICATES = Path(__file__).parents[2] / "experiments" / "search" / "results" / "certificates.md"

RING = [[6, 5, 5, 5, 3], [10, 0, 0, 0, 10], [12, 5, 5, 5, 9]]
THETA = [[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]]


def certified(name):
    """Returns the certified numbers of networks by cyclomatic number."""
    words = " ".join(re.fullmatch(r"(\d)(x)(\d)([AB])", name).groups())
    counts = CERTIFICATES.read_text(encoding="utf-8").split("Number of flawless networks")[1]
    row = re.search(rf"^\| {words} \|(.*)\|$", counts, re.MULTILINE)[1]
    return {loops: int(cell.replace(",", "")) for loops, cell in enumerate(row.split("|"), 1) if cell.strip()}


def counted(grids):
    loops, counts = np.unique(jax.vmap(measure)(jnp.asarray(grids)).cyclomatic, return_counts=True)
    return dict(zip(loops.tolist(), counts.tolist(), strict=True))


@pytest.mark.parametrize(
    "name", ["6x6A", *(pytest.param(name, marks=pytest.mark.slow) for name in ("5x5A", "7x7A", "5x5B"))]
)
def test_spaces_have_as_many_networks_as_are_certified(name):
    networks = spaces.with_symmetry(spaces.read_networks(name))
    assert counted(networks) == certified(name)
    if name != "5x5A":
        return
    listed = spaces.list_networks(*spaces.SPACES[name])
    assert {grid.tobytes() for grid in listed} == {grid.tobytes() for grid in networks}


def test_a_changed_file_is_refused(tmp_path, monkeypatch):
    text = (spaces._FOLDER / "5x5A.txt").read_text(encoding="utf-8")
    (tmp_path / "5x5A.txt").write_text(text[:-2] + "0\n", encoding="utf-8")
    monkeypatch.setattr(spaces, "_FOLDER", tmp_path)
    with refused(tmp_path / "5x5A.txt", "others"):
        spaces.read_networks("5x5A")
    with refused("space", "'9x9A'"):
        spaces.read_networks("9x9A")


def lane_graph(grid):
    """Returns the graph of nodes (row, column, heading), side by side from the codes. Nobody turns back."""
    graph = nx.DiGraph()
    steps = [(-1, 0, 8), (0, 1, 4), (1, 0, 2), (0, -1, 1)]
    for row, column in np.ndindex(grid.shape):
        for heading in range(4):
            if not grid[row, column] & steps[(heading + 2) % 4][2]:
                continue
            for way, (down, right, bit) in enumerate(steps):
                if grid[row, column] & bit and way != (heading + 2) % 4:
                    graph.add_edge((row, column, heading), (row + down, column + right, way))
    return graph


@pytest.fixture(scope="module")
def space():
    return spaces.make_space(spaces.read_networks("5x5A"))


def test_distances_and_pairs_are_those_of_networkx(space):
    total = 0
    for number, grid in enumerate(np.asarray(space.grids)):
        away = dict(nx.all_pairs_shortest_path_length(lane_graph(grid)))
        nodes = list(zip(*(np.asarray(part)[number].tolist() for part in space.nodes), strict=True))
        distance = np.asarray(space.distance)[number]
        place = {node: nodes.index(node) for node in set(nodes)}
        assert set(place) == set(away)
        for start, goals in away.items():
            total += len(goals) - 1
            assert {goal: distance[place[start], place[goal]] for goal in goals} == goals
    assert len(space.pairs) == total == np.count_nonzero(space.distance)


def test_actions_lead_to_nodes_that_levels_have(corridor):
    """The two networks have different numbers of nodes, so one is padded."""
    assert corridor.choice.shape[1] > len(
        set(zip(*(np.asarray(part)[0].tolist() for part in corridor.nodes), strict=True))
    )
    for onward, distance in zip(np.asarray(corridor.onward), np.asarray(corridor.distance), strict=True):
        away = np.where(np.eye(len(onward), dtype=bool), 0, 999)
        for _ in range(len(away)):
            away = np.minimum(away, 1 + away[onward].min(axis=1))
        is_level = distance > 0
        np.testing.assert_array_equal(away[is_level], distance[is_level])


def driven_return(weights, levels, key, greedy):
    """Drives one episode on each level, tile by tile; returns the sums of rewards."""
    params = agent.params()
    seen, state = jax.vmap(RoadNav.reset_to_level, (None, 0, None))(key, levels, params)
    count = len(levels.grid)

    def go(carry, key):
        seen, state, total, over = carry
        row = jax.tree.map(lambda part: part[None], seen)
        head = agent.NETWORK.apply(weights, jnp.zeros((count, 0)), row, jnp.ones((1, count), bool))[1][0]
        action = head.argmax(axis=-1) if greedy else jax.random.categorical(key, head)
        done = jax.vmap(RoadNav.step, (None, 0, 0, None))(key, state, action, params)
        total += jnp.where(over, 0, done.reward)
        return (done.observation, done.state, total, over | done.terminated | done.truncated), None

    start = seen, state, jnp.zeros(count), jnp.zeros(count, bool)
    return jax.lax.scan(go, start, jax.random.split(key, agent.LIMIT))[0][2]


@pytest.mark.slow
@pytest.mark.parametrize("greedy", [True, False])
def test_regret_is_that_of_driving(space, greedy):
    levels = spaces.levels_of(space, jnp.arange(len(space.pairs)))
    weights = agent.new_agent(jax.random.key(1), levels, agent.PPO).weights
    # Wider logits, so that the policy is far from uniform.
    weights = jax.tree.map(lambda part: 3 * part, weights)
    best = 1 - 0.01 * levels.shortest
    drive = jax.jit(lambda key: driven_return(weights, levels, key, greedy))
    exact = np.asarray(regret.evaluate(weights, space, greedy=greedy).regret)
    assert exact.min() > -1e-4
    if greedy:
        np.testing.assert_allclose(exact, best - drive(jax.random.key(0)), atol=1e-4)
        return
    sampled = np.stack([best - drive(jax.random.key(number)) for number in range(16)])
    error = sampled.mean(axis=0) - exact
    deviation = sampled.std(axis=0, ddof=1) / 4
    assert abs(error.mean()) < 4 * np.sqrt((deviation**2).sum()) / len(exact)
    # A level's mean of 16 drives still has noise, so this is no more than a rough agreement level by level.
    assert np.corrcoef(sampled.mean(axis=0), exact)[0, 1] > 0.8


@pytest.mark.slow
def test_regret_to_goals_is_the_regret_of_their_levels(space):
    levels = spaces.levels_of(space, jnp.arange(len(space.pairs)))
    weights = agent.new_agent(jax.random.key(1), levels, agent.PPO).weights
    weights = jax.tree.map(lambda part: 3 * part, weights)
    network, goal = np.divmod(np.arange(space.choice.size), space.choice.shape[1])
    regrets = np.asarray(regret.regret_to_goals(weights, space, jnp.asarray(network), jnp.asarray(goal)))
    by_level = regrets.reshape(*space.choice.shape, -1).swapaxes(1, 2).reshape(-1)[np.asarray(space.pairs)]
    exact = regret.evaluate(weights, space, greedy=False).regret
    np.testing.assert_allclose(by_level, exact, atol=1e-5)
    assert exact.std() > 0.1


def test_summaries_are_means_of_the_worst(space):
    outcome = regret.Outcome(jnp.arange(len(space.pairs), dtype=jnp.float32), jnp.zeros(len(space.pairs)))
    summary, last = regret.summarise(space, outcome), len(space.pairs) - 1
    worst = -(-len(space.pairs) // 100)
    assert summary["worst"] == last and summary["mean"] == pytest.approx(last / 2)
    assert summary["cvar1"] == pytest.approx(last - (worst - 1) / 2)


# A rollout has as many decisions as in the study. In shorter ones no failed episode ends, because it takes 96 tiles, so
# that every level has the learnability 0.
PPO = agent.PPO._replace(updates=24, envs=32, minibatches=2)
# For methods that do not score levels.
SHORT = PPO._replace(steps=16)


@pytest.fixture(scope="module")
def corridor():
    """Returns levels on a ring, where nothing can be decided, and on a ring with a street across it.

    A curriculum is optimal if it has no level on the ring.
    """
    return spaces.make_space(np.array([RING, THETA], np.int8))


def learned_networks(monkeypatch, module, corridor, ppo=PPO, seed=0, **settings):
    """Trains by a method; returns the networks of the levels that it learned from, update by update."""
    networks, learn = [], module.learn

    def recording(key, learner, driven, ppo):
        networks.append(np.asarray(driven.seen.whole_map)[0])
        return learn(key, learner, driven, ppo)

    with monkeypatch.context() as patch:
        patch.setattr(module, "learn", recording)
        assert len(list(module.train(jax.random.key(seed), corridor, ppo, **settings))) == ppo.updates
    return np.array(networks)


def is_theta(networks):
    """Returns which levels have a choice."""
    return (np.asarray(networks) == THETA).all(axis=(-2, -1))


def lower_bound(samples):
    """Returns the lower end of the 95 % interval of the mean of independent samples."""
    return np.mean(samples) - stats.t.ppf(0.975, len(samples) - 1) * stats.sem(samples)


def share_in_space(corridor):
    return (np.asarray(corridor.pairs) >= corridor.distance[0].size).mean()


@pytest.mark.slow
def test_random_levels_are_uniform_and_the_oracle_leaves_the_ring_out(monkeypatch, corridor):
    uniform = is_theta(learned_networks(monkeypatch, domain_randomisation, corridor, SHORT)).mean(axis=1)
    assert uniform.mean() == pytest.approx(share_in_space(corridor), abs=0.06) and uniform.min() < 1
    assert is_theta(learned_networks(monkeypatch, oracle, corridor, SHORT)).all()


def test_goals_one_tile_apart_are_those_of_the_graph(corridor):
    is_next = neighbours.next_goals(corridor)
    for number, grid in enumerate([RING, THETA]):
        nodes = list(zip(*(np.asarray(part)[number].tolist() for part in corridor.nodes), strict=True))
        graph = lane_graph(np.array(grid))
        # A network with fewer nodes repeats its first one.
        for first, second in np.ndindex(len(set(nodes)), len(set(nodes))):
            edges = graph.has_edge(nodes[first], nodes[second]), graph.has_edge(nodes[second], nodes[first])
            assert is_next[number, first, second] == any(edges)


@pytest.mark.parametrize("known", [0.0, 0.2, 1.0])
def test_an_unknown_regret_is_the_mean_of_its_neighbours(corridor, known):
    rng = np.random.default_rng(0)
    is_level = np.asarray(corridor.distance) > 0
    is_next = neighbours.next_goals(corridor)
    table = np.where(is_level & (rng.random(is_level.shape) < known), rng.random(is_level.shape), np.nan)
    table = table.astype(np.float32)
    predicted = neighbours.predict(table, is_level, is_next)
    mean = np.nanmean(table) if known else neighbours.UNKNOWN
    for network, start, goal in np.ndindex(table.shape):
        near = [
            table[network, start, other]
            for other in np.flatnonzero(is_next[network, goal])
            if not np.isnan(table[network, start, other])
        ]
        if not np.isnan(table[network, start, goal]):
            expected = table[network, start, goal]
        elif not is_level[network, start, goal]:
            expected = 0
        else:
            expected = np.mean(near) if near else mean
        assert predicted[network, start, goal] == pytest.approx(expected, abs=1e-6)


@pytest.mark.slow
def test_predicted_regret_leaves_the_ring_out(monkeypatch, corridor):
    """A round that looks at all goals knows what the oracle knows. With few goals, most levels are not on the ring."""
    looked = []
    compute = neighbours.regret_to_goals

    def recording(weights, space, network, goal):
        looked.append(list(zip(network.tolist(), goal.tolist(), strict=True)))
        return compute(weights, space, network, goal)

    monkeypatch.setattr(neighbours, "regret_to_goals", recording)
    assert is_theta(learned_networks(monkeypatch, neighbours, corridor, SHORT, goals=1000)).all()
    goals = (np.asarray(corridor.distance) > 0).any(axis=1)
    assert all(sorted(goal) == list(zip(*map(list, goals.nonzero()), strict=True)) for goal in looked)
    for spread in (True, False):
        looked.clear()
        networks = learned_networks(monkeypatch, neighbours, corridor, SHORT, goals=8, spread=spread)
        assert lower_bound(is_theta(networks).mean(axis=1)) > share_in_space(corridor)
        assert all(len(set(goal)) == 8 and goals[tuple(zip(*goal, strict=True))].all() for goal in looked)


def test_scores_find_the_worst_levels_among_the_highest():
    regret, guess = np.arange(200.0), np.random.default_rng(0).random(200)
    # The two worst levels are sought among the ten with the highest scores.
    assert worst.find_worst(regret, regret, guess) == 1
    assert worst.find_worst(-regret, regret, guess) == 0
    assert worst.find_worst(np.where(regret == 199, 1, 0), regret, np.where(regret == 198, -1, guess)) == 0.5
    found = [worst.find_worst(np.zeros(200), regret, np.random.default_rng(seed).random(200)) for seed in range(400)]
    assert np.mean(found) == pytest.approx(0.05, abs=0.03)


def test_neighbours_are_another_start_and_goals_one_tile_away(space):
    rng = np.random.default_rng(0)
    table = np.where(np.asarray(space.distance) > 0, rng.random(space.distance.shape), np.nan)
    levels = rng.integers(len(space.pairs), size=50)
    scores = worst._neighbour_scores(table, space, levels, rng.random(50))
    levels_of = np.transpose(np.unravel_index(np.asarray(space.pairs)[levels], table.shape))
    for (network, start, goal), other, near in zip(levels_of, *scores.values(), strict=True):
        others = np.delete(table[network, :, goal], start)
        assert other in others and other != table[network, start, goal]
        is_near = [
            other_goal in space.onward[network, goal] or goal in space.onward[network, other_goal]
            for other_goal in range(table.shape[1])
        ]
        assert near == pytest.approx(np.nanmean(table[network, start, is_near]))


@pytest.mark.slow
def test_routes_are_ways_on_the_network(space):
    levels = spaces.levels_of(space, jnp.arange(len(space.pairs)))
    learner = agent.new_agent(jax.random.key(1), levels, agent.PPO)
    learner = learner._replace(weights=jax.tree.map(lambda part: 3 * part, learner.weights))
    table = worst._by_goal(space, learner)
    greedy = np.full(space.distance.shape, np.nan)
    exact = regret.evaluate(learner.weights, space, greedy=True).regret
    greedy.reshape(-1)[np.asarray(space.pairs)] = exact
    arrived = 0
    for network, goal in [(0, 3), (1, 10), (2, 20), (0, 30)]:
        route = worst._route(space, learner, table, network, goal)
        graph = lane_graph(np.array(route["codes"]))
        nodes = list(zip(*(np.asarray(part)[network].tolist() for part in space.nodes), strict=True))
        start = nodes.index(tuple(route["shortest"][0]))
        for way in (route["shortest"], route["driven"]):
            assert tuple(way[0]) == nodes[start]
            assert all(graph.has_edge(tuple(one), tuple(other)) for one, other in pairwise(way))
        assert tuple(route["shortest"][-1]) == nodes[goal]
        assert len(route["shortest"]) - 1 == space.distance[network, start, goal]
        # The greedy policy drives this way: to the goal in as many tiles, or in a loop until the limit.
        tiles = len(route["driven"]) - 1
        if tuple(route["driven"][-1]) == nodes[goal]:
            arrived += 1
            assert greedy[network, start, goal] == pytest.approx(0.01 * (tiles - len(route["shortest"]) + 1), abs=1e-4)
        else:
            assert route["driven"].count(route["driven"][-1]) == 2
            assert greedy[network, start, goal] > 1
    assert arrived < 4


def test_transitions_are_not_predicted_across_episodes():
    rng = np.random.default_rng(0)
    predicted, seen = rng.random((2, 6, 3, 5))
    ended = rng.random((6, 3)) < 0.3
    ended[:, 0] = True
    loss = np.asarray(traced.transition_loss(jnp.asarray(predicted), jnp.asarray(seen), jnp.asarray(ended)))
    for level in range(3):
        errors = [
            np.mean((predicted[step, level] - seen[step + 1, level]) ** 2)
            for step in range(5)
            if not ended[step, level]
        ]
        assert loss[level] == pytest.approx(np.mean(errors) if errors else 0, abs=1e-6)


@pytest.mark.slow
def test_the_transition_model_learns_where_decisions_lead(corridor):
    levels = spaces.levels_of(corridor, spaces.draw(jax.random.key(0), corridor, PPO.envs))
    learner = agent.new_agent(jax.random.key(0), levels, PPO)
    driven = agent.rollout(jax.random.key(1), learner, levels, PPO)
    value_loss = agent.score(driven, PPO).positive_value_loss
    predictor = traced.Predictor(jax.random.key(2), driven)
    losses = [
        float((predictor.difficulty(jax.random.key(number), driven, PPO) - value_loss).mean()) for number in range(60)
    ]
    # A model that predicts no change has this loss or more.
    seen = driven.seen.window
    same = ((seen[:-1] & 9) != (seen[1:] & 9))[~np.asarray(driven.ended[:-1])].mean() / 3
    assert losses[-1] < min(0.2 * losses[0], same)


@pytest.mark.slow
def test_learnable_levels_are_not_on_the_ring(monkeypatch, corridor):
    """Nobody fails on the ring. Half of a batch are learnable levels, and half are random.

    A method that ignores its scores chooses theta as often as the space has it.
    """
    levels = spaces.levels_of(corridor, jnp.arange(len(corridor.pairs)))
    driven = agent.rollout(jax.random.key(1), agent.new_agent(jax.random.key(0), levels, PPO), levels, PPO)
    is_learnable = np.asarray(agent.score(driven, PPO).learnability) > 0
    assert is_learnable.any() and is_theta(levels.grid)[is_learnable].all()
    chosen = []
    for seed in range(5):
        networks = learned_networks(monkeypatch, sfl, corridor, seed=seed)
        assert len(networks) == 16
        chosen.append(is_theta(networks)[:, : PPO.envs // 2].mean())
    assert lower_bound(chosen) > share_in_space(corridor)


@pytest.mark.slow
def test_the_archive_is_a_source_of_levels(monkeypatch, corridor):
    assert len(learned_networks(monkeypatch, archive, corridor, SHORT, evaluations=500)) == PPO.updates


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PLR", "robust PLR", "ACCEL", "TRACED"])
def test_levels_of_high_scores_are_replayed(monkeypatch, corridor, name):
    """Not those of high regret: no score of a rollout follows it for long, see docs/ued.md.

    A method that ignores its scores draws levels whose score is that of half of the buffer.
    """
    pytest.importorskip("jaxued")
    module = {"ACCEL": accel, "TRACED": traced}.get(name, plr)
    buffers, replays, ranks = [], [], []

    class RecordingBuffer(plr.LevelBuffer):
        def sample(self, key, count):
            buffers.append(self)
            scores = np.asarray(self.state["scores"])[: int(self.state["size"])]
            places, levels, extra = super().sample(key, count)
            replays.append(np.asarray(levels.grid))
            ranks.append(stats.percentileofscore(scores, scores[places], "mean").mean() / 100)
            return places, levels, extra

    monkeypatch.setattr(module, "LevelBuffer", RecordingBuffer)
    settings = {"robust": True} if name == "robust PLR" else {}
    networks = learned_networks(monkeypatch, module, corridor, capacity=64, **settings)
    assert len(replays) > 4 and lower_bound(ranks) > 0.5
    if name == "PLR":
        assert len(networks) == PPO.updates
    else:
        np.testing.assert_array_equal(networks, replays)
    state = buffers[-1].state
    size = int(state["size"])
    if name == "TRACED":
        # The score is the difficulty. Levels of each replay, except the last one, have its co-learnability too.
        gains = np.asarray(state["scores"] - state["levels_extra"]["difficulty"])[:size]
        learned = np.asarray(state["levels_extra"]["learned"])[:size]
        by_replay = {number: gains[learned == number] for number in np.unique(learned)}
        assert all(np.ptp(gain) < 1e-5 for gain in by_replay.values())
        assert (by_replay[traced.NEVER] == 0).all() and (by_replay[max(by_replay)] == 0).all()
        assert sum(bool(gain.any()) for gain in by_replay.values()) >= 1
        return
    # The buffer knows of each level the highest return: the best one where nothing can be decided.
    highest = np.asarray(state["levels_extra"]["highest_return"])[:size]
    best = 1 - 0.01 * np.asarray(state["levels"].shortest)[:size]
    is_ring = (np.asarray(state["levels"].grid)[:size] == RING).all(axis=(1, 2))
    assert is_ring.any()
    np.testing.assert_allclose(highest[is_ring], best[is_ring], atol=1e-5)
    assert (highest <= best + 1e-5).all()


@pytest.mark.slow
def test_edits_keep_the_task_or_make_one(corridor):
    levels = spaces.levels_of(corridor, spaces.draw(jax.random.key(0), corridor, 64))
    edited = jax.device_get(accel.edit(jax.random.key(1), levels))
    changed = (edited.grid != np.asarray(levels.grid)).any(axis=(1, 2))
    assert changed.mean() > 0.2
    for number in range(16):
        graph = lane_graph(edited.grid[number])
        start, goal = ((int(part[number]) for part in node) for node in (edited.start, edited.goal))
        assert nx.shortest_path_length(graph, tuple(start), tuple(goal)) == edited.shortest[number] > 0


@pytest.mark.slow
def test_scores_are_those_of_jaxued():
    pytest.importorskip("jaxued")
    jax.tree_map = jax.tree.map
    from jaxued import utils

    rng = np.random.default_rng(0)
    ended, numbers = rng.random((20, 6)) < 0.2, rng.random((20, 6)).astype(np.float32)
    ended[:, 0] = False
    theirs = utils.positive_value_loss(jnp.asarray(ended), jnp.asarray(numbers), incomplete_value=0.0)
    np.testing.assert_allclose(agent.episode_means(numbers, jnp.asarray(ended)), theirs, rtol=1e-5)


def test_the_maze_of_jaxued_is_road_nav(space):
    """Every action takes the turn that it takes in `RoadNav`. Then the road is followed to a choice, up to 8 tiles."""
    maze, params, key = jaxued_scripts.maze_of(space), agent.params(), jax.random.key(0)
    level = jax.tree.map(lambda part: part[0], spaces.levels_of(space, spaces.draw(jax.random.key(3), space, 1)))
    reset, step = jax.jit(maze.reset_to_level), jax.jit(maze.step)
    seen, state = reset(key, jaxued_scripts.RoadLevel(*level), maze.default_params)
    raw, raw_state = RoadNav.reset_to_level(key, level, params)
    for action in np.random.default_rng(0).integers(3, size=100):
        window, mark = (np.asarray(part)[2:-2, 2:-2] for part in (raw.window, raw.mark))
        image = np.asarray(seen.image)
        np.testing.assert_array_equal(image[..., :4] @ [8, 4, 2, 1], window)
        np.testing.assert_array_equal(image[..., 4], mark)
        assert mark.sum() == 1 and seen.agent_dir == (raw.there[2] - raw.here[2]) % 4
        seen, state, reward, over, _ = step(key, state, jnp.int32(action), maze.default_params)
        driven = 0.0
        for _ in range(8):
            done = RoadNav.step(key, raw_state, int(action), params)
            raw, raw_state, driven = done.observation, done.state, driven + float(done.reward)
            ended, action = bool(done.terminated | done.truncated), 0
            if ended or raw.ways.sum() != 1:
                break
        assert reward == pytest.approx(driven, abs=1e-5) and over == ended
        if over:
            break
    assert over and not jaxued_scripts.RoadLevel(*level).wall_map.any()


@pytest.mark.slow
def test_driving_all_levels_gives_the_regret(space):
    """On an agent without a memory, whose regret is known."""
    levels = spaces.levels_of(space, jnp.arange(len(space.pairs)))
    weights = agent.new_agent(jax.random.key(1), levels, agent.PPO).weights
    weights = jax.tree.map(lambda part: 3 * part, weights)

    def policy(weights, memory, seen, first):
        row = jax.tree.map(lambda part: part[None], seen)
        return memory, agent.NETWORK.apply(weights, memory, row, first[None])[1][0]

    maze = jaxued_scripts.RoadMaze(agent.params(), view=lambda seen: seen)
    # The lanes are no divisor of the number of levels.
    key, lanes = jax.random.key(0), jnp.zeros((500, 0))
    driven = jaxued_scripts.drive_all(key, maze, policy, weights, lanes, space, greedy=True)
    exact = regret.evaluate(weights, space, greedy=True)
    np.testing.assert_allclose(driven.regret, exact.regret, atol=1e-4)
    np.testing.assert_allclose(driven.success, exact.success, atol=1e-6)
    assert 0.05 < driven.success.mean() < 0.95
    sampled = jaxued_scripts.drive_all(key, maze, policy, weights, lanes, space, greedy=False).regret
    error = sampled - regret.evaluate(weights, space, greedy=False).regret
    assert abs(error.mean()) < 4 * stats.sem(np.asarray(error))


@pytest.mark.slow
@pytest.mark.skipif("JAXUED" not in os.environ, reason="JAXUED does not name a checkout of JaxUED")
def test_methods_of_jaxued_run_unchanged(tmp_path):
    """In a process of its own, because the checkout has another version of JaxUED."""
    command = ["--methods", "DR", "robust PLR", "--space", "5x5A", "--rounds", "4", "--seeds", "1", "--quick"]
    program = [sys.executable, "-m", "experiments.navigation.ued.jaxued_methods", *command]
    folders = ["--jaxued", os.environ["JAXUED"], "--out", str(tmp_path / "out")]
    subprocess.run([*program, *folders], check=True, cwd=CERTIFICATES.parents[3])
    lines = (tmp_path / "out" / "ued-jaxued.md").read_text(encoding="utf-8").splitlines()
    programs = [tuple(line.strip("| ").split(" | ")[:2]) for line in lines if line.startswith(("| JaxUED", "| ours"))]
    assert programs == [(program, method) for program in ("JaxUED", "ours") for method in ("DR", "robust PLR")]


@pytest.mark.slow
def test_the_method_on_the_page_runs(capsys):
    page = CERTIFICATES.parents[3] / "docs" / "ued.md"
    (program,) = (text for _, text in blocks(page.read_text(encoding="utf-8"), "python"))
    run_program(program, "docs/ued.md", capsys)
