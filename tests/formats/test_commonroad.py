"""CommonRoad's scenarios: lanelets by the graph of tiles; then what CommonRoad reads and plans (make simulators)."""

import json
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from networks import numbered, points_of, refs
from oracle import road_graph
from simulator_maps import BATCHES, distances, lane_graph, maps, on_any_roads

from elitelanes_jax.formats.commonroad import to_commonroad
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.streets import Streets

OWN_ENVIRONMENT = Path(__file__).parents[2] / ".venv-commonroad" / "bin" / "python"


@on_any_roads
def test_lanelets_are_the_movements(grid):
    streets = Streets()
    root = ET.fromstring(to_commonroad(as_map(grid), streets))
    graph = lane_graph(grid)
    lanes = numbered(graph)
    numbers = {lane: number for number, lane in lanes.items()}
    lanelets = {int(one.get("id")): one for one in root.findall("lanelet")}
    ids = [int(one.get("id")) for one in root.iter() if one.get("id")]
    assert lanelets.keys() == lanes.keys() and len(set(ids)) == len(ids)
    sides = {number: (points_of(one[0]), points_of(one[1])) for number, one in lanelets.items()}
    for number, one in lanelets.items():
        lane = lanes[number]
        assert refs(one, "successor") == {numbers[other] for other in graph[lane]}
        assert refs(one, "predecessor") == {numbers[other] for other in graph.predecessors(lane)}
        centre = np.mean(sides[number], axis=0)
        assert distances(centre, lane, grid, streets).max() < streets.lane / 40 * (lane[2] == (lane[3] + 2) % 4) + 1e-5
        for other in refs(one, "successor"):
            assert all(a[-1] == b[0] for a, b in zip(sides[number], sides[other], strict=True))
        for other in refs(one, "adjacentLeft"):
            # At dead ends they are 5e-7 m apart. The designer of CommonRoad allows 1e-6 m.
            assert np.abs(np.array(sides[other][0]) - sides[number][0][::-1]).max() < 1e-6
    steps = nx.single_source_shortest_path_length(graph, lanes[1])
    goal = root.find("planningProblem/goalState/position/lanelet").get("ref")
    assert steps[lanes[int(goal)]] == max(steps.values())
    first, second = np.mean(sides[1], axis=0)[:2]
    orientation = float(root.find("planningProblem/initialState/orientation/exact").text)
    assert abs(np.exp(1j * orientation) - (second - first) / abs(second - first)) < 1e-4
    for number, one in lanelets.items():
        row, column, into, out = lanes[number]
        oncoming = {numbers[row, column, (out + 2) % 4, (into + 2) % 4]} if out != (into + 2) % 4 else set()
        assert refs(one, "adjacentLeft") == oncoming


@pytest.mark.slow
@pytest.mark.parametrize("batch", BATCHES)
def test_commonroad_reads_and_plans(batch, tmp_path):
    if not OWN_ENVIRONMENT.exists():
        pytest.skip("CommonRoad is not here: make simulators")
    streets, files = Streets(), []
    for number, road_map in enumerate(maps(batch)):
        files.append(tmp_path / f"{number}.xml")
        files[-1].write_text(to_commonroad(road_map, streets))
    program = Path(__file__).with_name("commonroad_checker.py")
    done = subprocess.run([OWN_ENVIRONMENT, program, str(streets.lane), *files], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    said = [json.loads(line) for line in done.stdout.splitlines()]
    for road_map, file, one in zip(maps(batch), files, said, strict=True):
        grid = road_map.codes
        graph = lane_graph(grid)
        lanes = numbered(graph)
        numbers = {lane: number for number, lane in lanes.items()}
        assert one["errors"] == [] and one["off_road"] == 0 and one["cars"] >= len(lanes)
        assert one["after"] == {
            str(number): sorted(numbers[other] for other in graph[lane]) for number, lane in lanes.items()
        }
        degrees = [degree for _, degree in road_graph(grid).degree() if degree > 2]
        assert one["intersections"] == sorted([degree - 1] * degree for degree in degrees)
        root = ET.parse(file)
        goal = int(root.find("planningProblem/goalState/position/lanelet").get("ref"))
        bounds = [(points_of(one[0]), points_of(one[1])) for one in root.iterfind("lanelet")]
        centres = [np.mean(both, axis=0) for both in bounds]
        metres = {lanes[number]: abs(np.diff(centre)).sum() for number, centre in enumerate(centres, 1)}
        graph.add_weighted_edges_from([(one, other, metres[one]) for one, other in graph.edges])
        best = nx.shortest_path_length(graph, lanes[1], lanes[goal], "weight")
        found = [[lanes[number] for number in route] for route in one["routes"]]
        assert all(nx.is_path(graph, route) for route in found)
        ours = [route for route in found if route[0] == lanes[1] and route[-1] == lanes[goal]]
        # Others start or end in lanelets that overlap these. The last lanelet does not count.
        assert min(sum(metres[lane] for lane in route[:-1]) for route in ours) == pytest.approx(best)
