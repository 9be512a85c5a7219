"""Proximal policy optimisation for the environments in `elitelanes_jax.drive`, with Flax and Optax.

Schulman et al., "Proximal policy optimization algorithms", 2017; advantages of Schulman et al., "High-dimensional
continuous control using generalized advantage estimation", 2016.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import NamedTuple, Protocol, TypeAlias

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Key

from elitelanes_jax.drive import Environment, Level, auto_reset
from experiments.common import Pytree

__all__ = [
    *("Driven", "Driver", "Network", "Outputs", "Ppo", "advantages", "begin", "collect", "distribution"),
    *("drive_levels", "learn", "train"),
]


Outputs: TypeAlias = tuple[Float[Array, "B M"], Float[Array, "T B A"], Float[Array, "T B"]]
"""What a network returns: its memory after the steps, the head of `distribution`, and the values of observations."""


class Network(Protocol):
    """A policy with memory: a module of Flax that maps memory, observations and first steps to `Outputs`.

    Memory is float32 ``[B, M]``. Observations are ``[T, B, ...]``. First steps, bool ``[T, B]``, begin an episode.
    """

    @property
    def memory(self) -> int:
        """The size M of the memory, which may be 0."""

    def init(self, key: Key[Array, ""], /, *inputs: Pytree) -> Pytree:
        """Returns random weights."""

    def apply(self, weights: Pytree, /, *inputs: Pytree) -> Pytree:
        """Returns the `Outputs` of inputs."""


class Ppo(NamedTuple):
    """Settings of the training.

    Attributes:
      updates: how many; each drives and then learns from what was driven.
      envs: environments side by side.
      steps: of each environment in an update.
      epochs: passes over an update's steps.
      minibatches: parts of the environments, each of which makes one step of Adam.
      rate: of Adam at the start; it falls to 0.
      discount: of a step.
      trace: lambda of the advantages.
      clip: of the ratio of probabilities.
      entropy: weight of the entropy at the start; it falls to 0.
    """

    updates: int
    envs: int = 256
    steps: int = 32
    epochs: int = 4
    minibatches: int = 8
    rate: float = 1e-3
    discount: float = 0.98
    trace: float = 0.95
    clip: float = 0.2
    entropy: float = 0.01


class Driven(NamedTuple):
    """The steps that were driven, each ``[T, B, ...]``; `after` is the value of the observation after an action."""

    seen: Pytree
    first: Array
    action: Array
    chance: Array
    value: Array
    after: Array
    reward: Array
    terminated: Array
    ended: Array


class Driver(NamedTuple):
    """The state of a training: the learner, and the environments with the memory of the policy."""

    weights: Pytree
    optimizer: Pytree
    states: Pytree
    seen: Pytree
    first: Array
    memory: Array


def distribution(
    head: Array, discrete: bool
) -> tuple[Callable[[Array], Array], Callable[[Array], Array], Callable[[], Array]]:
    """Returns the functions of a policy's distribution: key -> action, action -> log-probability, and () -> entropy.

    Args:
      head: float32 ``[..., A]``: logits of actions, or means followed by logarithms of standard deviations.
      discrete: which of the two.
    """
    if discrete:
        logs = jax.nn.log_softmax(head)
        return (
            lambda key: jax.random.categorical(key, head),
            lambda action: jnp.take_along_axis(logs, action[..., None], axis=-1)[..., 0],
            lambda: -(jnp.exp(logs) * logs).sum(axis=-1),
        )
    mean, log_deviation = jnp.split(head, 2, axis=-1)
    deviation = jnp.exp(log_deviation)
    constant = 0.5 * jnp.log(2 * jnp.pi)

    def chance(action: Array) -> Array:
        return (-0.5 * ((action - mean) / deviation) ** 2 - log_deviation - constant).sum(axis=-1)

    return (
        lambda key: mean + deviation * jax.random.normal(key, mean.shape),
        chance,
        lambda: (log_deviation + constant + 0.5).sum(axis=-1),
    )


def advantages(
    reward: Array,
    value: Array,
    after: Array,
    terminated: Array,
    ended: Array,
    discount: float,
    trace: float,
) -> Array:
    """Estimates advantages, float32 ``[T, B]``, of steps with these rewards.

    Args:
      reward: float32 ``[T, B]``.
      value: float32 ``[T, B]``, of the observation that each step began with.
      after: float32 ``[T, B]``, of the one it led to, before any reset.
      terminated: bool ``[T, B]``, nothing comes after: `after` counts as 0.
      ended: bool ``[T, B]``, terminated or truncated: the next step belongs to another episode.
      discount: of a step.
      trace: lambda.
    """
    surprise = reward + discount * after * ~terminated - value

    def back(later: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        surprise, ended = step
        now = surprise + discount * trace * later * ~ended
        return now, now

    return jax.lax.scan(back, jnp.zeros_like(value[0]), (surprise, ended), reverse=True)[1]


def train(
    key: Array, environment: Environment, params: Pytree, network: Network, ppo: Ppo
) -> Iterator[tuple[Pytree, Array]]:
    """Trains a policy.

    Args:
      key: consumed.
      environment: whose resets draw from ``params.levels``.
      params: its settings.
      network: the policy.
      ppo: settings of the training.

    Yields:
      After each update the weights, and the mean reward of its steps. Arrays that were yielded last are used up.
    """
    beginning, training = jax.random.split(key)
    driver = _begin(beginning, params, environment, network, ppo)
    for update in range(ppo.updates):
        driver, reward = _update(jax.random.fold_in(training, update), driver, params, environment, network, ppo)
        yield driver.weights, reward


@lru_cache
def _optimizer(ppo: Ppo) -> optax.GradientTransformation:
    rate = optax.linear_schedule(ppo.rate, 0.0, ppo.updates * ppo.epochs * ppo.minibatches)
    return optax.chain(optax.clip_by_global_norm(0.5), optax.adam(rate, eps=1e-5))


@partial(jax.jit, static_argnames=("environment", "network", "ppo"))
def _begin(key: Array, params: Pytree, environment: Environment, network: Network, ppo: Ppo) -> Driver:
    starting, weighing = jax.random.split(key)
    seen, states = jax.vmap(environment.reset, (0, None))(jax.random.split(starting, ppo.envs), params)
    return begin(weighing, seen, states, network, ppo)


def begin(key: Array, seen: Pytree, states: Pytree, network: Network, ppo: Ppo) -> Driver:
    """Returns a driver with random weights and B environments in these states; the key is consumed."""
    count = len(jax.tree.leaves(seen)[0])
    first, memory = jnp.ones(count, bool), jnp.zeros((count, network.memory))
    weights = network.init(key, memory, *_row((seen, first)))
    return Driver(weights, _optimizer(ppo).init(weights), states, seen, first, memory)


@partial(jax.jit, static_argnames=("environment", "network", "ppo"), donate_argnames="driver")
def _update(
    key: Array, driver: Driver, params: Pytree, environment: Environment, network: Network, ppo: Ppo
) -> tuple[Driver, Array]:
    driving, learning = jax.random.split(key)
    memory = driver.memory
    driver, driven = collect(driving, driver, params, auto_reset(environment), network, ppo.steps)
    discrete = environment.actions is not None
    weights, optimizer = learn(learning, driver.weights, driver.optimizer, memory, driven, network, ppo, discrete)
    return driver._replace(weights=weights, optimizer=optimizer), driven.reward.mean()


def collect(
    key: Array, driver: Driver, params: Pytree, environment: Environment, network: Network, steps: int
) -> tuple[Driver, Driven]:
    """Drives some steps of all environments.

    Args:
      key: consumed.
      driver: the state before.
      params: of the environment.
      environment: whose steps begin the next episode themselves.
      network: the policy.
      steps: of each environment.
    """
    discrete, count = environment.actions is not None, len(driver.first)

    def drive(driver: Driver, key: Array) -> tuple[Driver, Driven]:
        choosing, going = jax.random.split(key)
        memory, head, value = network.apply(driver.weights, driver.memory, *_row((driver.seen, driver.first)))
        draw, chance_of, _ = distribution(head[0], discrete)
        action = draw(choosing)
        done = jax.vmap(environment.step, (0, 0, 0, None))(
            jax.random.split(going, count), driver.states, action, params
        )
        _, _, after = network.apply(driver.weights, memory, *_row((done.reached, jnp.zeros_like(driver.first))))
        ended = done.terminated | done.truncated
        step = Driven(
            *(driver.seen, driver.first, action, chance_of(action), value[0], after[0]),
            *(done.reward, done.terminated, ended),
        )
        return driver._replace(states=done.state, seen=done.observation, first=ended, memory=memory), step

    return jax.lax.scan(drive, driver, jax.random.split(key, steps))


def learn(
    key: Array,
    weights: Pytree,
    optimizer: Pytree,
    memory: Array,
    driven: Driven,
    network: Network,
    ppo: Ppo,
    discrete: bool,
) -> tuple[Pytree, Pytree]:
    """Learns from steps; returns the weights and the state of the optimiser.

    Args:
      key: consumed.
      weights: of the network.
      optimizer: its state.
      memory: of the policy before the first step, ``[B, M]``.
      driven: the steps ``[T, B]`` of these weights.
      network: the policy.
      ppo: settings of the training.
      discrete: see `distribution`.
    """
    outcome = driven.reward, driven.value, driven.after, driven.terminated, driven.ended
    advantage = advantages(*outcome, ppo.discount, ppo.trace)
    target = advantage + driven.value
    share = 1 - optimizer[1][0].count / (ppo.updates * ppo.epochs * ppo.minibatches)

    def loss(weights: Pytree, memory: Array, driven: Driven, advantage: Array, target: Array) -> Array:
        _, head, value = network.apply(weights, memory, driven.seen, driven.first)
        _, chance_of, entropy = distribution(head, discrete)
        ratio = jnp.exp(chance_of(driven.action) - driven.chance)
        scaled = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        gain = jnp.minimum(ratio * scaled, jnp.clip(ratio, 1 - ppo.clip, 1 + ppo.clip) * scaled).mean()
        return 0.5 * ((value - target) ** 2).mean() - gain - ppo.entropy * share * entropy().mean()

    def improve(carry: tuple[Pytree, Pytree], chosen: Array) -> tuple[tuple[Pytree, Pytree], None]:
        weights, optimizer = carry
        part = jax.tree.map(lambda x: x[:, chosen], (driven, advantage, target))
        gradient = jax.grad(loss)(weights, memory[chosen], *part)
        updates, optimizer = _optimizer(ppo).update(gradient, optimizer)
        return (optax.apply_updates(weights, updates), optimizer), None

    orders = jax.vmap(lambda key: jax.random.permutation(key, len(memory)))(jax.random.split(key, ppo.epochs))
    parts = orders.reshape(ppo.epochs * ppo.minibatches, -1)
    return jax.lax.scan(improve, (weights, optimizer), parts)[0]


def _row(tree: Pytree) -> Pytree:
    """Puts an axis of one step in front."""
    return jax.tree.map(lambda x: x[None], tree)


@partial(jax.jit, static_argnames=("environment", "network", "steps"))
def drive_levels(
    key: Array,
    weights: Pytree,
    levels: Level,
    params: Pytree,
    environment: Environment,
    network: Network,
    *,
    steps: int,
) -> Pytree:
    """Drives one episode on each level, and returns the info ``[N]`` of its last step.

    Args:
      key: consumed.
      weights: of the network.
      levels: a batch of N.
      params: of the environment.
      environment: without automatic resets.
      network: as in `train`.
      steps: the most that are driven.
    """
    count = levels.grid.shape[0]
    starting, driving = jax.random.split(key)
    seen, states = jax.vmap(environment.reset_to_level, (0, 0, None))(jax.random.split(starting, count), levels, params)

    discrete = environment.actions is not None

    def go(carry: Pytree) -> Pytree:
        step, seen, states, memory, first, over, info = carry
        choosing, going = jax.random.split(jax.random.fold_in(driving, step))
        memory, head, _ = network.apply(weights, memory, *_row((seen, first)))
        action = distribution(head[0], discrete)[0](choosing)
        done = jax.vmap(environment.step, (0, 0, 0, None))(jax.random.split(going, count), states, action, params)

        def stay(new: Array, old: Array) -> Array:
            return jnp.where(over.reshape(over.shape + (1,) * (new.ndim - 1)), old, new)

        info, states, seen = jax.tree.map(stay, (done.info, done.state, done.observation), (info, states, seen))
        over |= done.terminated | done.truncated
        return step + 1, seen, states, memory, jnp.zeros_like(first), over, info

    shape = jax.eval_shape(
        jax.vmap(environment.step, (0, 0, None, None)),
        *(jax.random.split(key, count), states, _any_action(environment), params),
    )
    info = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shape.info)
    over, first = jnp.zeros(count, bool), jnp.ones(count, bool)
    carry = 0, seen, states, jnp.zeros((count, network.memory)), first, over, info
    return jax.lax.while_loop(lambda carry: (carry[0] < steps) & ~carry[5].all(), go, carry)[-1]


def _any_action(environment: Environment) -> Array:
    return jnp.int32(0) if environment.actions is not None else jnp.zeros(environment.action_size)
