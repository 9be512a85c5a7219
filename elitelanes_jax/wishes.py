"""What a user asks a search for: the part of the settings that all commands which evolve maps share."""

from pathlib import Path
from typing import Any, NamedTuple

from chex import PRNGKey

from elitelanes_jax.archive import read_axis
from elitelanes_jax.checks import check_once
from elitelanes_jax.errors import InputError
from elitelanes_jax.objective import Weights
from elitelanes_jax.requests import read_ranges
from elitelanes_jax.rules import rules_named
from elitelanes_jax.search import Result, evolve, preset_config
from elitelanes_jax.selection import check_possible
from elitelanes_jax.templates import read_template

__all__ = ["Wishes", "read_wishes", "search", "weights_of"]


class Wishes(NamedTuple):
    """What to evolve.

    Attributes:
      method: see `evolve`.
      preset: see `evolve`.
      evaluations: of each run.
      generations: of each run; where they are given, they take the place of evaluations.
      axes: of the niches, as `read_axis` reads them; by default the preset's.
      where: ranges that every map meets, see `evolve`.
      weights: of the fitness, by metric, in place of the usual ones.
      fix: file of given cells, see `read_template`.
      rules: see `evolve`.
    """

    method: str = "map-elites"
    preset: str = "tuned"
    evaluations: int = 200_000
    generations: int | None = None
    axes: tuple[str, ...] = ()
    where: tuple[str, ...] = ()
    weights: tuple[tuple[str, int], ...] = ()
    fix: Path | None = None
    rules: str | None = None


def search(
    wishes: Wishes,
    keys: PRNGKey,
    shape: tuple[int, int],
    alphabet: tuple[int, ...],
    *,
    initial: Any = None,
    progress: bool | None = None,
) -> Result:
    """Evolves maps that can all be drawn: by the filling repair, but where rules leave cells empty.

    Args:
      wishes: what is asked for.
      keys: ``[S]``, a run each.
      shape: (height, width) of the grids.
      alphabet: the codes that can be drawn.
      initial: see `evolve`.
      progress: see `evolve`.

    Raises:
      InputError: for wishes out of their range.
    """
    return evolve(keys, shape, alphabet=alphabet, initial=initial, progress=progress, **read_wishes(wishes, shape))


def read_wishes(wishes: Wishes, shape: tuple[int, int]) -> dict[str, Any]:
    """The arguments of `evolve` that wishes come to.

    Raises:
      InputError: for wishes out of their range, or that no map that is kept can meet.
    """
    axes = [read_axis(text, shape) for text in wishes.axes]
    preset_config(wishes.method, wishes.preset)
    where = read_ranges(wishes.where)
    fix = None if wishes.fix is None else read_template(wishes.fix, shape)
    check_possible(where, fix, wishes.rules)
    return {
        "method": wishes.method,
        "preset": wishes.preset,
        "generations": wishes.generations,
        "evaluations": wishes.evaluations if wishes.generations is None else None,
        "axes": axes or None,
        "weights": weights_of(wishes),
        "where": where,
        "fix": fix,
        "rules": wishes.rules,
        "fill": wishes.rules is None,
    }


def weights_of(wishes: Wishes) -> Weights:
    """The usual weights, or those of the rules, with the given ones in their places."""
    usual = rules_named(wishes.rules).weights if wishes.rules is not None else Weights()
    check_once("weights", "metric", [name for name, _ in wishes.weights])
    for name, _ in wishes.weights:
        if name not in Weights._fields:
            raise InputError(f"weights: expected a metric such as dead_ends, or constant, got {name!r}")
    return usual._replace(**dict(wishes.weights))
