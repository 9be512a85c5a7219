"""Proves certificates: the optimum of every cyclomatic number of flawless networks, each with a network.

    python -m experiments.search.certify [SIZE ...] [--out FILE] [--table FILE]

A size is 8x8A, or 7x9B: in A every cell is filled, in B cells may be empty. Sizes that the file already has are kept.
Up to 81 cells in A and 64 in B, `exact/sweep.py` proves the optima and counts the networks. For larger grids
`exact/proof.py` proves the optima by two halves, and does not count. `check_archive.py` then measures the networks with
code of its own.
"""

import argparse
import json
import multiprocessing
import os
import re
import resource
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError
from experiments.common import Parser, leave, run, write
from experiments.search.check_archive import check, rescore
from experiments.search.exact.halves import Half, make_half
from experiments.search.exact.proof import find_most_crossings, find_optimum
from experiments.search.exact.sweep import sweep

__all__ = [
    *("SIZES", "TRANSPOSED", "Certificate", "Cost", "Niche", "Size"),
    *("certify", "certify_by_halves", "main", "make_table", "parse_size"),
]

Size = tuple[int, int, bool]
"""Height, width, and whether every cell is filled."""

_SQUARES = [(side, side, fill) for side in range(3, 9) for fill in (True, False)]
_RECTANGLES = [(low, high, fill) for low in range(3, 8) for high in range(low + 1, 10) for fill in (True, False)]
_LARGE = [(9, 9, True), (9, 9, False), (10, 10, True), (12, 12, True)]
SIZES: list[Size] = sorted([*_SQUARES, *_RECTANGLES, *_LARGE], key=lambda size: (not size[2], size[0] * size[1]))

# A bridge ends at a crossing, or goes on through a tile with two connections, whose other link is a bridge too. As
# crossings are not linked to each other, a flawless network with a bridge has at least two, of a weight of 100 each.
_LEAST_COST_OF_BRIDGES = 200

# The most cells, by whether all are filled; larger grids are cut into halves.
_MOST_SWEPT = {True: 81, False: 64}


class Niche(TypedDict):
    """What is proven about a cyclomatic number: the lowest fitness, the number of networks, and rows of codes."""

    cyclomatic: int
    optimum: int
    networks: int | None
    witness: list[str]


class Cost(TypedDict):
    """Processor time, the process's peak memory, the states that were kept, and the most after one cell."""

    seconds: float
    mebibytes: int
    states: int
    peak: int


class Certificate(TypedDict):
    """The record of one size: `niches` has the cyclomatic numbers that are feasible."""

    height: int
    width: int
    fill: bool
    niches: list[Niche]
    cost: Cost


def certify(size: Size, *, thin: bool = True) -> Certificate:
    """Certifies one size.

    Three sweeps: the first counts the networks of each cyclomatic number, the second finds the best network without a
    bridge, the third the highest straight score with or without bridges. Bridges cost so much that the second is the
    optimum, if the third would gain less.

    Args:
      size: the smaller side first, so that the line is short.
      thin: see `sweep`.

    Raises:
      ArithmeticError: if bridges might pay, or a witness is not what it should be.
    """
    height, width, fill = size
    began = time.process_time()
    shape = (width, height)
    # Every link of a crossing leads to a tile with two connections, so tiles are at least 5/2 of the three-way and 3
    # times the four-way crossings, and the cyclomatic number is 1 + three-way / 2 + four-way.
    counted = sweep(shape, 2 + height * width // 3, fill=fill, counting=True)
    feasible = np.flatnonzero(counted.values > 0).tolist()
    bins = max(feasible, default=0) + 1
    best = sweep(shape, bins, fill=fill, bridgeless=True, thin=thin)
    bound = sweep(shape, bins, fill=fill, thin=thin)
    niches = []
    for cyclomatic in feasible:
        witness = TRANSPOSED[best.witnesses[cyclomatic].T] if cyclomatic in best.witnesses else None
        scores = best.values[cyclomatic], bound.values[cyclomatic]
        niches.append(_niche(size, cyclomatic, int(counted.values[cyclomatic]), *scores, witness))
    cost = _cost(began, counted.states + best.states + bound.states, max(counted.peak, best.peak, bound.peak))
    return {"height": height, "width": width, "fill": fill, "niches": niches, "cost": cost}


def certify_by_halves(size: Size, workers: Executor) -> Certificate:
    """Certifies one size by two halves, without the numbers of networks.

    Args:
      size: the upper half has half of the height, rounded down.
      workers: each takes a cyclomatic number at a time.

    Raises:
      ArithmeticError: see `certify`.
    """
    height, width, fill = size
    numbers = range(1, 2 + find_most_crossings(*_halves(size)) // 2)
    results = list(workers.map(partial(_certify_niche, size), numbers))
    best = {niche["cyclomatic"]: niche for niche, _ in results if niche}
    costs = [cost for _, cost in results]
    if not fill:  # networks that do not cross the cut
        low, high = sorted((height - height // 2, width))
        record = workers.submit(certify, (low, high, False)).result()
        costs.append(record["cost"])
        for niche in record["niches"]:
            rows = niche["witness"] if high == width else _transpose(niche["witness"])
            rows = [row.ljust(width, "0") for row in rows] + ["0" * width] * (height - len(rows))
            niche |= {"networks": None, "witness": rows}
            known = best.setdefault(niche["cyclomatic"], niche)
            best[niche["cyclomatic"]] = min(known, niche, key=lambda niche: niche["optimum"])
    cost = Cost(
        seconds=round(sum(cost["seconds"] for cost in costs), 2),
        mebibytes=max(cost["mebibytes"] for cost in costs),
        states=sum(cost["states"] for cost in costs),
        peak=max(cost["peak"] for cost in costs),
    )
    niches = [best[number] for number in sorted(best)]
    return {"height": height, "width": width, "fill": fill, "niches": niches, "cost": cost}


def _certify_niche(size: Size, cyclomatic: int) -> tuple[Niche | None, Cost]:
    """Certifies one cyclomatic number, of the networks that cross the cut; returns no niche if there is no network."""
    began = time.process_time()
    halves = _halves(size)
    best = find_optimum(*halves, cyclomatic)
    bound, states, peak = best.with_bridges, best.kept, best.peak
    if bound > best.score + _LEAST_COST_OF_BRIDGES // 2 or (best.score < 0 <= bound):
        proof = find_optimum(*halves, cyclomatic, bridgeless=False)
        bound, states, peak = proof.score, states + proof.kept, max(peak, proof.peak)
    cost = _cost(began, states, peak)
    if max(best.score, bound) < 0:
        return None, cost
    return _niche(size, cyclomatic, None, best.score, bound, best.grid), cost


@cache
def _halves(size: Size) -> tuple[Half, Half]:
    height, width, fill = size
    upper = make_half(height // 2, width, fill=fill)
    return upper, upper if height % 2 == 0 else make_half(height - height // 2, width, fill=fill)


def _niche(
    size: Size,
    cyclomatic: int,
    networks: int | None,
    score: float,
    with_bridges: float,
    witness: NDArray[np.int8] | None,
) -> Niche:
    """Makes the record of a niche from the highest straight score without bridges, and a bound of it with bridges.

    Raises:
      ArithmeticError: if bridges might pay, or the witness is not what it should be.
    """
    optimum = None if witness is None else int(-2 * (cyclomatic + score))
    least = int(-2 * (cyclomatic + with_bridges)) + _LEAST_COST_OF_BRIDGES
    if witness is None or optimum is None or optimum > least:
        raise ArithmeticError(f"{size}: bridges might pay at {cyclomatic}: got {optimum}, and {least} with bridges")
    rescored = rescore(witness.astype(int))
    if rescored[:3] != (optimum, cyclomatic, True) or rescored.filled < size[2]:
        raise ArithmeticError(f"{size}: expected {optimum} at {cyclomatic}, got {rescored} of {witness.tolist()}")
    rows = ["".join(f"{code:x}" for code in row) for row in witness.tolist()]
    return {"cyclomatic": cyclomatic, "optimum": optimum, "networks": networks, "witness": rows}


def _cost(began: float, states: int, peak: int) -> Cost:
    seconds, memory = time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return {"seconds": round(seconds, 2), "mebibytes": memory, "states": states, "peak": peak}


TRANSPOSED = np.array([code >> 3 & 1 | code >> 1 & 2 | code << 1 & 4 | code << 3 & 8 for code in range(16)], np.int8)
"""The code of each tile when rows become columns: north becomes west, and east south."""


def make_table(records: Sequence[Certificate]) -> str:
    """Makes the tables of optima, of numbers of networks, and of costs."""
    lines = ["Optimum by cyclomatic number. A vacant cell has no flawless network.", ""]
    for counts in (False, True):
        if counts:
            lines += ["", "Number of flawless networks, where they were counted.", ""]
        shown = [record for record in records if not counts or record["niches"][0]["networks"] is not None]
        numbers = range(1, 1 + max(niche["cyclomatic"] for record in shown for niche in record["niches"]))
        lines += [f"| grid | {' | '.join(map(str, numbers))} |", f"|---|{'---:|' * len(numbers)}"]
        for record in shown:
            values = {
                niche["cyclomatic"]: f"{niche['networks'] if counts else niche['optimum']:,}"
                for niche in record["niches"]
            }
            lines.append(f"| {_name(record)} | {' | '.join(values.get(number, '') for number in numbers)} |")
    about = "Cost: seconds of one core, and the peak memory of a process for each size, without start and compilation."
    lines += ["", about, "", "| grid | seconds | MiB | states | most after a cell |", "|---|---:|---:|---:|---:|"]
    for record in records:
        cost = record["cost"]
        row = f"{cost['seconds']:,.1f} | {cost['mebibytes']:,} | {cost['states']:,} | {cost['peak']:,}"
        lines.append(f"| {_name(record)} | {row} |")
    return "\n".join(lines) + "\n"


def _name(record: Certificate) -> str:
    return f"{record['height']} x {record['width']} {'A' if record['fill'] else 'B'}"


def parse_size(text: str) -> Size:
    """Reads a size such as 8x8A, the smaller side first."""
    parts = re.fullmatch(r"(\d+)x(\d+)([AB])", text)
    sides = sorted(map(int, parts.groups()[:2])) if parts else [0]
    if not parts or not 2 <= sides[0] <= sides[1] <= 14:
        raise argparse.ArgumentTypeError(f"expected a size such as 8x8A or 7x9B, sides of 2 to 14, got {text!r}")
    return sides[0], sides[1], parts[3] == "A"


def _transpose(rows: Sequence[str]) -> list[str]:
    """Makes rows of codes of columns of codes."""
    return ["".join(f"{code:x}" for code in row) for row in TRANSPOSED[_grid(rows).T].tolist()]


def _grid(rows: Sequence[str]) -> NDArray[np.int_]:
    return np.array([[int(code, 16) for code in row] for row in rows])


def _read(file: Path) -> dict[Size, Certificate]:
    if not file.exists():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return {(record["height"], record["width"], record["fill"]): record for record in content["certificates"]}
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(file, "certificates", repr(error)) from None


def _write(file: Path, records: Mapping[Size, Certificate]) -> None:
    # A line for each record: short, and what changes is seen.
    ordered = [records[size] for size in sorted(records, key=lambda size: (not size[2], *size))]
    lines = ",\n".join(json.dumps(record, separators=(",", ":")) for record in ordered)
    write(file, f'{{"version":1,"certificates":[\n{lines}\n]}}\n')


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("certify", __doc__)
    parser.add_argument("sizes", nargs="*", type=parse_size, metavar="SIZE", help="such as 8x8A 7x9B; by default all")
    parser.add_argument("--out", type=Path, default=Path("results/certificates.json"), help="file to add to")
    parser.add_argument("--table", type=Path, help="file for tables of all sizes in the other file")
    options = parser.parse_args(arguments)
    return run("certify", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    records = _read(options.out)
    for size in options.sizes or SIZES:
        if size not in records:
            # Processes of their own, so that the memory is that of this size alone.
            context = multiprocessing.get_context("spawn")
            large = size[0] * size[1] > _MOST_SWEPT[size[2]]
            with ProcessPoolExecutor(len(os.sched_getaffinity(0)) if large else 1, mp_context=context) as pool:
                if large:
                    records[size] = certify_by_halves(size, pool)
                else:
                    pool.submit(certify, (3, 3, True)).result()  # compiles
                    records[size] = pool.submit(certify, size).result()
            _write(options.out, records)
        record = records[size]
        optima = {niche["cyclomatic"]: niche["optimum"] for niche in record["niches"]}
        faults = check(optima, [_grid(niche["witness"]) for niche in record["niches"]], fill=size[2])[1]
        assert not faults, faults
        print(f"{_name(record)}: {optima}, {record['cost']['seconds']} s", flush=True)
    if options.table:
        write(options.table, make_table(list(records.values())))


if __name__ == "__main__":
    leave(main())
