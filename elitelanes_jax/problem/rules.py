"""The constraints that make a grid a map, and sets of rules that maps may have to keep."""

from typing import NamedTuple

from elitelanes_jax.network.records import Weights


class Rules(NamedTuple):
    """A set of rules.

    Attributes:
      forbidden: the metrics that must be 0.
      weights: the weights of a fitness whose optima keep the rules.
    """

    forbidden: tuple[str, ...]
    weights: Weights


RULES = {
    # The source is Duckietown's appearance specification, "Topological constraints". A violation
    # weighs as much as a further component. The rules allow the adjacent turns and crossings that
    # the paper's fitness punishes.
    "duckietown": Rules(
        forbidden=("crowded_crossings", "unlinked_neighbours"),
        weights=Weights(
            crowded_crossings=300, unlinked_neighbours=300, adjacent_turns=0, adjacent_crossings=0
        ),
    ),
}
"""Sets of rules, by name."""


class Constraint(NamedTuple):
    """A metric that has one value on every map.

    Attributes:
      metric: the name of the metric.
      value: its value on every map.
      violated: words for a grid on which it has another value.
    """

    metric: str
    value: int
    violated: str


OFF_ALPHABET = Constraint("off_alphabet", 0, "with tiles that are not in the alphabet")
"""A map has the codes of the search alone, which are at most those of its tile set."""

_ALWAYS = (
    Constraint("components", 1, "not in one piece"),
    Constraint("dead_ends", 0, "with dead ends"),
    Constraint("boundary_violations", 0, "with roads that leave the grid"),
    Constraint("mismatches", 0, "with roads that do not meet"),
    OFF_ALPHABET,
)


def map_constraints(rules: str | None, *, filled: bool) -> tuple[Constraint, ...]:
    """Returns the constraints that every map satisfies.

    A grid is counted under the first constraint that it violates. `filled` says whether every cell
    of a map has a road, unless rules leave cells empty.
    """
    constraints = list(_ALWAYS)
    if rules is not None:
        for metric in RULES[rules].forbidden:
            constraints.append(Constraint(metric, 0, "against the rules"))
    elif filled:
        constraints.append(Constraint("empty_cells", 0, "with empty cells"))
    return tuple(constraints)
