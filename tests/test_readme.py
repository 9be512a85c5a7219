"""The README's examples run, and its commands are ones that there are."""

import re
import shlex
from pathlib import Path

import pytest
from pages import blocks, run_program

from elitelanes_jax.cli import _parser

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
EXPERIMENTS = (ROOT / "experiments" / "README.md").read_text()
PROGRAMS = [program for _, program in blocks(README + EXPERIMENTS, "python")]
COMMANDS = re.findall(r"^elitelanes .*$", README, re.MULTILINE)
TARGETS = re.findall(r"^make (\S+)", README, re.MULTILINE)


@pytest.mark.parametrize("program", PROGRAMS)
def test_programs_run_and_print_what_they_say(program, capsys):
    run_program(program, "README.md", capsys)


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_understood(command):
    assert callable(_parser().parse_args(shlex.split(command)[1:]).run)


def test_there_is_something_to_test():
    assert len(PROGRAMS) == 5
    assert len(COMMANDS) >= 4
    assert len(PROGRAMS[0].splitlines()) == 10


def test_make_targets_and_links_are_there():
    makefile = (ROOT / "Makefile").read_text()
    for target in TARGETS:
        assert f"\n{target}:" in makefile
    for folder, text in ((ROOT, README), (ROOT / "experiments", EXPERIMENTS)):
        for link in re.findall(r"\]\((?!https?:)([^)]+)\)", text):
            assert (folder / link.partition("#")[0]).exists(), link
