"""Loads networks in MetaDrive without a display, and lets its IDM policy drive along their lanes.

Arguments: how many of the first networks cars drive in, and the networks' names. Each has a ``.net.xml`` of SUMO and
an ``.xodr`` of OpenDRIVE. Prints a line of JSON for each network.
"""

import json
import logging
import random
import sys
from pathlib import Path

import numpy as np
from metadrive.component.lane.point_lane import PointLane
from metadrive.component.vehicle.vehicle_type import SVehicle
from metadrive.engine.base_engine import BaseEngine
from metadrive.envs import BaseEnv
from metadrive.manager.base_manager import BaseManager
from metadrive.manager.sumo_map_manager import SumoMapManager
from metadrive.obs.observation_base import DummyObservation
from metadrive.policy.idm_policy import TrajectoryIDMPolicy
from metadrive.utils.opendrive.map_load import load_opendrive_map

# Pictures and models, 500 MB from GitHub, are for displays alone.
BaseEngine.try_pull_asset = staticmethod(lambda: None)
TrajectoryIDMPolicy.NORMAL_SPEED = 20  # km/h

CARS, METRES = 2, 100


class Driver(BaseManager):
    """A car that follows a random route of the map."""

    number = 0

    def reset(self):
        lanes = self.engine.map_manager.graph.lanes
        rng = random.Random(self.number)
        lane = lanes[rng.choice(sorted(name for name in lanes if not name.startswith(":")))]
        route = [lane]
        while length(route) < METRES or lane.name.startswith(":"):
            lane = rng.choice(sorted(lane.outgoing, key=lambda other: other.name))
            route.append(lane)
        self.points = resample(shape(route))
        self.index = 3  # half of a car from the start of the road
        self.aside = 0.0
        ahead = self.points[4] - self.points[3]
        self.car = self.spawn_object(
            SVehicle, vehicle_config={}, position=self.points[3], heading=float(np.arctan2(ahead[1], ahead[0]))
        )
        whole = PointLane(self.points, 3.2)
        # The policy passes its goal up to 3 m aside, so arrival is the route's last 4 m, not the policy's own 2 m.
        self.policy = self.add_policy(
            self.car.id, TrajectoryIDMPolicy, control_object=self.car, random_seed=0, traj_to_follow=whole
        )

    def before_step(self):
        near = self.points[self.index : self.index + 10] - self.car.position
        distances = np.linalg.norm(near, axis=1)
        self.aside = max(self.aside, distances.min())
        self.index += int(distances.argmin())
        # MetaDrive does not find a car on a route that leads back, so the policy has the next metres alone.
        first = min(max(self.index - 3, 0), len(self.points) - 4)
        self.policy.routing_target_lane = PointLane(self.points[first : self.index + 16], 3.2)
        self.car.before_step(self.policy.act(do_speed_control=True))

    @property
    def has_arrived(self):
        return self.index > len(self.points) - 5


def resample(points):
    """Points along a line, a metre apart."""
    points = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-3)]
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    metres = np.arange(0, along[-1])
    return np.stack([np.interp(metres, along, points[:, axis]) for axis in (0, 1)], axis=1)


def shape(lanes):
    return np.concatenate([np.array(lane.sumolib_obj.getShape()) for lane in lanes])


def length(lanes):
    return np.linalg.norm(np.diff(shape(lanes), axis=0), axis=1).sum()


class Town(BaseEnv):
    net, has_driver = "", False

    def reward_function(self, agent):
        return 0, {}

    def cost_function(self, agent):
        return 0, {}

    def done_function(self, agent):
        return False, {}

    def get_single_observation(self):
        return DummyObservation()

    def setup_engine(self):
        super().setup_engine()
        self.engine.register_manager("map_manager", SumoMapManager(self.net))
        if self.has_driver:
            self.engine.register_manager("driver", Driver())


def read(name, has_driver):
    """Loads a network, steps, and drives; returns what it has and how far cars came."""
    Town.net, Town.has_driver = f"{name}.net.xml", has_driver
    # The environment's own car stands beside the map.
    config = {"use_render": False, "log_level": logging.CRITICAL, "horizon": 10**6}
    env = Town(config | {"vehicle_config": {"spawn_position_heading": [(-2000, -2000), 0.0]}})
    arrived, aside, tracks = 0, 0.0, []
    try:
        for number in range(CARS if has_driver else 1):
            Driver.number = number
            env.reset()
            driver = env.engine.managers.get("driver")
            tracks.append([])
            # A step is 0.1 s. A route has a point for each metre, and a car takes 0.2 s for one.
            for _ in range(4 * len(driver.points) if has_driver else 20):
                env.step([0, -1])
                if has_driver:
                    tracks[-1].append(driver.car.position.tolist())
                    if driver.has_arrived:
                        arrived += 1
                        break
            if has_driver:
                aside = max(aside, driver.aside)
        lanes = sorted(env.engine.map_manager.graph.lanes)
    finally:
        env.close()
    roads = load_opendrive_map(f"{name}.xodr").roads
    return {"lanes": lanes, "roads": len(roads), "arrived": arrived, "aside": aside, "tracks": tracks}


if __name__ == "__main__":
    driven = int(sys.argv[1])
    for index, file in enumerate(sys.argv[2:]):
        print(json.dumps({"name": Path(file).name} | read(file, index < driven)), flush=True)
