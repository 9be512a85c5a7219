"""Runs JaxUED's own methods, unchanged, on the levels of a space, and compares their regret with that of ours.

    python -m experiments.navigation.ued.jaxued_methods --jaxued DIR [--methods ...] [--seeds N] [--space NAME]

`DIR` is a checkout of https://github.com/DramaCow/jaxued, whose scripts run as they are (see jaxued_scripts.py). Each
method also runs as we wrote it, with the same seeds, on as many levels and decisions. One episode on every level gives
the exact regret of JaxUED's greedy policies, which have a memory.

Writes ued-jaxued.md into the folder of results, which keeps every finished row: the same command continues.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from elitelanes_jax import InputError, __version__
from elitelanes_jax.search import use_compile_cache
from experiments.common import (
    Parser,
    Pytree,
    Untyped,
    kept,
    leave,
    open_results,
    require,
    run,
    table,
    whole,
    write,
)

__all__ = ["METHODS", "main"]


class Method(NamedTuple):
    """A method of JaxUED.

    Attributes:
      ours: its name in `rows.METHODS`.
      script: its file in the folder `examples`.
      options: of the script, which select the method.
    """

    ours: str
    script: str
    options: tuple[str, ...] = ()


# The settings of our buffer. Staleness, temperature, fill ratio and score are the defaults of both programs.
_BUFFER = ("--level_buffer_capacity", "2048", "--replay_prob", "0.5")

METHODS = {
    "DR": Method("domain randomisation", "maze_dr.py"),
    "PLR": Method("PLR", "maze_plr.py", (*_BUFFER, "--exploratory_grad_updates")),
    "robust PLR": Method("robust PLR", "maze_plr.py", _BUFFER),
    "ACCEL": Method("ACCEL", "maze_plr.py", (*_BUFFER, "--use_accel", "--num_edits", "1")),
}
"""The methods by the names in the table."""

RATE = 6e-3
"""The learning rate of JaxUED's methods. On 5 x 5 A it is the best of 0.003, 0.006 and 0.012 for all except ACCEL,
which was not run."""

LANES = 1024
"""The levels that are driven side by side to compute the regret."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("jaxued", __doc__)
    parser.add_argument("--jaxued", type=Path, required=True, metavar="DIR", help="a checkout of JaxUED")
    parser.add_argument("--methods", nargs="+", default=("DR", "PLR", "robust PLR"), choices=METHODS)
    parser.add_argument("--seeds", type=whole(1, 1000), default=3, metavar="N", help="rows of each; default 3")
    parser.add_argument("--rounds", type=whole(4, 10_000), default=60, metavar="N", help="of driving; default 60")
    parser.add_argument("--space", default="5x5A", choices=("5x5A", "6x6A", "7x7A"), help="default 5x5A")
    parser.add_argument("--rate", type=float, default=RATE, metavar="R", help=f"of JaxUED's methods; default {RATE}")
    parser.add_argument("--out", type=Path, default=Path("results/ued-jaxued"), metavar="DIR")
    parser.add_argument("--quick", action="store_true", help="few levels side by side, to test the program")
    options = parser.parse_args(arguments)
    return run("jaxued", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax", "distrax", "jaxued")
    source = options.jaxued.resolve() / "src"
    if not (source / "jaxued").is_dir():
        raise InputError("--jaxued", "a checkout with a folder src/jaxued", options.jaxued)
    # The scripts use the library of their checkout, which is newer than that on PyPI.
    sys.path.insert(0, str(source))
    from experiments.navigation.ued.agent import settings
    from experiments.navigation.ued.rows import RATES

    ppo = settings(options.rounds, quick=options.quick)
    about = {"program": "ued-jaxued", "version": __version__, "space": options.space, "ppo": ppo._asdict()}
    open_results(options.out, about | {"rate": options.rate, "our_rates": RATES})
    use_compile_cache()
    rows: dict[tuple[str, str], list[Untyped]] = {}
    for seed in range(options.seeds):
        for name in options.methods:
            method = METHODS[name]
            theirs = ppo._replace(rate=options.rate)
            ours = ppo._replace(rate=RATES[method.ours])
            makers = {
                "JaxUED": partial(_their_row, options.jaxued, method, seed, options.space, theirs),
                "ours": partial(_our_row, method, seed, options.space, ours),
            }
            for program, make in makers.items():
                row = kept(options.out / "rows" / f"{program}.{name.replace(' ', '-')}.{seed}.json", make)
                rows.setdefault((program, name), []).append(row)
                print(f"{program}, {name}, seed {seed}: greedy mean {row['greedy']['mean']:.4f}", flush=True)
    write(options.out / "ued-jaxued.md", _report(rows, options))
    print(options.out / "ued-jaxued.md")


def _their_row(checkout: Path, method: Method, seed: int, space_name: str, ppo: Untyped) -> Untyped:
    """Trains by a script of JaxUED; returns the figures of the greedy policy, and the mean of the other one."""
    from experiments.navigation.ued.jaxued_scripts import drive_all, maze_of, train
    from experiments.navigation.ued.regret import summarise
    from experiments.navigation.ued.spaces import open_space

    space, began = open_space(space_name), time.perf_counter()
    state, network = train(checkout / "examples" / method.script, method.options, seed, space, ppo)
    seconds = time.perf_counter() - began

    def policy(weights: Pytree, memory: Pytree, seen: Pytree, first: Array) -> tuple[Pytree, Array]:
        row = jax.tree.map(lambda part: part[None], (seen, first))
        memory, actions, _ = state.apply_fn(weights, row, memory)
        return memory, actions.logits[0]

    memory = network.initialize_carry((LANES,))
    drive = partial(drive_all, jax.random.key(seed), maze_of(space), policy, state.params, memory, space)
    sampled_mean = float(drive(greedy=False).regret.mean())
    return {"greedy": summarise(space, drive(greedy=True)), "sampled_mean": sampled_mean, "seconds": seconds}


def _our_row(method: Method, seed: int, space_name: str, ppo: Untyped) -> Untyped:
    """Trains by our method; returns the same figures."""
    from experiments.navigation.ued.report import at_end
    from experiments.navigation.ued.rows import run_row

    row = run_row(method.ours, seed, space_name, ppo, unseen=False)
    sampled_mean, seconds = at_end(row)["mean"], row["seconds"]["training"]
    return {"greedy": row["greedy"], "sampled_mean": sampled_mean, "seconds": seconds}


def _report(rows: dict[tuple[str, str], list[Untyped]], options: argparse.Namespace) -> str:
    from experiments.navigation.ued.report import with_interval

    figures = {"mean": "mean", "cvar5": "worst 5 %", "cvar1": "worst 1 %", "success": "success"}
    lines = []
    for (program, method), runs in sorted(rows.items(), key=lambda item: item[0][0]):
        greedy = [with_interval([row["greedy"][figure] for row in runs]) for figure in figures]
        sampled = with_interval([row["sampled_mean"] for row in runs])
        lines.append([program, method, *greedy, sampled, f"{np.mean([row['seconds'] for row in runs]):.0f}"])
    head = ["program", "method", *figures.values(), "mean, sampled", "seconds"]
    words = (
        f"# JaxUED's methods on {options.space}, {options.rounds} rounds\n\n"
        f"Exact regret of the greedy policy on all levels, and 95 % intervals over {options.seeds} seeds. The last"
        " regret is the mean of the policy that draws its actions:"
        " exact for ours, and of one episode a level for JaxUED's.\n\n"
    )
    return words + table(head, lines, left=2)


if __name__ == "__main__":
    leave(main())
