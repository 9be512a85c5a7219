"""What tests of written pages share."""

import re

__all__ = ["blocks", "run_program"]


def blocks(text, *languages):
    """The blocks of code on a page: language and text, in order."""
    return re.findall(rf"```({'|'.join(languages)})\n(.*?)```", text, re.DOTALL)


def run_program(program, name, capsys):
    """Runs a program and compares what it prints with what its comments say that it does."""
    exec(compile(program, name, "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    said = re.findall(r"^print\(.*\)  # (.*)$", program, re.MULTILINE)
    assert len(said) <= len(printed)
    for line, words in zip(printed[: len(said)], said, strict=True):
        assert words.split(": ")[0] == line or words == line
