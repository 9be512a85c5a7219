"""Which levels are the worst of an agent, and which scores find them? For agents of domain randomisation.

    python -m experiments.navigation.ued.worst [--seeds N] [--rounds N] [--space NAME] [--quick] [--out DIR]

Writes worst.md and worst.png into the folder of results, which keeps every finished seed: the same command continues.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TypedDict

import jax
import jax.numpy as jnp
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from elitelanes_jax import __version__
from elitelanes_jax.plots import road_map
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, kept, leave, open_results, require, run, save, table, whole, write
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, rollout, score, settings
from experiments.navigation.ued.methods import domain_randomisation
from experiments.navigation.ued.methods.neighbours import next_goals
from experiments.navigation.ued.methods.traced import Predictor
from experiments.navigation.ued.regret import evaluate, most_probable_actions
from experiments.navigation.ued.report import with_interval
from experiments.navigation.ued.rows import RATES
from experiments.navigation.ued.spaces import Space, draw, levels_of, open_space

SCORED, TOGETHER = 4096, 512
"""The levels that are scored, drawn uniformly, and how many a rollout has."""

LEARNED = 2
"""The rollouts from which the model of TRACED learns before it scores.

The model also learns while it scores, as in a training.
"""

WORST, HIGHEST = 0.01, 0.05
"""The share of levels that are to be found, and the share of levels with the highest scores, where they are sought."""

CHANCE = "a random number"


class Stage(TypedDict):
    """What is known of an agent after some rounds.

    Attributes:
      rounds: of the training.
      goals: the goals of the worst levels, of all levels of the space.
      found: by score, the share of the worst levels that are among those with the highest scores.
      expected: the mean value that the agent expects, of the worst levels and of all scored ones.
      highest: the mean of the highest return in a rollout, of the same.
    """

    rounds: int
    goals: int
    found: dict[str, float]
    expected: list[float]
    highest: list[float]


class Route(TypedDict):
    """A level that the agent fails, and the nodes (row, column, heading) of two ways from its start.

    Attributes:
      codes: rows of the network's tile codes.
      shortest: a shortest way to the goal.
      driven: where the most probable actions lead, until a node comes again.
    """

    codes: list[list[int]]
    shortest: list[list[int]]
    driven: list[list[int]]


class Study(TypedDict):
    """The study of one seed: its stages, and of its last agent the mean regret of each goal, and two levels."""

    stages: list[Stage]
    goals: list[float]
    routes: list[Route]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("worst", __doc__)
    parser.add_argument("--seeds", type=whole(1, 1000), default=5, metavar="N", help="agents; default 5")
    parser.add_argument("--rounds", type=whole(10, 10_000), default=60, metavar="N", help="of driving; default 60")
    parser.add_argument("--space", default="6x6A", choices=("5x5A", "6x6A"), help="default 6x6A")
    parser.add_argument("--out", type=Path, default=Path("results/ued-worst"), metavar="DIR")
    parser.add_argument("--quick", action="store_true", help="few levels side by side, to test the program")
    options = parser.parse_args(arguments)
    return run("worst", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax", "jaxued")
    ppo = settings(options.rounds, quick=options.quick)._replace(rate=RATES["domain randomisation"])
    about = {"program": "ued-worst", "version": __version__, "space": options.space, "ppo": ppo._asdict()}
    open_results(options.out, about)
    use_compile_cache()
    studies = []
    for seed in range(options.seeds):
        make = partial(study_worst, seed, options.space, ppo)
        studies.append(kept(options.out / "seeds" / f"{seed}.json", make))
        print(f"seed {seed}: {studies[-1]['stages']}", flush=True)
    write(options.out / "worst.md", _report(studies))
    save(_picture(studies), options.out / "worst.png")
    print(options.out / "worst.md")


def study_worst(seed: int, space_name: str, ppo: Ppo) -> Study:
    """Trains an agent, and looks for its worst levels at three stages of the training."""
    space = open_space(space_name)
    agents = list(domain_randomisation.train(jax.random.key(seed), space, ppo))
    stages = [ppo.updates // 10, ppo.updates // 3, ppo.updates]
    results: list[Stage] = []
    for rounds in stages:
        key = jax.random.fold_in(jax.random.key(seed), rounds)
        results.append(_study_stage(key, agents[rounds - 1], space, ppo, rounds))
    regret = _by_goal(space, agents[-1])
    starts = (~np.isnan(regret)).sum(axis=1)
    means = np.nansum(regret, axis=1) / np.maximum(starts, 1)
    worst = np.argsort(-means.reshape(-1))[:2]
    return {
        "stages": results,
        "goals": means[starts > 0].round(4).tolist(),
        "routes": [_route(space, agents[-1], regret, *np.divmod(goal, means.shape[1])) for goal in worst],
    }


def _study_stage(key: jax.Array, agent: Agent, space: Space, ppo: Ppo, rounds: int) -> Stage:
    drawing, scoring, guessing = jax.random.split(key, 3)
    regret = _by_goal(space, agent)
    pairs = np.asarray(space.pairs)
    of_level = regret.reshape(-1)[pairs]
    count = regret.shape[1]
    # A level's goal is its network and its last node.
    goal = pairs // count**2 * count + pairs % count
    goals_of_worst = np.unique(goal[np.argsort(-of_level)[: int(len(pairs) * WORST)]])
    levels = np.asarray(draw(drawing, space, SCORED))
    guess = np.asarray(jax.random.uniform(guessing, (SCORED,)))
    scores = _rollout_scores(scoring, agent, space, levels, ppo) | _neighbour_scores(regret, space, levels, guess)
    scores[CHANCE] = guess
    expected, highest = scores.pop("value"), scores.pop("highest return")
    # Few rollouts end no episode. These have no return.
    highest = np.where(np.isfinite(highest), highest, np.nan)
    worst = np.argsort(-of_level[levels])[: int(SCORED * WORST)]
    return {
        "rounds": rounds,
        "goals": len(goals_of_worst),
        "found": {name: find_worst(values, of_level[levels], guess) for name, values in scores.items()},
        "expected": [float(expected[worst].mean()), float(expected.mean())],
        "highest": [float(np.nanmean(highest[worst])), float(np.nanmean(highest))],
    }


def find_worst(score: np.ndarray, regret: np.ndarray, guess: np.ndarray) -> float:
    """Returns the share of the worst levels that are among the levels with the highest scores.

    Args:
      score: float ``[B]``.
      regret: the exact regret, float ``[B]``.
      guess: random numbers that decide between levels of one score, float ``[B]``.
    """
    worst = np.argsort(-regret)[: int(len(regret) * WORST)]
    highest = np.lexsort((guess, score))[::-1][: int(len(regret) * HIGHEST)]
    return float(np.isin(worst, highest).mean())


def _by_goal(space: Space, agent: Agent) -> Float[np.ndarray, "G N N"]:
    """Returns the exact regret by network, start and goal; NaN where a pair is no level."""
    regret = np.full(space.distance.shape, np.nan)
    regret.reshape(-1)[np.asarray(space.pairs)] = evaluate(agent.weights, space, greedy=False).regret
    return regret


def _rollout_scores(key: jax.Array, agent: Agent, space: Space, levels: np.ndarray, ppo: Ppo) -> dict[str, np.ndarray]:
    """Scores levels by a rollout on each of them."""
    # Each level counts once for the model of transitions.
    wide = ppo._replace(envs=TOGETHER, epochs=1)
    drives = []
    for number, part in enumerate(np.split(levels, len(levels) // TOGETHER)):
        drives.append(rollout(jax.random.fold_in(key, number), agent, levels_of(space, jnp.asarray(part)), ppo))
    scores = [score(driven, ppo) for driven in drives]
    predictor = Predictor(key, drives[0])
    for driven in drives[:LEARNED]:
        predictor.difficulty(key, driven, wide)
    difficulty = [predictor.difficulty(key, driven, wide) for driven in drives]
    max_mc = np.concatenate([part.max_mc for part in scores])
    return {
        "value": np.concatenate([driven.value.mean(axis=0) for driven in drives]),
        "highest return": np.concatenate([part.highest_return for part in scores]),
        "positive value loss": np.concatenate([part.positive_value_loss for part in scores]),
        "MaxMC": max_mc,
        "MaxMC with the other sign": -max_mc,
        "learnability": np.concatenate([part.learnability for part in scores]),
        "difficulty of TRACED": np.concatenate(difficulty),
    }


def _neighbour_scores(
    regret: Float[np.ndarray, "G N N"], space: Space, levels: np.ndarray, guess: np.ndarray
) -> dict[str, np.ndarray]:
    """Scores levels by the exact regret of a neighbour: another start, or a goal one tile away."""
    count = regret.shape[1]
    network, pair = np.divmod(np.asarray(space.pairs)[levels], count**2)
    start, goal = np.divmod(pair, count)
    to_goal = regret[network, :, goal]  # [B, N]
    is_other = ~np.isnan(to_goal) & (np.arange(count) != start[:, None])
    # The one at a random place among the other starts.
    place = (guess * is_other.sum(axis=1)).astype(int)
    other = (is_other.cumsum(axis=1) > place[:, None]).argmax(axis=1)
    near = np.where(next_goals(space)[network, goal], regret[network, start], np.nan)
    known = ~np.isnan(near)
    return {
        "regret from another start": np.nan_to_num(to_goal[np.arange(len(levels)), other]),
        "regret to goals one tile away": np.nansum(near, axis=1) / np.maximum(known.sum(axis=1), 1),
    }


def _route(space: Space, agent: Agent, regret: Float[np.ndarray, "G N N"], network: int, goal: int) -> Route:
    """Returns the ways to a goal from the nearest start whose regret is at least 95 % of the goal's highest."""
    distance, onward = np.asarray(space.distance[network]), np.asarray(space.onward[network])
    of_start = np.nan_to_num(regret[network, :, goal])
    start = int(np.where(of_start >= 0.95 * of_start.max(), distance[:, goal], distance.max() + 1).argmin())
    shortest, driven = [start], [start]
    while shortest[-1] != goal:
        after = onward[shortest[-1]]
        # The goal has no distance to itself.
        shortest.append(min(after.tolist(), key=lambda node: -1 if node == goal else distance[node, goal]))
    actions = most_probable_actions(agent.weights, space, network, goal)
    while driven.count(driven[-1]) < 2 and driven[-1] != goal:
        driven.append(int(onward[driven[-1], actions[driven[-1]]]))
    nodes = np.stack([np.asarray(part[network]) for part in space.nodes], axis=1)
    return {
        "codes": np.asarray(space.grids[network]).tolist(),
        "shortest": nodes[shortest].tolist(),
        "driven": nodes[driven].tolist(),
    }


def _report(studies: list[Study]) -> str:
    stages = [stage["rounds"] for stage in studies[0]["stages"]]
    lines = []
    for name in studies[0]["stages"][0]["found"]:
        by_stage = [[study["stages"][at]["found"][name] for study in studies] for at in range(len(stages))]
        lines.append([name, *(with_interval(shares, 2) for shares in by_stage)])
    goals = [[float(study["stages"][at]["goals"]) for study in studies] for at in range(len(stages))]
    count = len(studies[0]["goals"])
    lines.append([f"goals of the worst levels, of {count:,}", *(with_interval(numbers, 0) for numbers in goals)])
    for at_level, which in enumerate(("the worst levels", "all levels")):
        for name, words in (("expected", "the value that the agent expects"), ("highest", "the highest return")):
            by_stage = [[study["stages"][at][name][at_level] for study in studies] for at in range(len(stages))]  # type: ignore[literal-required]
            lines.append([f"{words}, {which}", *(with_interval(numbers, 2) for numbers in by_stage)])
    words = (
        "The share of the worst 1 % of levels that are among the 5 % with the highest scores. The columns are rounds of"
        f" domain randomisation. Means of {len(studies)} agents, and 95 % intervals.\n\n"
    )
    return "# The worst levels\n\n" + words + table(["score", *map(str, stages)], lines)


def _picture(studies: list[Study]) -> Figure:
    plot, axes = plt.subplots(1, 4, figsize=(14, 3.8), width_ratios=(1, 1, 1.1, 1.2), layout="constrained")
    for ax, route in zip(axes, studies[0]["routes"], strict=False):
        _draw_route(ax, route)
    handles = [line for line in axes[0].lines if not line.get_label().startswith("_")]
    axes[0].legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0), ncol=2, fontsize=8, frameon=False)
    for study in studies:
        goals = np.sort(study["goals"])[::-1]
        axes[2].plot(100 * np.arange(1, len(goals) + 1) / len(goals), goals, linewidth=1)
    axes[2].set(xscale="log", xlabel="% of goals, the worst first", ylabel="mean regret from all starts")
    axes[2].set_xticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
    axes[2].set_title("regret by goal, a line for each agent", fontsize=9)
    axes[2].grid(alpha=0.3)
    _draw_found(axes[3], studies)
    return plot


def _draw_found(ax: Axes, studies: list[Study]) -> None:
    middle = [study["stages"][1] for study in studies]
    names = list(middle[0]["found"])[::-1]
    values = [np.mean([stage["found"][name] for stage in middle]) for name in names]
    colours = ["tab:green" if name.startswith("regret") else "0.6" for name in names]
    ax.barh(names, values, color=colours)
    ax.axvline(HIGHEST, color="black", linewidth=0.8, linestyle=":")
    ax.set(xlim=(0, 1), xlabel="share found")
    ax.set_title(f"worst 1 % of levels found in the highest 5 %, round {middle[0]['rounds']}", fontsize=9, loc="right")
    ax.tick_params(axis="y", labelsize=8)


def _draw_route(ax: Axes, route: Route) -> None:
    road_map(route["codes"], ax=ax, lanes=False)
    # The two ways are drawn beside each other.
    for way, label, colour, middle in (
        (route["shortest"], "shortest way", "tab:green", 0.6),
        (route["driven"], "driven, for ever", "tab:red", 0.4),
    ):
        rows, columns = (np.array([node[axis] for node in way]) + middle for axis in (0, 1))
        ax.plot(columns, rows, color=colour, linewidth=2, label=label)
    start = route["shortest"][0]
    ax.plot(start[1] + 0.5, start[0] + 0.5, "o", color="white", markeredgecolor="black", markersize=8, label="start")
    row, column, heading = route["shortest"][-1]
    marker = "^>v<"[heading]
    ax.plot(column + 0.5, row + 0.5, marker, color="gold", markeredgecolor="black", markersize=12, label="goal")


if __name__ == "__main__":
    leave(main())
