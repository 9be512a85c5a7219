"""The optimisers by kind of configuration, and the configurations by method and preset."""

from collections.abc import Callable

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record
from elitelanes_jax.optimizers._annealed import (
    AnnealedGwoConfig,
    AnnealedPsoConfig,
    annealed_ea,
    annealed_gwo,
    annealed_pso,
)
from elitelanes_jax.optimizers._annealed_map_elites import AnnealedMapElitesConfig, annealed_map_elites
from elitelanes_jax.optimizers._annealing import AnnealingConfig
from elitelanes_jax.optimizers._ea import ea
from elitelanes_jax.optimizers._gwo import GwoConfig, gwo
from elitelanes_jax.optimizers._map_elites import MapElitesConfig, map_elites
from elitelanes_jax.optimizers._moves import Mix
from elitelanes_jax.optimizers._population import EvolutionConfig
from elitelanes_jax.optimizers._pso import PsoConfig, pso
from elitelanes_jax.optimizers.base import Optimizer
from elitelanes_jax.problem.problem import Problem

# Moves without those that mirror parts of a map and with few that copy them, so that its parts differ. Outlines of
# rectangles lead from one sparse network to the next: 67 towns of 12 x 12 with them, 47 with the usual share. Towns are
# equally fit, and most flawed ones have a single flaw: elites drift, windows are refitted, and a niche is pursued until
# it holds a network without a flaw.
_IRREGULAR = AnnealingConfig(
    chains=1,
    hottest=40,
    coldest=12,
    moves=Mix(outline=24, mirror=0, slide=1, transplant=4, displaced=1, refit=25, filling=0.0),
)

PRESETS: dict[tuple[str, str], Record] = {
    ("map-elites", "tuned"): AnnealedMapElitesConfig(),
    ("map-elites", "paper"): MapElitesConfig(),
    ("map-elites", "standard"): MapElitesConfig(parents="archive"),
    ("map-elites", "irregular"): AnnealedMapElitesConfig(
        opposite=0.0, mirrored=False, annealing=_IRREGULAR, grown=121, drifts=True, complete=True
    ),
    ("ea", "tuned"): AnnealingConfig(),
    ("ea", "paper"): EvolutionConfig(),
    ("pso", "tuned"): AnnealedPsoConfig(),
    ("pso", "paper"): PsoConfig(),
    ("gwo", "tuned"): AnnealedGwoConfig(),
    ("gwo", "paper"): GwoConfig(),
}
"""The configurations by method and preset."""

_FACTORIES: dict[type, Callable[..., Optimizer]] = {
    AnnealedMapElitesConfig: annealed_map_elites,
    MapElitesConfig: map_elites,
    AnnealingConfig: annealed_ea,
    EvolutionConfig: ea,
    AnnealedPsoConfig: annealed_pso,
    PsoConfig: pso,
    AnnealedGwoConfig: annealed_gwo,
    GwoConfig: gwo,
}


def make_optimizer(problem: Problem, config: Record) -> Optimizer:
    """Makes the optimiser of a kind of configuration, on a problem."""
    return _FACTORIES[type(config)](problem, config)


def find_preset(config: Record) -> tuple[str, str]:
    """Returns the method and the preset of a configuration's kind.

    Raises:
      InputError: if it is none.
    """
    for place, known in PRESETS.items():
        if type(known) is type(config):
            return place
    kinds = ", ".join(kind.__name__ for kind in _FACTORIES)
    raise InputError(f"config: expected one of {kinds}, got {type(config).__name__}")
