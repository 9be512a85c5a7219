"""Programs that are compiled as users compile them return what the unoptimised ones of the other tests return."""

import json
import os
import subprocess
import sys

import each_once


def test_optimised_programs_return_the_same_bits(monkeypatch):
    """Every kernel and every method once. The oracles of the other tests check what they return."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    monkeypatch.setattr(each_once._compiling, "_MOST_CELLS", None)  # `main` sets it
    optimised = subprocess.Popen([sys.executable, each_once.__file__], env=environment, stdout=subprocess.PIPE)
    here = each_once.main()
    assert json.loads(optimised.communicate()[0]) == here
