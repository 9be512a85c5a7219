"""The functions and configurations of a user.

They are checked, and a changed function is recognised.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial
from inspect import unwrap

import jax
import jax.numpy as jnp
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Key

from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import Plain, Pytree, UserValue
from elitelanes_jax.optimizers.loop import check_state
from elitelanes_jax.optimizers.presets import PRESETS, Config, find_preset, user_moves, with_moves
from elitelanes_jax.problem.kernels import Digest, apply_fitness, check_fitness, digest
from elitelanes_jax.search._setup import Extensions, Factory, Setup
from elitelanes_jax.search.compile_cache import settings_of_thread
from elitelanes_jax.search.resolve import Search, with_method
from elitelanes_jax.search.settings import CUSTOM
from elitelanes_jax.search.spec import SearchSpec


def set_method(
    spec: SearchSpec, options: Mapping[str, UserValue], extensions: Extensions
) -> SearchSpec:
    """Returns a specification that asks for the method of a configuration.

    With an optimiser of the user, the specification asks for any method.

    Args:
      spec: the specification with the options of the call.
      options: the options of the call.
      extensions: the extensions of the call.

    Raises:
      InputError: for a configuration or an optimiser of the wrong type, both, the configuration of
        another method than the one in `options`, a preset beside it, or a method beside an
        optimiser.
    """
    # A configuration replaces the method of a specification, which may come from an earlier result,
    # but not another method in the same call.
    config, optimizer = extensions.config, extensions.optimizer
    if optimizer is not None:
        if not callable(optimizer):
            expected = "a function from a problem to an Optimizer (method= takes names)"
            raise InputError("optimizer", expected, quote(optimizer))
        if config is not None:
            raise InputError("config", "none with an optimizer", quote(config, 60))
        # A preset stays: it has the default axes.
        if "method" in options:
            raise InputError("method", "none with an optimizer", repr(options["method"]))
        if extensions.moves is not None:
            raise InputError("moves", "a method with moves, such as preset tuned", "an optimizer")
        if spec.options.get("method") == CUSTOM:
            # The method is that of an earlier result.
            return spec.replace(method="map-elites", preset="tuned")
        return spec
    if config is None:
        return spec
    _check_plain_numbers("config", config)
    method, preset = find_preset(config)
    if options.get("method", method) != method:
        raise InputError("config", f"one of {options['method']}", type(config).__name__)
    if "preset" in options:
        raise InputError("preset", "none with a config", repr(options["preset"]))
    return spec.replace(method=method, preset=preset)


def _check_plain_numbers(argument: str, config: Config) -> None:
    """Checks that a configuration has no arrays.

    Results whose configuration has arrays could not be compared or saved.
    """
    for path, leaf in jax.tree.leaves_with_path(config):
        if hasattr(leaf, "dtype"):
            raise InputError(argument, "plain numbers", f"an array, {jax.tree_util.keystr(path)}")


def check_extensions(search: Search, extensions: Extensions) -> None:
    """Checks the user's functions against a resolved search.

    Raises:
      InputError: for a feature without a kernel, a function without a hash, or a fitness that JAX
        cannot trace.
    """
    for name in search.settings.features:
        if name not in extensions.kernels:
            expected = f"the kernel of {name}, as evolve(features={{name: kernel}})"
            raise InputError("features", expected, "none")
    functions = [
        ("optimizer", extensions.optimizer),
        ("fitness", extensions.fitness),
        *extensions.kernels.items(),
    ]
    for name, function in functions:
        if not _is_hashable(function):
            raise InputError(name, "a function with a hash", quote(function))
    if extensions.fitness is not None:
        check_fitness(extensions.fitness, search.shape, search.feature_names)


def find_config(search: Search, extensions: Extensions) -> Config | None:
    """Returns the configuration of a search, with the user's moves.

    The configuration is the user's, or the preset's. For an optimiser of the user it is None.

    Raises:
      InputError: for moves of a method that has none, or weights of moves that are arrays.
    """
    if extensions.optimizer is not None:
        return None
    config = extensions.config
    if config is None:
        config = PRESETS[search.settings.method, search.settings.preset]
    if extensions.moves is not None:
        config = with_moves(config, extensions.moves)
        _check_plain_numbers("moves", config)
    return config


def record_method(search: Search, config: Config | None, extensions: Extensions) -> Search:
    """Returns a search whose settings say what makes the result, if it is no preset of a method."""
    if extensions.optimizer is not None:
        return with_method(search, CUSTOM, _name_of(extensions.optimizer))
    if config != PRESETS[search.settings.method, search.settings.preset]:
        return with_method(search, search.settings.method, CUSTOM)
    return search


def _is_hashable(value: UserValue) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


def _name_of(factory: Factory) -> str:
    """Returns the module and the name of a function, or of the type of a callable object."""
    while isinstance(factory, partial):
        factory = factory.func
    named = unwrap(factory) if hasattr(factory, "__qualname__") else type(factory)
    return f"{named.__module__}.{named.__qualname__}"


def digest_functions(setup: Setup) -> dict[str, Digest]:
    """Returns the digests of the user's functions, by name.

    They are needed because an edited function keeps its name. Features, a fitness and moves are
    traced at every call, because a global or an attribute that a function reads may have changed.
    An optimiser is traced again only if one of these computes something else; its digest covers
    them. A fitness or a move whose name a feature has too is named by its kind as well, such as
    "move zigzag".
    """
    digests = _digest_kernels(setup)
    if setup.factory is not None:
        # Without these digests, the cache would return the digest of a fitness as it was.
        digits = [(name, digest.digits) for name, digest in digests.items()]
        leaves, structure = jax.tree.flatten(replace(setup, digests=tuple(digits)))
        numbers = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves)
        return {"optimizer": _digest_optimizer(structure, numbers, settings_of_thread())}
    assert setup.config is not None
    grid = jax.ShapeDtypeStruct(setup.problem.shape, jnp.int8)
    for name, move in user_moves(setup.config).items():
        bits = jax.ShapeDtypeStruct((move.bits,), jnp.uint32)
        if name in digests:
            name = f"move {name}"
        digests[name] = digest(move.apply, bits, grid, grid)
    return digests


def _digest_kernels(setup: Setup) -> dict[str, Digest]:
    """Returns the digests of the user's features and fitness, by name."""
    problem = setup.problem
    grid = jax.ShapeDtypeStruct(problem.shape, jnp.int8)
    digests = {name: digest(kernel, grid) for name, kernel in problem.kernels}
    if problem.fitness is not None:
        grids = jax.ShapeDtypeStruct((1, *problem.shape), jnp.int8)
        features = jax.ShapeDtypeStruct((1, len(problem.feature_names)), jnp.int32)
        usual = jax.ShapeDtypeStruct((1,), jnp.int32)
        fitness = partial(apply_fitness, problem.fitness, problem.feature_names)
        name = "user fitness" if "fitness" in digests else "fitness"
        digests[name] = digest(fitness, grids, features, usual)
    return digests


@lru_cache(maxsize=32)
def _digest_optimizer(
    structure: PyTreeDef,
    numbers: tuple[jax.ShapeDtypeStruct, ...],
    settings: tuple[tuple[str, Plain], ...],
) -> Digest:
    """Returns the digest of the user's optimiser, which takes up to a second to trace.

    `structure` is that of the setup; `numbers` are the shapes and dtypes of its leaves. `settings`
    are those of JAX, which may change what is traced.
    """
    setup: Setup = jax.tree.unflatten(structure, numbers)
    key = jax.eval_shape(partial(jax.random.key, impl=setup.key_kind), 0)
    return digest(_call_all, setup, key)


def _call_all(setup: Setup, key: Key[Array, ""]) -> Pytree:
    optimizer = setup.make_optimizer()
    state = check_state(optimizer.init(key))
    return optimizer.step(key, state), optimizer.elites(state), optimizer.evaluations_per_step
