"""commonroad-io reads scenarios."""

import contextlib
import io

import counted
from commonroad.common.file_reader import CommonRoadFileReader


def read(file):
    # It prints a line for each turn, whose names are those of its own schema.
    with contextlib.redirect_stdout(io.StringIO()):
        network = CommonRoadFileReader(file).open()[0].lanelet_network
    assert all(one.polygon.shapely_object.is_valid for one in network.lanelets), "an outline crosses itself"
    signs = [str(one.traffic_sign_elements[0].traffic_sign_element_id.value) for one in network.traffic_signs]
    return {
        "lanelets": len(network.lanelets),
        "follow": sum(len(one.successor) for one in network.lanelets),
        "stops": signs.count("206"),
        "lights": len(network.traffic_lights),
    }


counted.main(read)
