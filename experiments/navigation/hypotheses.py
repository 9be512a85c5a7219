"""The study's hypotheses, each as figures with the range that was expected of them."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from experiments.navigation.outcomes import (
    ALIKE,
    Difference,
    Places,
    Runs,
    correlation,
    correlations,
    over_seeds,
    read_places,
)
from experiments.navigation.tasks import Figures

__all__ = ["Answer", "answers"]

_SOURCES = {"MAP-Elites'": "maps-100", "the EA's": "ea", "WFC's": "wfc", "random": "random"}
_OWN = dict(zip(_SOURCES, ("seen", "test ea", "test wfc", "test random"), strict=True))
_FOUR = tuple(_OWN.values())
_LANES = (*_FOUR, "held out", "human-made")


class Answer(NamedTuple):
    """A figure that a hypothesis is about.

    Attributes:
      hypothesis: its number on the page of this room, README.md.
      words: what the figure is.
      found: the figure, over seeds.
      least: of what was expected.
      most: of what was expected.
    """

    hypothesis: int
    words: str
    found: Difference
    least: float = -np.inf
    most: float = np.inf

    @property
    def verdict(self) -> str:
        """Whether the whole interval lies within what was expected ("yes"), outside ("no"), or neither ("open")."""
        if not np.isfinite(self.found.low):
            return "open"
        if self.least < self.found.low and self.found.high < self.most:
            return "yes"
        return "no" if self.found.high <= self.least or self.found.low >= self.most else "open"


class Of(Protocol):
    """The figures of one seed."""

    def __call__(self, task: str, condition: str, *tests: str, key: Figures = "success") -> float:
        """Returns a figure of a run, averaged over tests."""


def _paired(runs: Runs, figure: Callable[[Of], float]) -> Difference:
    """Averages a figure over the seeds that have all its runs.

    Args:
      runs: all.
      figure: computes the value of one seed from the figures of its runs.
    """
    values = []
    for seed in sorted({seed for _, _, seed in runs}):

        def of(task: str, condition: str, *tests: str, key: Figures = "success", seed: int = seed) -> float:
            return float(np.mean([runs[task, condition, seed][test][key] for test in tests]))

        try:
            values.append(figure(of))
        except KeyError:
            continue
    return over_seeds(values)


def answers(runs: Runs, out: Path) -> list[Answer]:
    """Answers the hypotheses by the finished runs of a folder; figures without any run are left out."""
    found = [*_by_success(runs), *_by_places(runs, read_places(out))]
    return sorted((answer for answer in found if answer.found.seeds), key=lambda answer: answer.hypothesis)


def _by_success(runs: Runs) -> list[Answer]:
    def more(task: str, one: str, other: str, *tests: str) -> Difference:
        return _paired(runs, lambda of: of(task, one, *tests) - of(task, other, *tests))

    def lane(of: Of) -> float:
        others = ("maps-1", "ea", "wfc", "random")
        return max(abs(of("lane", one, test) - of("lane", "maps-100", test)) for one in others for test in _LANES)

    found = [
        Answer(1, "lane: the largest difference of any set from 100 maps, on any test", _paired(runs, lane), most=0.02),
        Answer(2, "map: 1000 maps less 1, unseen maps", more("map", "maps-1000", "maps-1", *ALIKE), least=0.2),
        Answer(2, "map: 1000 maps less 100, unseen maps", more("map", "maps-1000", "maps-100", *ALIKE), least=0),
        Answer(3, "window: 1000 maps less 10, unseen maps", more("window", "maps-1000", "maps-10", *ALIKE), most=0.05),
    ]
    for task in ("map", "window"):

        def cost(of: Of, task: str = task) -> float:
            return of(task, "maps-1000", "seen") - of(task, "maps-1000", "held out")

        held = _paired(runs, cost)
        found.append(Answer(4, f"{task}: niches trained on less niches held out, 1000 maps", held, most=0.02))
    others = dict(list(_SOURCES.items())[1:])
    for name, other in others.items():
        words = f"map: MAP-Elites' maps less {name}, mean of the four tests"
        found.append(Answer(5, words, more("map", "maps-100", other, *_FOUR), least=0))
    for name in ("WFC's", "random"):
        words = f"map: {name} maps less the EA's, mean of the four tests"
        found.append(Answer(5, words, more("map", _SOURCES[name], "ea", *_FOUR), least=0))
    for name, own in _SOURCES.items():

        def lead(of: Of, name: str = name, own: str = own) -> float:
            rivals = [of("map", source, _OWN[name]) for source in _SOURCES.values() if source != own]
            return of("map", own, _OWN[name]) - max(rivals)

        words = f"map: {name} maps less the best others of each seed, on their own kind"
        found.append(Answer(5, words, _paired(runs, lead), least=0))
    for name, other in others.items():

        def further(of: Of, other: str = other) -> float:
            worst, every = (
                of("map", "maps-100", *_FOUR, key=key) - of("map", other, *_FOUR, key=key)
                for key in ("worst", "success")
            )
            return worst - every

        words = f"map: MAP-Elites' lead over {name} on the worst tenth less that on all maps, mean of the four tests"
        found.append(Answer(6, words, _paired(runs, further), least=0))
    for task in ("map", "window"):

        def gap(of: Of, task: str = task) -> float:
            gained = [of(task, "maps-1000", test) - of(task, "maps-1", test) for test in ("human-made", "seen")]
            return gained[0] - gained[1]

        made = more(task, "maps-1000", "untrained", "human-made")
        found.append(Answer(9, f"{task}: 1000 maps less turns at random, maps made by hand", made, least=0))
        words = f"{task}: what 1000 maps gain on 1 on maps made by hand, less that on niches trained on"
        found.append(Answer(9, words, _paired(runs, gap), most=0))
    return found


def _by_places(runs: Runs, places: Places) -> list[Answer]:
    found = []
    for feature, words in (("cyclomatic", "loops"), ("straight_share", "the share of straights")):
        values = correlations(runs, places, "map", "maps-1000", feature)
        found.append(Answer(7, f"map: rank correlation of failures with {words}", over_seeds(values), most=0))

    for key, words in (("never", "share of places never known"), ("tiles", "tiles until the others are known")):
        for one, other in [("the EA's", "MAP-Elites'"), *((name, "random") for name in list(_SOURCES)[:-1])]:
            pair = _OWN[one], _OWN[other]
            apart = [float(np.mean(of[pair[0]][key]) - np.mean(of[pair[1]][key])) for of in places.values()]
            found.append(Answer(8, f"where: {words}, {one} maps less {other}", over_seeds(apart), least=0))
    straight = [
        correlation(*(np.concatenate([of[test][key] for test in ALIKE]) for key in ("ambiguity", "straight_share")))
        for of in places.values()
    ]
    words = "where: rank correlation of ambiguity with the share of straights"
    found.append(Answer(8, words, over_seeds([value for value in straight if np.isfinite(value)]), least=0))
    return found
