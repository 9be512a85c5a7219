"""Rows of the table, one of a method and a seed, and the study of scores: what is run, and what is kept of it."""

import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import TypedDict

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from elitelanes_jax import evolve
from elitelanes_jax.network import measure
from experiments.navigation.maps import human_maps
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, new_agent, rollout, score
from experiments.navigation.ued.methods import accel, archive, domain_randomisation, oracle, plr, sfl
from experiments.navigation.ued.regret import Summary, evaluate, summarise
from experiments.navigation.ued.spaces import Space, draw, levels_of, make_space, read_networks

__all__ = ["METHODS", "Row", "Stage", "open_space", "run_row", "study_scores"]

METHODS: dict[str, Callable[..., Iterator[Agent]]] = {
    "domain randomisation": domain_randomisation.train,
    "PLR": plr.train,
    "robust PLR": plr.robust_train,
    "ACCEL": accel.train,
    "SFL": sfl.train,
    "archive": archive.train,
    "oracle": oracle.train,
}
"""The methods by the names in the table."""

TIMES = 4
"""The times in a training at which the regret is computed, at equal distances, the end included."""

_HUMAN = Path(__file__).parents[3] / ".venv-duckietown"  # of make duckietown; people's maps are tests where it is
_STRAIGHT_BINS = 10


class Row(TypedDict):
    """The figures of a method and a seed.

    Attributes:
      curve: by the number of rounds, figures of the policy that draws its actions.
      greedy: figures at the end, of the most probable actions.
      quantiles: 101 quantiles of the regret of all levels at the end, of the policy that draws its actions.
      unseen: figures at the end on maps outside the space, by their name.
      seconds: of training and of one evaluation.
    """

    curve: dict[str, Summary]
    greedy: Summary
    quantiles: list[float]
    unseen: dict[str, Summary]
    seconds: dict[str, float]


class Stage(TypedDict):
    """The study of scores at one stage: Spearman's rank correlation with the exact regret, by score."""

    rounds: int
    mean_regret: float
    correlation: dict[str, float]


@cache
def open_space(name: str) -> Space:
    """Makes a space, once."""
    return make_space(read_networks(name))


@cache
def _unseen() -> dict[str, Space]:
    """Returns the maps outside the space: towns of 9 x 9 tiles, and people's maps of up to 8 x 8 where they are."""
    towns = evolve(0, (9, 9), style="town", seeds=2, evaluations=20_000, progress=False).maps(8)
    spaces = {"towns of 9 x 9": make_space(np.stack([town.codes for town in towns]))}
    folder = next(_HUMAN.glob("lib/*/site-packages/duckietown_world/data/gd1/maps"), None)
    if folder is not None:
        spaces["people's maps"] = make_space(human_maps(folder))
    return spaces


def run_row(method: str, seed: int, space_name: str, ppo: Ppo, *, unseen: bool = True) -> Row:
    """Trains an agent by a method, and evaluates it."""
    space = open_space(space_name)
    at = {ppo.updates * (time + 1) // TIMES for time in range(TIMES)}
    curve: dict[str, Summary] = {}
    evaluating, began = 0.0, time.perf_counter()
    for number, agent in enumerate(METHODS[method](jax.random.key(seed), space, ppo), 1):
        if number in at:
            started = time.perf_counter()
            outcome = evaluate(agent.weights, space, greedy=False)
            curve[str(number)] = summarise(space, outcome)
            evaluating += time.perf_counter() - started
    training = time.perf_counter() - began - evaluating
    return {
        "curve": curve,
        "greedy": summarise(space, evaluate(agent.weights, space, greedy=True)),
        "quantiles": np.quantile(np.asarray(outcome.regret), np.linspace(0, 1, 101)).round(5).tolist(),
        "unseen": {
            name: summarise(maps, evaluate(agent.weights, maps, greedy=False))
            for name, maps in (_unseen() if unseen else {}).items()
        },
        "seconds": {"training": training, "evaluation": evaluating / len(curve)},
    }


def study_scores(seed: int, space_name: str, ppo: Ppo) -> list[Stage]:
    """Scores every level of a space at several stages of a training by domain randomisation.

    Each level gets one rollout of ``ppo.steps`` decisions, as it does in the methods. Niches are scored by the mean
    regret of an agent with the same seed plus 1000 and half of the training, so that no level scores itself.
    """
    space = open_space(space_name)
    niche = _niches(space)
    *_, other = domain_randomisation.train(jax.random.key(1000 + seed), space, ppo._replace(updates=ppo.updates // 2))
    other_regret = np.asarray(evaluate(other.weights, space, greedy=False).regret, np.float64)
    niche_mean = np.bincount(niche, other_regret) / np.maximum(np.bincount(niche), 1)
    stages = [0, ppo.updates // 10, ppo.updates // 3, ppo.updates]
    start = new_agent(jax.random.key(seed), levels_of(space, draw(jax.random.key(seed), space, ppo.envs)), ppo)
    agents = [start, *domain_randomisation.train(jax.random.key(seed), space, ppo)]
    results: list[Stage] = []
    for rounds in stages:
        outcome = evaluate(agents[rounds].weights, space, greedy=False)
        regret, success = np.asarray(outcome.regret), np.asarray(outcome.success)
        scores = _score_all(jax.random.key(seed), agents[rounds], space, ppo)
        scores |= {"exact learnability": success * (1 - success), "niche": niche_mean[niche]}
        correlation = {name: float(stats.spearmanr(scores[name], regret).statistic) for name in scores}
        results.append({"rounds": rounds, "mean_regret": float(regret.mean()), "correlation": correlation})
    return results


def _niches(space: Space) -> np.ndarray:
    """Returns the niche of each level: its network's cyclomatic number and share of straights."""
    metrics = jax.vmap(measure)(space.grids)
    filled = (np.asarray(space.grids) > 0).sum(axis=(1, 2))
    share = np.isin(np.asarray(space.grids), (5, 10)).sum(axis=(1, 2)) / filled
    niche = np.asarray(metrics.cyclomatic) * _STRAIGHT_BINS + (share * _STRAIGHT_BINS).astype(int)
    return niche[np.asarray(space.pairs) // space.choice.shape[1] ** 2]


def _score_all(key: jax.Array, agent: Agent, space: Space, ppo: Ppo) -> dict[str, np.ndarray]:
    """Scores every level by one rollout."""
    count, together = len(space.pairs), 2048
    parts = []
    for first in range(0, count, together):
        # The last part begins again at the first levels, so that all parts have one size.
        index = jnp.arange(first, first + together) % count
        driven = rollout(jax.random.fold_in(key, first), agent, levels_of(space, index), ppo)
        parts.append(score(driven, ppo))
    names = ("positive_value_loss", "max_mc", "learnability")
    return {name: np.concatenate([np.asarray(getattr(part, name)) for part in parts])[:count] for name in names}
