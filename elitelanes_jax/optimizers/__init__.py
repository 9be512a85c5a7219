"""Optimisers on one convention (see `base`): each a factory from a problem and a configuration."""

from elitelanes_jax.evolution import EvolutionConfig
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.optimizers.ea import ea
from elitelanes_jax.optimizers.map_elites import MapElitesConfig, MapElitesState, map_elites

__all__ = [
    "Elites",
    "EvolutionConfig",
    "Info",
    "MapElitesConfig",
    "MapElitesState",
    "Optimizer",
    "ea",
    "map_elites",
]
