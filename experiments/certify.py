"""Certificates: the optimum of every cyclomatic number of flawless networks, each with a network.

python experiments/certify.py [SIZE ...] [--out FILE] [--table FILE]

A size is 8x8A, or 7x9B: in A every cell is filled, in B cells may be empty. Sizes that the file already has are kept.
`frontier.py` has the programme, `check_archive.py` measures its networks without it.
"""

import argparse
import json
import multiprocessing
import re
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from check_archive import check, rescore
from frontier import sweep

from elitelanes_jax._util.atomic_io import write_atomic
from elitelanes_jax._util.checks import path
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say

__all__ = ["SIZES", "Size", "certify", "main", "table"]

Size = tuple[int, int, bool]
"""Height, width, and whether every cell is filled."""

SQUARES = [(side, side, fill) for side in range(3, 9) for fill in (True, False)]
RECTANGLES = [(low, high, fill) for low in range(3, 8) for high in range(low + 1, 10) for fill in (True, False)]
SIZES: list[Size] = sorted([*SQUARES, *RECTANGLES, (9, 9, True)], key=lambda size: (not size[2], size[0] * size[1]))

OUT = Path("results/certificates.json")

# A bridge ends at a crossing, or goes on through a tile with two connections, whose other link is a bridge too. As
# crossings are not linked to each other, a flawless network with a bridge has at least two, of a weight of 100 each.
_LEAST_COST_OF_BRIDGES = 200


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
        optimum = int(-2 * (cyclomatic + best.values[cyclomatic])) if cyclomatic in best.witnesses else None
        least = int(-2 * (cyclomatic + bound.values[cyclomatic])) + _LEAST_COST_OF_BRIDGES
        if optimum is None or optimum > least:
            raise ArithmeticError(f"{size}: bridges might pay at {cyclomatic}: got {optimum}, and {least} with bridges")
        witness = _TRANSPOSED[best.witnesses[cyclomatic].T]
        score = rescore(witness.astype(int))
        if score[:3] != (optimum, cyclomatic, True) or score.filled < fill:
            raise ArithmeticError(f"{size}: expected {optimum} at {cyclomatic}, got {score} of {witness.tolist()}")
        rows = ["".join(f"{code:x}" for code in row) for row in witness.tolist()]
        networks = int(counted.values[cyclomatic])
        niches.append({"cyclomatic": cyclomatic, "optimum": optimum, "networks": networks, "witness": rows})
    cost = {
        "seconds": round(time.process_time() - began, 2),
        "mebibytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "states": counted.states + best.states + bound.states,
        "peak": max(counted.peak, best.peak, bound.peak),
    }
    return {"height": height, "width": width, "fill": fill, "niches": niches, "cost": cost}


# The code of each tile when rows become columns: north and west change places, and east and south.
_TRANSPOSED = np.array([code >> 3 & 1 | code >> 1 & 2 | code << 1 & 4 | code << 3 & 8 for code in range(16)], np.int8)


def table(records: list[dict[str, Any]]) -> str:
    """Makes the tables of optima, of numbers of networks, and of what they took."""
    lines = ["Optimum by cyclomatic number; what is vacant has no flawless network.", ""]
    most = max(niche["cyclomatic"] for record in records for niche in record["niches"])
    numbers = range(1, most + 1)
    head = [f"| grid | {' | '.join(map(str, numbers))} |", f"|---|{'---:|' * most}"]
    for name in ("optimum", "networks"):
        if name == "networks":
            lines += ["", "Number of flawless networks.", ""]
        lines += head
        for record in records:
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
            # A process of its own, so that the memory is that of this size alone.
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(1, mp_context=context) as pool:
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
