"""A larger program is seen: `python tests/program_sizes.py` writes the new counts, which are committed."""

import json

import jax
import pytest
from program_sizes import FILE, count_all


def test_programs_are_as_large_as_the_file_says():
    kept = json.loads(FILE.read_text(encoding="utf-8"))
    if kept["jax"] != jax.__version__:
        pytest.skip(f"the counts are those of JAX {kept['jax']}")
    found = count_all()["programs"]
    assert found.keys() == kept["programs"].keys()
    for name, counts in found.items():
        for unit, count in counts.items():
            assert count == pytest.approx(kept["programs"][name][unit], rel=0.02), (name, unit)
