"""The page on long runs and many machines: its programs and scripts, on one machine."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from killed_runs import digest
from pages import blocks, run_program

from elitelanes_jax.cli.main import main

PAGE = (Path(__file__).parents[2] / "docs" / "scaling.md").read_text(encoding="utf-8")
PROGRAMS = [text for _, text in blocks(PAGE, "python")]
SMALL = ["--size", "5", "6", "--seeds", "6", "--maps", "3", "--tile-px", "16", "--method", "ea", "--preset", "paper"]
SMALL += ["--generations", "9000"]


@pytest.mark.parametrize("number", [0, 1, 2, 4, pytest.param(6, marks=pytest.mark.slow)])
def test_programs_run_and_print_what_they_say(number, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_program(PROGRAMS[number], "docs/scaling.md", capsys)


@pytest.fixture
def whole(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["generate", *SMALL, "--out", "whole"]) == 0
    return digest(Path("whole"))


@pytest.mark.slow
def test_the_script_for_slurm_runs_the_parts(whole):
    (script,) = (text for _, text in blocks(PAGE, "bash"))
    script = script.replace("--seeds 1000 --maps 100", " ".join(SMALL))
    here = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "SLURM_ARRAY_TASK_COUNT": "3"}
    for number in ("1", "2", "3", "2"):
        subprocess.run(["bash", "-c", script], env=here | {"SLURM_ARRAY_TASK_ID": number}, check=True)
    assert main(["merge", *(f"parts/{number}" for number in (1, 2, 3)), "--out", "maps"]) == 0
    assert digest(Path("maps")) == whole


@pytest.mark.slow
def test_the_program_with_spawned_processes_runs(tmp_path):
    (program,) = (text for text in PROGRAMS if "__main__" in text)
    file = tmp_path / "program.py"
    file.write_text(program)
    run = subprocess.run([sys.executable, file], capture_output=True, text=True, check=True)
    assert run.stdout == "4\n"
