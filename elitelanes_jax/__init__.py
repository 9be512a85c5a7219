"""Elite Lanes JAX: evolutionary generation of road networks for a miniature city.

The kernels work on one grid and are pure: `jax.jit` and `jax.vmap` them. `evolve` runs whole searches.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from elitelanes_jax.version import __version__

if TYPE_CHECKING:
    from elitelanes_jax.errors import InputError
    from elitelanes_jax.grids import random_grids
    from elitelanes_jax.metrics import Metrics, measure
    from elitelanes_jax.objective import Weights, fitness
    from elitelanes_jax.repairs import repair
    from elitelanes_jax.search import Result, evolve
    from elitelanes_jax.symmetry import mirror, rotate

__all__ = [
    "InputError",
    "Metrics",
    "Result",
    "Weights",
    "__version__",
    "evolve",
    "fitness",
    "measure",
    "mirror",
    "random_grids",
    "repair",
    "rotate",
]

# Each name is imported when it is first asked for, so that what needs no JAX does not wait for it (PEP 562).
_HOMES = {
    "InputError": "errors",
    "Metrics": "metrics",
    "Result": "search",
    "Weights": "objective",
    "evolve": "search",
    "fitness": "objective",
    "measure": "metrics",
    "mirror": "symmetry",
    "random_grids": "grids",
    "repair": "repairs",
    "rotate": "symmetry",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
