"""Scenic reads OpenDRIVE as the network of its driving domain."""

import warnings

import counted
from scenic.domains.driving.roads import Network


def read(file):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        network = Network.fromFile(file, useCache=False, writeCache=False)
    # A manoeuvre leads from a lane to a connecting lane, and from there to another.
    turns = sum(len(crossing.maneuvers) for crossing in network.intersections)
    of_file = [str(one.message) for one in found if "Open" in one.category.__name__]
    return {"lanes": len(network.lanes), "links": 2 * turns, "warnings": of_file}


counted.main(read)
