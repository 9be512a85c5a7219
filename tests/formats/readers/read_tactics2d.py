"""tactics2d reads OpenDRIVE."""

import counted
from tactics2d.map.parser import XODRParser

warned = counted.Warned()


def read(file):
    warned.messages.clear()
    made = XODRParser().parse(file)
    assert all(lane.speed_limit for lane in made.lanes.values()), "lanes without a speed"
    links = 2 * sum(len(one.connections) for one in made.junctions.values())
    return {"lanes": len(made.lanes), "links": links, "warnings": warned.messages[:5]}


counted.main(read)
