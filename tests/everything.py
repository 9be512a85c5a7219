"""Runs the tests in every environment and writes a row for each to docs/tested.md.

`make everything` calls it with `ENVIRONMENTS`, by default all environments. Rows of other environments are kept.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from datetime import date
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

__all__ = ["ENVIRONMENTS", "PAGE", "Environment", "main"]

PAGE = Path(__file__).parents[1] / "docs" / "tested.md"
"""The page with the table."""


class Environment(NamedTuple):
    """The folder of a virtual environment, and how its tests run."""

    folder: str
    packages: tuple[str, ...] = ()
    """What the table lists besides JAX, NumPy, SciPy and OpenCV."""
    all_cores: bool = False
    """Whether its tests run on all cores (`-n auto`), so that no other environment runs beside it."""


ENVIRONMENTS = {
    "test": Environment(".venv", ("networkx", "numba"), all_cores=True),
    "interop": Environment(".venv-interop", ("qdax", "evosax", "ribs")),
    "cluster": Environment(".venv-cluster", ("distributed", "submitit", "cloudpickle")),
    "rl": Environment(".venv-rl", ("gymnasium", "gymnax", "rejax", "jaxmarl", "pettingzoo")),
    "sb3": Environment(".venv-sb3", ("gymnasium", "stable-baselines3", "torch", "pufferlib-core")),
    "ued-tests": Environment(".venv-ued", ("jaxued", "gymnax", "flax", "optax")),
    "sumo": Environment(".venv-sumo", ("eclipse-sumo",)),
    "simulators": Environment(".venv-simulators", ("carla", "lanelet2", "eclipse-sumo"), all_cores=True),
    "duckietown": Environment(".venv-duckietown", ("duckietown-world-daffy",)),
    "duckietown-sdk": Environment(".venv-duckietown-sdk", ("duckietown-sdk",)),
    "mujoco": Environment(".venv-mujoco", ("mujoco", "trimesh", "usd-core")),
    "metadrive": Environment(".venv-metadrive", ("metadrive-simulator", "eclipse-sumo")),
    "pufferdrive": Environment(".venv"),
    "gym-duckietown": Environment(".venv-gym-duckietown", ("duckietown-gym-daffy", "dt-maps")),
    "shards": Environment(".venv-shards", ("webdataset", "datasets", "pyarrow")),
    "yolo": Environment(".venv-yolo", ("ultralytics", "torch")),
    "marimo": Environment(".venv-marimo", ("marimo", "anywidget")),
    "newest": Environment(".venv-newest", ("networkx", "numba"), all_cores=True),
    "lowest": Environment(".venv-lowest", ("networkx", "numba"), all_cores=True),
    "test-types": Environment(".venv", ("jaxtyping", "beartype"), all_cores=True),
    "test-slow": Environment(".venv", all_cores=True),
}
"""The environments by the targets of make that run their tests."""

_USUAL = ("jax", "numpy", "scipy", "opencv-python-headless")
_VERSIONS = """
import sys
from importlib.metadata import PackageNotFoundError, version
print(sys.version.split()[0])
for name in sys.argv[1:]:
    try:
        print(name, version(name))
    except PackageNotFoundError:
        pass
"""
_HEAD = """# Tested with

`make everything` runs the tests in all environments and writes this table.
Each row is the last run of one target of `make`. A test is skipped if its environment lacks something that it needs.
After a number of failed tests, their names follow.

| make | Python | packages | passed | skipped | failed | minutes | day |
|---|---|---|---|---|---|---|---|
"""


def main(names: Sequence[str] = ()) -> int:
    """Runs the tests in environments, by default in all.

    Returns:
      The exit code: 1 if a test fails or an environment runs no test, 2 if a name is unknown.
    """
    if unknown := [name for name in names if name not in ENVIRONMENTS]:
        print(f"ENVIRONMENTS: expected some of {', '.join(ENVIRONMENTS)}, got {unknown[0]}", file=sys.stderr)
        return 2
    chosen = names or tuple(ENVIRONMENTS)
    rows, failed = _read_rows(), False
    # First those that need all cores, one after another; then the others, as many side by side as there are cores.
    for all_cores, workers in ((True, 1), (False, os.cpu_count() or 1)):
        with ThreadPoolExecutor(workers) as pool:
            runs = [pool.submit(_run, name) for name in chosen if ENVIRONMENTS[name].all_cores == all_cores]
            for run in as_completed(runs):
                name, passed, row = run.result()
                failed |= not passed
                rows[name] = row
                text = _HEAD + "".join(f"| {rows[known]} |\n" for known in ENVIRONMENTS if known in rows)
                PAGE.write_text(text, encoding="utf-8")
    return int(failed)


def _run(name: str) -> tuple[str, bool, str]:
    """Runs the tests of an environment; returns its name, whether all passed, and its row."""
    environment = ENVIRONMENTS[name]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        options = f"{os.environ.get('PYTEST_ADDOPTS', '')} --junitxml={report}"
        # The output of environments side by side is shown when each has ended.
        output = None if environment.all_cores else subprocess.PIPE
        ran = subprocess.run(
            ["make", name],
            env=os.environ | {"PYTEST_ADDOPTS": options},
            stdout=output,
            stderr=output and subprocess.STDOUT,
            text=True,
            check=False,
        )
        counts = _counts(report)
    print(ran.stdout or "", flush=True)
    row = " | ".join((f"`{name}`", *_versions(environment), *counts, date.today().isoformat()))
    return name, ran.returncode == 0 and counts[0] != "0", row


def _read_rows() -> dict[str, str]:
    lines = PAGE.read_text(encoding="utf-8").splitlines() if PAGE.exists() else []
    return {line.split("`")[1]: line.strip("| ") for line in lines if line.startswith("| `")}


def _counts(report: Path) -> tuple[str, str, str, str]:
    """Returns how many tests passed, were skipped and failed, and the minutes; without a report, that all failed."""
    if not report.exists():
        return "0", "0", "all", "0"
    suite = ElementTree.parse(report).getroot().find("testsuite")
    assert suite is not None
    tests, skipped, *bad = (int(suite.get(name, 0)) for name in ("tests", "skipped", "failures", "errors"))
    failed = ": ".join([str(sum(bad)), *_failed_tests(suite)])
    return str(tests - skipped - sum(bad)), str(skipped), failed, f"{float(suite.get('time', 0)) / 60:.1f}"


def _failed_tests(suite: ElementTree.Element) -> list[str]:
    """Returns a text with the names of the tests that failed, without their parameters; nothing if none failed."""
    bad = [
        case for case in suite.iter("testcase") if case.find("failure") is not None or case.find("error") is not None
    ]
    names = {f"`{case.get('classname')}.{case.get('name', '').partition('[')[0]}`" for case in bad}
    return [", ".join(sorted(names))] if names else []


def _versions(environment: Environment) -> tuple[str, str]:
    """Returns the version of Python, and the versions of packages."""
    python = PAGE.parents[1] / environment.folder / "bin" / "python"
    if not python.exists():
        return "none", "not installed"
    command = [python, "-c", _VERSIONS, *_USUAL, *environment.packages]
    first, *packages = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    return first, ", ".join(packages)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
