"""Loads the maps in a folder by duckietown-world, or drives through them in SUMO.

python check_folder.py {duckietown,sumo} FOLDER

duckietown-world has to make the graph of lanes that the map says. In SUMO a car enters every edge of the network, in
both directions of each road, and 20 at least; all have to arrive, none by a collision or moved on by force. The digests
of the maps that passed are written next to the folder, and the next run skips these maps. Exit code 1: a map failed.
"""

import sys
import tempfile
from hashlib import sha256
from itertools import islice
from pathlib import Path

import numpy as np
from duckietown_lanes import check_lanes, read_by_duckietown_world
from sumo_drive import convert, drive, read

from elitelanes_jax import read_map
from elitelanes_jax._util.progress import Progress
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.sumo import to_sumo
from elitelanes_jax.network import canonical_form


def check_drive(grid, folder):
    """Whether all cars arrive, without a word from SUMO."""
    net = folder / "town.net.xml"
    _, edges, connections = read(to_sumo(as_map(grid), "town"))
    assert convert(net, grid) == []
    vehicles = max(20, len(edges))
    assert drive(net, connections, folder, 0, vehicles) == (vehicles, "")


def checks_of(by, grids, folder):
    """Yields a function for each map, which raises AssertionError if the map fails."""
    if by == "sumo":
        yield from (lambda grid=grid: check_drive(grid, folder) for grid in grids)
        return
    files = [folder / f"{number}.yaml" for number in range(len(grids))]
    for file, grid in zip(files, grids, strict=True):
        file.write_text(to_duckietown(grid))
    for grid, graph in zip(grids, read_by_duckietown_world(files), strict=True):
        yield lambda grid=grid, graph=graph: check_lanes(grid, graph)


def main(by, folder):
    maps = {}
    for file in sorted(folder.glob("maps/*/map.json")):
        grid = np.asarray(read_map(file).codes)
        maps[sha256(repr(grid.tolist()).encode()).hexdigest()[:16]] = file, grid
    if by not in ("duckietown", "sumo") or not maps:
        sys.exit(f"{__doc__}\nexpected duckietown or sumo, and maps in {folder}/maps/*/map.json")
    kept = folder.with_name(f"{folder.name}-{by}.txt")
    passed = set(kept.read_text().split()) & set(maps) if kept.exists() else set()
    missing = iter([digest for digest in maps if digest not in passed])
    progress = Progress(by, len(maps), "maps", done=len(passed))
    with progress, kept.open("a") as lines, tempfile.TemporaryDirectory() as scratch:
        while some := list(islice(missing, 50)):  # duckietown-world takes two seconds to start
            checks = checks_of(by, [maps[digest][1] for digest in some], Path(scratch))
            for digest, check in zip(some, checks, strict=True):
                try:
                    check()
                except AssertionError as error:
                    print(f"{maps[digest][0]}: {str(error)[:500]}", file=sys.stderr)
                else:
                    passed.add(digest)
                    print(digest, file=lines, flush=True)
                progress.count()
    distinct = len({canonical_form(grid) for _, grid in maps.values()})
    print(f"{len(passed)} of {len(maps)} maps passed, {distinct} distinct even if turned or mirrored")
    return int(len(passed) < len(maps))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
