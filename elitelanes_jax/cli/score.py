"""The command ``elitelanes score``."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import one_of, path
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.cli.arguments import Commands, add_command, checked_by, naming
from elitelanes_jax.cli.program import say
from elitelanes_jax.maps.spec import SPLITS


def add_score(commands: Commands) -> None:
    command = add_command(
        commands,
        "score",
        _score,
        help="score raw archives of the benchmark, or a network on a dataset",
        description="Measures the grids of raw archives again and prints their scores, "
        "with 95 % intervals over runs. With --predictions, compares the predictions of a network "
        "with a dataset.",
    )
    command.add_argument(
        "archives",
        type=checked_by(path),
        nargs="+",
        metavar="ARCHIVE|DATASET",
        help="an .npz of runs on a task, or the folder of a dataset",
    )
    command.add_argument(
        "--predictions",
        type=checked_by(path),
        metavar="DIR|FILE",
        help="label maps such as 000012.png, a file of COCO's results, or a .jsonl file of lane poses: "
        "number, d in tiles, phi in radians",
    )
    command.add_argument(
        "--split",
        type=checked_by(one_of(*SPLITS)),
        metavar="NAME",
        help="the split of the dataset: train, validation or test; default test",
    )


def _score(options: argparse.Namespace) -> int:
    if options.predictions is not None:
        return _score_dataset(options)
    if options.split is not None:
        raise InputError("--split", "--predictions too", "none")
    from elitelanes_jax.benchmark.submissions import LEAST_RUNS, Submission, score_and_grade
    from elitelanes_jax.search.compile_cache import use_compile_cache

    # Grids are measured by a compiled program.
    use_compile_cache()
    for file in options.archives:
        if Path(file).is_dir():
            hint = "--predictions scores a network on a dataset"
            raise InputError(file, "an .npz of runs on a task", "a folder", hint)
        submission = Submission.load(file)
        # The messages of the scores name no file, because they are of arrays.
        with naming(file):
            of_runs = score_and_grade(submission)
        task, runs = submission.task, len(submission.grids)
        draft = "" if runs >= LEAST_RUNS else f"; the board takes {LEAST_RUNS} or more"
        title = f"{file}: {task.name}, {pluralize(runs, 'run')}{draft}"
        say(f"{title}\n{_table(task.budgets, of_runs)}", asked=True)
    return 0


def _score_dataset(options: argparse.Namespace) -> int:
    from elitelanes_jax.dataset.scoring import score_predictions

    if len(options.archives) > 1:
        raise InputError("--predictions", "one dataset", len(options.archives))
    split = options.split or "test"
    try:
        scores = score_predictions(options.archives[0], options.predictions, split=split)
    except InputError as error:
        # The subject may go on with the place in the file.
        if error.subject.partition(":")[0] in ("predictions", "split"):
            error = error.replace(subject=f"--{error.subject}")
        raise error from None
    width = max(map(len, scores)) + 2
    lines = (f"{name:{width}}{score:.3f}" for name, score in scores.items())
    say("\n".join(lines), asked=True)
    return 0


def _table(budgets: Sequence[int], scores: Mapping[str, NDArray[np.float64]]) -> str:
    """Returns a table of scores ``[R, T]`` by name, with a line for each of the T budgets."""
    from elitelanes_jax.benchmark.scores import confidence_interval

    lines = ["".join(f"{name:>22}" for name in ("evaluations", *scores))]
    for index, budget in enumerate(budgets):
        cells = [f"{budget:,}"]
        for values in scores.values():
            # The precision of a run without filled niches is NaN.
            known = values[:, index][~np.isnan(values[:, index])]
            low, high = confidence_interval(values[:, index])
            cells.append(f"{known.mean():.3f} [{low:.3f}, {high:.3f}]" if len(known) else "-")
        lines.append("".join(f"{cell:>22}" for cell in cells))
    return "\n".join(lines)
