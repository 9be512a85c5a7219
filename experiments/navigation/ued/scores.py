"""Do scores of levels know the regret? Every level of a space is scored at several stages of a training."""

from typing import TypedDict

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from elitelanes_jax.network import measure
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, new_agent, rollout, score
from experiments.navigation.ued.methods import domain_randomisation
from experiments.navigation.ued.regret import evaluate
from experiments.navigation.ued.spaces import Space, draw, levels_of, open_space

__all__ = ["Stage", "study_scores"]

_STRAIGHT_BINS = 10


class Stage(TypedDict):
    """The study of scores at one stage: Spearman's rank correlation with the exact regret, by score."""

    rounds: int
    mean_regret: float
    correlation: dict[str, float]


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
        correlation = {name: _rank_correlation(scores[name], regret) for name in scores}
        results.append({"rounds": rounds, "mean_regret": float(regret.mean()), "correlation": correlation})
    return results


def _rank_correlation(score: np.ndarray, regret: np.ndarray) -> float:
    """Returns Spearman's rank correlation; 0 for a score that is the same on all levels, because it tells nothing."""
    return float(stats.spearmanr(score, regret).statistic) if np.ptp(score) else 0.0


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
