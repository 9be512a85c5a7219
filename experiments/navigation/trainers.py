"""Trains drivers by other libraries' PPO, and drives them for 20 s on 100 towns that they have not seen.

A town counts if the robot never leaves its lane and drives 3 m or more: a robot that stands still stays in its lane.

    python -m experiments.navigation.trainers TOWNS [--cleanrl FILE] [--seeds N] [--steps N]

`make sb3` has the packages. TOWNS is a folder of `elitelanes generate --style town`. The first 100 towns are for the
test, all others for the training. FILE is CleanRL's `ppo_continuous_action.py`: the program runs it unchanged, except
that its environments are ours.
"""

import argparse
import contextlib
import runpy
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError, read_map
from elitelanes_jax.drive import LaneDrive, LaneDriveParams, make_levels
from elitelanes_jax.drive.interop import gymnasium_vector_env, sb3_vec_env
from experiments.common import Parser, leave, require, run, whole

__all__ = ["main"]

TESTS = 100
RIDE = 600  # steps, 20 s
LEAST_METRES = 3
ENVS = 256
ENVIRONMENTS = """    envs = gym.vector.SyncVectorEnv(
        [make_env(args.env_id, i, args.capture_video, run_name, args.gamma) for i in range(args.num_envs)]
    )
"""

Policy: TypeAlias = Callable[[NDArray], NDArray]
"""From observations ``[N, 7]`` to actions ``[N, 2]``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("trainers", __doc__)
    parser.add_argument("towns", type=Path, metavar="TOWNS", help="folder of maps, 101 or more")
    parser.add_argument("--cleanrl", type=Path, metavar="FILE", help="CleanRL's PPO; by default Stable-Baselines3's")
    parser.add_argument("--seeds", type=whole(1, 1000), default=3, metavar="N", help="drivers; default 3")
    parser.add_argument("--steps", type=whole(1), default=2_000_000, metavar="N", help="of training; default 2000000")
    options = parser.parse_args(arguments)
    return run("trainers", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "gymnasium", "torch")
    files = sorted(options.towns.glob("maps/*/map.json"))
    if len(files) <= TESTS:
        raise InputError("TOWNS", f"{TESTS + 1} or more maps", f"{len(files)} in {options.towns}")
    towns = np.stack([read_map(file).codes for file in files])
    params = _params(towns[TESTS:], 0)
    print("| seed | minutes | processor minutes | towns | metres driven, median |\n|---:|---:|---:|---:|---:|")
    for seed in range(options.seeds):
        began, worked = time.perf_counter(), time.process_time()
        if options.cleanrl is None:
            policy = _train_sb3(params, seed, options.steps)
        else:
            policy = _train_cleanrl(params, seed, options.steps, options.cleanrl)
        minutes, processor = (time.perf_counter() - began) / 60, (time.process_time() - worked) / 60
        stayed, metres = _drive(policy, towns[:TESTS])
        share = np.mean(stayed & (metres >= LEAST_METRES))
        print(f"| {seed} | {minutes:.1f} | {processor:.1f} | {share:.0%} | {np.median(metres):.1f} |", flush=True)


def _params(towns: NDArray[np.int8], seed: int) -> LaneDriveParams:
    levels = make_levels(jax.random.key(seed), towns, max(len(towns), 1024))
    # If leaving the road costs 10, the default, a random driver may learn to stand still.
    return LaneDriveParams(levels, limit=RIDE, task="lane", action="twist", offset_cost=10.0, leaving_cost=3.0)


def _train_sb3(params: LaneDriveParams, seed: int, steps: int) -> Policy:
    """Trains by the PPO of Stable-Baselines3."""
    import stable_baselines3
    from stable_baselines3.common.vec_env import VecNormalize

    envs = VecNormalize(sb3_vec_env(LaneDrive, params, stable_baselines3, envs=ENVS))
    settings = {"n_steps": 64, "batch_size": 2048, "n_epochs": 5, "learning_rate": lambda left: 1e-3 * left}
    model = stable_baselines3.PPO("MlpPolicy", envs, seed=seed, device="cpu", **settings)
    model.learn(steps)
    return lambda seen: model.predict(envs.normalize_obs(seen), deterministic=True)[0]


def _train_cleanrl(params: LaneDriveParams, seed: int, steps: int, file: Path) -> Policy:
    """Trains by CleanRL's file, in which one statement is replaced: that which makes the environments."""
    import gymnasium
    import torch

    program = file.read_text(encoding="utf-8")
    if program.count(ENVIRONMENTS) != 1:
        raise InputError("--cleanrl", "CleanRL's ppo_continuous_action.py of 2025", file)
    wrappers = gymnasium.wrappers.vector

    def make(envs: int) -> gymnasium.vector.VectorEnv:
        made = gymnasium_vector_env(LaneDrive, params, gymnasium, envs=envs)
        return wrappers.NormalizeReward(wrappers.NormalizeObservation(wrappers.ClipAction(made)), gamma=0.99)

    arguments = f"--seed {seed} --total-timesteps {steps} --num-envs {ENVS} --num-steps 64 --num-minibatches 8"
    arguments += " --update-epochs 5 --learning-rate 1e-3 --no-cuda"
    with tempfile.TemporaryDirectory() as folder:
        ours = Path(folder) / file.name
        ours.write_text(program.replace(ENVIRONMENTS, "    envs = make_ours(args.num_envs)\n"), encoding="utf-8")
        sys.argv = [str(ours), *arguments.split()]
        # It prints its speed, and writes its logs to the folder that it runs in.
        with contextlib.chdir(folder), contextlib.redirect_stdout(sys.stderr):
            names = runpy.run_path(str(ours), {"make_ours": make}, run_name="__main__")
    agent, normal = names["agent"], names["envs"].env.obs_rms

    def policy(seen: NDArray) -> NDArray:
        scaled = (seen - normal.mean) / np.sqrt(normal.var + 1e-8)
        with torch.no_grad():
            return agent.actor_mean(torch.tensor(scaled, dtype=torch.float32)).numpy()

    return policy


def _drive(policy: Policy, towns: NDArray[np.int8]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Drives for 20 s on each town; returns whether the robot stayed in its lane, and the metres that it drove."""
    params = _params(towns, 1)
    levels = make_levels(jax.random.key(1), towns)
    keys = jax.random.split(jax.random.key(2), len(towns))
    reset = jax.jit(jax.vmap(LaneDrive.reset_to_level, (0, 0, None)))
    step = jax.jit(jax.vmap(LaneDrive.step, (0, 0, 0, None)))
    seen, state = reset(keys, levels, params)
    stayed, metres = np.ones(len(towns), bool), np.zeros(len(towns))
    for number in range(RIDE):
        keys = jax.vmap(jax.random.fold_in, (0, None))(keys, number)
        vectors = jnp.column_stack([seen.d, seen.phi, seen.speed, seen.turn, seen.curvature])
        done = step(keys, state, policy(np.asarray(vectors)), params)
        seen, state = done.observation, done.state
        stayed &= np.asarray(done.info.own_lane)
        metres += np.asarray(seen.speed) * float(params.robot.dt)
    return stayed, metres


if __name__ == "__main__":
    leave(main())
