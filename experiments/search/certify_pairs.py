"""Proves the optima of niches of two descriptors: the cyclomatic number, and the number of tiles of a kind.

    python -m experiments.search.certify_pairs [TASK ...] [--out FILE] [--enumerated FILE]

A task is 7x7B-turns: a size as of `certify`, and turns, crossings or straights. Tasks that the file already has are
kept. A network counts if it is flawless and has no bridge, so one sweep of `exact/sweep.py` counts the networks of each
niche, and a second one finds the best. `check_archive.py` measures the best networks with code of its own.

`--enumerated` compares the optima of all tasks of a size with the lines that `enumerate.cpp` prints for this size.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np

from elitelanes_jax.benchmark import PAIRS
from experiments.common import Parser, leave, run, write
from experiments.search.certify import TRANSPOSED, parse_size
from experiments.search.check_archive import count_tiles, rescore
from experiments.search.exact.sweep import sweep
from experiments.search.exact.tiles import COUNTED

__all__ = ["Certificate", "Niche", "certify_pair", "compare", "main"]


class Niche(TypedDict):
    """What is proven about a niche: the lowest fitness, the number of networks, and rows of codes."""

    cyclomatic: int
    tiles: int
    optimum: int
    networks: int
    witness: list[str]


class Certificate(TypedDict):
    """The record of one task. `tiles` names the kind of tiles of the second descriptor."""

    height: int
    width: int
    fill: bool
    tiles: str
    niches: list[Niche]


def certify_pair(name: str, *, thin: bool = True) -> Certificate:
    """Certifies one task.

    Args:
      name: such as ``7x7B-turns``, the smaller side first.
      thin: see `sweep`.

    Raises:
      ArithmeticError: if a witness is not what it should be.
    """
    size, _, tiles = name.partition("-")
    height, width, fill = parse_size(size)
    # As in `certify`, so that the line of the sweep is short.
    shape, bins = (width, height), 2 + height * width // 3
    networks = sweep(shape, bins, fill=fill, counting=True, bridgeless=True, tiles=tiles).values
    bins = 1 + int(np.argwhere(networks > 0)[:, 0].max())
    best = sweep(shape, bins, fill=fill, bridgeless=True, thin=thin, tiles=tiles)
    niches: list[Niche] = []
    for cyclomatic, number in np.argwhere(networks > 0).tolist():
        witness = TRANSPOSED[best.witnesses[cyclomatic, number].T].astype(int)
        optimum = int(-2 * (cyclomatic + best.values[cyclomatic, number]))
        expected = (optimum, cyclomatic, True)
        if rescore(witness)[:3] != expected or count_tiles(witness, tiles) != number or (fill and not witness.all()):
            raise ArithmeticError(f"{name}: expected {expected} with {number} {tiles}, got {witness.tolist()}")
        rows = ["".join(f"{code:x}" for code in row) for row in witness.tolist()]
        count = int(networks[cyclomatic, number])
        niches.append(
            {"cyclomatic": cyclomatic, "tiles": number, "optimum": optimum, "networks": count, "witness": rows}
        )
    return {"height": height, "width": width, "fill": fill, "tiles": tiles, "niches": niches}


def compare(record: Certificate, lines: Sequence[str]) -> int:
    """Compares a certificate with the lines of `enumerate.cpp`; returns the number of niches that it has.

    Raises:
      ArithmeticError: if an optimum differs, or one of them has a niche that the other one lacks.
    """
    scores: dict[tuple[int, int], int] = {}
    for line in lines:
        cyclomatic, turns, straights, _, score = map(int, line.split())
        niche = cyclomatic, {"turns": turns, "straights": straights}[record["tiles"]]
        if score >= 0:
            scores[niche] = max(score, scores.get(niche, 0))
    enumerated = {niche: -2 * (niche[0] + score) for niche, score in scores.items()}
    certified = {(niche["cyclomatic"], niche["tiles"]): niche["optimum"] for niche in record["niches"]}
    if enumerated != certified:
        differing = {niche for niche, _ in enumerated.items() ^ certified.items()}
        raise ArithmeticError(f"{name_of(record)}: enumeration and certificate differ at {sorted(differing)}")
    return len(certified)


def name_of(record: Certificate) -> str:
    """Returns the name of the task that a certificate is of."""
    return f"{record['height']}x{record['width']}{'A' if record['fill'] else 'B'}-{record['tiles']}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("certify_pairs", __doc__)
    parser.add_argument(
        "tasks", nargs="*", type=_task, default=PAIRS, metavar="TASK", help=f"default {' '.join(PAIRS)}"
    )
    parser.add_argument("--out", type=Path, default=Path("results/certificates-2.json"), help="file to add to")
    parser.add_argument("--enumerated", type=Path, metavar="FILE", help="output of enumerate.cpp for the tasks' size")
    options = parser.parse_args(arguments)
    return run("certify_pairs", lambda: _run(options))


def _task(text: str) -> str:
    size, _, tiles = text.partition("-")
    if tiles not in COUNTED:
        raise argparse.ArgumentTypeError(f"expected a size and one of {', '.join(COUNTED)}, got {text!r}")
    height, width, fill = parse_size(size)
    return f"{height}x{width}{'A' if fill else 'B'}-{tiles}"


def _run(options: argparse.Namespace) -> None:
    content = json.loads(options.out.read_text(encoding="utf-8")) if options.out.exists() else {"certificates": []}
    records = {name_of(record): record for record in content["certificates"]}
    for name in options.tasks:
        if name not in records:
            records[name] = certify_pair(name)
            text = ",\n".join(json.dumps(record, separators=(",", ":")) for record in records.values())
            write(options.out, f'{{"version":2,"certificates":[\n{text}\n]}}\n')
        print(f"{name}: {len(records[name]['niches'])} niches", flush=True)
        if options.enumerated:
            count = compare(records[name], options.enumerated.read_text(encoding="utf-8").splitlines())
            print(f"{name}: enumeration has the same {count} optima", flush=True)


if __name__ == "__main__":
    leave(main())
