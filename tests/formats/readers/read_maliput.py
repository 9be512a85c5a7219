"""maliput-malidrive reads OpenDRIVE by its strict rules, and checks the invariants of its own model."""

import os
from pathlib import Path

import counted
import maliput_malidrive
from maliput import api, plugin

os.environ["MALIPUT_PLUGIN_PATH"] = str(Path(maliput_malidrive.__file__).parent)


def read(file):
    settings = {"road_geometry_id": "map", "opendrive_file": str(Path(file).resolve()), "linear_tolerance": "0.05"}
    settings |= {"angular_tolerance": "0.01", "standard_strictness_policy": "strict"}
    # The network has to live as long as its geometry.
    network = plugin.create_road_network("maliput_malidrive", settings)
    geometry = network.road_geometry()
    broken = geometry.CheckInvariants()
    assert not broken, broken
    lanes = geometry.ById().GetLanes().values()
    ends = 0
    for lane in lanes:
        for which in (api.kStart, api.kFinish):
            branches = lane.GetOngoingBranches(which)
            ends += branches.size() if branches else 0
    # Each link is counted at both of its lanes.
    return {"lanes": len(lanes), "links": ends / 2}


counted.main(read)
