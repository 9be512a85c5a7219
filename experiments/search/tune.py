"""Tries settings of a row of the board on 6 x 6 alone.

    python -m experiments.search.tune ROW [--out DIR]

Draws eight settings of the row at random from its choices, each choice about as often as the others. They run for
100,000 evaluations on 6 x 6 A and on 6 x 6 B with four seeds, which no row of the board uses. The best mean
reliability after 10,000 and 100,000 evaluations wins. Finished trials are kept; the same command continues.
"""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np

from elitelanes_jax import InputError
from elitelanes_jax.benchmark import Submission, find_task
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, run, write
from experiments.search.board_rows import TUNED, Setting

__all__ = ["draw_settings", "main"]

_TASKS = [find_task(f"{size}-100000") for size in ("6x6A", "6x6B")]
_TRIALS, _SEEDS = 8, range(1000, 1004)


class Trial(TypedDict):
    """A trial of settings: the mean reliability of each task at every budget, and the seconds of the processor."""

    settings: dict[str, Setting]
    reliability: dict[str, list[float]]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("tune", __doc__)
    parser.add_argument("row", metavar="ROW", help=f"one of {', '.join(TUNED)}")
    parser.add_argument("--out", type=Path, default=Path("results/tuning"), metavar="DIR", help="folder of results")
    options = parser.parse_args(arguments)
    return run("tune", lambda: _tune(options.row, options.out))


def _tune(row: str, out: Path) -> None:
    if row not in TUNED:
        raise InputError("ROW", f"one of {', '.join(TUNED)}", row)
    use_compile_cache()
    file = out / f"{row}.json"
    trials: list[Trial] = json.loads(file.read_text(encoding="utf-8"))["trials"] if file.exists() else []
    finished = [trial["settings"] for trial in trials]
    for settings in draw_settings(TUNED[row][1]):
        if settings not in finished:
            trials.append(_try(row, settings))
            write(file, json.dumps({"row": row, "seeds": len(_SEEDS), "trials": trials}, indent=1) + "\n")
    for trial in sorted(trials, key=_mean_reliability):
        print(f"{row}, {trial['settings']}: reliability {_mean_reliability(trial):.3f}")


def _try(row: str, settings: dict[str, Setting]) -> Trial:
    began = time.process_time()
    play, reliability = TUNED[row][0](**settings), {}
    for task in _TASKS:
        _, scores = Submission(task, play(task, _SEEDS, task.budgets)).score()
        reliability[task.name] = np.round(scores.reliability.mean(axis=0), 6).tolist()
    return Trial(settings=settings, reliability=reliability, seconds=round(time.process_time() - began, 1))


def draw_settings(choices: dict[str, tuple[Setting, ...]]) -> list[dict[str, Setting]]:
    """Draws eight different settings, the same each time; each choice comes equally often, or nearly."""
    draws = np.random.default_rng(0)
    while True:
        orders = [draws.permutation(np.arange(_TRIALS) % len(values)) for values in choices.values()]
        drawn = [tuple(order[trial] for order in orders) for trial in range(_TRIALS)]
        if len(set(drawn)) == _TRIALS:
            break
    return [
        {name: values[index] for (name, values), index in zip(choices.items(), indices, strict=True)}
        for indices in drawn
    ]


def _mean_reliability(trial: Trial) -> float:
    return float(np.mean(list(trial["reliability"].values())))


if __name__ == "__main__":
    leave(main())
