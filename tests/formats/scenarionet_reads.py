"""Drives through databases of ScenarioNet in MetaDrive's ScenarioEnv, without a display.

Arguments: the databases. All cars follow their logs. Prints a line of JSON for each scenario.
"""

import copy
import json
import logging
import sys
from pathlib import Path

import numpy as np
from metadrive.engine.base_engine import BaseEngine
from metadrive.envs.scenario_env import ScenarioEnv
from metadrive.policy.replay_policy import ReplayEgoCarPolicy
from metadrive.scenario import ScenarioDescription
from metadrive.scenario.utils import read_dataset_summary, read_scenario_data

# Pictures and models, 500 MB from GitHub, are for displays alone.
BaseEngine.try_pull_asset = staticmethod(lambda: None)


def check(file, summary):
    """Checks a scenario by MetaDrive's rules, and its summary against the one that MetaDrive makes."""
    scenario = read_scenario_data(file)
    ScenarioDescription.sanity_check(scenario.to_dict(), check_self_type=True, valid_check=True)
    made = copy.deepcopy(scenario)
    ScenarioDescription.update_summaries(made)
    metadata = scenario["metadata"]
    assert summary == metadata | {"ts": metadata["ts"].tolist()}
    expected, numbers = made["metadata"]["number_summary"], metadata["number_summary"]
    # Of a map without a line between lanes, MetaDrive says minus infinity.
    expected["map_height_diff"] = max(expected["map_height_diff"], 0.0)
    assert expected.keys() == numbers.keys()
    for key, value in numbers.items():
        assert (list(expected[key]) if isinstance(expected[key], set) else expected[key]) == value, key
    for number, car in made["metadata"]["object_summary"].items():
        distance = metadata["object_summary"][number].pop("moving_distance")
        assert abs(car.pop("moving_distance") - distance) < 1e-3
        assert car == metadata["object_summary"][number]


def drive(env, index):
    """Follows the logs to the end of a scenario; returns what MetaDrive has on the map and how cars came on."""
    env.reset(seed=index)
    scenario = env.engine.data_manager.current_scenario
    lanes = env.engine.map_manager.current_map.road_network.graph
    links = sorted((name, after) for name, lane in lanes.items() for after in lane.exit_lanes)
    back = sorted((before, name) for name, lane in lanes.items() for before in lane.entry_lanes)
    assert links == back
    traffic = env.engine.traffic_manager
    arrived, crashes, aside, cars = False, 0, 0.0, set()
    for step in range(1, scenario["length"]):
        info = env.step([0, 0])[4]
        arrived = arrived or info["arrive_dest"]
        crashes += info["crash"] or any(car.crash_vehicle for car in traffic.vehicles)
        for car in traffic.vehicles:
            number = traffic.obj_id_to_scenario_id[car.id]
            cars.add(number)
            place = scenario["tracks"][number]["state"]["position"][step][:2]
            aside = max(aside, float(np.abs(car.position - place).max()))
    assert cars == scenario["tracks"].keys()
    result = {"lanes": list(lanes), "links": links, "cars": len(cars), "steps": step}
    result |= {"arrived": arrived, "route": float(info["route_completion"])}
    return result | {"crashes": crashes, "aside": aside}


def read(folder):
    summaries, names, folders = read_dataset_summary(folder)
    config = {"data_directory": folder, "num_scenarios": len(names), "agent_policy": ReplayEgoCarPolicy}
    env = ScenarioEnv(config | {"use_render": False, "log_level": logging.CRITICAL, "store_map": False})
    try:
        for index, name in enumerate(names):
            check(Path(folder) / folders[name] / name, summaries[name])
            print(json.dumps({"name": name} | drive(env, index)), flush=True)
    finally:
        env.close()


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        read(folder)
