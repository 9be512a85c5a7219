"""The page on exports: its commands and its program run, and show what it shows."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from elitelanes_jax.cli import _parser, main
from elitelanes_jax.exports.boxes import boxes
from elitelanes_jax.roadmap import RoadMap, to_json

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "exports.md").read_text()
COMMANDS = re.findall(r"^elitelanes .*$", PAGE, re.MULTILINE)
(SHOWN,) = re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)
(PROGRAM,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)

pytestmark = pytest.mark.usefixtures("own_compile_cache")


def shown_grid():
    """The codes of the map that the page shows."""
    sign = {boxes([[code, 0], [0, 0]])[:1].strip() or " ": code for code in range(16)}
    lines = SHOWN.partition("\n\n")[0].splitlines()
    width = max(map(len, lines))
    return np.array([[sign[line.ljust(width)[column]] for column in range(0, width, 2)] for line in lines])


def test_commands_run_and_show_what_is_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    searches = [command for command in COMMANDS if command.startswith("elitelanes generate")]
    show, *others = [command for command in COMMANDS if command not in searches]
    for search in searches:
        assert callable(_parser().parse_args(shlex.split(search)[1:]).run)
    for number in range(4):
        file = Path("maps", "maps", f"{number:04d}", "map.json")
        file.parent.mkdir(parents=True)
        file.write_text(to_json(RoadMap(shown_grid())))
    assert main(shlex.split(show)[1:]) == 0
    assert capsys.readouterr().out == SHOWN
    for command in others:
        assert main(shlex.split(command)[1:]) == 0
    assert (len(searches), len(others)) == (2, 7)


def test_the_program_prints_what_it_says(capsys):
    exec(compile(PROGRAM, "exports.md", "exec"), {})
    assert capsys.readouterr().out.splitlines() == re.findall(r"print\(.*\)  # (.*)$", PROGRAM, re.MULTILINE)


def test_links_and_targets_are_there():
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", PAGE):
        assert (ROOT / "docs" / link).exists(), link
    for target in re.findall(r"`make (\S+)`", PAGE):
        assert f"\n{target}:" in (ROOT / "Makefile").read_text()
