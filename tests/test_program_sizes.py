"""A larger program is seen: `python tests/program_sizes.py` writes the new counts, which are committed."""

import json

import jax
import pytest
from program_sizes import FILE, count_all

from elitelanes_jax.optimizers import PRESETS


# Lowering takes most of the time.
@pytest.mark.parametrize("presets", [[("map-elites", "tuned")], pytest.param([*PRESETS], marks=pytest.mark.slow)])
def test_programs_are_as_large_as_the_file_says(presets):
    kept = json.loads(FILE.read_text(encoding="utf-8"))
    if kept["jax"] != jax.__version__:
        pytest.skip(f"the counts are those of JAX {kept['jax']}")
    found = count_all(presets)["programs"]
    assert set(found) <= set(kept["programs"]) and (len(presets) == 1 or len(found) == len(kept["programs"]))
    for name, counts in found.items():
        for unit, count in counts.items():
            assert count == pytest.approx(kept["programs"][name][unit], rel=0.02), (name, unit)
