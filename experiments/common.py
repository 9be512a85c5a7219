"""What all experiments share: command lines, folders of results, tables and figures."""

import argparse
import csv
import io
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias, TypeVar

import numpy as np
from scipy import stats

from elitelanes_jax import InputError, use_cores

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    *("Parser", "Pytree", "Untyped", "add_cores", "bootstrap_interval", "kept", "leave", "open_results", "require"),
    *("run", "save", "table", "to_csv", "whole", "write"),
]

INTERRUPTED = 130

# Packages whose modules have another name.
_MODULES = {"eclipse-sumo": "sumo", "scikit-learn": "sklearn"}

T = TypeVar("T")

Pytree: TypeAlias = Any
"""A pytree of arrays. Only the library or the environment that made it knows its structure."""

Untyped: TypeAlias = Any
"""An object of a library without types."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line. Its help is a module's docstring."""

    def __init__(self, program: str, description: str | None) -> None:
        super().__init__(prog=program, description=description, formatter_class=argparse.RawDescriptionHelpFormatter)

    def error(self, message: str) -> NoReturn:
        """Exits with the message, on one line, and code 2."""
        self.exit(2, f"{self.prog}: " + "\\n".join(message.splitlines()) + "\n")


def whole(least: int, most: int = 2**31 - 1) -> Callable[[str], int]:
    """Makes a type of argument: a whole number from `least` to `most`."""

    def parse(text: str) -> int:
        if not text.isascii() or not text.isdigit() or not least <= int(text) <= most:
            limits = f"{least} or more" if most == 2**31 - 1 else f"{least} to {most}"
            raise argparse.ArgumentTypeError(f"expected a whole number, {limits}, got {text!r}")
        return int(text)

    return parse


def add_cores(parser: argparse.ArgumentParser) -> None:
    """Adds the option ``--cores``, which limits the processor's cores that searches use."""

    def limit(text: str) -> int:
        count = whole(1, 1024)(text)
        use_cores(count)
        return count

    parser.add_argument("--cores", type=limit, metavar="N", help="use at most N cores; by default all. Same results")


def run(program: str, work: Callable[[], None]) -> int:
    """Runs an experiment; returns its exit code: 0, 2 for a user's mistake, 130 for an interruption.

    Messages are one line on standard error.

    Args:
      program: its name in messages.
      work: does everything. The same command continues it if it was interrupted.
    """
    try:
        work()
    except KeyboardInterrupt:
        print(f"{program}: interrupted; finished parts are kept; the same command continues", file=sys.stderr)
        return INTERRUPTED
    except (InputError, OSError) as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    return 0


def leave(code: int) -> NoReturn:
    """Ends the process with an exit code."""
    if code == INTERRUPTED:
        sys.stdout.flush()
        os._exit(code)  # the interpreter's own exit crashes while a thread of XLA compiles
    raise SystemExit(code)


def require(need: str, *packages: str) -> None:
    """Checks that packages are installed.

    Args:
      need: what needs them, for the message.
      packages: names to install.

    Raises:
      InputError: if one is missing.
    """
    if not all(find_spec(_MODULES.get(package, package)) for package in packages):
        raise InputError(f"{need} {' and '.join(packages)}", "", f"pip install {' '.join(packages)}")


def write(file: Path, content: str | bytes) -> None:
    """Writes a file completely or not at all, and makes missing folders."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.part")
    part.write_bytes(content if isinstance(content, bytes) else content.encode())
    part.replace(file)


def open_results(folder: Path, settings: Mapping[str, object]) -> None:
    """Makes a folder of results, or opens one that an earlier run with the same settings made.

    Raises:
      InputError: if the path is a file, or the folder has other files or results of other settings.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "a folder", "a file")
    file, asked = folder / "settings.json", json.loads(json.dumps(settings))
    if not folder.is_dir() or all(entry.name.startswith(".") for entry in folder.iterdir()):
        write(file, json.dumps(asked, indent=2) + "\n")
        return
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise InputError(folder, "a folder that is new, or of the same settings", "another") from None
    if not isinstance(found, dict):
        raise InputError(file, "a table of settings", type(found).__name__)
    for name in asked | found:
        if asked.get(name) != found.get(name):
            got = f"expected results of {name} {asked.get(name)!r}, got some of {found.get(name)!r}"
            raise InputError(folder, "", got, "choose another folder for these")


def kept(file: Path, make: Callable[[], T]) -> T:
    """Returns the content of a JSON file. If the file does not exist, first writes what `make` returns.

    Raises:
      InputError: if the file is not JSON.
    """
    if not file.exists():
        write(file, json.dumps(make()))
    try:
        content: T = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(file, "results as JSON", error, "delete the file to repeat its run") from None
    return content


def bootstrap_interval(sample: Sequence[float]) -> tuple[float, float]:
    """Returns the 95 % bootstrap interval of the mean (BCa, 9,999 resamples); of a constant sample its value twice."""
    if np.ptp(sample) == 0:
        return float(sample[0]), float(sample[0])
    found = stats.bootstrap((sample,), np.mean, n_resamples=9999, rng=np.random.default_rng(0))
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """Makes a Markdown table. All columns after the first `left` are aligned to the right."""
    marks = ["---"] * left + ["---:"] * (len(head) - left)
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, marks, *rows)) + "\n"


def to_csv(rows: Sequence[Mapping[str, object]]) -> str:
    """Makes a CSV table of rows. A row without a column has an empty field there."""
    lines = io.StringIO(newline="")
    columns = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(lines, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return lines.getvalue()


def save(figure: "Figure", file: Path, dpi: int = 110) -> None:
    """Writes a figure as PNG and closes it. The same figure always gives the same bytes."""
    import matplotlib.pyplot as plt

    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    plt.close(figure)
    write(file, content.getvalue())
