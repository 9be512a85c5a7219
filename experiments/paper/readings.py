"""Readings of the paper. Its text is ambiguous in several places."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from elitelanes_jax import Weights
from elitelanes_jax.optimizers import EvolutionConfig, GwoConfig, MapElitesConfig

__all__ = ["READINGS", "Reading"]

_COMMA = EvolutionConfig(survivors="comma")


class Reading(NamedTuple):
    """One way to read the paper.

    Attributes:
      about: the interpretation, in one line.
      weights: the weights of the fitness.
      configs: the settings of a method that replace its preset `paper`.
      fill: whether repair fills empty cells.
    """

    about: str
    weights: Weights = Weights()
    configs: Mapping[str, EvolutionConfig | GwoConfig | MapElitesConfig] = MappingProxyType({})
    fill: bool = False


READINGS = {
    "ours": Reading("a(x): linked crossings, counted from both; b(x): bridges; omega: own; plus; flip"),
    "a-pairs": Reading("a(x): pairs of linked crossings, each counted once", Weights(adjacent_crossings=50)),
    "a-score": Reading(
        "a(x): the score that the tables call ACV", Weights(adjacent_crossings=0, adjacent_crossing_score=100)
    ),
    "a-turns": Reading(
        "a(x): adjacent turns, as the equation's caption says", Weights(adjacent_crossings=0, adjacent_turns=180)
    ),
    "b-edges": Reading("b(x): edges, as the equation's caption says", Weights(bridges=0, edges=100)),
    "omega-worst": Reading("GWO's omega: the worst wolf", configs={"gwo": GwoConfig(omega="worst")}),
    "comma": Reading(
        "survivors are chosen from the offspring alone, as (mu, lambda) says",
        configs={"ea": _COMMA, "map-elites": MapElitesConfig(_COMMA)},
    ),
    "archive": Reading(
        "MAP-Elites takes parents from the archive", configs={"map-elites": MapElitesConfig(parents="archive")}
    ),
    "fill": Reading("repair fills, so that no tile has fewer than two connections", fill=True),
}
"""The readings by name. "ours" is the closest to the paper's tables."""
