"""Joins results of one search that ran with different keys."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, listed
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.search.result import History, Result, RunState


@name_wrong_arguments
def join_results(results: Sequence[Result]) -> Result:
    """Joins results of one search along the seeds, in their order.

    The arrays are those of one call of `evolve` with all keys, bit for bit. A result of one key counts as one seed. The
    joined result has no state to continue from. Its speed is that of the results one after another.

    Args:
      results: of the same size, options, configuration, functions and generations, with different keys.

    Raises:
      InputError: for no results, results of different searches, or a result that comes twice.
    """
    check_named("results", listed(Result), results)
    if not results:
        raise InputError("results: expected at least one, got none")
    for index, result in enumerate(results):
        _check_same_search(index, _search_of(result), _search_of(results[0]))
    _check_different_keys(results)
    batches = [_with_seeds(result) for result in results]
    elites = jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *(batch.elites for batch in batches))
    history = _join_histories([batch.history for batch in batches])
    return replace(without_state(results[0]), elites=elites, history=history)


def without_state(result: Result) -> Result:
    """Returns a result that has no state to continue from."""
    return replace(result, state=RunState(np.zeros((), np.int32), (), np.zeros((), np.uint32)))


def _search_of(result: Result) -> dict[str, UserValue]:
    """Returns by name all that results of one search have in common."""
    options = result.search.settings.values()
    generations = [count.tolist() for count in (result.history.generation, result.history.evaluations)]
    rest = {"size": result.search.shape, "axes": result.search.axes, "config": result.config}
    functions = {f"function {name!r}": digest for name, digest in result.functions}
    return options | rest | functions | {"generations of the history": generations}


def _check_same_search(index: int, got: dict[str, UserValue], expected: dict[str, UserValue]) -> None:
    for name in expected | got:
        if got.get(name) != expected.get(name):
            texts = [shorten(repr(search.get(name)), 60) for search in (expected, got)]
            raise InputError(f"results: expected one search with {name} {texts[0]}, got {texts[1]} at index {index}")


def _check_different_keys(results: Sequence[Result]) -> None:
    """Checks the fingerprints, which depend on the keys. A result that was saved without its state has none."""
    seen: dict[int, int] = {}
    for index, result in enumerate(results):
        if not jax.tree.leaves(result.state.inner):
            continue
        first = seen.setdefault(int(result.state.fingerprint), index)
        if first != index:
            raise InputError(
                f"results: expected each result once, got the keys of index {first} again at index {index}"
            )


def _with_seeds(result: Result) -> Result:
    """Returns a result whose arrays have a leading axis of seeds."""
    if result.elites.fitness.ndim == 2:
        return result
    elites = jax.tree.map(lambda array: array[None], result.elites)
    history = result.history
    of_seeds = {name: getattr(history, name)[None] for name in ("best_fitness", "elite_count", "refused")}
    return replace(result, elites=elites, history=history._replace(**of_seeds))


def _join_histories(histories: Sequence[History]) -> History:
    counts = {
        name: np.concatenate([getattr(history, name) for history in histories])
        for name in ("best_fitness", "elite_count", "refused")
    }
    seeds = [len(history.best_fitness) for history in histories]
    shares = [count / history.evaluations_per_second for count, history in zip(seeds, histories, strict=True)]
    return histories[0]._replace(**counts, evaluations_per_second=sum(seeds) / np.sum(shares, axis=0))
