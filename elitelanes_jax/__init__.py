"""Elite Lanes JAX: evolutionary generation of road networks for a miniature city.

The kernels work on one grid and are pure: `jax.jit` and `jax.vmap` them. `evolve` runs whole searches.
"""

from elitelanes_jax.grids import random_grids
from elitelanes_jax.metrics import Metrics, measure
from elitelanes_jax.objective import Weights, fitness
from elitelanes_jax.repairs import repair
from elitelanes_jax.search import Result, evolve
from elitelanes_jax.symmetry import mirror, rotate
from elitelanes_jax.version import __version__

__all__ = [
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
