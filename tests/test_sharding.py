"""Batches that are sharded over a mesh with explicit axes: each device computes its part, with the same results."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from batches import GROUPS

TESTS = Path(__file__).parent
FOUR = "--xla_force_host_platform_device_count=4"


@pytest.mark.parametrize(
    "group",
    [
        "few",
        *(pytest.param(name, marks=pytest.mark.slow) for name in GROUPS),
    ],
)
def test_sharded_batches_are_whole_batches(group):
    flags = f"{os.environ.get('XLA_FLAGS', '')} {FOUR}"
    environment = os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    command = [sys.executable, TESTS / "sharded.py", group]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr
