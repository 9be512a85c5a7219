"""Flaws: what keeps a grid from being a map."""

from elitelanes_jax.problem.rules import RULES

_FLAWS = (
    ("components", 1, "not in one piece"),
    ("dead_ends", 0, "with dead ends"),
    ("boundary_violations", 0, "with roads that leave the grid"),
    ("mismatches", 0, "with roads that do not meet"),
    ("off_alphabet", 0, "with tiles that the tile set lacks"),
)


def find_flaws(rules: str | None, *, filled: bool) -> list[tuple[str, int, str]]:
    """Returns the flaws that a map may not have: a metric, the one value that it should have, and words for others.

    A map is counted with the first flaw that it has.

    Args:
      rules: that maps keep.
      filled: whether every cell has a road.
    """
    flaws = list(_FLAWS)
    if rules is not None:
        flaws += [(name, 0, "against the rules") for name in RULES[rules].forbidden]
    elif filled:
        flaws.append(("empty_cells", 0, "with empty cells"))
    return flaws
