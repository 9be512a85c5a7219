"""Folders of results and command lines that all experiments share."""

import pytest

from elitelanes_jax import InputError
from experiments.common import kept, open_results


def test_results_are_made_once(tmp_path):
    file = tmp_path / "file.json"
    assert kept(file, lambda: {"made": 1}) == {"made": 1}
    assert kept(file, lambda: {"made": 2}) == {"made": 1}


def test_a_folder_that_an_early_end_left_is_used(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".settings.json.part").write_text("{")
    open_results(tmp_path / "out", {"seeds": 1})
    open_results(tmp_path / "out", {"seeds": 1})
    with pytest.raises(InputError, match="expected results of seeds 2, got some of 1"):
        open_results(tmp_path / "out", {"seeds": 2})
