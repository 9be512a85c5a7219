"""The leaderboard of the tasks of two descriptors: rows by track, their curves, and a checker.

    python -m experiments.search.leaderboard ROW ... --track TRACK [--tasks TASK ...] [--runs N] [--out DIR]
    python -m experiments.search.leaderboard --all [--out DIR]
    python -m experiments.search.leaderboard --check [--replay N] [--out DIR]
    python -m experiments.search.leaderboard --page [--out DIR]

A row is one of the track's, or a Python file of yours with a function `search` as `elitelanes_jax.benchmark.run_task`
takes it, a text `TITLE` and a text `CITATION`. The program writes a raw archive, and beside it an entry: the scores of
each run after 100, 200, 500 and so on evaluations. `--all` runs all rows of all tracks. Entries that are complete are
kept; the same command continues.

`--check` checks all entries in a folder: their facts, and their scores from the archives. NumPy and NetworkX alone
measure all scores but the graded one. `--replay` also runs N seeds of each entry again, drawn at random, and compares
the archives bit for bit.

`--page` writes tables and curves. Entries of fewer than ten runs are left out.
"""

import argparse
import hashlib
import json
import runpy
import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax.benchmark import PAIRS, TRACKS, Submission, Task, confidence_interval, find_task, run_task
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, Untyped, leave, require, run, save, table, whole, write
from experiments.search.board_rows import Row
from experiments.search.check_archive import count_tiles, rescore
from experiments.search.track_rows import CITATIONS, TRACK_ROWS

__all__ = ["PUBLISHED", "TASKS", "check_entry", "main", "make_summary", "read_entries"]

PUBLISHED = Path(__file__).parent / "results" / "leaderboard"
"""The entries of all published rows, a folder for each track."""

TASKS = {
    "links": ["5x5B-straights-100000"],
    "tiles": ["5x5B-straights-100000"],
    "moves": ["5x5B-straights-10000", "6x6B-straights-100000"],
    "open": ["6x6B-straights-10000", "7x7B-turns-10000"],
}
"""The tasks of each track."""

FIELDS = ("graded", "reliability", "coverage", "optimal")
"""The scores of an entry, each by run and evaluations. Rows are ranked and compared by the first."""

LEAST_RUNS = 10

Entry = dict[str, Any]
"""`row`, `title`, `citation`, `track`, `task`, `version`, `seeds`, `evaluations`, `archives` and each of `FIELDS`.

`archives` has the SHA-256 of the grids of each run. `program` has that of the row's own file, if it has one.
"""

_TEXTS = ("row", "title", "citation", "track", "task")


class Plan(NamedTuple):
    """A row that can be run: its name, what the page says of it, and the SHA-256 of its file if it has one."""

    name: str
    row: Row
    citation: str
    program: str | None = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("leaderboard", __doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW", help="a row of the track, or a file FILE.py")
    parser.add_argument("--track", choices=TRACKS, default="moves", help="default moves")
    parser.add_argument("--tasks", nargs="+", metavar="TASK", help="default: the tasks of the track")
    parser.add_argument("--runs", type=whole(1), default=20, metavar="N", help="seeds 0 to N - 1; default 20")
    parser.add_argument(
        "--out", type=Path, default=Path("results/leaderboard"), metavar="DIR", help="folder of entries"
    )
    parser.add_argument("--all", action="store_true", help="run all rows of all tracks")
    parser.add_argument("--check", action="store_true", help="check all entries of the folder")
    parser.add_argument(
        "--replay", type=whole(0), default=0, metavar="N", help="with --check: run N seeds again, drawn at random"
    )
    parser.add_argument("--page", action="store_true", help="write tables and curves, with published rows")
    options = parser.parse_args(arguments)
    return run("leaderboard", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    if not (options.rows or options.all or options.check or options.page):
        raise InputError("ROW", "a row, or --all, --check or --page", "none")
    use_compile_cache()
    for name in options.rows:
        plan = _find(name, options.track)
        for task in options.tasks or TASKS[options.track]:
            _measure(plan, options.track, _find_task(task), options.runs, options.out)
    if options.all:
        for track, tasks in TASKS.items():
            for task, name in ((task, name) for task in tasks for name in TRACK_ROWS[track]):
                _measure(_find(name, track), track, _find_task(task), options.runs, options.out)
    if options.check:
        files = sorted(options.out.glob("*/*.json"))
        if not files:
            raise InputError(options.out, "entries in TRACK/ROW-TASK.json", "none")
        for file in files:
            print(check_entry(file, options.replay), flush=True)
    if options.page:
        require("the picture of --page needs", "matplotlib")
        _write_page(read_entries(options.out), options.out)
        print(f"written to {options.out}")


def _find_task(name: str) -> Task:
    task = find_task(name)
    if task.tiles is None:
        raise InputError("--tasks", f"a task of {', '.join(PAIRS)}", name)
    return task


def _find(name: str, track: str) -> Plan:
    """Returns a row by its name, or a row that runs the search in a file."""
    if name in TRACK_ROWS[track]:
        library = name.partition("-")[0]
        if library in ("qdax", "ribs", "evosax"):
            require(f"{name} needs", library)
        return Plan(name, TRACK_ROWS[track][name], CITATIONS[name])
    file = Path(name)
    if file.suffix != ".py" or not file.is_file():
        raise InputError("ROW", f"one of {', '.join(TRACK_ROWS[track])}, or a file FILE.py", name)
    if file.stem in TRACK_ROWS[track]:
        raise InputError(file, "a name that no row of the track has", file.stem)
    facts = runpy.run_path(name)
    for key in ("TITLE", "CITATION"):
        if not isinstance(facts.get(key), str) or not facts[key].strip():
            raise InputError(file, f"a text {key}, which the page shows", repr(facts.get(key)))
    if not callable(facts.get("search")):
        raise InputError(file, "a function search", "none")

    def play(task: Task, seeds: range, budgets: Sequence[int]) -> NDArray[np.int8]:
        return run_task(task, facts["search"], seeds, operators=None if track == "open" else track).grids

    return Plan(file.stem, Row(facts["TITLE"], play), facts["CITATION"], hashlib.sha256(file.read_bytes()).hexdigest())


def _measure(plan: Plan, track: str, task: Task, runs: int, out: Path) -> None:
    """Runs a row on a task, and writes its archive and its entry, unless the entry has as many runs."""
    file = out / track / f"{plan.name}-{task.name}.json"
    if file.exists() and len((kept := _read(file))["seeds"]) >= runs:
        if kept.get("program") != plan.program and plan.program is not None:
            raise InputError(
                file, f"results of this {plan.name}.py", "those of another", "delete the file to run it again"
            )
        print(f"{track}, {plan.name}, {task.name}: kept, {len(kept['seeds'])} runs", flush=True)
        return
    began = time.process_time()
    grids = plan.row.play(task, range(runs), task.budgets)
    seconds = time.process_time() - began
    submission = Submission(task, grids, track)
    _, scores = submission.score()
    of_runs = scores._asdict() | {"graded": submission.grade()}
    submission.save(file.with_suffix(".npz"))
    entry: Entry = {
        "row": plan.name,
        "title": plan.row.title,
        "citation": plan.citation,
        "track": track,
        "task": task.name,
        "version": task.version,
        "seeds": list(range(runs)),
        "evaluations": list(task.budgets),
        "seconds": round(seconds, 1),
        "archives": [_digest(archive) for archive in grids],
        "program": plan.program,
        **{field: np.round(of_runs[field], 4).tolist() for field in FIELDS},
    }
    write(file, json.dumps(entry) + "\n")
    means = ", ".join(f"{field} {of_runs[field][:, -1].mean():.3f}" for field in FIELDS)
    print(f"{track}, {plan.name}, {task.name}, {runs} runs: {means} ({seconds:.0f} s)", flush=True)


def _digest(archive: NDArray[np.int8]) -> str:
    return hashlib.sha256(np.ascontiguousarray(archive, np.int8).tobytes()).hexdigest()


def _read(file: Path) -> Entry:
    """Reads an entry, and checks its facts.

    Raises:
      InputError: for a fact that is missing, or not what it should be.
    """
    try:
        entry = json.loads(file.read_text(encoding="utf-8"))
        keys = {*_TEXTS, "version", "seeds", "evaluations", "archives", *FIELDS}
        if missing := keys - set(entry):
            raise InputError(file, f"an entry with {', '.join(sorted(missing))}", "none")
        scores = {field: np.array(entry[field], float) for field in FIELDS}
    except (ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(file, "an entry", repr(error)) from None
    for text in _TEXTS:
        if not isinstance(entry[text], str) or not entry[text].strip():
            raise InputError(file, f"a text {text}", "none" if entry[text] == "" else repr(entry[text]))
    task = _find_task(entry["task"])
    seeds, archives = entry["seeds"], entry["archives"]
    runs = len(seeds) if isinstance(seeds, list) else 0
    _expect(file, "track", file.parent.name, entry["track"])
    if entry["track"] not in TRACKS:
        raise InputError(file, f"a track of {', '.join(TRACKS)}", entry["track"])
    _expect(file, "a name of ROW-TASK", f"{entry['row']}-{task.name}", file.stem)
    _expect(file, "version", task.version, entry["version"])
    _expect(file, "seeds", list(range(max(runs, 1))), seeds)
    _expect(file, "evaluations", list(task.budgets), entry["evaluations"])
    _expect(file, "archives of runs:", runs, len(archives) if isinstance(archives, list) else repr(archives))
    for field, values in scores.items():
        _expect(file, f"{field} of shape", (runs, len(task.budgets)), values.shape)
        if not ((values >= 0) & (values <= 1)).all():
            raise InputError(file, f"{field} from 0 to 1", repr(entry[field])[:60])
    return entry


def _expect(file: Path, fact: str, expected: object, got: object) -> None:
    if expected != got:
        raise InputError(file, f"{fact} {expected}", got)


def check_entry(file: Path, replay: int = 0) -> str:
    """Checks an entry, its archive and its program if they are beside it; returns in one line what was checked.

    Raises:
      InputError: for a fact, a score or an archive that is not what it should be.
    """
    entry = _read(file)
    task, runs = _find_task(entry["task"]), len(entry["seeds"])
    done = [f"{runs} runs"]
    if runs < LEAST_RUNS:
        done.append(f"a draft, because the board takes {LEAST_RUNS} or more")
    archive = file.with_suffix(".npz")
    if archive.exists():
        submission = Submission.load(archive)
        _expect(file, "an archive of task", task.name, submission.task.name)
        _expect(file, "an archive of track", entry["track"], submission.operators)
        changed = [
            number
            for number, (digest, grids) in enumerate(zip(entry["archives"], submission.grids, strict=False))
            if digest != _digest(grids)
        ]
        if changed or len(submission.grids) != runs:
            raise InputError(file, "archives with the entry's checksums", f"others in runs {changed} of {runs}")
        for field, values in (_rescore(file, submission) | {"graded": submission.grade()}).items():
            # A score that is no number is no match either.
            if not (np.abs(values - entry[field]) <= 6e-5).all():
                raise InputError(file, f"{field} as in the archive", "another")
        done.append("scores measured again")
    else:
        done.append("scores not measured, because its archive is not here")
    program = file.with_name(f"{entry['row']}.py")
    is_known = entry["row"] in TRACK_ROWS[entry["track"]]
    if is_known:
        _expect(file, "a title", TRACK_ROWS[entry["track"]][entry["row"]].title, entry["title"])
        _expect(file, "a citation", CITATIONS[entry["row"]], entry["citation"])
    elif program.exists():
        plan = _find(str(program), entry["track"])
        _expect(file, "a title", plan.row.title, entry["title"])
        _expect(file, "a citation", plan.citation, entry["citation"])
        _expect(file, f"results of {program.name} with the checksum", plan.program, entry.get("program"))
    if replay:
        if not (is_known or program.exists()):
            raise InputError(program, "the search of the row", "none", "copy it there")
        plan = _find(entry["row"] if is_known else str(program), entry["track"])
        # Nobody knows before which seeds are run again.
        seeds = sorted(np.random.default_rng().choice(runs, min(replay, runs), replace=False).tolist())
        for seed in seeds:
            (grids,) = plan.row.play(task, range(seed, seed + 1), task.budgets)
            if _digest(grids) != entry["archives"][seed]:
                raise InputError(file, "seeds that give the same archive again", f"another of seed {seed}")
        done.append(f"{len(seeds)} run again, equal bit for bit")
    return f"{file}: {', '.join(done)}"


def _rescore(file: Path, submission: Submission) -> dict[str, NDArray[np.float64]]:
    """Computes coverage, reliability and the share of optimal niches by the other measuring program."""
    task, (runs, budgets, _, height, width) = submission.task, submission.grids.shape
    optima = {tuple(niche): int(value) for niche, value in zip(task.niches.tolist(), task.optimum, strict=True)}
    distinct, places = np.unique(submission.grids.reshape(-1, height * width), axis=0, return_inverse=True)
    # The index of the niche of each network, -1 if it does not count, and its nearness to the optimum.
    order = {niche: index for index, niche in enumerate(optima)}
    index_of, nearness = np.full(len(distinct), -1), np.zeros(len(distinct))
    for number, codes in enumerate(distinct):
        grid = codes.reshape(height, width).astype(int)
        score = rescore(grid) if grid.any() else None
        if score is None or not score.flawless or score.bridges or score.filled < task.fill:
            continue
        niche = score.cyclomatic, count_tiles(grid, str(task.tiles))
        if niche not in optima or score.fitness < optima[niche]:
            raise InputError(file, "no network better than the certificates", f"{score.fitness} at {niche}")
        index_of[number], nearness[number] = order[niche], max(0.0, score.fitness / optima[niche])
    near = np.full((runs, budgets, len(optima)), -1.0)
    for (run_number, budget, _), place in np.ndenumerate(places.reshape(submission.grids.shape[:3])):
        if index_of[place] >= 0:
            index = run_number, budget, index_of[place]
            near[index] = max(near[index], nearness[place])
    filled, near = near >= 0, near.clip(0)
    return {"coverage": filled.mean(-1), "reliability": near.mean(-1), "optimal": (near == 1).mean(-1)}


def read_entries(folder: Path) -> list[Entry]:
    """Reads the published entries and those of a folder, which replace published ones; drafts are left out."""
    files = {file.relative_to(root): file for root in (PUBLISHED, folder) for file in root.glob("*/*.json")}
    entries = [entry for entry in map(_read, files.values()) if len(entry["seeds"]) >= LEAST_RUNS]
    tasks = [task for names in TASKS.values() for task in names]

    def order(entry: Entry) -> tuple[int, int, str, float]:
        known = tasks.index(entry["task"]) if entry["task"] in tasks else len(tasks)
        return TRACKS.index(entry["track"]), known, entry["task"], -_final(entry)[0]

    return sorted(entries, key=order)


def _final(entry: Entry, field: str = FIELDS[0]) -> tuple[float, float, float]:
    """Returns the mean of a score after the whole budget, and its interval of 95 %."""
    values = np.array(entry[field])[:, -1]
    return float(values.mean()), *confidence_interval(values)


def _by_panel(entries: Sequence[Entry]) -> dict[tuple[str, str], list[Entry]]:
    panels: dict[tuple[str, str], list[Entry]] = {}
    for entry in entries:
        panels.setdefault((entry["track"], entry["task"]), []).append(entry)
    return panels


def _write_page(entries: Sequence[Entry], out: Path) -> None:
    about = "Means of the runs, with intervals of 95 %."
    parts = [f"# The leaderboard\n\n{about}\n", make_summary(entries), "## All scores\n"]
    for (track, task), rows in _by_panel(entries).items():
        lines = []
        for entry in rows:
            cells = ["{:.3f} ({:.3f} to {:.3f})".format(*_final(entry, field)) for field in FIELDS]
            lines.append([entry["title"], entry["citation"], str(len(entry["seeds"])), *cells])
        head = ["search", "citation", "runs", "graded", "reliability (QD-score)", "coverage", "optimal"]
        parts.append(f"### {track}: {task}\n\n{table(head, lines, left=2)}")
    write(out / "leaderboard.md", "\n".join(parts).rstrip() + "\n")
    _draw(entries, out / "curves.png")


def make_summary(entries: Sequence[Entry]) -> str:
    """Makes a table of graded scores for each track, and says which pairs of rows no task separates."""
    parts = []
    for track in TRACKS:
        of_track = [entry for entry in entries if entry["track"] == track]
        if not of_track:
            continue
        tasks = list(dict.fromkeys(entry["task"] for entry in of_track))
        cells: dict[tuple[str, str], dict[str, str]] = {}
        for entry in of_track:
            scores = cells.setdefault((entry["title"], entry["citation"]), {})
            scores[entry["task"]] = "{:.2f} ({:.2f} to {:.2f})".format(*_final(entry))
        lines = [[*row, *(scores.get(task, "") for task in tasks)] for row, scores in cells.items()]
        parts.append(f"**Track `{track}`**\n\n{table(['search', 'citation', *tasks], lines, left=2)}")
    return "\n".join([*parts, _separation(entries)])


def _separation(entries: Sequence[Entry]) -> str:
    """Says, for each track, which pairs of rows no task separates by intervals that do not overlap."""
    lines = ["Pairs of searches whose intervals do not overlap in at least one task:\n"]
    for track in TRACKS:
        apart = {field: _pairs(entries, track, field) for field in FIELDS[:2]}
        never = [f"{one} and {other}" for (one, other), separated in apart["graded"].items() if not separated]
        if apart["graded"]:
            counts = [f"{sum(pairs.values())} by {field}" for field, pairs in apart.items()]
            rest = f" The graded score separates in no task: {'; '.join(never)}." if never else ""
            lines.append(f"- `{track}`: of {len(apart['graded'])} pairs {' and '.join(counts)}.{rest}")
    return "\n".join(lines) + "\n"


def _pairs(entries: Sequence[Entry], track: str, field: str) -> dict[tuple[str, str], bool]:
    """Returns, for each pair of rows of a track, whether a task separates them."""
    apart: dict[tuple[str, str], bool] = {}
    for (name, _), rows in _by_panel(entries).items():
        if name == track:
            for one, other in combinations(sorted(rows, key=lambda entry: entry["title"]), 2):
                pair = one["title"], other["title"]
                (_, low, high), (_, least, most) = _final(one, field), _final(other, field)
                apart[pair] = apart.get(pair, False) or high < least or most < low
    return apart


def _draw(entries: Sequence[Entry], file: Path) -> None:
    """Plots the scores against evaluations, a column for each task of each track, with intervals of 95 %."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    panels, titles = _by_panel(entries), sorted({entry["title"] for entry in entries})
    names = {"graded": "graded score", "reliability": "QD-score / niches", "coverage": "coverage", "optimal": "optimal"}
    figure, axes = plt.subplots(
        len(names), len(panels), figsize=(3.6 * len(panels), 11), layout="constrained", sharex=True, squeeze=False
    )
    lines: dict[str, Untyped] = {}
    for column, ((track, task), rows) in enumerate(panels.items()):
        for entry in rows:
            number = titles.index(entry["title"])
            look = {"color": f"C{number % 10}", "linestyle": ("-", "--", ":", "-.")[number // 10 % 4]}
            for axis, field in zip(axes[:, column], names, strict=True):
                values = np.array(entry[field])
                low, high = zip(*(confidence_interval(of_runs) for of_runs in values.T), strict=True)
                (lines[entry["title"]],) = axis.plot(entry["evaluations"], values.mean(axis=0), **look)
                axis.fill_between(entry["evaluations"], low, high, color=look["color"], alpha=0.15, linewidth=0)
        axes[0, column].set_title(f"{track}: {task}", fontsize=10)
        axes[-1, column].set_xlabel("evaluations of a run")
    for axis, label in zip(axes[:, 0], names.values(), strict=True):
        axis.set_ylabel(label)
    for axis in axes.flat:
        axis.set(xscale="log", ylim=(-0.02, 1.02))
        axis.grid(alpha=0.3)
    labels = [title.replace("`", "") for title in titles]
    figure.legend([lines[title] for title in titles], labels, loc="outside lower center", ncols=4, fontsize=8)
    save(figure, file)


if __name__ == "__main__":
    leave(main())
