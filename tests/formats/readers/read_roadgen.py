"""roadgen reads OpenDRIVE, and checks its own map of it."""

import counted
import roadgen

# What it says of each map: it has no place for trees, heights of origins and roofs.
USUAL = ("altitude", "no object of type", "flat roofs", "traffic lights name the lanes inside a junction")


def read(file):
    made = roadgen.read_opendrive(file)
    made.validate()
    assert not made.issues(), made.issues()[0]
    warnings = [one for one in made.read_warnings() if not any(word in one for word in USUAL)]
    return {"lanes": len(made.lane_ids()), "links": len(made.connections()), "warnings": warnings}


counted.main(read)
