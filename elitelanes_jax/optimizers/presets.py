"""The configuration of each method and preset, and the optimiser of each kind of configuration."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import TypeAlias, TypeVar

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record
from elitelanes_jax._util.types import OptionValue, Plain, UserValue
from elitelanes_jax.optimizers._annealed import (
    AnnealedGwoConfig,
    AnnealedPsoConfig,
    annealed_ea,
    annealed_gwo,
    annealed_pso,
)
from elitelanes_jax.optimizers._annealed_map_elites import (
    AnnealedMapElitesConfig,
    annealed_map_elites,
)
from elitelanes_jax.optimizers._annealing import AnnealingConfig
from elitelanes_jax.optimizers._gwo import GwoConfig, gwo
from elitelanes_jax.optimizers._map_elites import MapElitesConfig, map_elites
from elitelanes_jax.optimizers._moves import MoveWeights
from elitelanes_jax.optimizers._mutations import Move
from elitelanes_jax.optimizers._population import EvolutionConfig, ea
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
"""The configuration of a method; its type determines the method."""

# No mirrored blocks and few copied blocks, so that the parts of a map differ. Outlines of
# rectangles lead from one sparse network to the next: with this weight a run finds 67 towns of 12 x
# 12, with the usual weight 47. Many towns have the same fitness, and most infeasible towns violate
# one constraint. Therefore equal grids replace elites, windows are refitted, and a niche is pursued
# until its elite is feasible. Cycles from random grids fill no more niches.
_IRREGULAR = AnnealingConfig(
    chains=1,
    hottest=40,
    coldest=12,
    moves=MoveWeights(
        outline=24, mirror=0, slide=1, transplant=4, displaced=1, refit=25, fill_probability=0.0
    ),
)

PRESETS: dict[tuple[str, str], Config] = {
    ("map-elites", "tuned"): AnnealedMapElitesConfig(),
    ("map-elites", "paper"): MapElitesConfig(),
    ("map-elites", "standard"): MapElitesConfig(parents="archive"),
    ("map-elites", "irregular"): AnnealedMapElitesConfig(
        restart=0.0,
        vacant_probability=0.5,
        symmetric_probability=0.0,
        strips=False,
        annealing=_IRREGULAR,
        initial_towns_from=121,
        accept_equal=True,
        require_feasible=True,
    ),
    ("ea", "tuned"): AnnealingConfig(),
    ("ea", "paper"): EvolutionConfig(),
    ("pso", "tuned"): AnnealedPsoConfig(),
    ("pso", "paper"): PsoConfig(),
    ("gwo", "tuned"): AnnealedGwoConfig(),
    ("gwo", "paper"): GwoConfig(),
}
"""The configuration of each method and preset."""

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


@name_wrong_arguments
def make_optimizer(problem: Problem, config: Config) -> Optimizer:
    """Returns the optimiser that a configuration belongs to.

    It is `annealed_ea` for an `AnnealingConfig`, for example. Raises `InputError` for anything else
    than the configuration of a method, such as one of `PRESETS`.
    """
    _check_config(config)
    return _FACTORIES[type(config)](problem, config)


def _check_config(config: UserValue) -> None:
    if type(config) not in _FACTORIES:
        names = ", ".join(kind.__name__ for kind in _FACTORIES)
        raise InputError("config", f"one of {names}", type(config).__name__)


def with_moves(config: Config, moves: UserValue) -> Config:
    """Returns a configuration with other moves, see `MoveWeights.with_moves`.

    Raises `InputError` if the configuration has no moves.
    """
    annealing = _annealing(config)
    if annealing is None:
        raise InputError(
            "moves", "a method with moves, such as preset tuned", type(config).__name__
        )
    annealing = annealing.replace(moves=annealing.moves.with_moves(moves))
    if isinstance(config, AnnealingConfig):
        return annealing
    return config.replace(annealing=annealing)


def user_moves(config: Config) -> dict[str, Move]:
    """Returns the moves of the user in a configuration, by name."""
    annealing = _annealing(config)
    if annealing is None:
        return {}
    return {name: move for name, (_, move) in annealing.moves.user_moves.items()}


def _annealing(config: Config) -> AnnealingConfig | None:
    """Returns the options of annealing, which have the moves.

    Returns None for a method without annealing.
    """
    annealing = getattr(config, "annealing", config)
    return annealing if isinstance(annealing, AnnealingConfig) else None


def find_preset(config: Config) -> tuple[str, str]:
    """Returns the method and preset of a configuration.

    If it equals no preset, the preset is the first one of its type. Raises `InputError` for
    anything else.
    """
    _check_config(config)
    names_of_type = [names for names, preset in PRESETS.items() if type(preset) is type(config)]
    for names in names_of_type:
        if PRESETS[names] == config:
            return names
    return names_of_type[0]


def config_to_plain(config: Config) -> dict[str, Plain]:
    """Returns the type and the fields of a configuration, plain values for JSON.

    A move of the user becomes its weight.
    """

    def plain(fields: list[tuple[str, OptionValue]]) -> dict[str, Plain]:
        values = dict(fields)
        # JSON has no functions, so a move of the user is stored as its weight.
        if "user_moves" in values:
            values["user_moves"] = {
                name: weight for name, (weight, _) in values["user_moves"].items()
            }
        return values

    return {"kind": type(config).__name__, **asdict(config, dict_factory=plain)}


def config_from_plain(plain: Plain) -> Config | None:
    """Returns the configuration that `config_to_plain` described.

    Returns None if the configuration has moves of the user.

    Raises `InputError` for an unknown type, a missing or unknown field, or a wrong value.
    """
    kinds = {kind.__name__: kind for kind in _FACTORIES}
    if not isinstance(plain, Mapping) or plain.get("kind") not in kinds:
        raise InputError("config", f"a kind, one of {', '.join(kinds)}", quote(plain))
    fields = {name: value for name, value in plain.items() if name != "kind"}
    # Plain values do not have the functions of these moves.
    if _has_user_moves(fields):
        return None
    return _from_plain(kinds[plain["kind"]](), fields)


def _has_user_moves(fields: Mapping[str, Plain]) -> bool:
    """Returns whether the plain fields of a configuration have moves of the user."""
    annealing = fields.get("annealing", fields)
    moves = annealing.get("moves") if isinstance(annealing, Mapping) else None
    return isinstance(moves, Mapping) and bool(moves.get("user_moves"))


def _from_plain(default: R, plain: Plain) -> R:
    """Returns a record of the kind of `default` from its plain fields.

    The fields may be records in turn.
    """
    names = default.options()
    if not isinstance(plain, Mapping) or set(plain) != set(names):
        raise InputError("config", ", ".join(names), quote(plain))
    values = dict(plain)
    for name in names:
        part = getattr(default, name)
        if isinstance(part, Record):
            values[name] = _from_plain(part, plain[name])
    return default.replace(**values)
