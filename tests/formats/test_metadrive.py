"""Networks in MetaDrive, which has an environment of its own: make metadrive."""

import json
import subprocess
from pathlib import Path

import pytest
from simulator_maps import draw, lane_graph
from sumo_drive import read

from elitelanes_jax.formats.opendrive import to_opendrive
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.scenarionet import index_scenarios, to_scenarionet
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.formats.sumo import to_sumo
from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.exporting import FORMATS

PROGRAMS = Path(__file__).parents[2] / ".venv-metadrive" / "bin"
TOWNS, DRIVEN = 200, 20


def run(program, *arguments):
    """Runs a program in MetaDrive's environment; returns the lines of JSON that it prints."""
    command = [PROGRAMS / "python", Path(__file__).with_name(program), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env={"PATH": ""})
    assert done.returncode == 0, done.stderr[-3000:]
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"name"')]


@pytest.mark.slow
def test_metadrive_loads_towns_steps_and_its_drivers_reach_their_goals(tmp_path):
    if not (PROGRAMS / "python").exists():
        pytest.skip("MetaDrive is not here: make metadrive")
    expected = {}
    for number in range(TOWNS):
        grid, name = draw(3 * number + 2), str(number)
        plain = to_sumo(as_map(grid), name)
        for suffix, text in zip(FORMATS["sumo"].suffixes, plain, strict=True):
            (tmp_path / f"{name}{suffix}").write_text(text)
        subprocess.run([PROGRAMS / "netconvert", "-c", tmp_path / f"{name}.netccfg"], check=True, capture_output=True)
        roads = to_opendrive(as_map(grid))
        (tmp_path / f"{name}.xodr").write_text(roads)
        expected[name] = {f"{edge}_0" for edge in read(plain)[1]}, roads.count("<road ")
    # Cars drive in the smallest towns, because a step takes longer in larger ones.
    files = [str(tmp_path / name) for name in sorted(expected, key=lambda name: expected[name][1])]
    lines = run("metadrive_reads.py", str(DRIVEN), *files)
    assert len(lines) == TOWNS
    for index, line in enumerate(lines):
        lanes, roads = expected[line["name"]]
        assert {lane for lane in line["lanes"] if not lane.startswith(":")} == lanes
        assert line["roads"] == roads
        if index < DRIVEN:
            assert line["arrived"] == 2 and line["aside"] < 4, line


def lanes_and_links(grid):
    """The ids of the lanes, and of each lane with one that continues it, by the graph of tiles."""
    graph = lane_graph(grid)
    # In the order of row, column, heading, and turn: right, straight, left, back.
    lanes = sorted(graph, key=lambda lane: (*lane[:3], (lane[2] + 1 - lane[3]) % 4))
    numbers = {lane: str(index) for index, lane in enumerate(lanes)}
    return set(numbers.values()), {(numbers[lane], numbers[after]) for lane, after in graph.edges}


@pytest.mark.slow
@pytest.mark.parametrize(("streets", "towns"), [(Streets(), 50), (Streets(tile_size=8, speed=5), 20)])
def test_scenarios_are_sane_and_all_cars_follow_their_logs_to_the_end(streets, towns, tmp_path):
    if not (PROGRAMS / "python").exists():
        pytest.skip("MetaDrive is not here: make metadrive")
    # 6 x 6, 9 x 9 and 12 x 12, from three sources. Six of the towns have dead ends.
    seeds = [seed for seed in range(108) if seed % 18 < 9][:towns]
    grids = {}
    files = []
    for seed in seeds:
        files.append(tmp_path / f"sd_{seed}.pkl")
        grids[files[-1].name] = draw(seed)
        road_map = furnish(grids[files[-1].name], "signs=possible lights=0.3")
        files[-1].write_bytes(to_scenarionet(road_map, str(seed), streets, seed=seed))
    for name, content in index_scenarios(tmp_path, files).items():
        (tmp_path / name).write_bytes(content)
    lines = run("scenarionet_reads.py", str(tmp_path))
    assert [line["name"] for line in lines] == list(grids)
    for line in lines:
        lanes, links = lanes_and_links(grids[line["name"]])
        assert set(line["lanes"]) == lanes
        assert set(map(tuple, line["links"])) == links
        assert line["arrived"] and line["route"] > 0.999, line["name"]
        assert line["crashes"] == 0 and line["aside"] < 1e-3, line["name"]
        assert line["cars"] > 1 and line["steps"] > 10, line["name"]
    if streets == Streets():
        # In a small town the car comes back to where it was, and the scenario ends before.
        steps = [line["steps"] for line in lines]
        assert max(steps) == 90 and steps.count(90) > 0.9 * len(steps)
