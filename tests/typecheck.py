"""A pytest plugin that checks types at each call: of arrays, with their shapes and dtypes, and of all other arguments.

    make test-types

It checks the rooms in which arrays of JAX are computed with. It makes the tests an eighth slower, so that `make test`
does without it.
"""

from pathlib import Path

import jaxtyping
from beartype import BeartypeConf, beartype

__all__ = ["ROOMS", "typecheck"]

ROOMS = ["network", "problem", "optimizers", "search._programs", "search.evolution", "search.running", "search.result"]
# Not the rides, which are drawn from scalars of NumPy, and not the options of RoadTraffic, whose rule may be a name.
_LEFT_OUT = ("__init__", "rides", "_road_traffic_records")
_DRIVE = Path(__file__).parents[1] / "elitelanes_jax" / "drive"
ROOMS += [f"drive.{file.stem}" for file in _DRIVE.glob("*.py") if file.stem not in _LEFT_OUT]

# As for static checkers, an int is a float too.
typecheck = beartype(conf=BeartypeConf(is_pep484_tower=True))

jaxtyping.install_import_hook([f"elitelanes_jax.{room}" for room in ROOMS], "typecheck.typecheck")
