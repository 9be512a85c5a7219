"""Has readers by others read our maps, and compares what they count with the maps: python check.py [NAME ...].

NAME is a reader of readers.toml; by default all of them. `--share 0.05` takes that part of the maps. Each reader has an
environment in .venv-readers, which is made if it is missing. A map that a reader has read goes to results/readers, and
is not read again unless its file changes. At the end, the table of docs/simulators.md is written. Exit code 1: a reader
refused a map, or counted something else.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import networkx as nx
import numpy as np

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
sys.path[:0] = [str(HERE.parent), str(ROOT / "tests")]

from oracle import road_graph  # noqa: E402
from simulator_maps import draw, lane_graph, peoples_maps  # noqa: E402

from elitelanes_jax import InputError, RoadMap, export  # noqa: E402
from elitelanes_jax._util.progress import Progress  # noqa: E402
from elitelanes_jax.formats._scene import make_scene  # noqa: E402
from elitelanes_jax.formats.signals import crossing_of  # noqa: E402
from elitelanes_jax.formats.streets import Streets  # noqa: E402
from elitelanes_jax.lanes.curves import on_road  # noqa: E402
from elitelanes_jax.maps import FormatOptions, furnish  # noqa: E402
from elitelanes_jax.network.codes import SIDES  # noqa: E402
from elitelanes_jax.network.wfc import generate_batch  # noqa: E402

PAGE = ROOT / "docs" / "simulators.md"
MAPS, ODD_MAPS, BATCH, SECONDS = 1000, 100, 20, 1200
BEGIN, END = "<!-- readers: written by tests/formats/readers/check.py -->\n", "<!-- end of readers -->\n"
FURNITURE = ("signs=possible lights=0.3", "signs=possible trees=0.1 houses=0.05", "trees=0.2 duckies=0.1")
WORDS = {"lanelets": "lanes", "follow": "links", "turns": "turns"}


class Reader(NamedTuple):
    """A table of readers.toml."""

    name: str
    title: str
    format: str
    packages: tuple[str, ...]
    program: str = ""
    python: str = "3.11"
    cells: int = 10**6

    @property
    def results(self) -> Path:
        return ROOT / "results" / "readers" / f"{self.name}.jsonl"

    def environment(self) -> Path:
        """Makes the environment if it is missing or has other packages; returns its Python."""
        # Readers with the same packages share one.
        name = next(one.name for one in readers() if one.packages == self.packages)
        folder = ROOT / ".venv-readers" / name
        packages, installed = "\n".join(self.packages), folder / "installed.txt"
        python = folder / "bin" / "python"
        if not installed.exists() or installed.read_text() != packages:
            subprocess.run([python_of(self.python), "-m", "venv", "--clear", folder], check=True)
            pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
            subprocess.run([*pip, *self.packages], check=True)
            installed.write_text(packages)
        return python

    def read(self, files: list[Path]) -> list[dict]:
        """Returns what the reader's program says of each file. After a crash, the other files are read again."""
        program = HERE / (self.program or f"read_{self.name}.py")
        said: list[dict] = []
        while len(said) < len(files):
            command = [self.environment(), program, *files[len(said) :]]
            try:
                done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
                if done.returncode == -signal.SIGINT:
                    # The user interrupted the reader, which says nothing about the file.
                    raise KeyboardInterrupt
                output, why = (
                    done.stdout,
                    f"ended with {done.returncode}: {done.stderr[-300:].decode(errors='replace')}",
                )
            except subprocess.TimeoutExpired as error:
                output, why = error.stdout or b"", f"not read in {SECONDS} s"
            lines = output.decode(errors="replace").splitlines()
            said += [json.loads(line.removeprefix("READ ")) for line in lines if line.startswith("READ ")]
            if len(said) < len(files):
                said.append({"error": why})
        return said


def python_of(number: str) -> str:
    """Returns a Python of a version: on the PATH, or of pyenv."""
    for path in (f"python{number}", *map(str, Path.home().glob(f".pyenv/versions/{number}.*/bin/python"))):
        try:
            subprocess.run([path, "-c", ""], check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            continue
        return path
    sys.exit(f"expected Python {number} on the PATH or by pyenv, got none")


def readers() -> list[Reader]:
    table = tomllib.loads((HERE / "readers.toml").read_text())
    return [Reader(name, **values | {"packages": tuple(values["packages"])}) for name, values in table.items()]


def maps() -> list[tuple[str, Callable[[], RoadMap]]]:
    """Lists what maps there are, drawn by seeds, odd ones or by people, with a function that makes each."""
    listed: list[tuple[str, Callable[[], RoadMap]]] = []
    for seed in range(MAPS):
        # Two of three are filled, a sixth has dead ends, a third are towns.
        listed.append(("drawn", partial(furnished, draw, seed, seed // 21)))
    for seed in range(ODD_MAPS):
        kind = ("with dead ends", "with adjacent crossings", "of several parts", "of one row")[seed % 4]
        listed.append((kind, partial(furnished, odd, seed, seed // 4)))
    return listed + [("by people", lambda road_map=road_map: road_map) for road_map in peoples_maps()]


def furnished(make: Callable[[int], np.ndarray], seed: int, number: int) -> RoadMap:
    """Returns a map, every second one with signs, lights or other objects, if they fit."""
    codes = np.asarray(make(seed))
    if number % 2:
        try:
            return furnish(codes, FURNITURE[number // 2 % 3])
        except InputError:
            pass
    return RoadMap(codes)


def odd(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    side = 4 + seed // 4 % 9
    if seed % 4 == 0:
        return generate_batch(random, 1, (side, side), alphabet=range(16), border="closed").grid[0]
    if seed % 4 == 1:
        # A block of streets, with 3-way crossings around 4-way ones.
        block = np.full((side, side), 15)
        block[0], block[-1], block[:, 0], block[:, -1] = 7, 13, 14, 11
        block[[0, 0, -1, -1], [0, -1, 0, -1]] = 6, 3, 12, 9
        return block
    if seed % 4 == 2:
        first, second = generate_batch(random, 2, (side, side), alphabet=range(16), border="closed").grid
        return np.concatenate([first, np.zeros((1, side), int), second])
    row = np.full((1, side), 5)
    row[0, 0], row[0, -1] = 4, 1
    return row if seed % 8 == 3 else np.where(row.T == 5, 10, np.where(row.T == 4, 2, 8))


def expected(road_map: RoadMap, to: str) -> dict[str, float]:
    """Returns what a reader of a format should count, by the graph of tiles and the objects."""
    lanes = lane_graph(road_map.codes)
    links = road_graph(road_map.codes)
    # Tiles inside roads have two links. Each part of a road is a chain of them between two nodes.
    chains = list(nx.connected_components(links.subgraph(t for t in links if links.degree[t] == 2)))
    nodes = {tile for tile in links if links.degree[tile] not in (0, 2)}
    roads = sum(links.degree[tile] for tile in nodes) / 2
    turns = sum(lane[:2] in nodes for lane in lanes)
    for chain in chains:
        ends = [other for tile in chain for other in links[tile] if other in nodes]
        # A ring has two further nodes, and a road back to its own node has one. Both have two turns there.
        added = 2 if not ends else int(ends[0] == ends[1])
        roads, turns = roads + added, turns + 2 * added
    rights = make_scene(road_map, Streets()).rights
    signs = [crossing_of(one, rights) for one in road_map.objects or () if one.kind == "sign_stop"]
    arms = {tile: links.degree[tile] for tile in rights}
    stopping = [tile for tile, right in rights.items() if right == "allway_stop"]
    if to == "opendrive":
        # OpenDRIVE has the signs of the map, and signs at all arms of the crossings without.
        stops = sum(signs.count(tile) or arms[tile] for tile in stopping)
    else:
        stops = sum(arms[tile] for tile in stopping)
    # Connections that the neighbour does not return are no roads.
    codes, middles = np.zeros(road_map.codes.shape, int), np.arange(0.1, 1, 0.2)
    for tile, other in links.to_directed().edges:
        down, right = other[0] - tile[0], other[1] - tile[1]
        codes[tile] += next(side.bit for side in SIDES if (side.down, side.right) == (down, right))
    return {
        "lanes": 2 * roads + turns,
        "links": 2 * turns,
        "roads": roads,
        "turns": turns,
        "lanelets": len(lanes),
        "follow": lanes.number_of_edges(),
        "stops": stops,
        "lights": sum(arms[tile] for tile, right in rights.items() if right == "traffic_light"),
        "objects": sum(bool(one.height) for one in road_map.objects or ()),
        # A cell is free if its middle is on the road. A tile has 5 x 5 cells.
        "cells": int(on_road(codes[:, :, None, None], *np.meshgrid(middles, middles)).sum()),
    }


class Files(NamedTuple):
    """The files of a map in a format: the one that readers are given, and a digest of all."""

    path: Path
    digest: str


def write_files(to: str, batch: list[tuple[str, RoadMap]], folder: Path) -> list[Files]:
    """Writes the maps of a batch in a format."""
    options = FormatOptions(tile_px=16) if to in ("mujoco", "gltf", "usd") else FormatOptions()
    files: list[Files] = []
    for index, (_, road_map) in enumerate(batch):
        written = export(road_map, to, options, name=f"map{index}")
        for path, content in written.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        # netconvert is given the settings, which come last, and all other readers the first file.
        path = folder / list(written)[-1 if to == "sumo" else 0]
        files.append(Files(path, sha256(b"".join(written.values())).hexdigest()[:16]))
    return files


def check(reader: Reader, batch: list[tuple[str, RoadMap]], files: list[Files], known: dict[str, dict]) -> list[dict]:
    """Has a reader read the files of a batch that it does not know; returns and keeps what it said of all."""
    fitting = [index for index, (_, road_map) in enumerate(batch) if road_map.codes.size <= reader.cells]
    new = [index for index in fitting if files[index].digest not in known]
    with reader.results.open("a") as lines:
        for index, counts in zip(new, reader.read([files[index].path for index in new]), strict=True):
            kind, road_map = batch[index]
            wanted = expected(road_map, reader.format)
            counted = {name: count for name, count in counts.items() if name in wanted}
            wrong = [
                f"{name} {wanted[name]:g}, got {count:g}" for name, count in counted.items() if wanted[name] != count
            ]
            problem = counts.get("error") or "; ".join(counts.get("warnings", ()) or wrong)
            if problem:
                grid = road_map.codes.tolist()
                print(f"{reader.name}: map {kind}: {problem[:500]}\n  {grid}", file=sys.stderr)
            digest = files[index].digest
            known[digest] = {"map": digest, "kind": kind, "counts": sorted(counted), "problem": problem}
            known[digest]["day"] = date.today().isoformat()
            print(json.dumps(known[digest]), file=lines, flush=True)
    # Maps of different kinds may have the same file. A file that was read before may be one of another kind.
    return [known[files[index].digest] | {"kind": batch[index][0]} for index in fitting]


def write_table(seen: dict[Reader, list[dict]]) -> None:
    """Writes the rows of readers on the page. Rows of other readers stay."""
    before, rest = PAGE.read_text().split(BEGIN)
    table, after = rest.split(END)
    rows = {line.split(" | ")[0].removeprefix("| "): line for line in table.splitlines()[3:-1]}
    for reader, lines in seen.items():
        if lines:
            rows[reader.title] = row(reader, lines)
    titles = [reader.title for reader in readers() if reader.title in rows]
    head = "\n| reader | version | format | maps | by people | refused or unequal | equal counts | day |\n"
    head += "|---|---|---|---:|---:|---:|---|---|\n"
    PAGE.write_text(before + BEGIN + head + "".join(f"{rows[title]}\n" for title in titles) + "\n" + END + after)


def row(reader: Reader, lines: list[dict]) -> str:
    """Returns a row of the table."""
    people = sum(line["kind"] == "by people" for line in lines)
    problems = sum(bool(line["problem"]) for line in lines)
    names = sorted({WORDS.get(name, name) for line in lines for name in line["counts"]})
    size = f", up to {reader.cells} cells" if reader.cells < 10**6 else ""
    columns = (
        reader.title,
        reader.packages[0].partition("==")[2],
        f"`{reader.format}`",
        f"{len(lines):,}{size}",
        str(people),
        str(problems),
        ", ".join(names),
        max(line["day"] for line in lines),
    )
    return f"| {' | '.join(columns)} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--share", type=float, default=1.0)
    asked = parser.parse_args()
    known_readers = readers()
    if unknown := set(asked.names) - {reader.name for reader in known_readers}:
        parser.error(
            f"expected some of {', '.join(one.name for one in known_readers)}, got {', '.join(sorted(unknown))}"
        )
    chosen = [one for one in known_readers if one.name in (asked.names or [one.name])]
    every = maps()
    # Each share has maps of all kinds.
    order = np.random.default_rng(77).permutation(len(every))[: round(asked.share * len(every))].tolist()
    known: dict[Reader, dict[str, dict]] = {}
    for reader in chosen:
        reader.results.parent.mkdir(parents=True, exist_ok=True)
        lines = reader.results.read_text().splitlines() if reader.results.exists() else []
        known[reader] = {line["map"]: line for line in map(json.loads, lines)}
        reader.environment()
    seen: dict[Reader, list[dict]] = {reader: [] for reader in chosen}
    try:
        with Progress("readers", len(order), "maps") as progress:
            for start in range(0, len(order), BATCH):
                batch = [(every[index][0], every[index][1]()) for index in order[start : start + BATCH]]
                # After an interruption, readers end before their files are removed.
                with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(2) as pool:
                    files = {to: write_files(to, batch, Path(scratch, to)) for to in {one.format for one in chosen}}
                    found = {one: pool.submit(check, one, batch, files[one.format], known[one]) for one in chosen}
                    for reader, lines in found.items():
                        seen[reader] += lines.result()
                progress.count(len(batch))
    finally:
        # A share is for a look at all kinds of maps. An interrupted run writes what it has.
        if asked.share == 1:
            write_table(seen)
    return int(any(line["problem"] for lines in seen.values() for line in lines))


if __name__ == "__main__":
    sys.exit(main())
