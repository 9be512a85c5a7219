"""Certificates: the optimum of every cyclomatic number of flawless networks, each with a network.

python experiments/certify.py [SIZE ...] [--out FILE] [--table FILE]

A size is 8x8A, or 7x9B: in A every cell is filled, in B cells may be empty. Sizes that the file already has are kept.
`frontier.py` has the programme, and `halves.py` that for more than 81 cells, or 64 if some may be empty, which does not
count networks.
`check_archive.py` measures their networks without them.
"""

import argparse
import json
import multiprocessing
import re
import resource
import sys
import time
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from check_archive import check, rescore
from elitelanes_jax._util.cores import count_cores
from frontier import sweep
from half_sweep import Half, make_half
from halves import find_most_crossings, find_optimum
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax._util.checks import path
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say

__all__ = ["SIZES", "Size", "certify", "certify_by_halves", "certify_niche", "main", "table"]

Size = tuple[int, int, bool]
"""Height, width, and whether every cell is filled."""

SQUARES = [(side, side, fill) for side in range(3, 9) for fill in (True, False)]
RECTANGLES = [(low, high, fill) for low in range(3, 8) for high in range(low + 1, 10) for fill in (True, False)]
LARGE = [(9, 9, True), (9, 9, False), (10, 10, True), (12, 12, True)]
SIZES: list[Size] = sorted([*SQUARES, *RECTANGLES, *LARGE], key=lambda size: (not size[2], size[0] * size[1]))

OUT = Path("results/certificates.json")

# A bridge ends at a crossing, or goes on through a tile with two connections, whose other link is a bridge too. As
# crossings are not linked to each other, a flawless network with a bridge has at least two, of a weight of 100 each.
_LEAST_COST_OF_BRIDGES = 200

# The most cells, by whether all are filled; larger grids are cut into halves.
_MOST_SWEPT = {True: 81, False: 64}


def certify(size: Size, *, thin: bool = True) -> dict[str, Any]:
    """Certifies one size.

    Three sweeps: the first counts the networks of each cyclomatic number, the second finds the best network without a
    bridge, the third the highest straight score with or without bridges. Bridges cost so much that the second is the
    optimum, if the third would gain less.

    Args:
      size: the smaller side first, so that the line is short.
      thin: as `sweep` takes it.

    Returns:
      The record that the file has for a size.

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
        witness = _TRANSPOSED[best.witnesses[cyclomatic].T] if cyclomatic in best.witnesses else None
        scores = best.values[cyclomatic], bound.values[cyclomatic]
        niches.append(_niche(size, cyclomatic, int(counted.values[cyclomatic]), *scores, witness))
    cost = _cost(began, counted.states + best.states + bound.states, max(counted.peak, best.peak, bound.peak))
    return {"height": height, "width": width, "fill": fill, "niches": niches, "cost": cost}


def certify_by_halves(size: Size, workers: Executor) -> dict[str, Any]:
    """Certifies one size by two halves, without the numbers of networks.

    Args:
      size: the upper half has half of the height, rounded down.
      workers: they take the cyclomatic numbers.

    Returns:
      The record that the file has for a size.

    Raises:
      ArithmeticError: as `certify`.
    """
    height, width, fill = size
    numbers = range(1, 2 + find_most_crossings(*_halves(size)) // 2)
    results = list(workers.map(partial(certify_niche, size), numbers))
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
    cost = {name: round(sum(cost[name] for cost in costs), 2) for name in ("seconds", "states")}
    cost |= {name: max(cost[name] for cost in costs) for name in ("mebibytes", "peak")}
    cost = {name: cost[name] for name in costs[0]}
    niches = [best[number] for number in sorted(best)]
    return {"height": height, "width": width, "fill": fill, "niches": niches, "cost": cost}


def certify_niche(size: Size, cyclomatic: int) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """Certifies one cyclomatic number, of the networks that cross the cut.

    Returns:
      The record of the niche, None if there is no network, and the cost.
    """
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
) -> dict[str, Any]:
    """Makes the record of a niche of the highest straight score without bridges, and a bound of it with bridges.

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


def _cost(began: float, states: int, peak: int) -> dict[str, Any]:
    return {
        "seconds": round(time.process_time() - began, 2),
        "mebibytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "states": states,
        "peak": peak,
    }


# The code of each tile when rows become columns: north and west change places, and east and south.
_TRANSPOSED = np.array([code >> 3 & 1 | code >> 1 & 2 | code << 1 & 4 | code << 3 & 8 for code in range(16)], np.int8)


def table(records: list[dict[str, Any]]) -> str:
    """Makes the tables of optima, of numbers of networks, and of what they took."""
    lines = ["Optimum by cyclomatic number; what is vacant has no flawless network.", ""]
    for name in ("optimum", "networks"):
        if name == "networks":
            lines += ["", "Number of flawless networks, where they were counted.", ""]
        shown = [record for record in records if record["niches"][0][name] is not None]
        most = max(niche["cyclomatic"] for record in shown for niche in record["niches"])
        numbers = range(1, most + 1)
        lines += [f"| grid | {' | '.join(map(str, numbers))} |", f"|---|{'---:|' * most}"]
        for record in shown:
            values = {niche["cyclomatic"]: f"{niche[name]:,}" for niche in record["niches"]}
            lines.append(f"| {_name(record)} | {' | '.join(values.get(number, '') for number in numbers)} |")
    lines += [
        "",
        "Cost: seconds of one core, and the most memory, of a process for each size; its start and compilation apart.",
        "",
    ]
    lines += ["| grid | seconds | MiB | states | most on one line |", "|---|---:|---:|---:|---:|"]
    for record in records:
        cost = record["cost"]
        row = f"{cost['seconds']:,.1f} | {cost['mebibytes']:,} | {cost['states']:,} | {cost['peak']:,}"
        lines.append(f"| {_name(record)} | {row} |")
    return "\n".join(lines) + "\n"


def _name(record: dict[str, Any]) -> str:
    return f"{record['height']} x {record['width']} {'A' if record['fill'] else 'B'}"


def _size(text: str) -> Size:
    parts = re.fullmatch(r"(\d+)x(\d+)([AB])", text)
    if not parts or not 2 <= min(int(parts[1]), int(parts[2])) <= max(int(parts[1]), int(parts[2])) <= 14:
        raise InputError(f"expected a size such as 8x8A or 7x9B, sides of 2 to 14, got {text!r}")
    low, high = sorted((int(parts[1]), int(parts[2])))
    return low, high, parts[3] == "A"


def _transpose(rows: list[str]) -> list[str]:
    """Makes rows of codes of columns of codes."""
    return ["".join(f"{code:x}" for code in row) for row in _TRANSPOSED[_grid(rows).T].tolist()]


def _read(file: Path) -> dict[Size, dict[str, Any]]:
    if not file.exists():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return {(record["height"], record["width"], record["fill"]): record for record in content["certificates"]}
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(f"{file}: expected certificates, got {error!r}") from None


def _write(file: Path, records: list[dict[str, Any]]) -> None:
    # A line for each record: short, and what changes is seen.
    lines = ",\n".join(json.dumps(record, separators=(",", ":")) for record in records)
    write_atomic(file, f'{{"version":1,"certificates":[\n{lines}\n]}}\n'.encode())


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(prog="certify.py", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sizes", nargs="*", type=checked_by(_size), help="such as 8x8A 7x9B; by default all")
    parser.add_argument(
        "--out", type=checked_by(path), default=Path("results/certificates.json"), help="file to add to"
    )
    parser.add_argument("--table", type=checked_by(path), help="file for tables of all that the other file has")
    options = parser.parse_args(arguments)
    return guarded("certify.py", lambda: _run(options), interrupted="sizes that were done are kept")


def _run(options: argparse.Namespace) -> int:
    records = _read(options.out)
    for size in options.sizes or SIZES:
        if size not in records:
            # Processes of their own, so that the memory is that of this size alone.
            context = multiprocessing.get_context("spawn")
            large = size[0] * size[1] > _MOST_SWEPT[size[2]]
            with ProcessPoolExecutor(count_cores() if large else 1, mp_context=context) as pool:
                if large:
                    records[size] = certify_by_halves(size, pool)
                else:
                    pool.submit(certify, (3, 3, True)).result()  # compiles
                    records[size] = pool.submit(certify, size).result()
            _write(options.out, [records[key] for key in sorted(records, key=lambda key: (not key[2], *key))])
        record = records[size]
        optima = {niche["cyclomatic"]: niche["optimum"] for niche in record["niches"]}
        faults = check(optima, [_grid(niche["witness"]) for niche in record["niches"]], fill=size[2])[1]
        assert not faults, faults
        say(f"{_name(record)}: {optima}, {record['cost']['seconds']} s")
    if options.table:
        write_atomic(options.table, table(list(records.values())).encode())
    return 0


def _grid(rows: list[str]) -> np.ndarray:
    return np.array([[int(code, 16) for code in row] for row in rows])


if __name__ == "__main__":
    leave(lambda: main(sys.argv[1:]))
