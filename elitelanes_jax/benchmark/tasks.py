"""The tasks of the benchmark, and the certified optima of their niches."""

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError, quote

VERSION = 1
"""The version of the tasks of `SIZES`. Scores of different versions are not comparable."""

PAIRS_VERSION = 2
"""The version of the tasks of `PAIRS`."""

BUDGETS = (10_000, 100_000, 1_000_000)
"""The budgets that a task of `SIZES` may have, in evaluations."""

PAIRS_BUDGETS = (10_000, 100_000)
"""The budgets that a task of `PAIRS` may have, in evaluations."""

CURVE = (100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000)
"""The evaluations after which a task of `PAIRS` is scored."""

# fmt: off
SIZES = (
    "5x5A", "5x5B", "6x6A", "6x6B", "7x7A", "7x7B", "8x8A", "8x8B", "7x9A", "7x9B",
    "9x9A", "9x9B", "10x10A", "12x12A",
)
# fmt: on
"""Height, width and variant: in A every cell is filled, in B cells may be empty."""

PAIRS = ("5x5B-straights", "6x6B-straights", "6x7B-turns", "7x7B-turns")
"""A size, and the tiles whose number is a second descriptor beside the cyclomatic number."""


class _Niche(TypedDict):
    """What is proven of a niche. Only a task of two descriptors has `tiles`."""

    cyclomatic: int
    tiles: NotRequired[int]
    optimum: int
    networks: int | None
    witness: list[str]


class _Certificate(TypedDict):
    """What is proven of a size, or of a pair. Only a pair has `tiles`."""

    height: int
    width: int
    fill: bool
    tiles: NotRequired[str]
    niches: list[_Niche]


@keeps_copies
class Task(NamedTuple):
    """A task: for each niche, find the flawless network of lowest fitness.

    A network is flawless if it has one component and no dead end, boundary violation, mismatch,
    adjacent crossings or adjacent turns. In tasks of two descriptors it also has no bridge. The
    fitness is that of `elitelanes_jax.Weights()`.

    Attributes:
      name: size, second descriptor if there is one, and budget, such as ``8x8A-100000`` or
        ``7x7B-turns-100000``.
      shape: (height, width).
      fill: whether every cell has to be filled.
      evaluations: the budget of a run.
      cyclomatic: int ``[F]``, the cyclomatic numbers of the feasible niches. No network is in
        another niche, which is proven.
      optimum: int ``[F]``, the lowest fitness of each, proven.
      networks: int ``[F]``, the number of flawless networks of each; -1 if they are not counted.
      witnesses: int8 ``[F, H, W]``, an optimal network of each.
      tiles: the second descriptor, ``turns`` or ``straights``; None if the task has one descriptor.
      niches: int ``[F, D]``, the descriptors of the feasible niches: the cyclomatic number, and the
        number of `tiles` if the task has a second descriptor.
    """

    name: str
    shape: tuple[int, int]
    fill: bool
    evaluations: int
    cyclomatic: NDArray[np.int_]
    optimum: NDArray[np.int_]
    networks: NDArray[np.int_]
    witnesses: NDArray[np.int8]
    tiles: str | None
    niches: NDArray[np.int_]

    @property
    def version(self) -> int:
        """The version of the task's definition: 1 with one descriptor, 2 with two."""
        return VERSION if self.tiles is None else PAIRS_VERSION

    @property
    def budgets(self) -> tuple[int, ...]:
        """The evaluations at which a run is scored, ascending, up to its own budget.

        With two descriptors they are those of a curve: 100, 200, 500, 1,000 and so on.
        """
        known = BUDGETS if self.tiles is None else CURVE
        return tuple(budget for budget in known if budget <= self.evaluations)


@name_wrong_arguments
def find_task(name: str) -> Task:
    """Returns a task by name: one of `SIZES` or `PAIRS`, a hyphen, and the budget.

    The budget is 10000, 100000 or 1000000; of `PAIRS` 10000 or 100000.

    Raises:
      InputError: for any other name.
    """
    # Anything but a text gets the message of an unknown name.
    size, _, budget = name.rpartition("-") if isinstance(name, str) else ("", "", "")
    known = PAIRS_BUDGETS if size in PAIRS else BUDGETS
    if size not in (*SIZES, *PAIRS) or budget not in map(str, known):
        sizes = f"{', '.join(SIZES)} and {', '.join(map(str, BUDGETS))}"
        pairs = f"{', '.join(PAIRS)} and {', '.join(map(str, PAIRS_BUDGETS))}"
        raise InputError("task", f"SIZE-BUDGET of {sizes}, or of {pairs}", quote(name, 40))
    certificate = _certificates()[size]
    niches = certificate["niches"]
    tiles = certificate.get("tiles")
    cyclomatic = np.array([niche["cyclomatic"] for niche in niches])
    descriptors = [cyclomatic]
    if tiles is not None:
        descriptors.append(np.array([niche["tiles"] for niche in niches]))
    return Task(
        name=name,
        shape=(certificate["height"], certificate["width"]),
        fill=certificate["fill"],
        evaluations=int(budget),
        cyclomatic=cyclomatic,
        optimum=np.array([niche["optimum"] for niche in niches]),
        networks=np.array(
            [-1 if niche["networks"] is None else niche["networks"] for niche in niches]
        ),
        witnesses=np.array([_read_grid(niche["witness"]) for niche in niches]),
        tiles=tiles,
        niches=np.stack(descriptors, axis=-1),
    )


def _read_grid(rows: list[str]) -> NDArray[np.int8]:
    """Reads a grid whose rows have a hexadecimal digit for each cell."""
    return np.array([[int(code, 16) for code in row] for row in rows], np.int8)


@cache
def _certificates() -> dict[str, _Certificate]:
    """Reads the certificates, by the names of `SIZES` and `PAIRS`."""
    certificates: dict[str, _Certificate] = {}
    for file in ("certificates.json", "certificates-2.json"):
        text = files(__package__).joinpath(file).read_text(encoding="utf-8")
        for certificate in json.loads(text)["certificates"]:
            variant = "A" if certificate["fill"] else "B"
            size = f"{certificate['height']}x{certificate['width']}{variant}"
            tiles = certificate.get("tiles")
            certificates[size if tiles is None else f"{size}-{tiles}"] = certificate
    return certificates
