"""py123d reads OpenDRIVE, from which it makes the maps of PufferDrive and GPUDrive."""

from pathlib import Path

import counted
from py123d.parser.opendrive.opendrive_map_parser import OpenDriveMapParser

warned = counted.Warned()


def read(file):
    warned.messages.clear()
    things = {}
    for thing in OpenDriveMapParser(Path(file)).iter_map_objects():
        things.setdefault(type(thing).__name__, []).append(thing)
    zones = [str(zone.stop_zone_type) for zone in things.get("StopZone", ())]
    return {
        "lanes": len(things["Lane"]),
        "links": sum(len(lane.successor_ids) for lane in things["Lane"]),
        "stops": zones.count("StopZoneType.STOP_SIGN"),
        "lights": zones.count("StopZoneType.TRAFFIC_LIGHT"),
        "warnings": warned.messages[:5],
    }


counted.main(read)
