"""What all wrappers share: checks of their arguments, and the options that a caller may replace."""

from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record, check_names
from elitelanes_jax._util.types import Pytree, Untyped, UserValue
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive._library_types import Params


def check_module(params: Params, module: Untyped, name: str, argument: str, needed: str) -> None:
    """Checks the options of an environment, and that a module has what is needed.

    `needed` is the name of a class or module, such as ``vector.VectorEnv``.
    """
    attribute = module
    for attribute_name in needed.split("."):
        attribute = getattr(attribute, attribute_name, None)
    if attribute is None:
        raise InputError(argument, f"the module {name}", quote(module))
    if not isinstance(params, Record):
        expected = "RoadNavParams, LaneDriveParams or RoadTrafficParams"
        raise InputError("params", expected, quote(params))


def check_render(render: UserValue) -> Callable[[Batch], list[NDArray[np.uint8]]] | None:
    """Returns a function that draws a picture of each environment of a batch; None without `render`.

    `render` takes a state. Raises `InputError` if it is no function. The returned function raises
    it if `render` returns no picture.
    """
    if render is None:
        return None
    if not callable(render):
        raise InputError(
            "render",
            "a function that takes a state and returns a picture, or None",
            quote(render),
        )

    def draw(state: Pytree) -> NDArray[np.uint8]:
        picture = np.asarray(render(state))
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            got = f"{picture.dtype} {list(picture.shape)}"
            raise InputError("render", "a function that returns a picture uint8 [H, W, 3]", got)
        return picture

    return lambda batch: list(map(draw, batch.states("render")))


def read_options(options: UserValue, *known: str) -> Mapping[str, UserValue]:
    """Returns the options of a reset, a dictionary with some of the known names, or None."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise InputError("options", "a dictionary", quote(options))
    check_names(map(str, options), known)
    return options


# Attributes that are fixed when a wrapper is made. Another value would change nothing.
_FIXED = frozenset(
    {"action_space", "observation_space", "single_action_space", "single_observation_space"}
    | {"num_envs", "num_agents", "autoreset_mode", "render_mode"}
)

# Beartype takes `Self` in whole classes that it decorates, and jaxtyping decorates methods.
W = TypeVar("W", bound="HasParams")


class HasParams:
    """The options of a wrapper, which the caller may replace, see `Batch.replace_params`."""

    _batch: Batch
    _is_made = False

    @property
    def params(self) -> Params:
        return self._batch.params

    @params.setter
    def params(self, params: UserValue) -> None:
        self._batch.replace_params(params)

    def __setattr__(self, name: str, value: UserValue) -> None:
        # The constructors of libraries set these names too.
        if self._is_made and name in _FIXED:
            raise InputError(
                name,
                "the value that the environment has",
                quote(value),
                "make another environment",
            )
        # An attribute of this name would change nothing.
        if "_batch" in vars(self) and name in self.params.options():
            raise InputError(
                name,
                f"it in params, as env.params = env.params.replace({name}=...)",
                "an attribute",
            )
        super().__setattr__(name, value)

    def made(self: W, batch: Batch) -> W:
        """Returns the environment with its batch, complete from here on."""
        # An attribute is copied with the environment, so a deep copy has states of its own.
        self._batch = batch
        self._is_made = True
        return self

    def check_settable(self, name: UserValue) -> None:
        """Checks a name that `set_attr` got."""
        if name != "params":
            got = quote(name)
            raise InputError("set_attr", "params, the only attribute to set", got)
