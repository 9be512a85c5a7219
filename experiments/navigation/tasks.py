"""The study's tasks and conditions, the training of one driver, and its tests."""

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple, TypeAlias, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.drive import Level, RoadNav, RoadNavParams
from experiments.common import Pytree
from experiments.navigation.drivers import MapNetwork, WindowNetwork, at_choices
from experiments.navigation.maps import SIDE, draw_levels
from experiments.navigation.ppo import Network, Ppo, drive_levels, train

__all__ = [
    "CONDITIONS",
    "TASKS",
    "Condition",
    "Figures",
    "Judged",
    "Task",
    "TrainBudget",
    "test_driver",
    "train_driver",
]


class Condition(NamedTuple):
    """Maps that a driver is trained on.

    Attributes:
      words: their description in tables.
      source: the name of the maps (see `make_maps`).
      maps: how many, the first ones; 0 for no training.
    """

    words: str
    source: str
    maps: int


CONDITIONS = {
    "untrained": Condition("not trained: turns at random", "map-elites", 0),
    "maps-1": Condition("1 map of MAP-Elites", "map-elites", 1),
    "maps-3": Condition("3 maps", "map-elites", 3),
    "maps-10": Condition("10 maps", "map-elites", 10),
    "maps-30": Condition("30 maps", "map-elites", 30),
    "maps-100": Condition("100 maps", "map-elites", 100),
    "maps-1000": Condition("1000 maps", "map-elites", 1000),
    "ea": Condition("100 maps, EA", "ea", 100),
    "wfc": Condition("100 maps, WFC", "wfc", 100),
    "random": Condition("100 maps, random", "random", 100),
}
"""The conditions by name."""


class TrainBudget(NamedTuple):
    """The amount of training and testing.

    Attributes:
      updates: of PPO, each of 256 environments.
      levels: to train on, on however many maps.
      each: levels of each map in a test.
    """

    updates: int = 60
    levels: int = 8192
    each: int = 14


Figures: TypeAlias = Literal["success", "spl"]
"""The figures of a test."""


class Judged(TypedDict):
    """The figures of a test.

    Attributes:
      success: the share of levels that are a success.
      spl: the mean success weighted by path length.
      by_map: the success on each map.
    """

    success: float
    spl: float
    by_map: list[float]


class Task(NamedTuple):
    """A task of `RoadNav`: to reach a goal.

    Attributes:
      words: its description.
      network: of the driver.
      params: from levels to the environment's settings.
      conditions: names of those that are run.
      few: names of those that the first `FEW` seeds alone run.
    """

    words: str
    network: Network
    params: Callable[[Level], RoadNavParams]
    conditions: tuple[str, ...]
    few: tuple[str, ...]


FEW = 3
"""The number of seeds that run what no hypothesis asks for."""

_TOGETHER = 512  # levels of a test that are driven side by side
_LIMIT = 64  # tiles; the furthest goal is 12 away
_ENVIRONMENT = at_choices(RoadNav)
_PPO = Ppo(60, epochs=3, rate=2e-3)
_params = partial(RoadNavParams, limit=_LIMIT, tile_cost=0.02)

TASKS = {
    "map": Task(
        "reach the goal, the map seen",
        MapNetwork(),
        partial(_params, window=2 * SIDE - 1, goal="both", whole_map=True),
        tuple(CONDITIONS),
        few=("maps-3", "maps-10", "maps-30"),
    ),
    "window": Task(
        "reach the goal by a 5 x 5 window, the compass and memory",
        WindowNetwork(),
        partial(_params, window=5, goal="compass"),
        ("untrained", "maps-1", "maps-10", "maps-100", "maps-1000"),
        few=("maps-100",),
    ),
}
"""The tasks by name."""


def train_driver(task: Task, condition: Condition, seed: int, grids: NDArray[np.int8], budget: TrainBudget) -> Pytree:
    """Trains a driver on the first maps of a condition, int8 ``[M, 8, 8]``; returns its weights."""
    count = max(1, condition.maps)
    params = task.params(draw_levels(seed, grids[:count], budget.levels))
    if condition.maps == 0:
        seen, _ = _ENVIRONMENT.reset(jax.random.key(0), params)
        row = jax.tree.map(lambda part: part[None, None], seen)
        return task.network.init(jax.random.key(seed), jnp.zeros((1, task.network.memory)), row, jnp.ones((1, 1), bool))
    ppo = _PPO._replace(updates=budget.updates)
    *_, (weights, _) = train(jax.random.key(seed), _ENVIRONMENT, params, task.network, ppo)
    return weights


def test_driver(
    task: Task, weights: Pytree, tests: dict[str, NDArray[np.int8]], budget: TrainBudget
) -> dict[str, Judged]:
    """Drives on all maps of all tests, with the same levels for all drivers; returns the figures of each test."""
    parts = [draw_levels(1000 + number, grids, len(grids) * budget.each) for number, grids in enumerate(tests.values())]
    levels = jax.tree.map(lambda *of: np.concatenate(of), *parts)
    count, outcomes = len(levels.grid), []
    for first in range(0, count, _TOGETHER):
        # All parts have one size, which is compiled once, and each ends with its own longest episode.
        part = jax.tree.map(lambda of, first=first: of[np.arange(first, first + _TOGETHER) % count], levels)
        key, params = jax.random.fold_in(jax.random.key(7), first), task.params(part)
        info = drive_levels(key, weights, part, params, _ENVIRONMENT, task.network, steps=_LIMIT)
        outcomes.append((info.success, info.spl))
    success, spl = (np.concatenate(of).astype(float)[:count] for of in zip(*outcomes, strict=True))
    ends = np.cumsum([len(grids) * budget.each for grids in tests.values()])[:-1]
    split = zip(*(np.split(part, ends) for part in (success, spl)), strict=True)
    return {
        name: {
            "success": float(success.mean()),
            "spl": float(spl.mean()),
            "by_map": success.reshape(budget.each, -1).mean(axis=0).round(3).tolist(),
        }
        for name, (success, spl) in zip(tests, split, strict=True)
    }
