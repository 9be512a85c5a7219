"""What readers by others should count: the maps of make readers, and our own files by the same counts."""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "readers"))

from check import Reader, check, expected, furnished, odd, python_of, readers, write_files

from elitelanes_jax.formats import RoadMap
from elitelanes_jax.formats.commonroad import to_commonroad
from elitelanes_jax.formats.opendrive import to_opendrive

RING_AND_KNOT = RoadMap([[6, 3, 0, 6, 3, 0], [12, 9, 0, 12, 15, 1], [0, 0, 0, 0, 8, 0]])


def counted(road_map):
    """The same counts from our own files."""
    root = ET.fromstring(to_opendrive(road_map))
    turns = len(list(root.iter("connection")))
    roads = len(list(root.iter("road"))) - turns
    names = [signal.get("name") for signal in root.iter("signal")]
    lanelets = ET.fromstring(to_commonroad(road_map)).findall("lanelet")
    return {
        "lanes": sum(lane.get("id") != "0" for lane in root.iter("lane")),
        "links": 2 * turns,
        "roads": roads,
        "turns": turns,
        "lanelets": len(lanelets),
        "follow": sum(len(one.findall("successor")) for one in lanelets),
        "stops": names.count("sign_stop"),
        "lights": names.count("trafficlight"),
    }


@pytest.mark.parametrize("seed", range(24))
def test_odd_maps_have_what_readers_should_count(seed):
    road_map = furnished(odd, seed, seed // 4)
    made, wanted = counted(road_map), expected(road_map, "opendrive")
    assert made == {name: wanted[name] for name in made}


def test_rings_and_roads_back_to_their_crossing_count_too():
    made, wanted = counted(RING_AND_KNOT), expected(RING_AND_KNOT, "opendrive")
    assert made == {name: wanted[name] for name in made} and wanted["roads"] == 2 + 4


def test_each_reader_has_a_program_and_pinned_packages():
    for reader in readers():
        assert (Path(__file__).parent / "readers" / (reader.program or f"read_{reader.name}.py")).exists()
        assert all("==" in package for package in reader.packages[:1])
    assert len(readers()) >= 12


def test_a_reader_that_crashes_at_a_file_reads_the_others(tmp_path, monkeypatch):
    """A crash ends its program, so it starts again with the next file."""
    program = tmp_path / "read_test.py"
    program.write_text(
        "import os, sys\n"
        "for file in sys.argv[1:]:\n"
        "    if file.endswith('bad'):\n"
        "        os._exit(9)\n"
        """    print('READ {"lanes": 1}', flush=True)\n"""
    )
    monkeypatch.setattr(Reader, "environment", lambda self: Path(python_of("3.11")))
    reader = Reader("test", "test", "opendrive", (), program=str(program))
    said = reader.read([Path("a"), Path("bad"), Path("c")])
    assert [one.get("lanes") for one in said] == [1, None, 1] and "ended with 9" in said[1]["error"]


def test_a_map_keeps_its_kind_if_another_has_the_same_file(tmp_path, monkeypatch):
    batch = [("by people", RING_AND_KNOT), ("drawn", RING_AND_KNOT)]
    monkeypatch.setattr(Reader, "results", property(lambda self: tmp_path / "test.jsonl"))
    monkeypatch.setattr(Reader, "read", lambda self, files: [{"lanelets": 1} for _ in files])
    reader, known = Reader("test", "test", "lanelet2", ()), {}
    for _ in range(2):
        lines = check(reader, batch, write_files("lanelet2", batch, tmp_path), known)
        assert [line["kind"] for line in lines] == ["by people", "drawn"]
        assert all(line["problem"].startswith("lanelets ") for line in lines)


def test_all_odd_maps_can_be_made():
    assert all(np.asarray(odd(seed)).any() for seed in range(100))
