"""Joins results of one search that ran with different keys."""

from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, listed
from elitelanes_jax._util.errors import InputError, quote, warn_user
from elitelanes_jax.search.records import NO_STATE, History
from elitelanes_jax.search.result import Result


@name_wrong_arguments
def join_results(results: Sequence[Result]) -> Result:
    """Joins results of one search along the seeds, in their order.

    The arrays are those of one call of `evolve` with all keys, bit for bit. A result of one key
    counts as one seed. The joined result has no state to continue from. Its speed is that of the
    results one after another.

    Args:
      results: the results, with the same size, options, configuration, functions and generations,
        and with different keys.

    Raises:
      InputError: for no results, results of different searches, or a result that comes twice.

    Warns if seeds of two results have equal arrays, because results without a state do not tell
    their keys.
    """
    check_named("results", listed(Result), results)
    if not results:
        raise InputError("results", "at least one", "none")
    joined = join_parts_of_run(results)
    _warn_of_equal_seeds(results)
    return joined


def join_parts_of_run(results: Sequence[Result]) -> Result:
    """Joins results as `join_results` does.

    Their keys are known to differ, so it warns of nothing.
    """
    for index, result in enumerate(results):
        _check_same_search(index, _search_of(result), _search_of(results[0]))
    _check_different_keys(results)
    batches = [result.with_seed_axis() for result in results]
    all_elites = [batch.elites for batch in batches]
    elites = jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *all_elites)
    history = _join_histories([batch.history for batch in batches])
    return replace(without_state(results[0]), elites=elites, history=history)


def without_state(result: Result) -> Result:
    """Returns a result that has no state to continue from."""
    return replace(result, state=NO_STATE)


def _search_of(result: Result) -> dict[str, object]:
    """Returns by name all that results of one search have in common."""
    history = result.history
    common = dict(result.search.settings.values())
    common |= {"size": result.search.shape, "axes": result.search.axes, "config": result.config}
    for name, digest in result.functions:
        common[f"function {name!r}"] = digest
    common["generations of the history"] = [
        history.generation.tolist(),
        history.evaluations.tolist(),
    ]
    return common


def _check_same_search(index: int, got: dict[str, object], expected: dict[str, object]) -> None:
    for name in expected | got:
        if got.get(name) != expected.get(name):
            first, other = quote(expected.get(name), 60), quote(got.get(name), 60)
            raise InputError(
                "results", f"one search with {name} {first}", f"{other} at index {index}"
            )


def _check_different_keys(results: Sequence[Result]) -> None:
    """Checks the fingerprints, which depend on the keys.

    A result that was saved without its state has none.
    """
    seen: dict[int, int] = {}
    for index, result in enumerate(results):
        if not jax.tree.leaves(result.state.inner):
            continue
        first = seen.setdefault(int(result.state.fingerprint), index)
        if first != index:
            raise InputError(
                "results", "each result once", f"the keys of index {first} again at index {index}"
            )


def _warn_of_equal_seeds(results: Sequence[Result]) -> None:
    """Warns if a seed has the arrays of a seed in an earlier result."""
    seen: dict[bytes, tuple[int, int]] = {}
    for index, result in enumerate(results):
        batch = result.with_seed_axis()
        grids, fitness = np.asarray(batch.elites.grids), np.asarray(batch.elites.fitness)
        # The digests of a result are compared after all are made, because two seeds of one result
        # had different keys, or `evolve` has warned of them.
        digests = []
        for seed, history in enumerate(batch.history.best_fitness):
            arrays = grids[seed].tobytes() + fitness[seed].tobytes() + history.tobytes()
            digests.append(sha256(arrays).digest())
        for seed, digest in enumerate(digests):
            if digest in seen:
                first, earlier = seen[digest]
                warn_user(
                    f"results: seed {seed} at index {index} has the elites and the history "
                    f"of seed {earlier} at index {first}: unless the grids are tiny, "
                    "both had the same key, and the joined result counts it twice"
                )
                return
        for seed, digest in enumerate(digests):
            seen[digest] = index, seed


def _join_histories(histories: Sequence[History]) -> History:
    # Each search takes as long as its evaluations need, one after another.
    seeds = [len(history.best_fitness) for history in histories]
    shares = []
    for count, history in zip(seeds, histories, strict=True):
        shares.append(count / history.evaluations_per_second)
    return histories[0]._replace(
        best_fitness=np.concatenate([history.best_fitness for history in histories]),
        elite_count=np.concatenate([history.elite_count for history in histories]),
        refused=np.concatenate([history.refused for history in histories]),
        evaluations_per_second=sum(seeds) / np.sum(shares, axis=0),
    )
