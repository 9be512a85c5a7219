"""Road networks for SUMO, the traffic simulator: its plain XML, and what its `netconvert` makes of that.

Roads are those of `reduced_graph`, with a lane in each direction; traffic keeps right. They run along the middle of
straights and the arcs of turns. SUMO knows no edge from a node to itself: a road back to where it began is cut in two,
and so is a ring.
"""

import math
import os
import re
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.checks import check_grid, is_real
from elitelanes_jax.codes import SIDES
from elitelanes_jax.errors import InputError, reason, short
from elitelanes_jax.exports.graph import Tile, reduced_graph
from elitelanes_jax.extras import optional
from elitelanes_jax.folders import unwritable, write_whole

__all__ = ["Network", "PlainXml", "Streets", "convert", "network", "plain_xml", "write_sumo"]

_RIGHTS_OF_WAY = ("allway_stop", "priority", "right_before_left", "traffic_light")
_OUTPUTS = {"net": "--output-file", "opendrive": "--opendrive-output"}
_OPTIONS = (
    "--offset.disable-normalization=true",  # the network lies where the grid does
    "--precision=4",  # for streets as small as Duckietown's
    "--geometry.min-radius=0",  # no warnings of turns that are as sharp as their tiles
    "--roundabouts.guess=false",
)

# When it was made, in a comment with netconvert's settings and in OpenDRIVE's header.
_TIMES = re.compile(r'<!-- generated on .*?-->\s*| date="[^"]*"', re.DOTALL)

_SIDE_NAMES = {(side.down, side.right): side.name for side in SIDES}
_ARC = np.linspace(0, math.pi / 2, 9)
_HALF = _ARC.size // 2


class Streets(NamedTuple):
    """How tiles become streets.

    By default they are for SUMO's own cars, 5 m long: between crossings side by side there is room for two of them. On
    shorter streets, cars that wait block the crossings behind them. ``Streets(tile=8.43)`` is in the proportions of
    Duckietown, 58.5 cm a tile and 22.2 cm from the middle of the road to its white line; a Duckiebot has 2.6 m there.

    Attributes:
      tile: side of a tile in metres, 0.01 to 1000, and more than two lanes.
      lane: width of a lane in metres, 0.001 to 500.
      speed: limit in metres a second, 0.001 to 100.
      right_of_way: at crossings: "allway_stop", as stop lines on all sides ask for, "priority", "right_before_left" or
        "traffic_light".
    """

    tile: float = 30.0
    lane: float = 3.2
    speed: float = 8.33
    right_of_way: str = "allway_stop"


class PlainXml(NamedTuple):
    """A network in SUMO's plain XML, a text a file.

    Attributes:
      nodes: each ``ROW_COLUMN``, after its tile; places in metres, x to the east and y to the north, from the grid's
        south-west corner.
      edges: each ``ROW_COLUMN_SIDE``, after the tile where it starts and the side by which it leaves that.
      connections: from each edge to those that start where it ends, but for the way back; that is there at dead ends.
    """

    nodes: str
    edges: str
    connections: str


class Network(NamedTuple):
    """A network as netconvert wrote it.

    Attributes:
      text: of a file of SUMO or OpenDRIVE, without the date.
      warnings: of netconvert, a line each.
    """

    text: str
    warnings: tuple[str, ...]


def plain_xml(codes: Any, streets: Streets = Streets()) -> PlainXml:  # noqa: B008
    """A grid as plain XML.

    Args:
      codes: integer codes ``[H, W]``. A connection that no neighbour answers is no road, nor one that leaves the grid.
      streets: their measures.

    Returns:
      A `PlainXml`; the same grid gives the same texts.

    Raises:
      InputError: for a bad grid (see `check_grid`), one without any road, measures out of their ranges, or where
        NetworkX is not installed.
    """
    streets = _checked(streets)
    roads = _roads(codes)
    if not roads:
        raise InputError("grid: expected a road, two tiles that connect to each other, got none")
    exits: dict[Tile, list[Tile]] = {}
    for road in roads:
        exits.setdefault(road[0], []).append(road[1])
    height = len(check_grid(codes))
    lines = [streets.tile * _line(road, exits, height) for road in roads]
    places = {road[0]: line[0] for road, line in zip(roads, lines, strict=True)}
    return PlainXml(
        _xml("nodes", (_node(node, place, len(exits[node]), streets) for node, place in places.items())),
        _xml("edges", (_edge(road, line, streets) for road, line in zip(roads, lines, strict=True))),
        _xml("connections", (_connection(road, after) for road in roads for after in _ways_on(road, exits))),
    )


def write_sumo(prefix: str | Path, codes: Any, streets: Streets = Streets()) -> tuple[Path, Path, Path]:  # noqa: B008
    """Writes a grid as ``PREFIX.nod.xml``, ``PREFIX.edg.xml`` and ``PREFIX.con.xml``, and returns their paths.

    Folders above them are made. Files that are there are replaced when all three are written.

    Raises:
      InputError: as `plain_xml`, or if the files cannot be written.
    """
    texts = plain_xml(codes, streets)
    nodes, edges, connections = files = tuple(Path(f"{prefix}.{kind}.xml") for kind in ("nod", "edg", "con"))
    try:
        nodes.parent.mkdir(parents=True, exist_ok=True)
        # Nodes of one network and edges of another would be a third: none is replaced before all are written.
        with tempfile.TemporaryDirectory(dir=nodes.parent, prefix=f".{nodes.name}-") as folder:
            for file, text in zip(files, texts, strict=True):
                write_whole(Path(folder, file.name), text.encode())
            for file in files:
                Path(folder, file.name).replace(file)
    except OSError as error:
        raise unwritable(nodes, OSError(error.errno, error.strerror)) from None  # not of the hidden folder
    return nodes, edges, connections


def network(codes: Any, to: str = "net", streets: Streets = Streets()) -> Network:  # noqa: B008
    """What SUMO's `netconvert` makes of a grid.

    Args:
      codes: integer codes ``[H, W]``, see `plain_xml`.
      to: "net", a network of SUMO, or "opendrive".
      streets: their measures.

    Returns:
      A `Network`; the same grid and version of SUMO give the same text.

    Raises:
      InputError: as `plain_xml`; if eclipse-sumo is not installed, or netconvert fails.
    """
    if to not in _OUTPUTS:
        raise InputError(f"to: expected one of {', '.join(_OUTPUTS)}, got {to!r}")
    sumo = optional("sumo", "netconvert is SUMO's", "eclipse-sumo")
    program = Path(sumo.SUMO_HOME, "bin", "netconvert")
    with tempfile.TemporaryDirectory() as folder:
        nodes, edges, connections = (file.name for file in write_sumo(Path(folder, "city"), codes, streets))
        try:
            run = subprocess.run(
                [program, "-n", nodes, "-e", edges, "-x", connections, _OUTPUTS[to], "converted", *_OPTIONS],
                cwd=folder,
                env={**os.environ, "SUMO_HOME": sumo.SUMO_HOME},
                capture_output=True,
                text=True,
            )
        except OSError as error:
            raise InputError(f"{program}: expected a program, got: {reason(error)}") from None
        said = run.stderr.splitlines()
        if run.returncode:
            why = "; ".join(line for line in said if line.startswith("Error")) or f"exit code {run.returncode}"
            raise InputError(f"netconvert: expected a network of the map, got: {why}")
        text = Path(folder, "converted").read_text(encoding="utf-8")
    return Network(_TIMES.sub("", text), tuple(line for line in said if line.startswith("Warning")))


def convert(file: str | Path, codes: Any, to: str = "net", streets: Streets = Streets()) -> tuple[str, ...]:  # noqa: B008
    """Writes the `network` of a grid to a file, and returns netconvert's warnings.

    Args:
      file: such as ``city.net.xml`` or ``city.xodr``; folders above it are made. It is replaced if it is there, and
        left as it was after an error.
      codes: integer codes ``[H, W]``.
      to: "net" or "opendrive".
      streets: their measures.

    Raises:
      InputError: as `network`, or if the file cannot be written.
    """
    text, warnings = network(codes, to, streets)
    try:
        write_whole(Path(file), text.encode())
    except OSError as error:
        raise unwritable(file, error) from None
    return warnings


def _checked(streets: Streets) -> Streets:
    """The same measures, as floats."""
    for name, least, most in (("tile", 0.01, 1000), ("lane", 0.001, 500), ("speed", 0.001, 100)):
        value = getattr(streets, name)
        if not is_real(value) or not least <= value <= most:
            raise InputError(f"streets: expected {name} to be a number, {least} to {most}, got {short(repr(value))}")
    if streets.tile <= 2 * streets.lane:
        raise InputError(f"streets: expected tile to be over two lanes, {2 * streets.lane:g} m, got {streets.tile:g} m")
    if streets.right_of_way not in _RIGHTS_OF_WAY:
        expected, got = ", ".join(_RIGHTS_OF_WAY), short(repr(streets.right_of_way))
        raise InputError(f"streets: expected right_of_way to be one of {expected}, got {got}")
    return Streets(float(streets.tile), float(streets.lane), float(streets.speed), streets.right_of_way)


def _roads(codes: Any) -> list[list[Tile]]:
    """The tiles from node to node, of each road in each direction."""
    roads = []
    for start, end, path in reduced_graph(codes).edges(data="path"):
        middle = len(path) // 2
        for part in (path[: middle + 1], path[middle:]) if start == end else (path,):
            roads += [part, part[::-1]]
    return sorted(roads)


def _line(road: list[Tile], exits: dict[Tile, list[Tile]], height: int) -> NDArray[np.complex128]:
    """The middle of a road from node to node, east + north·i in tiles; no point where it is straight.

    Each tile is crossed from border to border: with a towards the one and b towards the other, both from its centre,
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


def _beyond(node: Tile, neighbour: Tile, exits: dict[Tile, list[Tile]]) -> Tile:
    """The tile behind a node, for a road that goes to a neighbour: on the one other road, or else straight behind."""
    if len(exits[node]) == 2:
        return next(other for other in exits[node] if other != neighbour)
    return 2 * node[0] - neighbour[0], 2 * node[1] - neighbour[1]


def _ways_on(road: list[Tile], exits: dict[Tile, list[Tile]]) -> list[Tile]:
    return [tile for tile in exits[road[-1]] if tile != road[-2]] or [road[-2]]


def _node(node: Tile, place: complex, degree: int, streets: Streets) -> str:
    # SUMO's own 4 m for lanes of 3.2 m where there is room; never as far as the tile's border, so that crossings side
    # by side have an edge between them.
    radius = min(1.25 * streets.lane, 0.9 * (streets.tile / 2 - streets.lane))
    kind = streets.right_of_way if degree > 2 else "priority"
    point = f'x="{place.real:.4f}" y="{place.imag:.4f}"'
    return f'<node id="{_id(node)}" {point} type="{kind}" radius="{radius:.4f}"/>'


def _edge(road: list[Tile], line: Iterable[complex], streets: Streets) -> str:
    shape = " ".join(f"{point.real:.4f},{point.imag:.4f}" for point in line)
    return (
        f'<edge id="{_edge_id(road[0], road[1])}" from="{_id(road[0])}" to="{_id(road[-1])}" numLanes="1" '
        f'speed="{streets.speed:g}" width="{streets.lane:g}" spreadType="right" shape="{shape}"/>'
    )


def _connection(road: list[Tile], after: Tile) -> str:
    start, end = _edge_id(road[0], road[1]), _edge_id(road[-1], after)
    return f'<connection from="{start}" to="{end}" fromLane="0" toLane="0"/>'


def _id(node: Tile) -> str:
    return f"{node[0]}_{node[1]}"


def _edge_id(node: Tile, neighbour: Tile) -> str:
    return f"{_id(node)}_{_SIDE_NAMES[neighbour[0] - node[0], neighbour[1] - node[1]]}"


def _xml(name: str, elements: Iterable[str]) -> str:
    lines = "".join(f"    {element}\n" for element in elements)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<{name}>\n{lines}</{name}>\n'
