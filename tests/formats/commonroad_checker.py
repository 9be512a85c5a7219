"""What CommonRoad reads from scenarios and plans in them: a line of JSON for each, in an environment of its own.

The first argument is the width of a lane, which the check of the road's boundary uses.
"""

import contextlib
import json
import logging
import os
import sys
from pathlib import Path

import commonroad
import numpy as np
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad_dc.boundary import boundary
from commonroad_dc.pycrcc import RectOBB
from commonroad_route_planner.route_planner import RoutePlanner
from lxml import etree

logging.disable(logging.CRITICAL)
(found,) = Path(commonroad.__path__[0]).rglob("XML_commonRoad_XSD.xsd")
schema = etree.XMLSchema(etree.parse(found))


def check(file, lane):
    errors = [] if schema.validate(etree.parse(file)) else [str(schema.error_log.last_error)]
    scenario, problems = CommonRoadFileReader(file).open()
    network = scenario.lanelet_network
    errors += [
        f"lanelet {one.lanelet_id}: polygon" for one in network.lanelets if not one.polygon.shapely_object.is_valid
    ]
    (problem,) = problems.planning_problem_dict.values()
    routes = RoutePlanner(lanelet_network=network, planning_problem=problem).plan_routes()
    # Half of a lane wide, a car fits in the middle of each lane and hits the road's edge beside it.
    _, edge = boundary.create_road_boundary_obstacle(scenario, method="obb_rectangles", width=lane / 50)
    inside, outside = 0, 0
    for one in network.lanelets:
        for start, end in zip(one.center_vertices[:-1], one.center_vertices[1:], strict=True):
            place, way = (start + end) / 2, end - start
            angle = float(np.arctan2(way[1], way[0]))
            car = RectOBB(lane / 10, lane / 4, angle, float(place[0]), float(place[1]))
            inside += 1
            outside += edge.collide(car)
    return {
        "errors": errors,
        "after": {one.lanelet_id: sorted(one.successor) for one in network.lanelets},
        "signs": sorted(
            str(one.traffic_sign_elements[0].traffic_sign_element_id.value) for one in network.traffic_signs
        ),
        "intersections": sorted(
            sorted(
                len(part.successors_right | part.successors_straight | part.successors_left) for part in one.incomings
            )
            for one in network.intersections
        ),
        "routes": [list(route.lanelet_ids) for route in routes],
        "cars": inside,
        "off_road": outside,
    }


for file in sys.argv[2:]:
    with Path(os.devnull).open("w") as nothing, contextlib.redirect_stdout(nothing):
        said = check(file, float(sys.argv[1]))
    print(json.dumps(said), flush=True)
