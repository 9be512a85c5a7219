"""Road networks for SUMO, the traffic simulator: its plain XML, and networks that its `netconvert` makes from it.

Roads are those of `reduced_graph`, with a lane in each direction; traffic keeps right. They run along the middle of
straights and the arcs of turns. SUMO has no edge from a node to itself, so a road back to its start, such as a ring, is
cut in two.
"""

import math
import os
import re
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, reason
from elitelanes_jax._util.files import unwritable_error, write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.formats._signals import rights_of_way
from elitelanes_jax.formats.graph import Cell, linked_tiles, walk_roads
from elitelanes_jax.formats.streets import Streets, no_road
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CONNECTIONS, SIDE_TOWARDS

_OPTIONS = (
    "--offset.disable-normalization=true",  # keep the grid's coordinates
    "--precision=4",  # for streets as small as Duckietown's
    "--geometry.min-radius=0",  # no warnings of turns as sharp as a tile's
    "--roundabouts.guess=false",
)

# The comment with the date and netconvert's settings.
_COMMENT = re.compile(r"<!-- generated on .*?-->\s*", re.DOTALL)

_ARC = np.linspace(0, math.pi / 2, 9)
_HALF = _ARC.size // 2


class PlainXml(NamedTuple):
    """A network in SUMO's plain XML, one text for each file.

    x is east and y north of the grid's south-west corner, in metres.
    """

    nodes: str  # each named ROW_COLUMN after its tile
    edges: str  # each named ROW_COLUMN_SIDE after its first tile and the side by which it leaves that tile
    connections: str  # from each edge to those that start at its end; back along the same road only at dead ends


def plain_xml(codes: AnyArray, streets: Streets = Streets()) -> PlainXml:
    """Returns a grid, integer codes ``[H, W]``, or a `RoadMap` as plain XML; the same map gives the same texts.

    Connections that no neighbour returns, or that leave the grid, are no roads. A crossing with lights or stop signs on
    the map has these, and no other right of way.

    Raises:
      InputError: for a bad grid (see `check_grid`), one without any road, or bad measures.
    """
    rules, grid = rights_of_way(codes, streets), check_grid(codes)
    roads = _roads(grid)
    if not roads:
        raise no_road()
    exits: dict[Cell, list[Cell]] = {}
    for road in roads:
        exits.setdefault(road[0], []).append(road[1])
    lines = [streets.tile * _line(road, exits, len(grid)) for road in roads]
    places = {road[0]: line[0] for road, line in zip(roads, lines, strict=True)}
    onward = [
        f'from="{_edge_id(road[0], road[1])}" to="{_edge_id(road[-1], after)}" fromLane="0" toLane="0"'
        for road in roads
        for after in [tile for tile in exits[road[-1]] if tile != road[-2]] or [road[-2]]
    ]
    return PlainXml(
        _xml("node", (_node(node, place, rules.get(node, "priority"), streets) for node, place in places.items())),
        _xml("edge", (_edge(road, line, streets) for road, line in zip(roads, lines, strict=True))),
        _xml("connection", onward),
    )


def write_sumo(prefix: str | Path, codes: AnyArray, streets: Streets = Streets()) -> tuple[Path, Path, Path]:
    """Writes a grid as ``PREFIX.nod.xml``, ``PREFIX.edg.xml`` and ``PREFIX.con.xml``, and returns their paths.

    Missing folders are made. Existing files are replaced when all three are written.

    Raises:
      InputError: as `plain_xml`, or if the files cannot be written.
    """
    prefix, texts = check_named("prefix", path, prefix), plain_xml(codes, streets)
    nodes, edges, connections = files = [Path(f"{prefix}.{kind}.xml") for kind in ("nod", "edg", "con")]
    try:
        nodes.parent.mkdir(parents=True, exist_ok=True)
        # Nodes of one network do not fit the edges of another, so no file is replaced before all are written.
        with tempfile.TemporaryDirectory(dir=nodes.parent, prefix=f".{nodes.name}-") as folder:
            for file, text in zip(files, texts, strict=True):
                write_atomic(Path(folder, file.name), text.encode())
            for file in files:
                Path(folder, file.name).replace(file)
    except OSError as error:
        error.filename = None  # that of the hidden folder
        raise unwritable_error(nodes, error) from None
    return nodes, edges, connections


def network(codes: AnyArray, streets: Streets = Streets()) -> tuple[str, tuple[str, ...]]:
    """Makes a network of a map, see `plain_xml`, by SUMO's `netconvert`.

    Returns:
      The text of a file ``.net.xml`` without the date, and netconvert's warnings. The same map and version of SUMO give
      the same text.

    Raises:
      InputError: as `plain_xml`; if eclipse-sumo is not installed, or netconvert fails.
    """
    sumo = import_optional("sumo", "netconvert is SUMO's", "eclipse-sumo")
    program = Path(sumo.SUMO_HOME, "bin", "netconvert")
    with tempfile.TemporaryDirectory() as folder:
        nodes, edges, connections = (file.name for file in write_sumo(Path(folder, "city"), codes, streets))
        command = [str(program), "-n", nodes, "-e", edges, "-x", connections, "-o", "converted", *_OPTIONS]
        env = {**os.environ, "SUMO_HOME": sumo.SUMO_HOME}
        try:
            run = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
        except OSError as error:
            raise InputError(f"{program}: expected a program, got: {reason(error)}") from None
        said = run.stderr.splitlines()
        if run.returncode:
            why = "; ".join(line for line in said if line.startswith("Error")) or f"exit code {run.returncode}"
            raise InputError(f"netconvert: expected a network of the map, got: {why}")
        text = Path(folder, "converted").read_text(encoding="utf-8")
    return _COMMENT.sub("", text), tuple(line for line in said if line.startswith("Warning"))


def convert(file: str | Path, codes: AnyArray, streets: Streets = Streets()) -> tuple[str, ...]:
    """Writes the `network` of a grid to a file, and returns netconvert's warnings.

    Args:
      file: such as ``city.net.xml``; missing folders are made. An existing file is replaced, and kept after an error.
      codes: integer codes ``[H, W]``, or a `RoadMap`.
      streets: their measures.

    Raises:
      InputError: as `network`, or if the file cannot be written.
    """
    target, (text, warnings) = check_named("file", path, file), network(codes, streets)
    try:
        write_atomic(target, text.encode())
    except OSError as error:
        raise unwritable_error(file, error) from None
    return warnings


def _roads(grid: AnyArray) -> list[list[Cell]]:
    """Lists the tiles from node to node, of each road in each direction."""
    links = linked_tiles(grid)
    roads = []
    for tiles in walk_roads(links, {tile for tile in links if CONNECTIONS[grid[tile]] >= 3 or len(links[tile]) < 2}):
        middle = len(tiles) // 2
        for part in (tiles[: middle + 1], tiles[middle:]) if tiles[0] == tiles[-1] else (tiles,):
            roads += [part, part[::-1]]
    return sorted(roads)


def _line(road: list[Cell], exits: dict[Cell, list[Cell]], height: int) -> NDArray[np.complex128]:
    """Returns the middle of a road from node to node, east + north·i in tiles, without points on straight lines.

    Each tile is crossed from border to border. For a and b, the vectors from its centre to both borders,
    a·(1 - sin t) + b·(1 - cos t) is the quarter circle of a turn, and on a straight, where b = -a, the line.
    """
    beyond = [_beyond(road[0], road[1], exits), *road, _beyond(road[-1], road[-2], exits)]
    centres = np.array([column + 0.5 + (height - row - 0.5) * 1j for row, column in beyond])
    half_steps = np.diff(centres)[:, None] / 2
    across = centres[1:-1, None] - half_steps[:-1] * (1 - np.sin(_ARC)) + half_steps[1:] * (1 - np.cos(_ARC))
    line = across.ravel()[_HALF:-_HALF]  # nodes are in the middle of their tiles
    line = line[np.append(True, abs(np.diff(line)) > 1e-9)]
    steps = np.diff(line)
    return line[[True, *(abs((steps[1:] * steps[:-1].conj()).imag) > 1e-9), True]]


def _beyond(node: Cell, neighbour: Cell, exits: dict[Cell, list[Cell]]) -> Cell:
    """Returns the tile behind a node, for a road to a neighbour: on the only other road, otherwise straight behind."""
    if len(exits[node]) == 2:
        return next(other for other in exits[node] if other != neighbour)
    return 2 * node[0] - neighbour[0], 2 * node[1] - neighbour[1]


def _node(node: Cell, place: complex, kind: str, streets: Streets) -> str:
    # SUMO's own 4 m for lanes of 3.2 m if there is room, but not up to the tile's border, so that there is an edge
    # between adjacent crossings.
    radius = min(1.25 * streets.lane, 0.9 * (streets.tile / 2 - streets.lane))
    return f'id="{_id(node)}" x="{place.real:.4f}" y="{place.imag:.4f}" type="{kind}" radius="{radius:.4f}"'


def _edge(road: list[Cell], line: Iterable[complex], streets: Streets) -> str:
    shape = " ".join(f"{point.real:.4f},{point.imag:.4f}" for point in line)
    return (
        f'id="{_edge_id(road[0], road[1])}" from="{_id(road[0])}" to="{_id(road[-1])}" numLanes="1" '
        f'speed="{streets.speed:g}" width="{streets.lane:g}" spreadType="right" shape="{shape}"'
    )


def _id(node: Cell) -> str:
    return f"{node[0]}_{node[1]}"


def _edge_id(node: Cell, neighbour: Cell) -> str:
    return f"{_id(node)}_{SIDE_TOWARDS[neighbour[0] - node[0], neighbour[1] - node[1]].name}"


def _xml(name: str, elements: Iterable[str]) -> str:
    lines = "".join(f"    <{name} {attributes}/>\n" for attributes in elements)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<{name}s>\n{lines}</{name}s>\n'
