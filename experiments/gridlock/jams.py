"""Cars on a town in SUMO, and whether they jam.

Cars drive from place to place by ways over fewest streets. A run is jammed if all its cars stand still for its last
three minutes: no car is ever moved on by force. SUMO keeps crossings clear by default.
"""

import os
import random
import subprocess
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.maps import FormatOptions, export
from experiments.common import require

__all__ = [
    *("SETTINGS", "Car", "Network", "Run", "Setting", "Ways", "draw_route", "drive", "full_loop", "least_loop"),
    *("make_network", "stand"),
]

LANE = 3.2
"""Width of a lane in metres."""

END, PERIOD, JAM_PERIODS = 900, 30, 6
"""Seconds of a run, seconds between two looks at it, and the last looks at which all cars of a jam stand still."""

STREETS_OF_A_ROUTE = 300
"""The least number of streets on a car's route. No car drives as many in a run."""


class Setting(NamedTuple):
    """A kind of crossing, a size of tiles, and how many cars there are.

    Attributes:
      right_of_way: that of all crossings.
      tile_size: side of a tile in metres.
      cars_per_link: cars for each link between two tiles. A link has a lane in each direction.
    """

    right_of_way: str
    tile_size: float
    cars_per_link: float


SETTINGS = {
    "allway_stop": Setting("allway_stop", 16.0, 1.2),
    "right_before_left": Setting("right_before_left", 20.0, 1.4),
}
"""The settings of the study."""


class Ways(NamedTuple):
    """The ways over fewest streets from one street.

    Attributes:
      before: the last streets before each street that can be reached, on these ways.
      number: the number of ways to each of these streets.
    """

    before: dict[str, list[str]]
    number: dict[str, int]


class Network(NamedTuple):
    """A town in SUMO.

    Attributes:
      folder: where its files are.
      length: metres of each street, a lane from crossing to crossing, by its name.
      onward: the streets that follow each street.
      ways: the ways from each street.
    """

    folder: Path
    length: dict[str, float]
    onward: dict[str, list[str]]
    ways: dict[str, Ways]

    @property
    def capacity(self) -> dict[str, int]:
        """The cars that find room on each street: 5 m each, and 2.5 m between two."""
        return {street: max(1, int((metres + 2.5) // 7.5)) for street, metres in self.length.items()}


class Run(NamedTuple):
    """What happened in a run.

    Attributes:
      jammed: whether all cars stood still at the end.
      since: the second since when they did; the end of the run if they did not.
      speed: mean speed in metres a second, of all looks after the first three.
      entered: the number of cars that found room.
    """

    jammed: bool
    since: float
    speed: float
    entered: int


class Car(NamedTuple):
    """A car: the street that it is on, and where its front is, in metres, x east and y north.

    On a crossing, `street` is SUMO's name of the lane there, which starts with a colon. `angle` is in degrees,
    clockwise from north.
    """

    street: str
    x: float
    y: float
    angle: float


def make_network(folder: Path, codes: NDArray[np.int8], setting: Setting) -> Network:
    """Makes the network of a town in a folder, by SUMO's netconvert."""
    options = FormatOptions(tile_size=setting.tile_size, lane=LANE, right_of_way=setting.right_of_way)
    for name, content in export(codes, "sumo", options, name="town").items():
        (folder / name).write_bytes(content)
    call("netconvert", folder, "-c", "town.netccfg")
    onward: dict[str, list[str]] = {}
    for pair in ET.parse(folder / "town.con.xml").getroot():
        onward.setdefault(pair.attrib["from"], []).append(pair.attrib["to"])
    length = {}
    for edge in ET.parse(folder / "town.net.xml").getroot().iter("edge"):
        lane = edge.find("lane")
        # Edges inside a crossing have no start.
        if lane is not None and "from" in edge.attrib:
            length[edge.attrib["id"]] = float(lane.attrib["length"])
    ways = {street: find_ways(onward, street) for street in onward}
    return Network(folder, length, onward, ways)


def call(program: str, folder: Path, *arguments: str) -> None:
    """Runs one of SUMO's programs in a folder."""
    require("this study needs", "eclipse-sumo")
    from sumo import SUMO_HOME

    command = [str(Path(SUMO_HOME, "bin", program)), *arguments]
    environment = {**os.environ, "SUMO_HOME": SUMO_HOME}
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)


def find_ways(onward: Mapping[str, Sequence[str]], start: str) -> Ways:
    """Finds the ways over fewest streets from one street to all others."""
    streets, before, count = {start: 0}, {start: list[str]()}, {start: 1}
    waiting = [start]
    for street in waiting:
        for following in onward[street]:
            if following not in streets:
                streets[following] = streets[street] + 1
                before[following], count[following] = [], 0
                waiting.append(following)
            if streets[following] == streets[street] + 1:
                before[following].append(street)
                count[following] += count[street]
    return Ways(before, count)


def draw_way(rng: random.Random, ways: Ways, start: str, goal: str) -> list[str]:
    """Draws one of the ways to a street, each with the same chance; returns its streets after the start."""
    way = [goal]
    while way[-1] != start:
        before = ways.before[way[-1]]
        way.append(rng.choices(before, [ways.number[street] for street in before])[0])
    return way[-2::-1]


def draw_route(rng: random.Random, network: Network, loop: Sequence[str] = ()) -> list[str]:
    """Draws a route: from street to street, each drawn by its length, or to a loop of streets and around it."""
    streets = sorted(network.onward)
    metres = [network.length[street] for street in streets]
    route = rng.choices(streets, metres)
    if loop:
        first = rng.choice(loop)
        route += draw_way(rng, network.ways[route[0]], route[0], first) if first != route[0] else []
        at = loop.index(first) + 1
        return route + [loop[(at + step) % len(loop)] for step in range(STREETS_OF_A_ROUTE)]
    while len(route) < STREETS_OF_A_ROUTE:
        goal, ways = rng.choices(streets, metres)[0], network.ways[route[-1]]
        if goal != route[-1] and goal in ways.number:
            route += draw_way(rng, ways, route[-1], goal)
    return route


def least_loop(network: Network) -> list[str]:
    """Returns the loop of streets that the fewest cars fill; of several, the first by their names."""
    capacity = network.capacity
    graph = nx.DiGraph()
    for street, following in network.onward.items():
        graph.add_weighted_edges_from((street, other, capacity[other]) for other in following)
    loops = []
    for start in graph:
        cars, ways = nx.single_source_dijkstra(graph, start)
        loops += [(cars[last] + capacity[start], ways[last]) for last in graph.predecessors(start) if last in cars]
    return min(loops)[1]


def full_loop(network: Network, cars: Sequence[Car]) -> list[str]:
    """Returns a loop of streets that are all full; none if there is none.

    A street is full if it has its capacity of cars. The shortest loop of streets comes first, then the first by names.
    """
    number = Counter(car.street for car in cars)
    full = {street for street, most in network.capacity.items() if number[street] >= most}
    graph = nx.DiGraph((street, other) for street in full for other in network.onward[street] if other in full)
    loops = []
    for start in graph:
        ways = nx.single_source_shortest_path(graph, start)
        loops += [ways[last] for last in graph.predecessors(start) if last in ways]
    return min(loops, key=lambda loop: (len(loop), loop), default=[])


def drive(network: Network, cars: int, seed: int, loop: Sequence[str] = ()) -> Run:
    """Lets cars drive for `END` seconds.

    One car starts each half second, where it finds room. With a `loop` all cars drive to it and around it.
    """
    simulate(network, cars, seed, loop, "--summary-output", "looks.xml", "--summary-output.period", str(PERIOD))
    looks = [look.attrib for look in ET.parse(network.folder / "looks.xml").getroot()]
    return outcome(looks)


def stand(network: Network, cars: int, seed: int) -> list[Car]:
    """Returns the cars of a run of `drive` at its end."""
    simulate(network, cars, seed, (), "--fcd-output", "cars.xml", "--device.fcd.begin", str(END - 1))
    *_, last = ET.parse(network.folder / "cars.xml").getroot()
    standing_cars = []
    for car in last:
        x, y, angle = (float(car.attrib[name]) for name in ("x", "y", "angle"))
        standing_cars.append(Car(car.attrib["lane"].rpartition("_")[0], x, y, angle))
    return standing_cars


def simulate(network: Network, cars: int, seed: int, loop: Sequence[str], *outputs: str) -> None:
    """Runs SUMO on a network."""
    rng = random.Random(seed)
    vehicles = []
    for car in range(cars):
        route = " ".join(draw_route(rng, network, loop))
        start = f'depart="{car / 2:.1f}" departPos="random_free" departSpeed="0"'
        vehicles.append(f'<vehicle id="{car}" {start}><route edges="{route}"/></vehicle>\n')
    (network.folder / "cars.rou.xml").write_text(f"<routes>\n{''.join(vehicles)}</routes>\n")
    # SUMO neither asks for schemas nor moves cars that wait for long.
    options = ["--xml-validation", "never", "--xml-validation.net", "never", "--xml-validation.routes", "never"]
    options += ["--no-step-log", "--no-warnings", "--time-to-teleport", "-1", "--seed", str(seed), "--end", str(END)]
    call("sumo", network.folder, "-n", "town.net.xml", "-r", "cars.rou.xml", *options, *outputs)


def outcome(looks: Sequence[Mapping[str, str]]) -> Run:
    """Reads SUMO's summary of a run."""
    still = [0 < int(look["running"]) == int(look["halting"]) for look in looks]
    moving = [index for index, stand in enumerate(still) if not stand]
    first_still = moving[-1] + 1 if moving else 0
    jammed = len(looks) - first_still >= JAM_PERIODS
    since = float(looks[first_still]["time"]) if jammed else float(END)
    # SUMO's mean speed is -1 without cars.
    speeds = [max(float(look["meanSpeed"]), 0.0) for look in looks[3:]]
    return Run(jammed, since, float(np.mean(speeds)), int(looks[-1]["inserted"]))
