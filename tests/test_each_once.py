"""Programs that are compiled as users compile them return what the unoptimised ones of the other tests return."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from compiled_programs import QUICK_FLAGS

from elitelanes_jax.optimizers import PRESETS

PROGRAM = Path(__file__).with_name("each_once.py")
METHODS = [":".join(names) for names in PRESETS if names[1] in ("tuned", "paper")]


def start(flags):
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"} | flags
    return subprocess.Popen([sys.executable, PROGRAM, *METHODS], env=environment, stdout=subprocess.PIPE)


@pytest.mark.slow
def test_optimised_programs_return_the_same_bits():
    """Every kernel, environment and method once. The oracles of the other tests check what they return."""
    processes = [start(flags) for flags in ({}, {"XLA_FLAGS": QUICK_FLAGS})]
    optimised, quick = (json.loads(process.communicate()[0]) for process in processes)
    assert optimised == quick
    assert set(METHODS) < set(quick)
