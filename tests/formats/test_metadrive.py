"""Networks in MetaDrive, which has an environment of its own: make metadrive."""

import json
import subprocess
from pathlib import Path

import pytest
from simulator_maps import draw
from sumo_drive import read

from elitelanes_jax.formats import to_opendrive, to_sumo
from elitelanes_jax.maps.exporting import FORMATS

PROGRAMS = Path(__file__).parents[2] / ".venv-metadrive" / "bin"
TOWNS, DRIVEN = 200, 20


@pytest.mark.slow
def test_metadrive_loads_towns_steps_and_its_drivers_reach_their_goals(tmp_path):
    if not (PROGRAMS / "python").exists():
        pytest.skip("MetaDrive is not here: make metadrive")
    expected = {}
    for number in range(TOWNS):
        grid, name = draw(3 * number + 2), str(number)
        plain = to_sumo(grid, name)
        for suffix, text in zip(FORMATS["sumo"].suffixes, plain, strict=True):
            (tmp_path / f"{name}{suffix}").write_text(text)
        subprocess.run([PROGRAMS / "netconvert", "-c", tmp_path / f"{name}.netccfg"], check=True, capture_output=True)
        roads = to_opendrive(grid)
        (tmp_path / f"{name}.xodr").write_text(roads)
        expected[name] = {f"{edge}_0" for edge in read(plain)[1]}, roads.count("<road ")
    # Cars drive in the smallest towns, because a step takes longer in larger ones.
    files = [str(tmp_path / name) for name in sorted(expected, key=lambda name: expected[name][1])]
    script = Path(__file__).with_name("metadrive_reads.py")
    command = [PROGRAMS / "python", script, str(DRIVEN), *files]
    done = subprocess.run(command, capture_output=True, text=True, env={"PATH": ""})
    assert done.returncode == 0, done.stderr[-3000:]
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"name"')]
    assert len(lines) == TOWNS
    for index, line in enumerate(lines):
        lanes, roads = expected[line["name"]]
        assert {lane for lane in line["lanes"] if not lane.startswith(":")} == lanes
        assert line["roads"] == roads
        if index < DRIVEN:
            assert line["arrived"] == 2 and line["aside"] < 4, line
