"""Runs an optimiser: many seeds and many generations in one compiled call."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Int, Key, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named, instance, whole
from elitelanes_jax._util.errors import InputError, quote, shorten
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Pytree, Tree, UserValue
from elitelanes_jax.network.bits import THREEFRY, fold_in, threefry
from elitelanes_jax.network.edges import check_array, check_same_tree
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import run_if, vary_together
from elitelanes_jax.optimizers.base import Info, Optimizer
from elitelanes_jax.problem.archive import Population


@name_wrong_arguments
@runs_jax
def seed_keys(seed: int, indices: int | Sequence[int]) -> Key[Array, " K"]:
    """Returns keys ``[K]`` made from a whole number, 0 to 2**32 - 1.

    Each key depends on `seed` and its index alone.

    Key i is ``fold_in(key(seed, impl="threefry2x32"), i)``, whatever kind of key JAX is set to
    make. `indices` are those of the keys; or their number K, for the first K. Raises `InputError`
    for another seed, or other indices than 0 to 2**32 - 1.
    """
    seed = check_named("seed", SEED, seed)
    index = whole(0, 2**32 - 1)
    if hasattr(indices, "tolist"):
        # An array without axes becomes a number.
        indices = indices.tolist()
    if isinstance(indices, Iterable) and np.ndim(indices):
        chosen = np.array([check_named("indices", index, one) for one in indices], np.int64)
    else:
        chosen = np.arange(check_named("indices", index, indices))
    return jax.random.wrap_key_data(jax.device_put(seed_key_data(seed, chosen)), impl=THREEFRY)


def seed_key_data(seed: int, indices: Int[np.ndarray, " K"]) -> UInt32[np.ndarray, "K 2"]:
    """Returns the data of `seed_keys`, for checked arguments.

    In NumPy, because JAX needs a quarter of a second to trace, lower and load the same.
    """
    return np.stack(
        threefry(np.array([[0], [seed]], np.uint32), indices.astype(np.uint32)), axis=-1
    )


@name_wrong_arguments
@runs_jax
def run(optimizer: Optimizer, keys: Key[Array, " S"], generations: int) -> tuple[Pytree, Info]:
    """Runs an optimiser from the start; for `jax.jit`.

    Args:
      optimizer: the optimiser of one problem.
      keys: ``[S]``, one for each seed. With JAX's default kind of key a seed's result does not
        depend on other seeds.
      generations: the number of generations, static.

    Returns:
      The states of all seeds, arrays ``[S, ...]``, and an `Info` of arrays ``[generations, S]``.
    """
    if not isinstance(optimizer, Optimizer):
        raise InputError("optimizer", "an Optimizer", type(optimizer).__name__)
    # A key of the old style is a vector of two numbers, so its batch has one more axis.
    if np.ndim(keys) != 1 + (getattr(keys, "dtype", None) == np.uint32):
        raise InputError("keys", "keys [S], such as those of seed_keys", quote(keys))
    if not np.shape(keys)[0]:
        raise InputError("keys", "at least one", "none")
    check_named("generations", whole(0), generations)

    def run_all(keys: Array) -> tuple[Pytree, Info]:
        first = optimizer.first_generation
        states = start(optimizer, keys)
        most = generations + 1 - first
        states, info = advance(optimizer, keys, states, first, generations, most=most)
        # Generation 0 only evaluates the initial grids, so its row is left out.
        return states, jax.tree.map(lambda rows: rows[1 - first :], info)

    return divide_batches(run_all, rows=(0, 1))(keys)


@runs_jax
def start(optimizer: Optimizer, keys: Key[Array, " S"]) -> Pytree:
    """Returns the states of runs before their first step, arrays ``[S, ...]``.

    The keys are ``[S]``. The first generation to run from these states is
    `Optimizer.first_generation`.
    """
    init = optimizer.init_unevaluated or optimizer.init
    states = over_seeds(lambda key: init(fold_in(key, 0)), keys)
    return check_state(states)


def over_seeds(function: Callable[..., Pytree], *trees: Pytree) -> Pytree:
    """Maps a function over the first axis of arrays, with `vmap` for several seeds.

    One seed alone takes a quarter less time to trace without `vmap`.
    """
    if jax.tree.leaves(trees)[0].shape[0] > 1:
        return jax.vmap(function)(*trees)
    result = function(*jax.tree.map(lambda array: array[0], trees))
    # A leaf from a user's optimiser may be a Python number.
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], result)


@runs_jax
def advance(
    optimizer: Optimizer,
    keys: Key[Array, " S"],
    states: Pytree,
    first: Int[ArrayLike, ""],
    last: Int[ArrayLike, ""],
    *,
    most: int,
) -> tuple[Pytree, Info]:
    """Runs the generations `first` to `last`, both included.

    A run begins with `Optimizer.first_generation`. Generation i of a seed depends on
    ``fold_in(key, i)`` and the state before it alone. Therefore generations 1 to 200 equal 1 to 100
    and then 101 to 200, bit for bit. With JAX's default kind of key, a seed's result does not
    depend on other seeds. `first` and `last` may be traced: one compiled call serves every part of
    every run.

    Returns the states, and an `Info` of arrays ``[most, S]``. Only the first `last` - `first` + 1
    rows have a meaning; if `last` is less than `first`, no generation is run. `most` is static.
    """

    # The function is inlined, so that it is traced once for the shapes and for the loop.
    @partial(jax.jit, inline=True)
    def step(states: Pytree, generation: Array) -> tuple[Pytree, Info]:
        def step_one(key: Array, state: Pytree) -> tuple[Pytree, Info]:
            outcome = optimizer.step(fold_in(key, generation), state)
            _check_step(state, outcome)
            return outcome

        return over_seeds(step_one, keys, states)

    first, last = (jnp.asarray(bound, jnp.int32) for bound in (first, last))
    states = vary_together(states, keys)
    row = jax.eval_shape(step, states, jnp.int32(0))[1]
    no_row = jax.tree.map(jnp.zeros_like, row)

    def run_generation(states: Pytree, generation: Array) -> tuple[Pytree, Info]:
        # After `last` nothing is left to do. The loop of one round in `run_if` then passes on the
        # states without a copy.
        return run_if(
            generation <= last, lambda _, carry: step(carry[0], generation), (states, no_row)
        )

    return lax.scan(run_generation, states, first + jnp.arange(most, dtype=jnp.int32))


def check_state(state: Tree) -> Tree:
    """Returns what an optimiser's `init` returned; raises `InputError` if it has no array."""
    if not jax.tree.leaves(state):
        raise InputError("optimizer", "an init that returns a pytree of arrays", quote(state))
    return state


def check_elites(elites: UserValue, shape: tuple[int, int], features: int) -> Population:
    """Returns the elites of an optimiser for grids of a shape.

    Raises `InputError` if they do not fit.
    """
    checked = check_named("optimizer: elites", instance(Population), elites)
    # The optimiser may be the user's. Its arrays may be of NumPy, and have other widths of
    # integers.
    slots = np.shape(checked.fitness)[:1]
    grids, fitness, columns = (jnp.asarray(array) for array in checked)
    for name, array in (("grids", grids), ("features", columns)):
        if not jnp.issubdtype(array.dtype, jnp.integer):
            raise InputError("optimizer: elites", f"{name} of whole numbers", array.dtype)
    grids, columns = grids.astype(jnp.int8), columns.astype(jnp.int32)
    check_array("optimizer: elites: fitness", fitness, slots or ("N",), jnp.int32, jnp.float32)
    check_array("optimizer: elites: grids", grids, (*slots, *shape), jnp.int8)
    check_array("optimizer: elites: features", columns, (*slots, features), jnp.int32)
    return Population(grids, fitness, columns)


def _check_step(state: Pytree, outcome: UserValue) -> None:
    """Raises `InputError` unless a step returned a state and an `Info` of scalars.

    The state has the structure, shapes and dtypes of the state that the step took.
    """
    if not _is_state_and_info(outcome):
        got = repr(outcome)
        if isinstance(outcome, tuple):
            # The text of a state may be long, so the message has only the types.
            got = f"({', '.join(type(part).__name__ for part in outcome)})"
        raise InputError("optimizer", "a step that returns (state, Info)", shorten(got))
    new_state, info = outcome
    for name in Info._fields:
        shape = np.shape(getattr(info, name))
        if shape:
            raise InputError("optimizer", "an Info of scalars", f"{name} of shape {shape}")
    check_same_tree(
        "optimizer: expected a step that keeps the structure, shapes and dtypes of its state",
        state,
        new_state,
    )


def _is_state_and_info(outcome: UserValue) -> TypeGuard[tuple[Pytree, Info]]:
    if not isinstance(outcome, tuple) or len(outcome) != 2:
        return False
    return set(Info._fields) <= set(getattr(outcome[1], "_fields", ()))
