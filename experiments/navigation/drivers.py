"""The drivers of the study: what each task's network sees, and the environment that it learns in."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jaxtyping import Array, Key
from numpy.typing import NDArray

from elitelanes_jax.drive import Environment, Transition
from experiments.common import Pytree
from experiments.navigation.ppo import Outputs

__all__ = ["LaneNetwork", "MapNetwork", "WindowNetwork", "at_choices", "in_lane", "lane_layers"]


def at_choices(environment: Environment, most: int = 8) -> Environment:
    """Makes the environment whose step goes on while there is but one way, for at most so many tiles in all.

    Rewards add up. Decisions are fewer, and each matters.
    """

    def step(key: Key[Array, ""], state: Pytree, action: Pytree, params: Pytree) -> Transition:
        done = environment.step(key, state, action, params)

        def go_on(_: Array, done: Transition) -> Transition:
            stay = done.terminated | done.truncated | (done.observation.ways.sum() != 1)
            more = environment.step(key, done.state, 0, params)
            more = more._replace(reward=done.reward + more.reward)
            return jax.tree.map(lambda new, old: jnp.where(stay, old, new), more, done)

        return jax.lax.fori_loop(1, most, go_on, done)

    return environment._replace(step=step)


def in_lane(environment: Environment) -> Environment:
    """Makes the environment of `LaneDrive` that terminates, at the same cost, where the own lane is left."""

    def step(key: Key[Array, ""], state: Pytree, action: Pytree, params: Pytree) -> Transition:
        done = environment.step(key, state, action, params)
        left = ~done.info.own_lane & ~done.terminated
        return done._replace(
            reward=done.reward - params.leaving_cost * left,
            terminated=done.terminated | left,
            truncated=done.truncated & ~left,
        )

    return environment._replace(step=step)


_INIT = partial(nn.initializers.orthogonal, np.sqrt(2))


def _hidden(x: Array, *sizes: int) -> Array:
    for size in sizes:
        x = nn.relu(nn.Dense(size, kernel_init=_INIT())(x))
    return x


def _heads(x: Array, ways: Array) -> tuple[Array, Array]:
    """Returns logits of the open ways, and values."""
    logits = nn.Dense(ways.shape[-1], kernel_init=nn.initializers.orthogonal(0.01))(x)
    closed = ~ways & ways.any(axis=-1, keepdims=True)
    return jnp.where(closed, -1e9, logits), nn.Dense(1, kernel_init=_INIT())(x)[..., 0]


class MapNetwork(nn.Module):
    """Sees the whole map around itself, turned to its heading, and the goal with its heading; no memory.

    It needs `window` of at least twice the map's side less one, and `whole_map`.
    """

    width: int = 128
    memory: int = 0

    @nn.compact
    def __call__(self, memory: Array, seen: Pytree, first: Array) -> Outputs:
        """See `ppo.Network`."""
        x = nn.relu(_links(seen.window, self.width) + self._goal(seen))
        logits, value = _heads(_hidden(x, self.width // 2, self.width // 2), seen.ways)
        return memory, logits, value

    def _goal(self, seen: Pytree) -> Array:
        """Embeds where the goal is, and from where it is to be reached."""
        size = seen.window.shape[-1]
        turned = (seen.there[..., 2] - seen.here[..., 2]) % 4
        number = seen.mark.reshape(*seen.mark.shape[:-2], -1).argmax(axis=-1) * 4 + turned
        return nn.Embed(size * size * 4, self.width, embedding_init=nn.initializers.normal(0.5))(number)


def _links(window: Array, width: int) -> Array:
    """Maps the links in a window, each once: those ahead of and left of each tile."""
    bits = jnp.stack([window & 8 > 0, window & 1 > 0], axis=-1).astype(jnp.float32)
    return nn.Dense(width, kernel_init=_INIT())(bits.reshape(*window.shape[:-2], -1))


class WindowNetwork(nn.Module):
    """Sees a window and the compass, and remembers in a gated recurrent unit."""

    width: int = 128
    memory: int = 64

    @nn.compact
    def __call__(self, memory: Array, seen: Pytree, first: Array) -> Outputs:
        """See `ppo.Network`."""
        compass = seen.compass * jnp.array([1, 1, 0.1])
        x = nn.relu(_links(seen.window, self.width) + nn.Dense(self.width, kernel_init=_INIT())(compass))
        x = _hidden(x, self.width)
        cell = nn.scan(_Cell, variable_broadcast="params", split_rngs={"params": False})(self.memory)
        # What the unit makes of its inputs is one product over all steps; only its memory goes step by step.
        memory, held = cell(memory, (nn.Dense(3 * self.memory)(x), first))
        logits, value = _heads(jnp.concatenate([x, held], axis=-1), seen.ways)
        return memory, logits, value


class _Cell(nn.Module):
    """A gated recurrent unit (Cho et al., 2014) that forgets all when an episode begins."""

    size: int

    @nn.compact
    def __call__(self, memory: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        given, first = step
        memory = jnp.where(first[:, None], 0, memory)
        held = nn.Dense(3 * self.size, use_bias=False, kernel_init=nn.initializers.orthogonal())(memory)
        (keep, mix, new), (keep_held, mix_held, new_held) = (jnp.split(part, 3, axis=-1) for part in (given, held))
        kept = nn.sigmoid(keep + keep_held)
        memory = kept * memory + (1 - kept) * nn.tanh(new + nn.sigmoid(mix + mix_held) * new_held)
        return memory, memory


class LaneNetwork(nn.Module):
    """Sees the robot's place on its lane and the lane's curvature ahead; drives by speed and turn."""

    width: int = 64
    memory: int = 0

    @nn.compact
    def __call__(self, memory: Array, seen: Pytree, first: Array) -> Outputs:
        """See `ppo.Network`."""
        numbers = jnp.stack([seen.d, seen.phi, seen.speed, seen.turn], axis=-1)
        x = jnp.concatenate([numbers, seen.curvature], axis=-1) * _scale(4 + seen.curvature.shape[-1])
        first_hidden = nn.tanh(nn.Dense(self.width, name="layer_0")(x))
        hidden = nn.tanh(nn.Dense(self.width, name="layer_1")(first_hidden))
        mean = nn.Dense(2, kernel_init=nn.initializers.orthogonal(0.01), name="layer_2")(hidden)
        deviation = self.param("log_deviation", nn.initializers.constant(-1.0), (2,))
        value = nn.Dense(1)(_hidden(x, self.width, self.width))[..., 0]
        return memory, jnp.concatenate([mean, jnp.broadcast_to(deviation, mean.shape)], axis=-1), value


def _scale(size: int) -> NDArray[np.float32]:
    """Returns what the numbers of an observation are multiplied by: offset, heading error, speed, turn, curvatures."""
    return np.array([10, 3, 1, 0.25] + [1 / 3] * (size - 4), np.float32)


def lane_layers(weights: Pytree) -> dict[str, NDArray[np.float32]]:
    """Returns the driver of a trained `LaneNetwork` as arrays to save: what it takes, without Flax, to drive by it.

    From the observation of `LaneDrive` as one vector x (see `wrappers.flatten`) to the action "twist": ``x * scale``,
    and then ``x @ kernel_i + bias_i`` for i = 0, 1, 2, with tanh after the first two.
    """
    held = {"scale": _scale(weights["params"]["layer_0"]["kernel"].shape[0])}
    for number in range(3):
        layer = weights["params"][f"layer_{number}"]
        held |= {f"kernel_{number}": np.asarray(layer["kernel"]), f"bias_{number}": np.asarray(layer["bias"])}
    return held
