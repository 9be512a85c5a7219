"""JaxUED's own scripts on our levels, unchanged, and the regret of agents with a memory.

The scripts `examples/maze_dr.py` and `examples/maze_plr.py` of https://github.com/DramaCow/jaxued train an agent on
mazes. `train` runs one of them as it is. Before that, it replaces the names that the script imports for its maze, for
Weights & Biases and for checkpoints by stand-ins.
"""

import io
import runpy
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, chdir, contextmanager, redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import NamedTuple
from unittest import mock

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int32, Key

from elitelanes_jax.drive import Level, RoadNav, RoadNavParams
from experiments.common import Pytree, Untyped
from experiments.navigation.drivers import at_choices
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import params
from experiments.navigation.ued.methods.accel import edit
from experiments.navigation.ued.regret import Outcome
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["Observation", "Policy", "RoadLevel", "RoadMaze", "drive_all", "maze_of", "train"]

Policy = Callable[[Pytree, Pytree, Pytree, Bool[Array, " B"]], tuple[Pytree, Float[Array, "B 3"]]]
"""Maps weights, memory, observations and first steps of B episodes to the next memory and logits of actions."""


class Observation(NamedTuple):
    """What JaxUED's network sees.

    Attributes:
      image: float32 ``[k, k, 5]``, turned to the heading: a layer for each link of a tile, and the goal's tile.
      agent_dir: int32, the heading with which the goal is to be reached, in quarter turns from the agent's heading.
    """

    image: Float[Array, "k k 5"]
    agent_dir: Int32[Array, ""]


def _view(seen: Pytree) -> Observation:
    links = seen.window[..., None] & jnp.array([8, 4, 2, 1], jnp.int8) > 0
    image = jnp.concatenate([links, seen.mark[..., None]], axis=-1).astype(jnp.float32)
    return Observation(image, (seen.there[2] - seen.here[2]) % 4)


class RoadLevel(Level):
    """A level with the name that JaxUED's scripts read."""

    @property
    def wall_map(self) -> Array:
        """Returns which tiles are empty. The scripts only count them."""
        return self.grid == 0


class RoadMaze:
    """`RoadNav` from choice to choice, with the functions of JaxUED's `UnderspecifiedEnv`.

    JaxUED's keys are arrays of two numbers. `RoadNav` uses no key, so it gets a constant one.
    """

    def __init__(self, params: RoadNavParams, view: Callable[[Pytree], Pytree] = _view) -> None:
        """Makes the environment; `view` makes the agent's observation from that of `RoadNav`."""
        self.default_params = params
        self.max_height = self.max_width = params.window // 2 + 1
        self._environment, self._view = at_choices(RoadNav), view

    def action_space(self, params: RoadNavParams) -> Untyped:
        """Returns the number n of actions."""
        return SimpleNamespace(n=self._environment.actions)

    def reset_to_level(self, key: Key[Array, ""], level: Level, params: RoadNavParams) -> tuple[Pytree, Pytree]:
        """Returns the observation and the state at the start of a level."""
        seen, state = self._environment.reset_to_level(jax.random.key(0), Level(*level), params)
        return self._view(seen), state

    def step(
        self, key: Key[Array, ""], state: Pytree, action: Array, params: RoadNavParams
    ) -> tuple[Pytree, Pytree, Array, Array, dict[str, Array]]:
        """Returns the observation, the state, the reward, whether the episode is over, and an empty record."""
        done = self._environment.step(jax.random.key(0), state, action, params)
        return self._view(done.observation), done.state, done.reward, done.terminated | done.truncated, {}


def maze_of(space: Space) -> RoadMaze:
    """Makes the environment whose window is the smallest one with all of a map from each of its tiles."""
    return RoadMaze(replace(params(), window=2 * space.grids.shape[1] - 1))


@partial(jax.jit, static_argnames=("environment", "policy", "greedy"))
def drive_all(
    key: Key[Array, ""],
    environment: RoadMaze,
    policy: Policy,
    weights: Pytree,
    memory: Pytree,
    space: Space,
    *,
    greedy: bool,
) -> Outcome:
    """Drives one episode on each of the L levels of a space; the key is consumed.

    The environment is deterministic. So the regret of a greedy policy is exact, even if the policy has a memory.

    Args:
      key: draws actions.
      environment: of the policy.
      policy: of the agent.
      weights: of the policy.
      memory: at the start, ``[B, ...]``. B levels are driven side by side. Where one ends, the next one begins.
      space: the levels.
      greedy: whether the policy takes its most probable action, the first of several, or draws its actions.
    """
    count, params = len(space.pairs), environment.default_params
    lanes = len(jax.tree.leaves(memory)[0])
    reset = jax.vmap(environment.reset_to_level, (None, 0, None))
    step = jax.vmap(environment.step, (None, 0, 0, None))

    def begin(level: Array) -> tuple[Pytree, Pytree]:
        # A lane without a level repeats the last one, and is not recorded.
        begun: tuple[Pytree, Pytree] = reset(key, levels_of(space, jnp.minimum(level, count - 1)), params)
        return begun

    def drive(carry: Pytree) -> Pytree:
        decision, level, next_level, (seen, state), first, memory, total, returns = carry
        memory, logits = policy(weights, memory, seen, first)
        if greedy:
            action = logits.argmax(axis=-1)
        else:
            action = jax.random.categorical(jax.random.fold_in(key, decision), logits)
        seen, state, reward, done, _ = step(key, state, action, params)
        total += reward
        returns = returns.at[jnp.where(done, level, count)].set(total, mode="drop")
        level = jnp.where(done, next_level + jnp.cumsum(done) - 1, level)
        choose = jax.vmap(lambda done, *parts: jax.tree.map(partial(jnp.where, done), *parts))
        at = choose(done, begin(level), (seen, state))
        return decision + 1, level, next_level + done.sum(), at, done, memory, jnp.where(done, 0, total), returns

    level = jnp.arange(lanes)
    start = 0, level, lanes, begin(level), jnp.ones(lanes, bool), memory, jnp.zeros(lanes), jnp.zeros(count)
    *_, returns = jax.lax.while_loop(lambda carry: (carry[1] < count).any(), drive, start)
    best = jnp.subtract(params.goal_reward, params.tile_cost * levels_of(space, jnp.arange(count)).shortest)
    # Only the goal pays, and it pays more than all tiles of an episode cost.
    return Outcome(best - returns, (returns > 0).astype(jnp.float32))


class _Config(dict[str, Untyped]):
    """The configuration, as Weights & Biases keeps it."""

    def as_dict(self) -> dict[str, Untyped]:
        return dict(self)


def _wandb() -> ModuleType:
    """Makes a module that keeps the configuration and records nothing."""
    module: Untyped = ModuleType("wandb")

    def init(config: dict[str, Untyped], **_: object) -> None:
        module.config = _Config(config)

    def ignore(*_: object, **__: object) -> None:
        pass

    module.init = init
    module.define_metric = module.log = module.Image = module.Video = ignore
    return module


class _Renderer:
    """Draws one black pixel."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def render_state(self, *_: object) -> Array:
        return jnp.zeros((1, 1, 3), jnp.uint8)

    render_level = render_state


@contextmanager
def _stand_ins(space: Space, states: list[Untyped]) -> Iterator[None]:
    """Replaces what the scripts import; the states of training that they save are appended to `states`."""
    import orbax.checkpoint
    from jaxued import environments
    from jaxued.environments import maze

    def make_maze(**_: object) -> RoadMaze:
        return maze_of(space)

    def make_level_generator(*_: object) -> Callable[[Array], RoadLevel]:
        def draw_level(key: Array) -> RoadLevel:
            return RoadLevel(*jax.tree.map(lambda part: part[0], levels_of(space, draw(key, space, 1))))

        return draw_level

    def make_level_mutator(*_: object) -> Callable[[Array, RoadLevel, int], RoadLevel]:
        def mutate(key: Array, level: RoadLevel, edits: int) -> RoadLevel:
            levels = Level(*jax.tree.map(lambda part: part[None], level))
            for edit_key in jax.random.split(jax.random.wrap_key_data(key), edits):
                levels = edit(edit_key, levels)
            return RoadLevel(*jax.tree.map(lambda part: part[0], levels))

        return mutate

    class Prefabs(RoadLevel):
        @classmethod
        def load_prefabs(cls, names: Sequence[str]) -> RoadLevel:
            return RoadLevel(*levels_of(space, jnp.arange(len(names))))

    class Checkpoints:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def save(self, step: int, *_: object, args: Untyped) -> None:
            states.append(args.item)

        def wait_until_finished(self) -> None:
            pass

    with ExitStack() as stack:
        enter = stack.enter_context
        enter(mock.patch.dict(sys.modules, {"wandb": _wandb()}))
        enter(mock.patch.multiple(environments, Maze=make_maze, MazeRenderer=_Renderer))
        enter(mock.patch.object(maze, "Level", Prefabs))
        enter(mock.patch.object(maze, "make_level_generator", make_level_generator))
        enter(mock.patch.object(maze, "make_level_mutator_minimax", make_level_mutator))
        enter(mock.patch.object(orbax.checkpoint, "CheckpointManager", Checkpoints))
        # The script writes its configuration into the working folder, and its progress to the output.
        enter(chdir(enter(tempfile.TemporaryDirectory())))
        enter(redirect_stdout(io.StringIO()))
        yield


def train(script: Path, options: Sequence[str], seed: int, space: Space, ppo: Ppo) -> tuple[Untyped, Untyped]:
    """Runs a script of JaxUED on the levels of a space.

    Args:
      script: the file.
      options: of its command line, besides the seed and the numbers in `ppo`.
      seed: of the script.
      space: the levels.
      ppo: its rounds, levels, decisions, epochs, minibatches, rate and discount are options of the script. Its trace
        and its entropy are not: the script has its own.

    Returns:
      The state of the training at its end, and the class of the network.
    """
    numbers = {
        "seed": seed,
        "num_updates": ppo.updates,
        "num_train_envs": ppo.envs,
        "num_steps": ppo.steps,
        "epoch_ppo": ppo.epochs,
        "num_minibatches": ppo.minibatches,
        "lr": ppo.rate,
        "gamma": ppo.discount,
        # The state is saved after an evaluation. There is one, at the end, of one level. Nobody reads its figures.
        "eval_freq": ppo.updates,
        "eval_num_attempts": 1,
        "eval_levels": "first",
        "checkpoint_save_interval": 1,
    }
    command = [str(script), *options]
    for name, number in numbers.items():
        command += [f"--{name}", str(number)]
    file = script.resolve()
    states: list[Untyped] = []
    with _stand_ins(space, states), mock.patch.object(sys, "argv", command):
        names = runpy.run_path(str(file), run_name="__main__")
    return states[-1], names["ActorCritic"]
