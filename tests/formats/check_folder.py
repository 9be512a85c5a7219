"""Loads the maps in a folder by duckietown-world, or drives through them in SUMO.

python check_folder.py {duckietown,sumo} FOLDER

duckietown-world has to make the graph of lanes that the map says. In SUMO a car enters every edge of the network, in
both directions of each road, and 20 at least; all have to arrive, none by a collision or moved on by force. What has
passed is written beside the folder, so that a run goes on where the last one ended. Exit code 1 says that a map failed.
"""

import tempfile
from hashlib import sha256
from pathlib import Path

import numpy as np
from duckietown_lanes import OWN_ENVIRONMENT, check_lanes, read_by_duckietown_world
from sumo_drive import drive, read

from elitelanes_jax import InputError, read_map
from elitelanes_jax._util.checks import one_of, path
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.progress import Progress
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say, warn
from elitelanes_jax.formats import convert, to_duckietown
from elitelanes_jax.formats.sumo import plain_xml
from elitelanes_jax.network import canonical_form

_AT_ONCE = 50  # duckietown-world takes two seconds to start


def graphs_of(grids, folder):
    """The graphs of lanes that duckietown-world makes."""
    files = [folder / f"{number}.yaml" for number in range(len(grids))]
    for file, grid in zip(files, grids, strict=True):
        file.write_text(to_duckietown(grid))
    return read_by_duckietown_world(files)


def check_drive(grid, folder):
    """Whether all cars arrive, without a word from SUMO."""
    net = folder / "town.net.xml"
    _, edges, connections = read(plain_xml(grid))
    assert convert(net, grid) == ()
    vehicles = max(20, len(edges))
    assert drive(net, connections, folder, 0, vehicles) == (vehicles, "")


def passing(by, maps, folder):
    """Those of some maps, pairs of file and grid by digest, that pass."""
    graphs = graphs_of([grid for _, grid in maps.values()], folder) if by == "duckietown" else [None] * len(maps)
    passed = []
    for (digest, (file, grid)), graph in zip(maps.items(), graphs, strict=True):
        try:
            check_drive(grid, folder) if graph is None else check_lanes(grid, graph)
        except AssertionError as error:
            warn(f"{file}: {str(error)[:500]}")
        else:
            passed.append(digest)
    return passed


def main(arguments=None):
    parser = Parser(prog="check_folder", description=__doc__)
    parser.add_argument("by", type=checked_by(one_of("duckietown", "sumo")), metavar="{duckietown,sumo}")
    parser.add_argument("folder", type=checked_by(path), metavar="FOLDER")
    options = parser.parse_args(arguments)
    return guarded("check_folder", lambda: _main(options.by, options.folder), interrupted="what passed is kept")


def _main(by, folder):
    if by == "sumo":
        import_optional("sumo", "driving needs SUMO", "eclipse-sumo")
    elif not OWN_ENVIRONMENT.exists():
        raise InputError("duckietown-world is not here: make duckietown")
    maps = {}
    for file in sorted(folder.glob("maps/*/map.json")):
        grid = np.asarray(read_map(file).codes)
        maps[sha256(repr(grid.tolist()).encode()).hexdigest()[:16]] = file, grid
    if not maps:
        raise InputError(f"{folder}: expected maps/*/map.json, got none")
    kept = folder.with_name(f"{folder.name}-{by}.txt")
    passed = set(kept.read_text().split()) & set(maps) if kept.exists() else set()
    missing = [digest for digest in maps if digest not in passed]
    step = _AT_ONCE if by == "duckietown" else 1
    with (
        Progress(by, len(maps), "maps", done=len(passed)) as progress,
        kept.open("a") as lines,
        tempfile.TemporaryDirectory() as scratch,
    ):
        for first in range(0, len(missing), step):
            some = missing[first : first + step]
            good = passing(by, {digest: maps[digest] for digest in some}, Path(scratch))
            lines.writelines(f"{digest}\n" for digest in good)
            lines.flush()
            passed.update(good)
            progress.count(len(some))
    distinct = len({canonical_form(grid) for _, grid in maps.values()})
    say(f"{len(passed)} of {len(maps)} maps passed, {distinct} distinct even if turned or mirrored", asked=True)
    return int(len(passed) < len(maps))


if __name__ == "__main__":
    leave(main)
