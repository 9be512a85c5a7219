"""`export` returns the files that the command of this name writes."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import RoadMap, export
from elitelanes_jax.cli.main import main
from elitelanes_jax.maps import FormatOptions, furnish
from elitelanes_jax.maps.exporting import FORMATS
from elitelanes_jax.tiles import render

TOWN = furnish(Path(__file__).parents[2] / "docs" / "examples" / "town.json", "signs trees=2 duckies=1")
SETTINGS = {
    "tile_size": 0.6,
    "dead_ends": "grass",
    "lane": 0.2,
    "speed": 0.3,
    "right_of_way": "priority",
    "traffic_seed": 7,
    "tile_px": 16,
    "cells": 8,
}


def files_of_command(folder, to, options):
    TOWN.save("town.json")
    flags = []
    for setting, value in options.chosen().items():
        flags += ["--" + setting.replace("_", "-"), str(value)]
    assert main(["export", "town.json", "--to", to, "--out", folder, *flags]) == 0
    files = (file for file in Path(folder).rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


@pytest.mark.parametrize("to", FORMATS)
def test_files_are_those_of_the_command(to, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    taken = {setting: value for setting, value in SETTINGS.items() if setting in FORMATS[to].takes}
    for number, options in enumerate((FormatOptions(), FormatOptions(**taken))):
        written = files_of_command(str(number), to, options)
        files = export(TOWN, to, options, name="town")
        assert files == export("town.json", to, options, name="town")
        # The command also writes the index of a folder of scenarios.
        assert files.items() <= written.items()
        assert len(written) - len(files) == (2 if to == "scenarionet" else 0)
        assert all(isinstance(content, bytes) for content in files.values())


def test_the_picture_of_a_floor_has_sides_that_programs_take(monkeypatch):
    asked = []

    def draw(road_map, tiles, *, tile_px):
        asked.append(tile_px)
        return render(road_map, tiles, tile_px=16)

    monkeypatch.setattr("elitelanes_jax.tiles.rendering.render", draw)
    for shape in ((2, 2), (2, 40), (40, 2)):
        export(np.full(shape, 15), "usd")
    assert asked == [256, 204, 204]


@pytest.mark.parametrize("to", ["pufferdrive", "scenarionet"])
def test_another_traffic_seed_has_other_cars(to):
    default, first, second = (export(TOWN, to, FormatOptions(traffic_seed=seed)) for seed in (None, 0, 1))
    assert default == first
    assert default.keys() == second.keys() and default != second


@pytest.mark.parametrize("name", [Path("ring"), 5, None])
def test_a_name_is_a_text(name):
    """`index_scenarios` would refuse the scenario of a `Path`, because it reads texts and numbers alone."""
    with refused("name", repr(name)):
        export(TOWN, "scenarionet", name=name)


def test_a_map_that_a_format_cannot_hold_is_refused():
    with refused("grid", "dead ends at A1 ([0, 0]), B1 ([0, 1])"):
        export(RoadMap([[4, 1]]), "duckietown")
    with refused("grid", "2 tiles, all on roads to dead ends"):
        export(RoadMap([[4, 1]]), "duckietown", FormatOptions(dead_ends="grass"))
    with refused("name", "'my town.map'", expected="spaces"):
        export(TOWN, "movingai", name="my town")
    with refused("traffic_seed", "1"):
        export(TOWN, "sumo", FormatOptions(traffic_seed=1))
