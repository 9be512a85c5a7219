"""SUMO's netconvert makes a network of our plain files, or of OpenDRIVE, and its own library reads that."""

import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import counted
import sumo
import sumolib

NETCONVERT = Path(sumo.SUMO_HOME, "bin", "netconvert")


def read(file):
    is_plain = file.endswith(".netccfg")
    with tempfile.TemporaryDirectory() as folder:
        net = Path(folder, "made.net.xml")
        options = ["-c", file] if is_plain else ["--opendrive-files", file]
        done = subprocess.run([NETCONVERT, *options, "-o", net], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        made = sumolib.net.readNet(str(net))
    turns = sum(len(onward) for edge in made.getEdges() for onward in edge.getOutgoing().values())
    counts = {"turns": turns, "warnings": [line for line in done.stderr.splitlines() if line.startswith("Warning")]}
    if is_plain:
        arms = Counter()
        for node in made.getNodes():
            arms[node.getType()] += len(node.getIncoming())
        counts |= {"roads": len(made.getEdges()) / 2, "stops": arms["allway_stop"], "lights": arms["traffic_light"]}
    return counts


counted.main(read)
