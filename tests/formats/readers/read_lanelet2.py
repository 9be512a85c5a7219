"""Lanelet2, or the package that stands in for it, reads its maps and makes a graph of routes."""

import counted
import lanelet2

RULES = lanelet2.traffic_rules.create("de", "vehicle")


def read(file):
    earth = lanelet2.projection.UtmProjector(lanelet2.io.Origin(0, 9))
    made, errors = lanelet2.io.loadRobust(file, earth)
    graph = lanelet2.routing.RoutingGraph(made, RULES)
    lanelets = list(made.laneletLayer)
    lines = [line.attributes["type"] for line in made.lineStringLayer if "type" in line.attributes]
    lights = lines.count("traffic_light")
    return {
        "lanelets": len(lanelets),
        "follow": sum(len(graph.following(one)) for one in lanelets),
        # A light has a stop line too.
        "stops": lines.count("stop_line") - lights,
        "lights": lights,
        "warnings": [*map(str, errors), *map(str, graph.checkValidity())],
    }


counted.main(read)
