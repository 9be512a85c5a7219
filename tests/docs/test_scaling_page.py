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
SPEC = 'GenerateSpec(size=(5, 6), maps=3, seeds=6, tile_px=16, search=SearchSpec(method="ea", preset="paper", '
SPEC += "generations=9000)), 3"


@pytest.mark.parametrize("number", [0, 1, 2, 4])
def test_programs_run_and_print_what_they_say(number, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_program(PROGRAMS[number], "docs/scaling.md", capsys)


@pytest.fixture
def whole(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["generate", *SMALL, "--out", "whole"]) == 0
    return digest(Path("whole"))


def smaller(program):
    """The program with a small run in three parts."""
    program = program.replace("GenerateSpec(seeds=1000, maps=100), 10", SPEC)
    return program.replace("import GenerateSpec", "import GenerateSpec, SearchSpec")


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
def test_submitit_runs_the_parts(whole):
    pytest.importorskip("submitit")
    program = smaller(PROGRAMS[3])
    Path("program.py").write_text(program)
    subprocess.run([sys.executable, "program.py"], check=True)
    assert digest(Path("maps")) == whole
