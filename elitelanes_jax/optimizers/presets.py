"""The optimisers by kind of configuration, and the configurations by method and preset."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import TypeAlias, TypeVar

from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.records import Record
from elitelanes_jax._util.types import Plain
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

Config: TypeAlias = (
    AnnealedMapElitesConfig
    | MapElitesConfig
    | AnnealingConfig
    | EvolutionConfig
    | AnnealedPsoConfig
    | PsoConfig
    | AnnealedGwoConfig
    | GwoConfig
)
"""The configuration of a method; its kind says which method."""

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

PRESETS: dict[tuple[str, str], Config] = {
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


R = TypeVar("R", bound=Record)


def make_optimizer(problem: Problem, config: Config) -> Optimizer:
    """Makes the optimiser of a kind of configuration, on a problem."""
    return _FACTORIES[type(config)](problem, config)


def find_preset(config: Config) -> tuple[str, str, bool]:
    """Finds the preset of a configuration.

    Returns:
      The method, the preset, and whether the configuration is the preset's. If it is that of no preset, the preset is
      the first one of its kind.

    Raises:
      InputError: for anything else than a configuration.
    """
    alike = [(found, known == config) for found, known in PRESETS.items() if type(known) is type(config)]
    if not alike:
        kinds = ", ".join(kind.__name__ for kind in _FACTORIES)
        raise InputError(f"config: expected one of {kinds}, got {type(config).__name__}")
    (method, preset), exact = max(alike, key=lambda one: one[1])
    return method, preset, exact


def config_to_plain(config: Config) -> dict[str, Plain]:
    """Returns the kind and the fields of a configuration, plain values for JSON."""
    return {"kind": type(config).__name__, **asdict(config)}


def config_from_plain(plain: Plain) -> Config:
    """Returns the configuration that `config_to_plain` described.

    Raises:
      InputError: for an unknown kind, a missing or unknown field, or a wrong value.
    """
    kinds = {kind.__name__: kind for kind in _FACTORIES}
    if not isinstance(plain, Mapping) or plain.get("kind") not in kinds:
        raise InputError(f"config: expected a kind, one of {', '.join(kinds)}, got {shorten(repr(plain))}")
    return _from_plain(kinds[plain["kind"]](), {name: value for name, value in plain.items() if name != "kind"})


def _from_plain(default: R, plain: Plain) -> R:
    names = default.options()
    if not isinstance(plain, Mapping) or set(plain) != set(names):
        raise InputError(f"config: expected {', '.join(names)}, got {shorten(repr(plain))}")
    parts = {name: getattr(default, name) for name in names}
    nested = {name: _from_plain(part, plain[name]) for name, part in parts.items() if isinstance(part, Record)}
    return default.replace(**{**plain, **nested})
