"""Helpers for tests of written pages."""

import re
import shlex

__all__ = ["blocks", "commands", "run_program"]


def blocks(text, *languages):
    """Returns the blocks of code on a page: language and text, in order."""
    return re.findall(rf"```({'|'.join(languages)})\n(.*?)```", text, re.DOTALL)


def commands(text):
    """Returns the arguments of each `elitelanes` command in the shell blocks of a page."""
    lines = [line for _, block in blocks(text, "sh") for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("elitelanes ")]


def run_program(program, name, capsys):
    """Runs a program and compares what it prints with the comments behind its prints."""
    exec(compile(program, name, "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    said = re.findall(r"^print\(.*\)  # (.*)$", program, re.MULTILINE)
    assert len(said) <= len(printed)
    for line, words in zip(printed[: len(said)], said, strict=True):
        assert words.split(": ")[0] == line or words == line
