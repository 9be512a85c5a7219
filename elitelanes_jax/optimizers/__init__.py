"""Optimisers on one convention (see `base`): each a factory from a problem and a configuration."""

from elitelanes_jax.annealing import AnnealingConfig
from elitelanes_jax.evolution import EvolutionConfig
from elitelanes_jax.optimizers.aimed_map_elites import (
    AimedMapElitesConfig,
    AimedMapElitesState,
    Scouts,
    aimed_map_elites,
)
from elitelanes_jax.optimizers.annealed import (
    AnnealedState,
    DiscreteGwoConfig,
    DiscretePsoConfig,
    annealed_ea,
    discrete_gwo,
    discrete_pso,
)
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.optimizers.ea import ea
from elitelanes_jax.optimizers.gwo import GwoConfig, GwoState, gwo
from elitelanes_jax.optimizers.map_elites import MapElitesConfig, MapElitesState, map_elites
from elitelanes_jax.optimizers.pso import PsoConfig, PsoState, pso

__all__ = [
    "AimedMapElitesConfig",
    "AimedMapElitesState",
    "AnnealedState",
    "AnnealingConfig",
    "DiscreteGwoConfig",
    "DiscretePsoConfig",
    "Elites",
    "EvolutionConfig",
    "GwoConfig",
    "GwoState",
    "Info",
    "MapElitesConfig",
    "MapElitesState",
    "Optimizer",
    "PsoConfig",
    "PsoState",
    "Scouts",
    "aimed_map_elites",
    "annealed_ea",
    "discrete_gwo",
    "discrete_pso",
    "ea",
    "gwo",
    "map_elites",
    "pso",
]
