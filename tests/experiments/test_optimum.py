"""The comparison of searches with proven optima runs, and continues."""

import numpy as np
import pytest

from experiments.search import optimum


@pytest.mark.slow
def test_it_runs_and_goes_on_where_it_was(tmp_path, monkeypatch):
    command, evolve = ["--quick", "--out", str(tmp_path)], optimum.evolve

    def interrupted(*args, **setting):
        if setting["spec"].options["method"] == "gwo" and args[1] == (8, 8):
            raise KeyboardInterrupt
        return evolve(*args, **setting)

    monkeypatch.setattr(optimum, "evolve", interrupted)
    assert optimum.main(command) == 130
    done = {file.name: file.read_bytes() for file in (tmp_path / "parts").iterdir()}
    monkeypatch.setattr(optimum, "evolve", evolve)
    assert optimum.main(command) == 0
    assert done.items() <= {file.name: file.read_bytes() for file in (tmp_path / "parts").iterdir()}.items()
    assert (tmp_path / "optimum.png").stat().st_size > 1000
    lines = (tmp_path / "optimum.md").read_text().splitlines()
    tables = "\n".join(lines).split("\n\n")
    widths = [{line.count("|") for line in table.splitlines()} for table in tables if table.startswith("|")]
    assert [len(width) for width in widths] == [1, 1]
    assert np.sum([line.startswith("| 12 A") for line in lines]) == 9
