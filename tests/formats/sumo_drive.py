"""Networks of maps, and vehicles that drive through them in SUMO."""

import os
import random
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import networkx as nx
import pytest

from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.sumo import to_sumo
from elitelanes_jax.maps.exporting import FORMATS


def points(text):
    return [complex(*map(float, point.split(","))) for point in text.split()]


def elements(text):
    return [element.attrib for element in ET.fromstring(text) if element.tag != "location"]


def read(plain):
    """Nodes as places, edges as attributes with their shapes as points, connections as pairs."""
    nodes = {node["id"]: complex(float(node["x"]), float(node["y"])) for node in elements(plain.nodes)}
    edges = {edge["id"]: edge | {"shape": points(edge["shape"])} for edge in elements(plain.edges)}
    return nodes, edges, [(pair["from"], pair["to"]) for pair in elements(plain.connections)]


def run(program, *arguments):
    """What one of SUMO's programs says on standard error."""
    home = pytest.importorskip("sumo", reason="SUMO is not here: make sumo").SUMO_HOME
    command = [Path(home, "bin", program), *map(str, arguments)]
    done = subprocess.run(command, env={**os.environ, "SUMO_HOME": home}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stderr


def convert(net, codes, **streets):
    """Makes a network by netconvert; returns its warnings."""
    name = net.name.removesuffix(".net.xml")
    for suffix, text in zip(FORMATS["sumo"].suffixes, to_sumo(as_map(codes), name, **streets), strict=True):
        net.with_name(name + suffix).write_text(text, encoding="utf-8")
    said = run("netconvert", "-c", net.with_name(f"{name}.netccfg"))
    return [line for line in said.splitlines() if line.startswith("Warning")]


def drive(net, connections, folder, seed, vehicles=20, kind="", crossings=True):
    """Lets vehicles drive, from each edge in turn to random ones; returns how many arrive, and what SUMO complains of.

    None may collide, or be moved on by force. Collisions at crossings are looked for too, or not.
    """
    onward, rng = nx.DiGraph(connections), random.Random(seed)
    edges, trips = sorted(onward), []
    for number in range(vehicles):
        start = edges[number % len(edges)]
        end = rng.choice(sorted(nx.descendants(onward, start)))
        trips.append(f'<trip id="{number}" depart="{number}" from="{start}" to="{end}"/>')
    trips_file, routes, arrived, statistics = (
        folder / name for name in ("trips.xml", "routes.xml", "trips.out", "statistics.xml")
    )
    trips_file.write_text(f"<routes>{kind}{''.join(trips)}</routes>")
    said = run("duarouter", "-n", net, "-r", trips_file, "-o", routes)
    outputs = ("--tripinfo-output", arrived, "--statistic-output", statistics)
    said += run("sumo", "-n", net, "-r", routes, *outputs, "--collision.check-junctions", crossings, "--end", 3600)
    counted = {element.tag: element.attrib for element in ET.parse(statistics).getroot()}
    assert counted["vehicles"] == {"loaded": str(vehicles), "inserted": str(vehicles), "running": "0", "waiting": "0"}
    assert set(counted["teleports"].values()) == set(counted["safety"].values()) == {"0"}, counted
    return len(ET.parse(arrived).findall("tripinfo")), said
