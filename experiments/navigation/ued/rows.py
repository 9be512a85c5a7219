"""Rows of the table, one of a method and a seed: what is run, and what is kept of it."""

import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import TypedDict

import jax
import numpy as np

from elitelanes_jax import InputError, evolve
from experiments.navigation.maps import human_maps
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent
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
from experiments.navigation.ued.regret import Summary, evaluate, summarise
from experiments.navigation.ued.spaces import Space, make_space, open_space

__all__ = ["METHODS", "RATES", "Row", "check_methods", "run_row"]

METHODS: dict[str, Callable[..., Iterator[Agent]]] = {
    "domain randomisation": domain_randomisation.train,
    "PLR": plr.train,
    "robust PLR": plr.robust_train,
    "ACCEL": accel.train,
    "TRACED": traced.train,
    "SFL": sfl.train,
    "archive": archive.train,
    "neighbours": neighbours.train,
    "neighbours, no spread": neighbours.train_without_spread,
    "oracle": oracle.train,
}
"""The methods by the names in the table."""

RATES = {
    "domain randomisation": 2e-3,
    "PLR": 4e-3,
    "robust PLR": 4e-3,
    "ACCEL": 8e-3,
    "TRACED": 8e-3,
    "SFL": 4e-3,
    "archive": 4e-3,
    "neighbours": 2e-3,
    "neighbours, no spread": 2e-3,
    "oracle": 2e-3,
}
"""The learning rates of the methods, chosen on 5 x 5 A by rates.py.

TRACED has the rate of ACCEL, whose loop it shares. The methods of neighbours have the rate of the oracle, and their
pilot runs had it.
"""

TIMES = 4
"""The times in a training at which the regret is computed, at equal distances, the end included."""

_HUMAN = Path(__file__).parents[3] / ".venv-duckietown"  # of make duckietown; people's maps are tests where it is


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


@cache
def _unseen() -> dict[str, Space]:
    """Returns the maps outside the space: towns of 9 x 9 tiles, and people's maps of up to 8 x 8 where they are."""
    towns = evolve(0, (9, 9), style="town", where="crossings=0..", seeds=2, evaluations=20_000, progress=False).maps(8)
    spaces = {"towns of 9 x 9": make_space(np.stack([town.codes for town in towns]))}
    folder = next(_HUMAN.glob("lib/*/site-packages/duckietown_world/data/gd1/maps"), None)
    if folder is not None:
        spaces["people's maps"] = make_space(human_maps(folder))
    return spaces


def check_methods(names: list[str] | None) -> list[str]:
    """Returns the methods that ``--methods`` names, or all without names. Raises `InputError` for an unknown name."""
    for name in names or []:
        if name not in METHODS:
            raise InputError("--methods", f"some of {', '.join(METHODS)}", name)
    return names or list(METHODS)


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
