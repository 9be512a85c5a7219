"""Do robots that learn to share a town block each other less often than robots that follow rules?

    python -m experiments.gridlock.sharing [--updates N] [--runs N] [--out DIR]

README.md has the question and the hypotheses. They were committed before the first run on the towns of the test.
"""

import json
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jaxtyping import Array, ArrayLike, Bool, Float32, Float64, Int, Key
from numpy.typing import NDArray

from elitelanes_jax import evolve
from elitelanes_jax.drive import RoadTraffic, RoadTrafficParams, TrafficLevels, make_traffic_levels
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, Pytree, kept, leave, open_results, run, table, whole, write
from experiments.navigation.ppo import Driven, Driver, Ppo, begin, distribution, learn

__all__ = ["POLICIES", "TOWNS", "Outcome", "drive", "main", "options_of", "ratio", "summarize", "train"]

WAIT = 3
"""The action that is no turn: 0 right, 1 straight, 2 left."""

TOWNS = Path(__file__).parent / "results" / "shared_towns.json"
"""The codes of the towns of training, and of those of the test."""

SIDE, COUNT, STEPS, RUNS, SEEDS = 8, 40, 300, 20, 3
"""Rows and columns of a town, towns of training and of the test, steps of a run, runs in a town, trained policies."""

FEW, MANY = 24, 32
"""The robots of the test, and those of further runs and of training: with more robots, more gridlocks teach."""

PPO = Ppo(updates=300, envs=COUNT, steps=64, epochs=3, discount=0.99, entropy=0.003)

EPISODE, GRIDLOCK, TILE = 320, -10.0, 0.1
"""The steps of an episode of training, and the rewards of a gridlock and of a tile nearer to the goal."""

Policy: TypeAlias = Callable[..., Array]
"""Maps a key and what R robots see to their choices, int32 ``[R]``."""

Runs: TypeAlias = dict[str, list[list[list[int]]]]
"""The fields of `Outcome` by run and town, for each number of robots."""

RESAMPLES = 9999


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("sharing", __doc__)
    parser.add_argument("--updates", type=whole(1, 100_000), default=PPO.updates, metavar="N", help="of each training")
    parser.add_argument("--runs", type=whole(1, 1000), default=RUNS, metavar="N", help="runs of a policy in a town")
    parser.add_argument("--out", type=Path, default=Path("results/sharing"), metavar="DIR", help="folder of results")
    options = parser.parse_args(arguments)
    return run("sharing", lambda: _study(options))


def _study(options: Namespace) -> None:
    use_compile_cache()
    open_results(options.out, {"updates": options.updates, "runs": options.runs})
    towns = kept(TOWNS, make_shared_towns)
    train_towns, test_towns = (make_traffic_levels(np.array(towns[half])) for half in ("train", "test"))
    runs = dict[str, Runs]()
    for name in POLICIES:
        file = options.out / "runs" / f"{name.replace(' ', '-')}.json"
        runs[name] = kept(file, partial(_runs_of, name, train_towns, test_towns, options))
    summary = {str(robots): summarize(runs, robots) for robots in (FEW, MANY)}
    write(options.out / "sharing.json", json.dumps(summary, indent=1) + "\n")
    tables = [f"**{robots} robots**\n\n{_table(figures)}" for robots, figures in summary.items()]
    write(options.out / "sharing.md", "\n".join(tables))


def _runs_of(name: str, train_towns: TrafficLevels, test_towns: TrafficLevels, options: Namespace) -> Runs:
    """Drives with a policy, which is trained before if it has to learn."""
    rule, policy = POLICIES[name]
    weights: list[Pytree] = []
    if policy is learned:
        weights = [train(jax.random.key(int(name[-1])), train_towns, PPO._replace(updates=options.updates))]
    keys = jax.random.split(jax.random.key(1000), options.runs)

    def drive_all(robots: int) -> Outcome:
        params = options_of(test_towns, rule, robots)
        levels = jnp.arange(len(test_towns.grid))
        of_town = partial(drive, policy=policy)
        return jax.vmap(lambda key: jax.vmap(lambda level: of_town(key, level, params, *weights))(levels))(keys)

    return {str(robots): [field.tolist() for field in drive_all(robots)] for robots in (FEW, MANY)}


def make_shared_towns() -> dict[str, list[list[list[int]]]]:
    """Makes towns of the style `town` with two crossings or more, in two halves."""
    keys = jax.random.split(jax.random.key(78), 16)
    result = evolve(keys, (SIDE, SIDE), style="town", where="crossings=2..", evaluations=20_000)
    grids = [road_map.codes.tolist() for road_map in result.choose(2 * COUNT).maps]
    order = np.random.default_rng(0).permutation(2 * COUNT)
    return {"train": [grids[index] for index in order[:COUNT]], "test": [grids[index] for index in order[COUNT:]]}


def options_of(towns: TrafficLevels, rule: str, robots: int, **more: bool) -> RoadTrafficParams:
    """Returns the options of a run. By default a gridlock does not end the run."""
    options: Pytree = {"rule": rule, "ends_in_gridlock": False, "limit": 2**20} | more
    return RoadTrafficParams(towns, robots=robots, gridlock_cost=-GRIDLOCK, progress_reward=TILE, **options)


def _least(costs: Float32[Array, "R 3"], seen: Pytree) -> Array:
    """Chooses the turn of least cost. A robot that cannot move waits."""
    turns = seen.allowed[:, :WAIT]
    return jnp.where(turns.any(axis=1), jnp.argmin(jnp.where(turns, costs, jnp.inf), axis=1), WAIT)


def shortest(key: Array, seen: Pytree) -> Array:
    """Drives by shortest ways."""
    return _least(seen.detour, seen)


def random_turns(key: Array, seen: Pytree) -> Array:
    """Turns at random."""
    return _least(jax.random.uniform(key, seen.closes.shape), seen)


def around_full_streets(key: Array, seen: Pytree) -> Array:
    """Takes the turn of least tiles, where a full street counts 16: of 4, 8, 16, 24 and 32 this gave the most goals."""
    return _least(seen.detour + 16 * seen.load, seen)


def with_room(key: Array, seen: Pytree) -> Array:
    """Drives in the same way, but does not take the last lane of a street of two lanes or more."""
    robots = seen.next_load * seen.next_slots
    fills = seen.at_crossing & (seen.next_slots > 1.5) & (robots + 1.5 > seen.next_slots)
    return jnp.where(fills, WAIT, around_full_streets(key, seen))


def along_the_line(key: Array, seen: Pytree) -> Array:
    """Drives by shortest ways, but not into a lane and turn that would close a line of waiting robots."""
    turn = _least(seen.detour + 1000 * seen.closes, seen)
    closes = jnp.take_along_axis(jnp.pad(seen.closes, ((0, 0), (0, 1))), turn[:, None], axis=1)[:, 0]
    return jnp.where(closes, WAIT, turn)


class Robots(nn.Module):
    """The policy of each robot, with two hidden layers. It has no memory."""

    memory: int = 0

    @nn.compact
    def __call__(self, memory: Array, seen: tuple[Array, Array], first: Array) -> tuple[Array, Array, Array]:
        """Returns the outputs of `ppo.Network` for what `features` returns."""
        features, allowed = seen
        policy, value = (nn.tanh(nn.Dense(64)(nn.tanh(nn.Dense(64)(features)))) for _ in range(2))
        logits = nn.Dense(4, kernel_init=nn.initializers.orthogonal(0.01))(policy)
        return memory, jnp.where(allowed, logits, -1e9), nn.Dense(1)(value)[..., 0]


def features(seen: Pytree) -> tuple[Float32[Array, "R 25"], Bool[Array, "R 4"]]:
    """Returns what the policy sees: the streets ahead, not the line of waiting robots, and the possible choices.

    Its numbers are about 1 at most: tiles are divided by 8, steps by 16, and slots and robots by 4.
    """
    waited = seen.waited.clip(0, 16) / 16
    crossings = seen.at_crossing, seen.next_at_crossing
    here = [seen.goal_distance / 8, *crossings, waited, seen.next_load, seen.next_slots / 4, seen.next_robots / 4]
    detour = seen.detour.clip(0, 32) / 8
    turns = [detour, seen.taken, seen.load, seen.slots / 4, seen.least_load, seen.most_load]
    columns = [jnp.asarray(field, jnp.float32) for field in (*here, *jnp.concatenate(turns, axis=1).T)]
    return jnp.stack(columns, axis=1), seen.allowed


def learned(key: Array, seen: Pytree, weights: Pytree) -> Array:
    """Draws choices from the policy with these weights."""
    outputs: Pytree = Robots().apply(weights, jnp.zeros((1, 0)), _row(features(seen)), jnp.zeros((1, 1), bool))
    return jax.random.categorical(key, outputs[1][0])


POLICIES: dict[str, tuple[str, Policy]] = {
    "all-way stop": ("allway_stop", shortest),
    "right before left": ("right_before_left", shortest),
    "random turns": ("allway_stop", random_turns),
    "around full streets": ("allway_stop", around_full_streets),
    "with room": ("allway_stop", with_room),
    "along the line": ("allway_stop", along_the_line),
    **{f"learned {seed}": ("allway_stop", learned) for seed in range(SEEDS)},
}
"""The rule at crossings and the choices of the robots, by name."""


def train(key: Key[Array, ""], towns: TrafficLevels, ppo: Ppo) -> Pytree:
    """Trains the policy of all robots by PPO; returns its weights. The key is consumed.

    A robot gets 0.1 for each tile nearer to its goal. A gridlock ends the episode, and costs 10 for each robot in it.
    """
    starting, learning = jax.random.split(key)
    params = options_of(towns, "allway_stop", MANY, ends_in_gridlock=True)
    seen, traffic = _begin(starting, jnp.arange(ppo.envs), params)
    driver = begin(starting, _see_all(seen), traffic, Robots(), ppo)
    for update in range(ppo.updates):
        driver = _update(jax.random.fold_in(learning, update), driver, params, ppo)
    return driver.weights


def _begin(key: Array, levels: Array, params: RoadTrafficParams) -> tuple[Pytree, Pytree]:
    """Returns the observations and the states of new episodes."""
    keys = jax.random.split(key, len(levels))
    return jax.vmap(RoadTraffic.reset_to_level, (0, 0, None))(keys, levels, params)


def _see_all(seen: Pytree) -> Pytree:
    """Returns the features of the robots of all towns, as one batch of robots."""
    return jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), jax.vmap(features)(seen))


@partial(jax.jit, static_argnames="ppo")
def _update(key: Array, driver: Driver, params: RoadTrafficParams, ppo: Ppo) -> Driver:
    driving, learning, placing = jax.random.split(key, 3)

    def look(seen: Pytree) -> Pytree:
        return Robots().apply(driver.weights, driver.memory, _row(seen), driver.first[None])

    def step(carry: tuple[Pytree, Pytree], key: Array) -> tuple[Pytree, Driven]:
        traffic, seen = carry
        choosing, going, starting = jax.random.split(key, 3)
        _, head, value = look(seen)
        draw, chance_of, _ = distribution(head[0], discrete=True)
        choice = draw(choosing)
        keys = jax.random.split(going, ppo.envs)
        done = jax.vmap(RoadTraffic.step, (0, 0, 0, None))(keys, traffic, choice.reshape(ppo.envs, MANY), params)
        after, ended = _place_again(starting, params, done.state, done.terminated), jnp.repeat(done.terminated, MANY)
        chance = chance_of(choice)
        driven = Driven(seen, driver.first, choice, chance, value[0], value[0], done.reward.ravel(), ended, ended)
        return (after, _see_all(_look_at(after, params))), driven

    (traffic, seen), driven = jax.lax.scan(step, (driver.states, driver.seen), jax.random.split(driving, ppo.steps))
    # Within an update only a gridlock ends an episode. So what comes after a step is what the next step begins with.
    driven = driven._replace(after=jnp.concatenate([driven.value[1:], look(seen)[2]]))
    learner = driver.weights, driver.optimizer, driver.memory
    weights, optimizer = learn(learning, *learner, driven, Robots(), ppo, discrete=True)
    traffic = _place_again(placing, params, traffic, traffic.steps >= EPISODE)
    return driver._replace(
        weights=weights, optimizer=optimizer, states=traffic, seen=_see_all(_look_at(traffic, params))
    )


def _look_at(traffic: Pytree, params: RoadTrafficParams) -> Pytree:
    """Returns the observations of the robots of all towns."""
    return jax.vmap(RoadTraffic.observe, (0, None))(traffic, params)


def _row(tree: Pytree) -> Pytree:
    return jax.tree.map(lambda x: x[None], tree)


def _place_again(key: Array, params: RoadTrafficParams, traffic: Pytree, over: Array) -> Pytree:
    """Places robots anew in the towns whose episode is over."""
    _, new = _begin(key, traffic.level, params)
    return jax.tree.map(lambda a, b: jnp.where(over.reshape(-1, *[1] * (a.ndim - 1)), a, b), new, traffic)


class Outcome(NamedTuple):
    """What happened in a run: the steps without gridlock, the goals reached in these steps, and all goals."""

    steps: Array
    goals_before: Array
    goals: Array


@partial(jax.jit, static_argnames=("policy", "steps"))
def drive(
    key: Key[Array, ""],
    level: Int[ArrayLike, ""],
    params: RoadTrafficParams,
    *more: Pytree,
    policy: Policy,
    steps: int = STEPS,
) -> Outcome:
    """Drives robots through a town; the key is consumed. The policy also gets `more`."""
    placing, driving = jax.random.split(key)

    def step(carry: tuple[Pytree, Pytree, Outcome], key: Array) -> tuple[tuple[Pytree, Pytree, Outcome], None]:
        seen, traffic, outcome = carry
        choosing, going = jax.random.split(key)
        is_free = ~traffic.gridlocked.any()
        done = RoadTraffic.step(going, traffic, policy(choosing, seen, *more), params)
        goals = done.info.reached.sum(dtype=jnp.int32)
        counts = is_free, is_free * goals, goals
        outcome = Outcome(*(x + y for x, y in zip(outcome, counts, strict=True)))
        return (done.observation, done.state, outcome), None

    start = RoadTraffic.reset_to_level(placing, level, params)
    carry = *start, Outcome(*[jnp.int32(0)] * 3)
    return jax.lax.scan(step, carry, jax.random.split(driving, steps))[0][2]


def ratio(values: Float64[np.ndarray, " N"], others: Float64[np.ndarray, " N"]) -> list[float]:
    """Returns the ratio of two sums over towns, and its 95 % interval: a percentile bootstrap over towns."""
    drawn = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    below = others[drawn].sum(axis=1)
    ratios = np.where(below > 0, values[drawn].sum(axis=1) / np.maximum(below, 1e-9), np.inf)
    return [
        float(values.sum() / max(others.sum(), 1e-9)),
        *np.percentile(ratios, [2.5, 97.5], method="nearest").tolist(),
    ]


def summarize(runs: Mapping[str, Runs], robots: int) -> dict[str, dict[str, object]]:
    """Returns figures of each policy: all policies that learned are one.

    "gridlocks" is the share of runs with a gridlock, and "by_policy" that of each policy. "goals" are those of 1000
    steps of a robot, "goals_before" only count steps without gridlock. Ratios have their 95 % intervals.
    """
    outcomes = dict[str, NDArray[np.float64]]()
    for name in runs:
        outcome = np.array(runs[name][str(robots)], np.float64)
        group = name.split(" ")[0] if POLICIES[name][1] is learned else name
        # Runs of policies that learned are put together, town by town.
        outcomes[group] = np.concatenate([outcomes[group], outcome], axis=1) if group in outcomes else outcome
    per_town = {
        name: ((steps < STEPS).mean(axis=0), goals.mean(axis=0)) for name, (steps, _, goals) in outcomes.items()
    }
    summary = dict[str, dict[str, object]]()
    for name, (steps, goals_before, goals) in outcomes.items():
        summary[name] = {
            "gridlocks": (steps < STEPS).mean(),
            "goals": 1000 * goals.mean() / STEPS / robots,
            "goals_before": 1000 * goals_before.sum() / steps.sum() / robots,
        }
        for other in ("all-way stop", "around full streets"):
            gridlocks, goals_ratio = map(ratio, per_town[name], per_town[other])
            summary[name] |= {f"gridlocks / {other}": gridlocks, f"goals / {other}": goals_ratio}
    return summary


def _table(summary: Mapping[str, Mapping[str, Any]]) -> str:
    head = ("policy", "runs in gridlock", "ratio, 95 %", "goals", "ratio, 95 %", "goals before gridlock")
    rows = []
    for name, figures in summary.items():
        gridlocks, goals = "", ""
        if name != "all-way stop":
            ratios = [figures[f"{what} / all-way stop"] for what in ("gridlocks", "goals")]
            gridlocks, goals = (f"{value:.2f} ({low:.2f} to {high:.2f})" for value, low, high in ratios)
        numbers = [f"{figures['goals']:.1f}", goals, f"{figures['goals_before']:.1f}"]
        rows.append((name, f"{100 * figures['gridlocks']:.1f} %", gridlocks, *numbers))
    return table(head, rows)


if __name__ == "__main__":
    leave(main())
