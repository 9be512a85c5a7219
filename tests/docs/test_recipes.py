"""The recipes in CONTRIBUTING.md are short, and do what they say. `test_pages` runs the program of the first one."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pages import blocks

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
CHANGES = [text for _, text in blocks(PAGE, "diff")]

PROGRAM = """
import jax
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.search.evolution import evolve
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset.spec import DatasetSpec
from elitelanes_jax.search.spec import SearchSpec

code = main("generate --size 2 2 --maps 1 --seeds 1 --generations 0 --note lake --out maps".split())
result = evolve(jax.random.key(0), (2, 2), generations=0, note="lake")
about = DatasetSpec(search=SearchSpec(note="lake")).to_plain()
print(code, result.search.settings.note, about["search"]["note"])
for make in (lambda: main(["generate", "--note", " ", "--out", "none"]), lambda: SearchSpec(note=1)):
    try:
        print(make())
    except InputError as error:
        print(error)
for command in ("generate", "dataset"):
    try:
        main([command, "--help"])
    except SystemExit:
        pass
"""


@pytest.fixture
def changed_package(tmp_path, monkeypatch):
    """A copy of the package with the recipe's lines in it, which other processes import."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "tiles").symlink_to(ROOT / "tiles")
    package = tmp_path / "elitelanes_jax"
    shutil.copytree(ROOT / "elitelanes_jax", package, ignore=shutil.ignore_patterns("__pycache__"))
    (place,) = re.findall(r"lines in `elitelanes_jax/(\S+)` add", PAGE)
    text = (package / place).read_text(encoding="utf-8")
    for change in CHANGES:
        before = "".join(line[1:] for line in change.splitlines(keepends=True) if line[0] != "+")
        assert text.count(before) == 1
        text = text.replace(before, "".join(line[1:] for line in change.splitlines(keepends=True)))
    (package / place).write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_a_new_option_is_one_field(changed_package):
    command = [sys.executable, "-c", PROGRAM]
    ran = subprocess.run(command, cwd=changed_package, env=os.environ, capture_output=True, text=True, check=True)
    run_record = json.loads((changed_package / "maps" / "run.json").read_text(encoding="utf-8"))
    assert run_record["settings"]["search"]["note"] == "lake"
    assert "\n0 lake lake\n2\nnote: expected a name, got 1\n" in ran.stdout
    assert ran.stderr.endswith("elitelanes: --note: expected a name, got ' '\n")
    assert len(re.findall(r"--note TEXT +words to keep with the maps\n", ran.stdout)) == 2
