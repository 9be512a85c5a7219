"""MetaDrive reads scenarios of ScenarioNet, and checks them by its own rules."""

import counted
from metadrive.scenario import ScenarioDescription
from metadrive.scenario.utils import read_scenario_data


def read(file):
    scenario = read_scenario_data(file)
    ScenarioDescription.sanity_check(scenario.to_dict(), check_self_type=True, valid_check=True)
    features = scenario["map_features"].values()
    lanes = [one for one in features if ScenarioDescription.EXIT in one]
    return {
        "lanelets": len(lanes),
        "follow": sum(len(one[ScenarioDescription.EXIT]) for one in lanes),
        "stops": sum(one["type"] == "STOP_SIGN" for one in features),
    }


counted.main(read)
