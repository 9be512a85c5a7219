"""pyopendrive reads OpenDRIVE into a typed model, with diagnostics."""

import counted
from pyopendrive import OpenDrive


def read(file):
    made = OpenDrive.load(file)
    lanes = 0
    for road in made.roads:
        for layer in road.lane_layers:
            for section in layer.sections:
                lanes += len(section.lanes.left or ()) + len(section.lanes.right or ())
    signals = [signal.type for road in made.roads for signal in road.signals]
    found = {one.message for one in made.diagnostics if one.code != "unsupported-element"}
    return {
        "lanes": lanes,
        "links": 2 * sum(len(one.connections) for one in made.junctions),
        "stops": signals.count("206"),
        "lights": signals.count("1000001"),
        "warnings": sorted(found),
    }


counted.main(read)
