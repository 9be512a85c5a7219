"""Rules that maps may be held to."""

from typing import Any, NamedTuple

from elitelanes_jax.errors import InputError
from elitelanes_jax.objective import Weights

__all__ = ["RULES", "Rules", "rules_named"]


class Rules(NamedTuple):
    """What a set of rules asks for.

    Attributes:
      none_of: the metrics that have to be 0.
      weights: of a fitness whose optima keep the rules.
    """

    none_of: tuple[str, ...]
    weights: Weights


RULES = {
    # Duckietown's appearance specification, "Topological constraints": a map that can be built on a real floor.
    "duckietown": Rules(
        none_of=("crowded_crossings", "unlinked_neighbours"),
        weights=Weights(crowded_crossings=300, unlinked_neighbours=300, adjacent_turns=0, adjacent_crossings=0),
    ),
}
"""Sets of rules, by name."""


def rules_named(name: Any) -> Rules:
    """The rules of a name.

    Raises:
      InputError: if there are none.
    """
    if not isinstance(name, str) or name not in RULES:
        raise InputError(f"rules: expected one of {', '.join(RULES)}, got {name!r}")
    return RULES[name]
