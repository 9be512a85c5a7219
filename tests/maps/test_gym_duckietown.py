"""Furnished maps in gym-duckietown and dt-maps, in an environment of their own: make gym-duckietown."""

import json
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from test_furnish import TOWN

from elitelanes_jax.formats.dt_maps import to_dt_maps
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.maps import furnish

HERE = Path(__file__).parent / "gym_duckietown"
PYTHON = Path(__file__).parents[2] / ".venv-gym-duckietown" / "bin" / "python"

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not PYTHON.exists(), reason="make gym-duckietown")]


def run(program, *arguments):
    """Returns the lines of JSON that a program prints; the simulator prints other lines too."""
    command = [PYTHON, HERE / program, *map(str, arguments)]
    printed = subprocess.run(command, check=True, capture_output=True, encoding="utf-8").stdout
    return [json.loads(line) for line in printed.splitlines() if line.startswith("{")]


@pytest.fixture(scope="module")
def towns():
    """Furnished towns, one not square."""
    return [
        furnish(TOWN, "all signs lights=0.5", seed=0),
        furnish(np.pad(TOWN, ((2, 0), (0, 0))), "all signs street_names", seed=1),
    ]


def test_gym_duckietown_sees_the_signs_and_hits_nothing(towns, tmp_path):
    """All objects are where the file has them."""
    files = [tmp_path / f"{index}.yaml" for index in range(len(towns))]
    for file, town in zip(files, towns, strict=True):
        file.write_text(to_duckietown(town.codes, objects=town.objects), encoding="utf-8")
    for figures, town in zip(run("look.py", 4, *files), towns, strict=True):
        assert figures["pose_error"] < 1e-9
        assert figures["poses"] > 0
        assert figures["collisions"] == 0
        assert figures["both"] == figures["lines"] == min(4, figures["stop_lines"])
        assert figures["stop_lines"] == sum(thing.kind.endswith("_intersect") for thing in town.objects)


def test_dt_maps_reads_all_layers_and_joins_all_lanes(towns, tmp_path):
    """Its own graph of lanes has no loose end."""
    for name, text in to_dt_maps(as_map(towns[0])).items():
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    kinds = Counter(thing.kind.partition("_")[0] for thing in towns[0].objects)
    (figures,) = run("layers.py", tmp_path)
    assert figures == {"signs": kinds["sign"], "duckies": kinds["duckie"], "robots": kinds["duckiebot"], "loose": 0}
