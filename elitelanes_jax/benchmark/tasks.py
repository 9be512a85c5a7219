"""The tasks of the benchmark, and the certified optima of their niches."""

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import Plain

VERSION = 1
"""The version of tasks and scores. Scores of different versions are not comparable."""

BUDGETS = (10_000, 100_000, 1_000_000)
"""The budgets that a task may have, in evaluations."""

# fmt: off
SIZES = (
    "5x5A", "5x5B", "6x6A", "6x6B", "7x7A", "7x7B", "8x8A", "8x8B", "7x9A", "7x9B",
    "9x9A", "9x9B", "10x10A", "12x12A",
)
# fmt: on
"""Height, width and variant: in A every cell is filled, in B cells may be empty."""


@keeps_copies
class Task(NamedTuple):
    """A task: for each cyclomatic number, find the flawless network of lowest fitness.

    A network is flawless if it has one component and no dead end, boundary violation, mismatch,
    adjacent crossings or adjacent turns. The fitness is that of `elitelanes_jax.Weights()`.

    Attributes:
      name: size and budget, such as ``8x8A-100000``.
      shape: (height, width).
      fill: whether every cell has to be filled.
      evaluations: the budget of a run.
      cyclomatic: int ``[F]``, the feasible niches. No network has another cyclomatic number, which
        is proven.
      optimum: int ``[F]``, the lowest fitness of each, proven.
      networks: int ``[F]``, the number of flawless networks of each; -1 if they are not counted.
      witnesses: int8 ``[F, H, W]``, an optimal network of each.
    """

    name: str
    shape: tuple[int, int]
    fill: bool
    evaluations: int
    cyclomatic: NDArray[np.int_]
    optimum: NDArray[np.int_]
    networks: NDArray[np.int_]
    witnesses: NDArray[np.int8]

    @property
    def budgets(self) -> tuple[int, ...]:
        """The budgets at which a run is scored, ascending: its own and all lower ones."""
        return tuple(budget for budget in BUDGETS if budget <= self.evaluations)


@name_wrong_arguments
def find_task(name: str) -> Task:
    """Returns a task by name: one of `SIZES`, a hyphen, 10000, 100000 or 1000000.

    Raises:
      InputError: for any other name.
    """
    # Anything but a text gets the message of an unknown name.
    size, _, budget = name.partition("-") if isinstance(name, str) else ("", "", "")
    if size not in SIZES or budget not in map(str, BUDGETS):
        expected = f"SIZE-BUDGET of {', '.join(SIZES)} and {', '.join(map(str, BUDGETS))}"
        raise InputError("task", expected, shorten(repr(name), 40))
    certificate = _certificates()[size]
    niches = certificate["niches"]
    return Task(
        name=name,
        shape=(certificate["height"], certificate["width"]),
        fill=certificate["fill"],
        evaluations=int(budget),
        cyclomatic=np.array([niche["cyclomatic"] for niche in niches]),
        optimum=np.array([niche["optimum"] for niche in niches]),
        networks=np.array(
            [-1 if niche["networks"] is None else niche["networks"] for niche in niches]
        ),
        witnesses=np.array([_read_grid(niche["witness"]) for niche in niches]),
    )


def _read_grid(rows: list[str]) -> NDArray[np.int8]:
    """Reads a grid whose rows have a hexadecimal digit for each cell."""
    return np.array([[int(code, 16) for code in row] for row in rows], np.int8)


@cache
def _certificates() -> dict[str, dict[str, Plain]]:
    """Reads the certificates, by the size of their task."""
    text = files(__package__).joinpath("certificates.json").read_text(encoding="utf-8")
    certificates = {}
    for certificate in json.loads(text)["certificates"]:
        variant = "A" if certificate["fill"] else "B"
        # These names are those of `SIZES`.
        certificates[f"{certificate['height']}x{certificate['width']}{variant}"] = certificate
    return certificates
