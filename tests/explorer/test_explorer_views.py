"""Every view of the page in Chromium, as ``views.mjs`` shows it: accessible by axe's rules, and not too wide."""

import json
import subprocess
from pathlib import Path

import pytest
from explored import IN_BROWSER, write_run

from elitelanes_jax import read_map
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.explorer.page import page_of
from elitelanes_jax.maps import furnish

HERE = Path(__file__).parent
TOWN = HERE.parents[1] / "docs" / "examples" / "town.json"

pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    (folder / "run.html").write_text(page_of(collect([write_run(folder / "run")])))
    furnished = furnish(read_map(TOWN), "all lights=0.2 duckies=6", seed=3)
    (folder / "furnished.html").write_text(page_of(collect([furnished])))
    command = ["node", HERE / "views.mjs", folder]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def test_axe_finds_no_serious_fault(seen):
    assert [fault for fault in seen["faults"] if fault["impact"] in ("serious", "critical")] == []


def test_nothing_is_wider_than_the_screen(seen):
    assert seen["overflow"] == []
