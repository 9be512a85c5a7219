"""Sets of rules that maps may have to keep."""

from typing import NamedTuple

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.network.weights import Weights


class Rules(NamedTuple):
    """A set of rules.

    Attributes:
      forbidden: the metrics that have to be 0.
      weights: of a fitness whose optima keep the rules.
    """

    forbidden: tuple[str, ...]
    weights: Weights


RULES = {
    # Duckietown's appearance specification, "Topological constraints": a map that can be built on a real floor.
    "duckietown": Rules(
        forbidden=("crowded_crossings", "unlinked_neighbours"),
        weights=Weights(crowded_crossings=300, unlinked_neighbours=300, adjacent_turns=0, adjacent_crossings=0),
    ),
}
"""Sets of rules, by name."""


def check_rules(name: UserValue) -> str:
    """Checks the name of a set of rules.

    Raises:
      InputError: if there is no such set.
    """
    if not isinstance(name, str) or name not in RULES:
        raise InputError(f"rules: expected one of {', '.join(RULES)}, got {name!r}")
    return name
