"""Names that mean something to the program that reads them: each format holds a name as it is, or refuses it."""

import csv
import io
import json
import pickle
import re
import xml.etree.ElementTree as ET
from urllib.parse import unquote

import numpy as np
import pytest
import yaml
from odd_names import ODD_NAMES, REFUSED
from refusals import refused

from elitelanes_jax import RoadMap
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats import MapObject
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.table import table_to_csv
from elitelanes_jax.maps.exporting import FORMATS

TOWN = RoadMap([[6, 7, 3], [10, 10, 10], [12, 13, 9]], objects=[MapObject("tree", 0.5, 0.5, 0, 0.25)])


def read_sumo(files):
    """SUMO reads the codes of characters, after it has cut the spaces around a value and found its commas and homes."""
    value = ET.fromstring(files[3]).find("node-files").get("value").strip()
    assert not re.search(r"[,:~\\]|\$\{", value)
    return unquote(value).removesuffix(".nod.xml")


def read_opendrive(files):
    return ET.fromstring(files[0]).find("header").get("name")


def read_mujoco(files):
    return ET.fromstring(files[0]).find("asset/texture[@name='floor']").get("file").removesuffix(".png")


def read_movingai(files):
    """C++ and Python split a line where they find spaces."""
    words = [line.split() for line in files[1].decode().splitlines()[1:]]
    assert {len(line) for line in words} == {9}
    (name,) = {line[1] for line in words}
    return name.removesuffix(".map")


def read_pufferdrive(files):
    return json.loads(files[1])["name"]


def read_scenarionet(files):
    return pickle.loads(files[0])["metadata"]["scenario_id"]


def read_usd(files):
    """A path is what stands between two @ on a line."""
    (path,) = re.findall("@([^@\n]*)@", files[0].decode())
    return path.removeprefix("./").removesuffix(".png")


READERS = {
    "pufferdrive": read_pufferdrive,
    "scenarionet": read_scenarionet,
    "sumo": read_sumo,
    "opendrive": read_opendrive,
    "mujoco": read_mujoco,
    "usd": read_usd,
    "movingai": read_movingai,
}


@pytest.mark.parametrize("kind", ODD_NAMES)
@pytest.mark.parametrize("to", FORMATS)
def test_a_name_is_read_as_it_is_or_refused(to, kind):
    name = ODD_NAMES[kind]
    size = {"tile_px": 16} if "tile_px" in FORMATS[to].takes else {}
    if kind in REFUSED.get(to, ()):
        with refused("name", "'...'", expected="a name"):
            FORMATS[to].files(TOWN, name, **size)
        return
    files = list(FORMATS[to].files(TOWN, name, **size).values())
    if to in READERS:
        assert READERS[to](files) == name
    else:  # no name is in the files
        assert files == list(FORMATS[to].files(TOWN, "town", **size).values())


@pytest.mark.parametrize("kind", ODD_NAMES)
def test_a_table_has_a_name_as_it_is(kind):
    rows = [{"file": ODD_NAMES[kind], "tiles": 3}, {"file": "b", "tiles": 4}]
    if kind in REFUSED["csv"]:
        with refused("file", "'a\\udcff'", expected="name in"):
            table_to_csv(rows)
        return
    read = list(csv.reader(io.StringIO(table_to_csv(rows), newline="")))
    assert read == [["file", "tiles"], [ODD_NAMES[kind], "3"], ["b", "4"]]
    assert table_to_csv(row for row in rows) == table_to_csv(rows)


@pytest.mark.parametrize("kind", ["yes", "No", "1e3", "0x1F", "12", "1_2", "190", "on", "_", "boat", "x-1.5", "é"])
def test_a_kind_of_object_is_a_text_in_yaml(kind):
    """PyYAML reads what duckietown-world does."""
    text = to_duckietown(TOWN.codes, objects=[MapObject(f"other:{kind}", 0.5, 0.5, 0, 0.1)])
    assert yaml.safe_load(text)["objects"][f"{kind}_0"]["kind"] == kind


@pytest.mark.parametrize(("to", "kind"), [(to, kind) for to in READERS for kind in sorted(REFUSED.get(to, ()))])
def test_a_command_refuses_a_name_in_one_line_and_writes_nothing(to, kind, tmp_path, capsys):
    file = tmp_path / f"{ODD_NAMES[kind]}.json"
    file.write_text('{"codes": [[6, 3], [12, 9]]}')
    assert main(["export", str(file), "--to", to, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("elitelanes: ") and said.count("\n") == 1 and "expected a name" in said
    assert [one.name for one in tmp_path.iterdir()] == [file.name]


def test_scenarios_of_different_maps_have_different_ids():
    """Tools for CommonRoad keep results by the ID of a scenario."""
    maps = [TOWN, RoadMap(TOWN.codes), RoadMap([[6, 3], [12, 9]]), RoadMap(np.rot90([[6, 5, 3], [12, 5, 9]]))]
    texts = [
        FORMATS["commonroad"].files(one, "town", tile_size=size)["town.xml"] for one in maps for size in (30.0, 8.0)
    ]
    ids = [ET.fromstring(text).get("benchmarkID") for text in texts]
    assert all(re.fullmatch(r"ZAM_Tiles-[1-9]\d*_1_T-1", one) for one in ids)
    assert ids[:2] == ids[2:4] and len(set(ids)) == 6  # a tree is in no network
    assert texts[0] == FORMATS["commonroad"].files(maps[0], "town", tile_size=30.0)["town.xml"]
